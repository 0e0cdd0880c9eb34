"""The graphics card's side of a renderer: buffers, programs, targets, and one drawing of it all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.rendering import shaders
from trocar.rendering.lenses import Pinhole
from trocar.rendering.library import limit, load, open_context
from trocar.rendering.lighting import Light
from trocar.rendering.scenery import Scenery

if TYPE_CHECKING:
    import moderngl

Array = NDArray[np.float64]
Commands = NDArray[np.uint32]

#: Pixels along an edge of the shadow map. Source: issue 8.
SHADOW_SIZE = 1024
#: What a shadow must be deeper by: slope, and units of the map's depth. Source: OpenGL's polygon
#: offset, chosen by eye: no surface is striped by its own shadow.
SHADOW_OFFSET = 2.0, 32.0
#: What each output holds: components and type.
FORMATS = {"COLOUR": (4, "f1"), "DEPTH": (1, "f4"), "IDS": (1, "i4"), "NORMALS": (4, "f4")}


@dataclass(frozen=True, eq=False)
class EyeDrawing:
    """One eye's part of a drawing: T_eye_reference (4, 4) and its lens."""

    T_eye_reference: Array
    lens: Pinhole


@dataclass(frozen=True, eq=False)
class Drawing:
    """What is drawn at one go.

    Attributes:
        rows: T_reference_object of every object, (m, 3, 4)
        seen: commands of what the eyes see, nearest first
        shading: commands of what throws shadows; empty without shadows
        eyes: their pictures stand above each other, the first on top
        light: in the reference frame
        shine: light power, softening, vignette, exposure, for the fragments
        backdrop: colour behind everything, 0 to 1
        outputs: "COLOUR", "DEPTH", "IDS", "NORMALS", in this order
        defines: of the shaders
        samples: of each pixel
    """

    rows: Array
    seen: Commands
    shading: Commands
    eyes: Sequence[EyeDrawing]
    light: Light
    vignette: float
    exposure: float
    backdrop: tuple[float, float, float]
    outputs: tuple[str, ...]
    samples: int = 0


