"""The graphics card: uploads draw lists, draws them, and reads the images back.

A picture takes up to three passes: shadows into their map, both eyes into one target, and the
effects of lens and sensor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.rendering import context, shaders
from trocar.rendering.buffers import KINDS, Scenery, scenery
from trocar.rendering.draw_list import DrawList
from trocar.rendering.look import Look
from trocar.rendering.optics import Optics
from trocar.rendering.textures import BUMP, PLACES, TILE_M, mirrored, tissue

if TYPE_CHECKING:
    import moderngl

Array = NDArray[np.float64]
#: {output: (eyes, height, width[, components])}, read-only.
Images = dict[str, NDArray[Any]]

#: Sharpness of a glint without gloss and with all of it. Source: chosen by eye.
SHARPNESS = 5.0, 260.0
#: Strength of glints by gloss: of plastic and cloth, of metal; and of a wet film on them. Source:
#: chosen by eye.
DIELECTRIC, METAL, FILM = 0.45, 0.75, 0.25
#: Metal mirrors its surroundings, which are not drawn: factors of its glints' sharpness and of its
#: diffuse light, and the ratio of that which goes back to the light. Source: chosen by eye.
BROADER, METAL_DIFFUSE, BACKWARDS = 0.45, 0.75, 0.85
#: Gloss that a wet film adds to the surface below it. Source: chosen by eye.
SMOOTHER = 0.3
#: Depth by which a shadow must lie behind: slope, and units of the map's depth. Source: OpenGL's
#: polygon offset, chosen by eye: no surface is striped by its own shadow.
SHADOW_OFFSET = 2.0, 32.0
#: Surgical style: half the width of a shadow's soft edge in its map [px], distance from a contact
#: within which light from around is missing [m], and smoke that halves contrast [1/m]. Source:
#: chosen by eye.
SOFT, CONTACT, SMOKE = 1.6, 0.0025, 12.0
#: Distance of the threads of gauze [m]. Source: our own choice, coarse enough to be seen.
THREADS_M = 7e-4
#: Components and type of each output's texture.
FORMATS = {"COLOUR": (4, "f1"), "DEPTH": (1, "f4"), "IDS": (1, "i4"), "NORMALS": (4, "f4")}
#: Components and type of each output as it is read.
READ = {
    "COLOUR": (3, np.uint8),
    "DEPTH": (1, np.float32),
    "IDS": (1, np.int32),
    "NORMALS": (3, np.float32),
}
#: Samplers of the lens's pass by output, in the order of texture units; the unit after them has the
#: lens's map.
INPUTS = {"COLOUR": "colour_in", "DEPTH": "depth_in", "IDS": "ids_in", "NORMALS": "normals_in"}
#: Buffers of commands: of what throws shadows, of what is seen.
SHADING, SEEN = "shading", "seen"
#: Size of the smallest buffer [bytes]; OpenGL has no empty ones.
LEAST = 64
#: A scenery without objects.
NOTHING = scenery(())


class Gpu:
    """Buffers, programs and targets of one context. Used inside `with gpu.context`.

    Args:
        look: light, exposure, lens and sensor

    Attributes:
        context: the graphics library's
        most: largest width and height of a picture [px]

    Raises:
        MissingExtraError: the extra `scope` is not installed
        TrocarError: there is no OpenGL 4.3; the Debian packages that bring it are named
    """

    def __init__(self, look: Look) -> None:
        self.context, self._gl = context.open_context(), context.load()
        self.most = context.limit(self.context)
        self._look = look
        self._programs: dict[tuple[str, ...], moderngl.Program] = {}
        self._uniforms: dict[int, dict[str, Any]] = {}
        self._set: dict[tuple[int, str], object] = {}
        self._arrays: dict[tuple[str, int], moderngl.VertexArray] = {}
        self._targets: dict[tuple[object, ...], moderngl.Framebuffer] = {}
        self._maps: dict[tuple[int, bool], tuple[moderngl.Texture, moderngl.Framebuffer]] = {}
        self._structures: tuple[moderngl.Texture, moderngl.Texture, moderngl.Sampler] | None = None
        self._lens_map: tuple[Optics, moderngl.Texture] | None = None
        self._things: Scenery | None = None
        self._rows: Array | None = None
        self._listed: DrawList | None = None
        names = "point", "normal", "place", "index", "colour", "finish", "row", SHADING, SEEN
        self._buffers = {name: self.context.buffer(reserve=LEAST, dynamic=True) for name in names}

    def load(self, things: Scenery, drawn: Scenery = NOTHING) -> None:
        """Upload scenery for all pictures from now on, and drawings behind it.

        Args:
            things: uploaded when it is another one
            drawn: uploaded at every call; see `drawn_scenery`
        """
        if things is not self._things:
            self._things = things
            self._fixed = _columns_of(things, self._look)
            for name, rows in self._fixed.items():
                self._write(name, rows, np.empty(0, dtype=rows.dtype), renew=True)
        if drawn is not NOTHING:
            for name, rows in _columns_of(drawn, self._look).items():
                self._write(name, self._fixed[name], rows)

    def draw(
        self, listed: DrawList, lenses: Optics, outputs: Sequence[str], time: float, stops: float
    ) -> Images:
        """Draw a list, wait for the images and return them, rows from the top.

        Args:
            listed: uploaded unless the picture before was drawn from it
            lenses: the camera's
            outputs: "COLOUR", "DEPTH", "IDS", "NORMALS", in this order
            time: seeds the noise, and blood has spread for so long [s]
            stops: exposure

        Raises:
            InputError: more samples than the driver allows
        """
        self._upload(listed)
        ctx = self.context
        ctx.enable_only(self._gl.DEPTH_TEST | self._gl.CULL_FACE)
        ctx.front_face = "cw"
        ctx.depth_func = "<"
        shade = self._shadow_map(lenses.size[0], hard=listed.light.scope and self._plain)
        if len(listed.shading):
            self._draw_shadows(listed, *shade)
        size = lenses.drawn[0], lenses.drawn[1] * len(lenses.eyes)
        drawn: dict[str, tuple[moderngl.Framebuffer, int]] = {}
        for some, samples in self._passes(outputs):
            target = self._target(size, some, samples)
            target.use()
            _clear(target, some, listed.backdrop)
            self._draw_eyes(listed, lenses, some, (time, 2.0**stops), shade[0])
            if samples:
                whole = self._target(size, some)
                ctx.copy_framebuffer(whole, target)
                target = whole
            drawn |= {name: (target, k) for k, name in enumerate(some)}
        if lenses.places is not None or self._look.noise > 0.0:
            drawn = self._sense(drawn, lenses, time)
        return {name: _read(*place, name, lenses) for name, place in drawn.items()}

    def release(self) -> None:
        """Release the graphics library; not inside `with gpu.context`."""
        self.context.release()

    # ------------------------------------------------------------------ uploads

    def _upload(self, listed: DrawList) -> None:
        """Upload where objects are, and the commands that draw them."""
        if listed is self._listed:
            return
        self._listed = listed
        nothing = np.empty(0, dtype=np.float32)
        if listed.rows is not self._rows:
            self._rows = listed.rows
            self._write("row", nothing, np.ascontiguousarray(listed.rows, dtype=np.float32))
        self._write(SHADING, nothing, listed.shading)
        self._write(SEEN, nothing, listed.seen)

    def _write(
        self, name: str, fixed: NDArray[Any], rest: NDArray[Any], *, renew: bool = False
    ) -> None:
        """Write rows behind those that a buffer has, which grows when it must."""
        buffer = self._buffers[name]
        if renew or fixed.nbytes + rest.nbytes > buffer.size:
            buffer.orphan(max(fixed.nbytes + 2 * rest.nbytes, LEAST))
            if fixed.nbytes:
                buffer.write(fixed)
        if rest.nbytes:
            buffer.write(rest, offset=fixed.nbytes)

    # ------------------------------------------------------------------ passes

    @property
    def _plain(self) -> bool:
        return self._look.style == "plain"

    def _passes(self, outputs: Sequence[str]) -> list[tuple[tuple[str, ...], int]]:
        """Return outputs that are drawn together, and samples of each pixel.

        Means of ids or of depths across an edge are neither: only colours have many samples.
        """
        samples = self._look.samples
        if not samples:
            return [(tuple(outputs), 0)]
        if samples > self.context.max_samples:
            raise InputError(
                f"samples: got {samples}; allowed with this graphics driver: up to"
                f" {self.context.max_samples}"
            )
        several = [o for o in outputs if o == "COLOUR"], [o for o in outputs if o != "COLOUR"]
        return [(tuple(o), n) for o, n in zip(several, (samples, 0), strict=True) if o]

    def _draw_shadows(
        self, listed: DrawList, shade: moderngl.Texture, target: moderngl.Framebuffer
    ) -> None:
        program = self._program(shaders.SHADOW_VERTEX, shaders.SHADOW_FRAGMENT)
        self._uniform(program, {"shadow": _columns(listed.light.clip)})
        target.use()
        target.clear(depth=1.0)
        self.context.polygon_offset = SHADOW_OFFSET
        self._draw_commands(program, SHADING, 0, len(listed.shading))
        self.context.polygon_offset = 0.0, 0.0
        shade.use(0)
        if (gl := context.opengl_library()) is not None:
            gl.glFlush()  # the eyes' target is used then without a wait

    def _draw_eyes(
        self,
        listed: DrawList,
        lenses: Optics,
        outputs: Sequence[str],
        moment: tuple[float, float],
        shade: moderngl.Texture,
    ) -> None:
        """Draw the picture of both eyes; `moment` is (simulated time [s], factor of exposure)."""
        time, exposure = moment
        light, look, frustum = listed.light, self._look, listed.light.frustum
        surgical = light.scope and not self._plain
        switches = {
            "SHADOWS": bool(len(listed.shading)),
            "SCOPE": light.scope,
            "PARALLEL": lenses.parallel,
            "VIGNETTE": look.vignette > 0.0,
            "SURGICAL": surgical,
            "SMOKE": surgical and look.smoke > 0.0,
            "BLEEDING": surgical and look.bleeding > 0.0,
        }
        defines = _outputs(outputs) + [name for name, on in switches.items() if on]
        defines += [f"AROUND {light.around:.6f}", f"WEAVE {np.pi / THREADS_M:.6f}"]
        if surgical:
            self._bind_structures(shade)
        wide, tall = frustum.right - frustum.left, frustum.bottom - frustum.top
        common = {
            "shadow": _columns(light.clip),
            "power": (light.power * exposure, look.smoke * SMOKE, look.vignette, exposure),
            "blur": SOFT / shade.width,
            "reach": (CONTACT / wide, CONTACT / tall, frustum.near / CONTACT),
            "places": tuple((PLACES / TILE_M).ravel()),
            "bump": BUMP * TILE_M,
        }
        width, height = lenses.drawn
        target = self.context.fbo
        for kind, first, count in listed.kinds:
            own = [KINDS[kind].upper()] if KINDS[kind] else []
            program = self._program(shaders.VERTEX, shaders.FRAGMENT, [*defines, *own])
            self._uniform(program, common)
            for row, eye in enumerate(lenses.eyes):
                target.viewport = 0, row * height, width, height
                T, lens = eye.T_eye_reference, eye.lens
                at = tuple(T[:3, :3] @ light.at + T[:3, 3])
                sky = (*(T[:3, :3] @ light.up), light.around)
                own_eye = {"eye": _columns(T), "pinhole": lens.clip, "depths": lens.depths}
                self._uniform(program, {**own_eye, "light": at, "sky": sky})
                if switches["BLEEDING"]:
                    T_eye_world = T @ listed.T_reference_world
                    wound = T_eye_world[:3, :3] @ look.bleeding_at + T_eye_world[:3, 3]
                    pool = {"pool": (*wound, look.pool(time)), "rise": tuple(T_eye_world[:3, 2])}
                    self._uniform(program, pool)
                self._draw_commands(program, SEEN, first, count)

    def _bind_structures(self, shade: moderngl.Texture) -> None:
        """Bind the textures of the surgical style, generated at the first call."""
        if self._structures is None:
            nearest = self._gl.NEAREST, self._gl.NEAREST
            hollow = self.context.sampler(filter=nearest, texture=shade)
            skin = self._picture(tissue(self._look.blood), repeats=True)
            self._structures = skin, self._picture(mirrored(), repeats=False), hollow
        skin, mirror, hollow = self._structures
        skin.use(8)
        mirror.use(9)
        hollow.texture = shade
        hollow.use(10)

    def _sense(
        self,
        drawn: Mapping[str, tuple[moderngl.Framebuffer, int]],
        lenses: Optics,
        time: float,
    ) -> dict[str, tuple[moderngl.Framebuffer, int]]:
        """Apply the effects of lens and sensor to what was drawn."""
        outputs, look = list(drawn), self._look
        defines = _outputs(outputs)
        defines += ["PLACES"] if lenses.places is not None else []
        defines += ["NOISE"] if look.noise > 0.0 else []
        program = self._program(shaders.LENS_VERTEX, shaders.LENS_FRAGMENT, defines)
        size = lenses.size[0], lenses.size[1] * len(lenses.eyes)
        target = self._target(size, outputs, name="sensed")
        target.use()
        self.context.enable_only(self._gl.NOTHING)
        for unit, (name, (source, number)) in enumerate(drawn.items()):
            cast(Any, source.color_attachments[number]).use(unit)
            self._uniform(program, {INPUTS[name]: unit})
        if lenses.places is not None:
            self._lens_texture(lenses, lenses.places).use(len(outputs))
        grain = (look.seed * 2654435761 + round(time * 1e6) * 40503) % 2**32
        size = lenses.drawn[0], lenses.drawn[1] * len(lenses.eyes)
        lens = {"places": len(outputs), "size": size, "noise": look.noise, "seed": grain}
        self._uniform(program, lens)
        key = "all", program.glo
        if key not in self._arrays:
            make = cast(Any, self.context).vertex_array  # its types are partial
            self._arrays[key] = make(program, [])
        self._arrays[key].render(self._gl.TRIANGLES, vertices=3)  # one that covers everything
        return {name: (target, k) for k, name in enumerate(outputs)}

    # ------------------------------------------------------------------ what is kept

    def _draw_commands(self, program: moderngl.Program, which: str, first: int, count: int) -> None:
        """Draw some of the commands of a buffer, as `VertexArray.render_indirect` does."""
        if not count:
            return
        key, buffers = ("objects", program.glo), self._buffers
        if key not in self._arrays:
            content = [
                (buffers["point"], "3f", "point"),
                (buffers["normal"], "3f", "normal"),
                (buffers["place"], "3f", "place"),
                (buffers["row"], "4f 4f 4f/i", "row0", "row1", "row2"),
                (buffers["colour"], "4f/i", "colour"),
                (buffers["finish"], "4f/i", "finish"),
            ]
            used = [entry for entry in content if all(name in program for name in entry[2:])]
            make = cast(Any, self.context).vertex_array  # its types are partial
            self._arrays[key] = make(program, used, buffers["index"], index_element_size=4)
        array, gl = self._arrays[key], context.opengl_library()
        if gl is None:
            array.render_indirect(buffers[which], self._gl.TRIANGLES, count, first)
            return
        gl.glUseProgram(program.glo)
        gl.glBindVertexArray(array.glo)
        gl.glBindBuffer(context.DRAW_INDIRECT_BUFFER, buffers[which].glo)
        gl.glMultiDrawElementsIndirect(
            context.TRIANGLES,
            context.UNSIGNED_INT,
            first * context.COMMAND,
            count,
            context.COMMAND,
        )

    def _program(self, vertex: str, fragment: str, defines: Sequence[str] = ()) -> moderngl.Program:
        """Return a program, compiled at the first call."""
        key = vertex, fragment, *defines
        if key not in self._programs:
            self._programs[key] = self.context.program(
                shaders.source(vertex, defines), shaders.source(fragment, defines)
            )
        return self._programs[key]

    def _uniform(self, program: moderngl.Program, values: Mapping[str, object]) -> None:
        """Set those uniforms that the compiler kept and that have another value."""
        number = program.glo
        if number not in self._uniforms:
            self._uniforms[number] = {name: program[name] for name in program}
        known = self._uniforms[number]
        for name, value in values.items():
            if name in known and self._set.get((number, name)) != value:
                known[name].value = self._set[number, name] = value

    def _picture(self, pixels: NDArray[np.uint8], *, repeats: bool) -> moderngl.Texture:
        """Return a texture of pixels (height, width, 4), with smaller copies for what is far."""
        found = self.context.texture(pixels.shape[1::-1], 4, pixels.tobytes())
        found.build_mipmaps()
        found.filter = (self._gl.LINEAR_MIPMAP_NEAREST, self._gl.LINEAR)
        found.repeat_x = found.repeat_y = repeats
        return found

    def _lens_texture(self, lenses: Optics, places: NDArray[np.float32]) -> moderngl.Texture:
        """Return the places of the light of each pixel, of the newest distorted camera."""
        if self._lens_map is None or self._lens_map[0] is not lenses:
            if self._lens_map is not None:
                self._lens_map[1].release()
            size = places.shape[1], places.shape[0]
            data = np.ascontiguousarray(places, dtype=np.float32).tobytes()
            self._lens_map = lenses, self.context.texture(size, 2, data, dtype="f4")
        return self._lens_map[1]

    def _shadow_map(
        self, width: int, *, hard: bool
    ) -> tuple[moderngl.Texture, moderngl.Framebuffer]:
        """Return the shadow map of pictures of a width, and the target that draws into it.

        Args:
            width: of the picture [px]
            hard: a single pixel is looked up, which costs half, instead of a blend of four
        """
        if (width, hard) not in self._maps:
            size = self._look.shadow_map(width, hard=hard)
            shade = self.context.depth_texture((size, size))
            shade.compare_func = "<="
            between = self._gl.NEAREST if hard else self._gl.LINEAR
            shade.filter = (between, between)
            shade.repeat_x = shade.repeat_y = False
            self._maps[width, hard] = shade, self.context.framebuffer([], shade)
        return self._maps[width, hard]

    def _target(
        self, size: tuple[int, int], outputs: Sequence[str], samples: int = 0, name: str = ""
    ) -> moderngl.Framebuffer:
        """Return a framebuffer of this size with these outputs; another for each name."""
        key = size, tuple(outputs), samples, name
        if key not in self._targets:
            textures = [
                self.context.texture(size, FORMATS[o][0], dtype=FORMATS[o][1], samples=samples)
                for o in outputs
            ]
            for output, texture in zip(outputs, textures, strict=True):
                if not samples and output == "IDS":
                    texture.filter = (self._gl.NEAREST, self._gl.NEAREST)
            depth = self.context.depth_renderbuffer(size, samples=samples)
            self._targets[key] = self.context.framebuffer(textures, depth)
        return self._targets[key]


def _read(
    target: moderngl.Framebuffer, attachment: int, output: str, lenses: Optics
) -> NDArray[Any]:
    """Wait for an output of a target and read it, (eyes, height, width[, components])."""
    components, kind = READ[output]
    more = (components,) if components > 1 else ()
    found = np.empty((len(lenses.eyes), *lenses.size[::-1], *more), dtype=kind)
    width, height = lenses.size[0], lenses.size[1] * len(lenses.eyes)
    gl = context.opengl_library()
    if gl is None:
        target.read_into(
            found.reshape(-1).view(np.uint8),
            components=components,
            attachment=attachment,
            alignment=1,
            dtype=FORMATS[output][1],
        )
    else:
        gl.glBindFramebuffer(context.FRAMEBUFFER, target.glo)
        gl.glReadBuffer(context.FIRST_ATTACHMENT + attachment)
        gl.glPixelStorei(context.PACK_ALIGNMENT, 1)
        format_ = context.FORMATS[components, found.dtype.name]
        gl.glReadPixels(0, 0, width, height, *format_, found.ctypes.data)
    found.setflags(write=False)
    return found


def _clear(
    target: moderngl.Framebuffer, outputs: Sequence[str], backdrop: tuple[float, float, float]
) -> None:
    """Fill each output with its background: a colour, infinitely far, no id."""
    far, nothing = (np.inf, np.inf, np.inf, np.inf), (0.0, 0.0, 0.0, 0.0)
    for name, value in (("COLOUR", (*backdrop, 1.0)), ("DEPTH", far), ("", nothing)):
        own = [o == name if name else o in ("IDS", "NORMALS") for o in outputs]
        if any(own):
            _mask(target, own)
            target.clear(color=value)
    _mask(target, [True] * len(outputs))


def _mask(target: moderngl.Framebuffer, which: Sequence[bool]) -> None:
    masks: list[tuple[bool, ...]] = [(on,) * 4 for on in which]
    cast(Any, target).color_mask = tuple(masks) if len(masks) > 1 else masks[0]


def _outputs(outputs: Sequence[str]) -> list[str]:
    """Return the numbers of outputs as definitions for a shader."""
    return [f"{name} {k}" for k, name in enumerate(outputs)]


def _columns(T: Array) -> tuple[float, ...]:
    return tuple(T.T.ravel().tolist())


def _columns_of(things: Scenery, look: Look) -> dict[str, NDArray[Any]]:
    """Return the rows of each buffer for a scenery."""
    return {
        "point": things.points,
        "normal": things.normals,
        "place": things.places if look.style == "surgical" else things.places[:0],
        "index": things.indices,
        "colour": _shades(things),
        "finish": _finishes(things, look),
    }


def _shades(things: Scenery) -> NDArray[np.float32]:
    """Return colours as the shaders use them: roots of red, green, blue; and 1, (m, 4)."""
    metal = things.colours[:, 3:]
    diffuse = 1.0 - (1.0 - METAL_DIFFUSE) * metal
    roots = np.sqrt(np.hstack([things.colours[:, :3] * diffuse, np.ones_like(metal)]))
    return roots.astype(np.float32)


def _finishes(things: Scenery, look: Look) -> NDArray[np.float32]:
    """Return sharpness and strength of glints, metallic ratio and id of objects, (m, 4)."""
    metal = things.colours[:, 3].astype(np.float64)
    film = look.wet * (1.0 - metal)
    gloss = np.clip(things.gloss + SMOOTHER * film, 0.0, 1.0)
    low, high = SHARPNESS
    sharp = low * (high / low) ** (gloss * (1.0 - BROADER * metal))
    strength = gloss * (DIELECTRIC + (METAL - DIELECTRIC) * metal) + FILM * film
    return np.stack([sharp, strength, BACKWARDS * metal, things.ids], axis=1).astype(np.float32)
