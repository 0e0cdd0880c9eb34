"""The graphics card's side of a renderer: what is kept there between drawings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.rendering import shaders
from trocar.rendering.buffers import Scenery, scenery
from trocar.rendering.context import draw, limit, load, open_context
from trocar.rendering.look import Look

#: Sharpness of a glint without gloss and with all of it. Source: chosen by eye.
SHARPNESS = 5.0, 260.0
#: Strength of glints by gloss: of plastic and cloth, of metal; and of a wet film on them. Source:
#: chosen by eye.
DIELECTRIC, METAL, FILM = 0.45, 0.75, 0.25
#: Of metal, which mirrors what is around it, of which we draw nothing: how much broader its glints
#: are, its share of diffuse light, and how much of that looks back to where it came from. Source:
#: chosen by eye.
BROADER, METAL_DIFFUSE, BACKWARDS = 0.45, 0.75, 0.85
#: A wet film is this much smoother than what is under it. Source: chosen by eye.
SMOOTHER = 0.3


def shades(things: Scenery) -> NDArray[np.float32]:
    """Return colours as the shaders want them: roots of red, green, blue; and 1, (m, 4)."""
    metal = things.colours[:, 3:]
    share = 1.0 - (1.0 - METAL_DIFFUSE) * metal
    roots = np.sqrt(np.hstack([things.colours[:, :3] * share, np.ones_like(metal)]))
    return roots.astype(np.float32)


def finishes(things: Scenery, look: Look) -> NDArray[np.float32]:
    """Return sharpness and strength of glints, how metallic objects are, and their ids, (m, 4)."""
    metal = things.colours[:, 3].astype(np.float64)
    film = look.wet * (1.0 - metal)
    gloss = np.clip(things.gloss + SMOOTHER * film, 0.0, 1.0)
    low, high = SHARPNESS
    sharp = low * (high / low) ** (gloss * (1.0 - BROADER * metal))
    strength = gloss * (DIELECTRIC + (METAL - DIELECTRIC) * metal) + FILM * film
    return np.stack([sharp, strength, BACKWARDS * metal, things.ids], axis=1).astype(np.float32)


if TYPE_CHECKING:
    import moderngl

Commands = NDArray[np.uint32]

Array = NDArray[np.float64]


#: What each output holds: components and type.
FORMATS = {"COLOUR": (4, "f1"), "DEPTH": (1, "f4"), "IDS": (1, "i4"), "NORMALS": (4, "f4")}
#: Which commands: of what throws shadows, of what is seen.
SHADING, SEEN = "shading", "seen"
#: Bytes of the smallest buffer: a card has no empty ones.
LEAST = 64
#: No drawings.
NOTHING = scenery(())


class Card:
    """Buffers, programs and targets. Used inside `with card.context`.

    Attributes:
        context: the graphics library's
        gl: the library
        most: pixels that a picture may be wide and high
    """

    def __init__(self) -> None:
        self.context, self.gl = open_context(), load()
        self.most = limit(self.context)
        self._programs: dict[tuple[str, ...], moderngl.Program] = {}
        self._uniforms: dict[int, dict[str, Any]] = {}
        self._set: dict[tuple[int, str], object] = {}
        self._arrays: dict[tuple[str, int], moderngl.VertexArray] = {}
        self._targets: dict[tuple[object, ...], moderngl.Framebuffer] = {}
        self._maps: dict[tuple[int, bool], tuple[moderngl.Texture, moderngl.Framebuffer]] = {}
        self._ways: dict[int, list[moderngl.Buffer]] = {}
        self._things: Scenery | None = None
        names = "point", "normal", "place", "index", "colour", "finish", "row", SHADING, SEEN
        self._buffers = {name: self.context.buffer(reserve=LEAST, dynamic=True) for name in names}

    def load(self, things: Scenery, look: Look, drawn: Scenery = NOTHING) -> None:
        """Take scenery, which is drawn from now on, and what bends, which follows it.

        Args:
            things: whatever stays the same until it is another one
            look: of its surfaces
            drawn: see `drawn_scenery`
        """
        if things is not self._things:
            self._things = things
            self._fixed = _columns_of(things, look)
            for name, rows in self._fixed.items():
                self._write(name, rows, np.empty(0, dtype=rows.dtype), renew=True)
        if drawn is not NOTHING:
            for name, rows in _columns_of(drawn, look).items():
                self._write(name, self._fixed[name], rows)

    def place(self, rows: Array, shading: Commands, seen: Commands) -> None:
        """Take where objects are, (m, 3, 4), and what is drawn of them."""
        nothing = np.empty(0, dtype=np.float32)
        for name, what in (
            ("row", np.ascontiguousarray(rows, dtype=np.float32)),
            (SHADING, shading),
            (SEEN, seen),
        ):
            self._write(name, nothing, what)

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

    def render(self, program: moderngl.Program, which: str, first: int, count: int) -> None:
        """Draw so many commands with a program."""
        if not count:
            return
        key = "objects", program.glo
        if key not in self._arrays:
            buffers = self._buffers
            content = [
                (buffers["point"], "3f", "point"),
                (buffers["normal"], "3f", "normal"),
                (buffers["place"], "3f", "place"),
                (buffers["row"], "4f 4f 4f/i", "row0", "row1", "row2"),
                (buffers["colour"], "4f/i", "colour"),
                (buffers["finish"], "4f/i", "finish"),
            ]
            used = [entry for entry in content if all(name in program for name in entry[2:])]
            self._arrays[key] = self.context.vertex_array(
                program, used, buffers["index"], index_element_size=4
            )
        draw(program, self._arrays[key], self._buffers[which], first, count)

    def fill(self, program: moderngl.Program) -> None:
        """Draw one triangle that covers everything."""
        key = "all", program.glo
        if key not in self._arrays:
            self._arrays[key] = self.context.vertex_array(program, [])
        self._arrays[key].render(self.gl.TRIANGLES, vertices=3)

    def program(self, vertex: str, fragment: str, defines: Sequence[str] = ()) -> moderngl.Program:
        """Return a program, compiled at the first call."""
        key = vertex, fragment, *defines
        if key not in self._programs:
            self._programs[key] = self.context.program(
                shaders.source(vertex, defines), shaders.source(fragment, defines)
            )
        return self._programs[key]

    def uniforms(self, program: moderngl.Program, values: Mapping[str, object]) -> None:
        """Set what the program has kept of these, and has not already; compilers drop some."""
        number = program.glo
        if number not in self._uniforms:
            self._uniforms[number] = {name: program[name] for name in program}
        known = self._uniforms[number]
        for name, value in values.items():
            if name in known and self._set.get((number, name)) != value:
                known[name].value = self._set[number, name] = value

    def picture(self, pixels: NDArray[np.uint8], repeats: bool) -> moderngl.Texture:
        """Return a texture of pixels (height, width, 4), with smaller copies for what is far."""
        found = self.context.texture(pixels.shape[1::-1], 4, pixels.tobytes())
        found.build_mipmaps()
        found.filter = (self.gl.LINEAR_MIPMAP_NEAREST, self.gl.LINEAR)
        found.repeat_x = found.repeat_y = repeats
        return found

    def shadow_map(self, size: int, *, hard: bool) -> tuple[moderngl.Texture, moderngl.Framebuffer]:
        """Return a shadow map of this size, and what draws into it.

        Args:
            size: pixels along its edge
            hard: a single pixel is looked up, which costs half, instead of a blend of four
        """
        if (size, hard) not in self._maps:
            shade = self.context.depth_texture((size, size))
            shade.compare_func = "<="
            between = self.gl.NEAREST if hard else self.gl.LINEAR
            shade.filter = (between, between)
            shade.repeat_x = shade.repeat_y = False
            self._maps[size, hard] = shade, self.context.framebuffer([], shade)
        return self._maps[size, hard]

    def target(
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
                    texture.filter = (self.gl.NEAREST, self.gl.NEAREST)
            depth = self.context.depth_renderbuffer(size, samples=samples)
            self._targets[key] = self.context.framebuffer(textures, depth)
        return self._targets[key]

    def request(
        self, target: moderngl.Framebuffer, number: int, into: NDArray[Any]
    ) -> Callable[[], NDArray[Any]]:
        """Have a texture of a framebuffer sent, and return what waits for it.

        Args:
            target: where it was drawn
            number: which of its textures
            into: takes all rows, (eyes, height, width[, 3]), and is returned read-only
        """
        free = self._ways.setdefault(into.nbytes, [])
        buffer = free.pop() if free else self.context.buffer(reserve=into.nbytes)
        target.read_into(
            buffer,
            components=3 if into.ndim == 4 else 1,
            attachment=number,
            dtype={"uint8": "f1", "float32": "f4", "int32": "i4"}[into.dtype.name],
        )

        def take() -> NDArray[Any]:
            buffer.read_into(into.reshape(-1).view(np.uint8))
            free.append(buffer)
            into.setflags(write=False)
            return into

        return take

    def release(self) -> None:
        """Let go of everything; not inside `with card.context`."""
        self.context.release()


def _columns_of(things: Scenery, look: Look) -> dict[str, NDArray[Any]]:
    """Return what each buffer has of scenery."""
    return {
        "point": things.points,
        "normal": things.normals,
        "place": things.places if look.style == "surgical" else things.places[:0],
        "index": things.indices,
        "colour": shades(things),
        "finish": finishes(things, look),
    }