class Card:
    """Draws scenery into textures. Made, used and released in one `with card.context`."""

    def __init__(self) -> None:
        self.context = open_context()
        self._gl = load()
        self.most = limit(self.context)
        self._scenery: Scenery | None = None
        self._programs: dict[tuple[str, ...], moderngl.Program] = {}
        self._arrays: dict[tuple[str, ...], moderngl.VertexArray] = {}
        self._targets: dict[tuple[object, ...], moderngl.Framebuffer] = {}
        self._shade = self.context.depth_texture((SHADOW_SIZE, SHADOW_SIZE))
        self._shade.compare_func = "<="
        self._shade.filter = (self._gl.LINEAR, self._gl.LINEAR)
        self._shade.repeat_x = self._shade.repeat_y = False
        self._shade_target = self.context.framebuffer([], self._shade)

    def load(self, scenery: Scenery, finishes: NDArray[np.float32]) -> None:
        """Take scenery.

        Args:
            scenery: what is drawn from now on
            finishes: of each object: sharpness and strength of its glints, share of diffuse light,
                id, (m, 4)
        """
        make = self.context.buffer
        count = max(1, len(scenery.bodies))
        self._points = make(_bytes(scenery.points, 12))
        self._normals = make(_bytes(scenery.normals, 12))
        self._indices = make(_bytes(scenery.indices, 4))
        self._colours = make(_bytes(scenery.colours, 16))
        self._finishes = make(_bytes(finishes, 16))
        self._rows = make(reserve=48 * count, dynamic=True)
        self._orders = [make(reserve=20 * count, dynamic=True) for _ in range(2)]
        for array in self._arrays.values():
            array.release()
        self._arrays.clear()
        self._scenery = scenery

    def draw(self, drawing: Drawing) -> moderngl.Framebuffer:
        """Draw, and return where it is: the eyes' pictures above each other, rows from the top."""
        self._rows.write(np.ascontiguousarray(drawing.rows, dtype=np.float32))
        for orders, what in zip(self._orders, (drawing.shading, drawing.seen), strict=True):
            if len(what):
                orders.write(what)
        context = self.context
        context.enable_only(self._gl.DEPTH_TEST | self._gl.CULL_FACE)
        context.front_face = "cw"
        context.depth_func = "<"
        if len(drawing.shading):
            self._draw_shadows(drawing)
        lens = drawing.eyes[0].lens
        size = lens.width, lens.height * len(drawing.eyes)
        target = self.target(size, drawing.outputs, drawing.samples)
        target.use()
        target.clear()
        self._draw_eyes(drawing)
        if drawing.samples:
            resolved = self.target(size, drawing.outputs)
            context.copy_framebuffer(resolved, target)
            return resolved
        return target

    def target(
        self, size: tuple[int, int], outputs: tuple[str, ...], samples: int = 0
    ) -> moderngl.Framebuffer:
        """Return a framebuffer of this size with these outputs.

        Raises:
            InputError: larger than the driver allows
        """
        if max(size) > self.most:
            raise InputError(
                f"a picture of {size[0]}x{size[1]} (eyes above each other): more than this"
                f" graphics driver can draw; allowed: up to {self.most} pixels wide and high"
            )
        key = (size, outputs, samples)
        if key not in self._targets:
            textures = [
                self.context.texture(size, FORMATS[o][0], dtype=FORMATS[o][1], samples=samples)
                for o in outputs
            ]
            depth = self.context.depth_renderbuffer(size, samples=samples)
            self._targets[key] = self.context.framebuffer(textures, depth)
        return self._targets[key]

    def release(self) -> None:
        """Let go of everything."""
        self.context.release()

    def program(
        self, kind: str, vertex: str, fragment: str, defines: Sequence[str]
    ) -> moderngl.Program:
        """Return a program, made when it is first asked for."""
        key = (kind, *defines)
        if key not in self._programs:
            self._programs[key] = self.context.program(
                shaders.source(vertex, defines), shaders.source(fragment, defines)
            )
        return self._programs[key]

    # ------------------------------------------------------------------ inside

    def _draw_shadows(self, drawing: Drawing) -> None:
        program = self.program("shadow", shaders.SHADOW_VERTEX, shaders.SHADOW_FRAGMENT, ())
        _tell(program, {"shadow": _columns(drawing.light.clip)})
        self._shade_target.use()
        self._shade_target.clear(depth=1.0)
        self.context.polygon_offset = SHADOW_OFFSET
        self._render("shadow", program, 0, drawing.shading)
        self.context.polygon_offset = 0.0, 0.0

    def _draw_eyes(self, drawing: Drawing) -> None:
        light = drawing.light
        defines = [f"{name} {k}" for k, name in enumerate(drawing.outputs)]
        behind = self.program("behind", shaders.BEHIND_VERTEX, shaders.BEHIND_FRAGMENT, defines)
        defines += ["SHADOWS"] if len(drawing.shading) else []
        defines += ["SCOPE"] if light.scope else []
        defines += ["VIGNETTE"] if drawing.vignette else []
        program = self.program("scene", shaders.VERTEX, shaders.FRAGMENT, defines)
        shared = {
            "shadow": _columns(light.clip),
            "power": (light.power, light.softening, drawing.vignette, drawing.exposure),
        }
        _tell(program, shared)
        _tell(behind, {"backdrop": drawing.backdrop})
        self._shade.use(0)
        for row, eye in enumerate(drawing.eyes):
            T, lens = eye.T_eye_reference, eye.lens
            cast("moderngl.Framebuffer", self.context.fbo).viewport = (
                0, row * lens.height, lens.width, lens.height,
            )  # fmt: skip
            _tell(
                program,
                {
                    "eye": _columns(T),
                    "pinhole": lens.clip,
                    "depths": lens.depths,
                    "light": tuple(T[:3, :3] @ light.at + T[:3, 3]),
                    "sky": (*(T[:3, :3] @ light.up), light.around),
                },
            )
            self._render("scene", program, 1, drawing.seen)
            self.context.depth_func = "<="
            self._behind_array(behind).render(self._gl.TRIANGLES, vertices=3)
            self.context.depth_func = "<"

    def _render(self, kind: str, program: moderngl.Program, order: int, what: Commands) -> None:
        if not len(what):
            return
        key = (kind, str(program.glo))
        if key not in self._arrays:
            content = [
                (self._points, "3f", "point"),
                (self._normals, "3f", "normal"),
                (self._rows, "4f 4f 4f/i", "row0", "row1", "row2"),
                (self._colours, "4f/i", "colour"),
                (self._finishes, "4f/i", "finish"),
            ]
            used = [entry for entry in content if all(name in program for name in entry[2:])]
            self._arrays[key] = self.context.vertex_array(
                program, used, self._indices, index_element_size=4
            )
        self._arrays[key].render_indirect(self._orders[order], self._gl.TRIANGLES, len(what))

    def _behind_array(self, program: moderngl.Program) -> moderngl.VertexArray:
        key = ("behind", str(program.glo))
        if key not in self._arrays:
            self._arrays[key] = self.context.vertex_array(program, [])
        return self._arrays[key]


def _tell(program: moderngl.Program, uniforms: Mapping[str, object]) -> None:
    """Set what the program has kept of these; a compiler drops what changes nothing."""
    for name, value in uniforms.items():
        if name in program:
            program[name] = value


def _columns(T: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in T.T.ravel())


def _bytes(array: NDArray[np.generic], least: int) -> bytes:
    """Return the bytes of an array, some where it is empty: a card has no empty buffers."""
    return array.tobytes() or bytes(least)
