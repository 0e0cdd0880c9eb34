"""One drawing: shadows, then both eyes at one go, then what lens and sensor make of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.rendering import context, shaders
from trocar.rendering.buffers import KINDS
from trocar.rendering.draw_list import Stage
from trocar.rendering.gpu import SEEN, SHADING, Card
from trocar.rendering.look import Look
from trocar.rendering.optics import Optics
from trocar.rendering.textures import BUMP, PLACES, TILE_M, mirrored, tissue

if TYPE_CHECKING:
    import moderngl

Array = NDArray[np.float64]

#: What a shadow must be deeper by: slope, and units of the map's depth. Source: OpenGL's polygon
#: offset, chosen by eye: no surface is striped by its own shadow.
SHADOW_OFFSET = 2.0, 32.0
#: Inputs of the lens's pass by output, in the order of texture units; the last has its places.
INPUTS = {"COLOUR": "colour_in", "DEPTH": "depth_in", "IDS": "ids_in", "NORMALS": "normals_in"}


#: Of the surgical style: half the width of a shadow's soft edge in its map [px], how far from a
#: contact light from around is missing [m], and smoke that halves what is seen [1/m]. Source:
#: chosen by eye.
SOFT, CONTACT, SMOKE = 1.6, 0.0025, 12.0


@dataclass(frozen=True, eq=False)
class Drawn:
    """Where an output is: in which framebuffer, and which of its textures."""

    target: moderngl.Framebuffer
    number: int

    @property
    def texture(self) -> Any:
        """The texture itself."""
        return self.target.color_attachments[self.number]


class Painter:
    """Draws stages of one camera after the other. Used inside `with card.context`."""

    def __init__(self, card: Card, look: Look) -> None:
        self._card, self._look = card, look
        self._structures: tuple[moderngl.Texture, moderngl.Texture, moderngl.Sampler] | None = None
        self._places: dict[int, tuple[Optics, moderngl.Texture]] = {}

    def paint(
        self, stage: Stage, lenses: Optics, outputs: Sequence[str], time: float, stops: float
    ) -> dict[str, Drawn]:
        """Draw; the eyes' pictures are above each other, rows from the top.

        Args:
            stage: what is drawn
            lenses: the camera's
            outputs: "COLOUR", "DEPTH", "IDS", "NORMALS", in this order
            time: noise is another at another time [s]
            stops: brighter by so many
        """
        card = self._card
        card.place(stage.rows, stage.shading, stage.seen)
        card.context.enable_only(card.gl.DEPTH_TEST | card.gl.CULL_FACE)
        card.context.front_face = "cw"
        card.context.depth_func = "<"
        if len(stage.shading):
            self._shade(stage, lenses)
            context.flush()
        size = lenses.drawn[0], lenses.drawn[1] * len(lenses.eyes)
        found: dict[str, Drawn] = {}
        for some, samples in self._passes(outputs):
            target = card.target(size, some, samples)
            target.use()
            _clear(target, some, stage.backdrop)
            self._eyes(stage, lenses, some, 2.0**stops)
            if samples:
                whole = card.target(size, some)
                card.context.copy_framebuffer(whole, target)
                target = whole
            found |= {name: Drawn(target, k) for k, name in enumerate(some)}
        if lenses.places is not None or self._look.noise > 0.0:
            return self._sensed(found, lenses, time)
        return found

    # ------------------------------------------------------------------ inside

    def _passes(self, outputs: Sequence[str]) -> list[tuple[tuple[str, ...], int]]:
        """Return outputs that are drawn together, and samples of each pixel.

        Means of ids or of depths across an edge are neither: only colours have many samples.
        """
        samples = self._look.samples
        if samples > self._card.context.max_samples:
            raise InputError(
                f"samples: got {samples}; allowed with this graphics driver: up to"
                f" {self._card.context.max_samples}"
            )
        if not samples:
            return [(tuple(outputs), 0)]
        several = [o for o in outputs if o == "COLOUR"], [o for o in outputs if o != "COLOUR"]
        return [(tuple(o), n) for o, n in zip(several, (samples, 0), strict=True) if o]

    def _shade(self, stage: Stage, lenses: Optics) -> None:
        card = self._card
        program = card.program(shaders.SHADOW_VERTEX, shaders.SHADOW_FRAGMENT)
        card.uniforms(program, {"shadow": _columns(stage.light.clip)})
        shade, target = self._map(stage, lenses)
        target.use()
        target.clear(depth=1.0)
        card.context.polygon_offset = SHADOW_OFFSET
        card.render(program, SHADING, 0, len(stage.shading))
        card.context.polygon_offset = 0.0, 0.0
        shade.use(0)

    def _map(self, stage: Stage, lenses: Optics) -> tuple[moderngl.Texture, moderngl.Framebuffer]:
        """Return the shadow map of a camera, and what draws into it."""
        hard = stage.light.scope and self._look.style == "plain"
        return self._card.shadow_map(self._look.shadow_map(lenses.size[0], hard=hard), hard=hard)

    def _eyes(self, stage: Stage, lenses: Optics, outputs: Sequence[str], exposure: float) -> None:
        card, light, look = self._card, stage.light, self._look
        surgical = look.style == "surgical" and light.scope
        switches = {
            "SHADOWS": bool(len(stage.shading)),
            "SCOPE": light.scope,
            "PARALLEL": lenses.parallel,
            "VIGNETTE": look.vignette > 0.0,
            "SURGICAL": surgical,
            "SMOKE": surgical and look.smoke > 0.0,
        }
        defines = [f"{name} {k}" for k, name in enumerate(outputs)]
        defines += [name for name, on in switches.items() if on]
        defines.append(f"AROUND {light.around:.6f}")
        shade, _ = self._map(stage, lenses)
        if surgical:
            self._bind(look, shade)
        wide, tall = (
            light.frustum.right - light.frustum.left,
            light.frustum.bottom - light.frustum.top,
        )
        common = {
            "shadow": _columns(light.clip),
            "power": (light.power * exposure, look.smoke * SMOKE, look.vignette, exposure),
            "blur": SOFT / shade.width,
            "reach": (CONTACT / wide, CONTACT / tall, light.frustum.near / CONTACT),
            "places": tuple((PLACES / TILE_M).ravel()),
            "bump": BUMP * TILE_M,
        }
        for kind, first, count in stage.kinds:
            own = [KINDS[kind].upper()] if KINDS[kind] else []
            program = card.program(shaders.VERTEX, shaders.FRAGMENT, [*defines, *own])
            card.uniforms(program, common)
            for row, eye in enumerate(lenses.eyes):
                width, height = lenses.drawn
                target = cast("moderngl.Framebuffer", card.context.fbo)
                target.viewport = 0, row * height, width, height
                T, lens = eye.T_eye_reference, eye.lens
                at = tuple(T[:3, :3] @ light.at + T[:3, 3])
                sky = (*(T[:3, :3] @ light.up), light.around)
                own_eye = {"eye": _columns(T), "pinhole": lens.clip, "depths": lens.depths}
                card.uniforms(program, {**own_eye, "light": at, "sky": sky})
                card.render(program, SEEN, first, count)

    def _bind(self, look: Look, shade: moderngl.Texture) -> None:
        """Bind the textures of the surgical style, generated at the first call."""
        card = self._card
        if self._structures is None:
            hollow = card.context.sampler(filter=(card.gl.NEAREST, card.gl.NEAREST), texture=shade)
            pictures = card.picture(tissue(look.blood), True), card.picture(mirrored(), False)
            self._structures = *pictures, hollow
        skin, mirror, hollow = self._structures
        skin.use(8)
        mirror.use(9)
        hollow.texture = shade
        hollow.use(10)

    def _sensed(self, drawn: Mapping[str, Drawn], lenses: Optics, time: float) -> dict[str, Drawn]:
        """Return what lens and sensor make of pictures."""
        card, outputs = self._card, list(drawn)
        defines = [f"{name} {k}" for k, name in enumerate(outputs)]
        defines += ["PLACES"] if lenses.places is not None else []
        defines += ["NOISE"] if self._look.noise > 0.0 else []
        program = card.program(shaders.LENS_VERTEX, shaders.LENS_FRAGMENT, defines)
        target = card.target(
            (lenses.size[0], lenses.size[1] * len(lenses.eyes)), outputs, name="sensed"
        )
        target.use()
        card.context.enable_only(card.gl.NOTHING)
        for unit, name in enumerate(outputs):
            drawn[name].texture.use(unit)
            card.uniforms(program, {INPUTS[name]: unit})
        if lenses.places is not None:
            self._where(lenses).use(len(outputs))
        grain = (self._look.seed * 2654435761 + round(time * 1e6) * 40503) % 2**32
        size = lenses.drawn[0], lenses.drawn[1] * len(lenses.eyes)
        card.uniforms(
            program,
            {"places": len(outputs), "size": size, "noise": self._look.noise, "seed": grain},
        )
        card.fill(program)
        return {name: Drawn(target, k) for k, name in enumerate(outputs)}

    def _where(self, lenses: Optics) -> moderngl.Texture:
        """Return the places of the light of each pixel as a texture."""
        if id(lenses) not in self._places:
            for _, old in self._places.values():
                old.release()
            self._places.clear()
            places = np.ascontiguousarray(lenses.places, dtype=np.float32)
            size = places.shape[1], places.shape[0]
            texture = self._card.context.texture(size, 2, places.tobytes(), dtype="f4")
            self._places[id(lenses)] = lenses, texture
        return self._places[id(lenses)][1]


def _clear(
    target: moderngl.Framebuffer, outputs: Sequence[str], backdrop: tuple[float, float, float]
) -> None:
    """Put what is behind everything into each output: a colour, infinitely far, no id."""
    far = np.inf, np.inf, np.inf, np.inf
    nothing = 0.0, 0.0, 0.0, 0.0
    for name, value in (("COLOUR", (*backdrop, 1.0)), ("DEPTH", far), ("", nothing)):
        own = [o == name if name else o in ("IDS", "NORMALS") for o in outputs]
        if any(own):
            _open_for(target, own)
            target.clear(color=value)
    _open_for(target, [True] * len(outputs))


def _open_for(target: moderngl.Framebuffer, which: Sequence[bool]) -> None:
    masks: list[tuple[bool, ...]] = [(on,) * 4 for on in which]
    cast(Any, target).color_mask = tuple(masks) if len(masks) > 1 else masks[0]


def _columns(T: Array) -> tuple[float, ...]:
    return tuple(T.T.ravel().tolist())
