"""Draws what cameras see from snapshots of a world; knows nothing of how the world moves."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.cameras import Intrinsics
from trocar.errors import InputError, TrocarError, UnknownNameError
from trocar.geometry.se3 import inverse
from trocar.rendering.card import Card, Drawing, EyeDrawing
from trocar.rendering.frames import StereoFrame
from trocar.rendering.lenses import pinhole, wide_pinhole
from trocar.rendering.library import load
from trocar.rendering.lighting import Light, room_light, scope_light
from trocar.rendering.look import Look
from trocar.rendering.scenery import Scenery, scenery
from trocar.rendering.sight import chosen_levels, commands, inside, middles, placed
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import ShapeRecord, Snapshot

if TYPE_CHECKING:
    import moderngl

Array = NDArray[np.float64]
Shapes = Sequence[ShapeRecord]

_log = logging.getLogger("trocar")

#: What is nearer than this to an eye, or farther, is not seen [m]. Source: our own choice: nothing
#: of a scope's own tip, and a whole room.
SCOPE_NEAR, SCOPE_FAR = 0.002, 12.0
VIEW_NEAR, VIEW_FAR = 0.02, 40.0
#: Behind everything: in a patient, and in a room. Source: chosen by eye.
DARK, WALL = (0.0, 0.0, 0.0), (0.80, 0.83, 0.86)
#: Objects that are larger than this throw no shadow in a room: floors [m]. Source: our own choice.
FLOOR = 2.5
#: Sharpness of a glint by gloss, and its strength: of plastic and cloth, of metal, of a wet film.
#: Source: chosen by eye.
SHARPNESS = 14.0, 900.0
DIELECTRIC, METAL, FILM = 0.25, 1.5, 0.35
#: Share of diffuse light that metal keeps: of what is around it, which a point of light is not.
METAL_DIFFUSE = 0.55


@dataclass(frozen=True)
class Channels:
    """What is wanted beside colour."""

    depth: bool = False
    ids: bool = False
    normals: bool = False

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the card's outputs."""
        wanted = (("DEPTH", self.depth), ("IDS", self.ids), ("NORMALS", self.normals))
        return ("COLOUR", *(name for name, on in wanted if on))


class Renderer:
    """Draws; may be called from any thread, one after the other.

    Args:
        shapes: asked for the shapes of a world and the build that they are of, at first and when a
            snapshot is of another build: `lambda: (world.snapshot().build, world.shapes())`
        channels: what is wanted beside colour
        look: light, exposure, lens and sensor

    Attributes:
        contexts: how often the graphics library was opened: more than once when it was lost

    Raises:
        TrocarError: there is no OpenGL; the Debian packages that bring it are named
    """

    def __init__(
        self,
        shapes: Callable[[], tuple[int, Shapes]],
        channels: Channels | None = None,
        look: Look | None = None,
    ) -> None:
        self._ask, self.channels, self.look = shapes, channels or Channels(), look or Look()
        self._lock = threading.Lock()
        self._build: int | None = None
        self._scenery = scenery(())
        self.contexts = 0
        self._card: Card | None = self._open()

    def render(
        self, snapshot: Snapshot, cameras: Mapping[str, CameraRecord], camera: str
    ) -> StereoFrame:
        """Draw what a camera sees.

        Args:
            snapshot: of the world
            cameras: its cameras; they are moved to where the snapshot has them
            camera: which

        Raises:
            UnknownNameError: no such camera; the known ones are listed
            InputError: a picture larger than the driver allows, or a camera of another build
            TrocarError: the graphics library was lost and cannot be opened again
        """
        if camera not in cameras:
            raise UnknownNameError("camera", camera, cameras)
        with self._lock:
            self._follow(snapshot)
            record = cameras[camera].at(snapshot)
            lost = load().Error, _LostError
            try:
                return self._drawn(snapshot, record)
            except lost as problem:
                _log.warning("the graphics context was lost (%s); it is made anew", problem)
                self._card = self._open()
                try:
                    return self._drawn(snapshot, record)
                except lost as again:
                    raise TrocarError(f"the graphics context was lost twice: {again}") from again

    def close(self) -> None:
        """Let go of the graphics library; `render` opens it again."""
        with self._lock:
            card, self._card = self._card, None
            if card is not None:
                card.release()

    # ------------------------------------------------------------------ inside

    def _open(self) -> Card:
        card = Card()
        self.contexts += 1
        with card.context:
            card.load(self._scenery, finishes(self._scenery, self.look))
        return card

    def _follow(self, snapshot: Snapshot) -> None:
        """Take the shapes of the snapshot's build."""
        if snapshot.build == self._build:
            return
        build, shapes = self._ask()
        if build != snapshot.build:
            raise InputError(
                f"the snapshot is of build {snapshot.build} of the world, its shapes are of build"
                f" {build}; ask for a new snapshot"
            )
        self._scenery = scenery(shapes)
        if self._card is None:
            self._card = self._open()
        else:
            with self._card.context:
                self._card.load(self._scenery, finishes(self._scenery, self.look))
        self._build = build

    def _drawn(self, snapshot: Snapshot, record: CameraRecord) -> StereoFrame:
        if self._card is None:
            self._card = self._open()
        with self._card.context:
            return self._frame(self._card, self._scenery, snapshot, record)

    def _frame(
        self, card: Card, things: Scenery, snapshot: Snapshot, record: CameraRecord
    ) -> StereoFrame:
        scope = record.kind == "endoscope"
        near, far = (SCOPE_NEAR, SCOPE_FAR) if scope else (VIEW_NEAR, VIEW_FAR)
        distorted = self.look.distortion and any(
            e.distortion.any() for e in record.calibration.eyes
        )
        lenses = [
            wide_pinhole(eye, near, far, card.most) if distorted else pinhole(eye, near, far)
            for eye in record.calibration.eyes
        ]
        T_reference_world = inverse(record.T_world_camera)
        eyes = [
            EyeDrawing(inverse(mount), lens)
            for mount, lens in zip(record.calibration.mounts, lenses, strict=True)
        ]
        drawing = self._drawing(things, snapshot, T_reference_world, eyes, scope)
        target = card.draw(drawing)
        pictures = _read(target, drawing.outputs, record.calibration.eyes)
        error = card.context.error
        if error != "GL_NO_ERROR":
            raise _LostError(error)
        return _packed(pictures, things, snapshot, record)

    def _drawing(
        self,
        things: Scenery,
        snapshot: Snapshot,
        T_reference_world: Array,
        eyes: list[EyeDrawing],
        scope: bool,
    ) -> Drawing:
        rows = placed(things, snapshot, T_reference_world)
        centres = middles(things, rows)
        frusta = [eye.lens.frustum(eye.T_eye_reference) for eye in eyes]
        seen = np.zeros(len(things.bodies), dtype=np.bool_)
        for frustum in frusta:
            seen |= inside(frustum, centres, things.radii)
        order = np.flatnonzero(seen)
        order = order[np.argsort(centres[order, 2] + things.radii[order], kind="stable")]
        level = chosen_levels(things, frusta[0], order, centres)
        light = self._light(things, centres, T_reference_world, frusta, scope)
        shading = np.zeros((0, 5), dtype=np.uint32)
        if self.look.shadows:
            throws = inside(light.frustum, centres, things.radii)
            if not scope:
                throws &= things.radii < FLOOR
            who = np.flatnonzero(throws)
            shading = commands(things, who, chosen_levels(things, frusta[0], who, centres))
        return Drawing(
            rows,
            commands(things, order, level),
            shading,
            eyes,
            light,
            self.look.vignette,
            2.0**self.look.exposure,
            DARK if scope else WALL,
            self.channels.outputs,
            self.look.samples,
        )

    def _light(
        self,
        things: Scenery,
        centres: Array,
        T_reference_world: Array,
        frusta: list,
        scope: bool,
    ) -> Light:
        if scope:
            return scope_light(frusta, SCOPE_FAR)
        small = things.radii < FLOOR
        world = (centres[small] - T_reference_world[:3, 3]) @ T_reference_world[:3, :3]
        if not len(world):
            return room_light(T_reference_world, np.zeros(3), 1.0)
        reach = things.radii[small][:, None]
        low, high = (world - reach).min(axis=0), (world + reach).max(axis=0)
        return room_light(T_reference_world, 0.5 * (low + high),
                          0.5 * float(np.linalg.norm(high - low)))  # fmt: skip


class _LostError(Exception):
    """The graphics context is gone."""


def finishes(things: Scenery, look: Look) -> NDArray[np.float32]:
    """Return how objects answer to light: sharpness and strength of glints, diffuse share, id."""
    metal = things.colours[:, 3].astype(np.float64)
    gloss = np.clip(things.gloss + 0.3 * look.wet * (1.0 - metal), 0.0, 1.0)
    low, high = SHARPNESS
    sharp = low * (high / low) ** gloss
    strength = gloss * (DIELECTRIC + (METAL - DIELECTRIC) * metal) + FILM * look.wet * (1.0 - metal)
    diffuse = 1.0 - (1.0 - METAL_DIFFUSE) * metal
    return np.stack([sharp, strength, diffuse, things.ids], axis=1).astype(np.float32)


def _read(
    target: moderngl.Framebuffer, outputs: tuple[str, ...], eyes: Sequence[Intrinsics]
) -> dict[str, np.ndarray]:
    """Return what was drawn: {output: (eyes, height, width[, components])}."""
    width, height = eyes[0].size
    shapes = {
        "COLOUR": ((3,), "f1", np.uint8),
        "DEPTH": ((), "f4", np.float32),
        "IDS": ((), "i4", np.int32),
        "NORMALS": ((3,), "f4", np.float32),
    }
    found: dict[str, np.ndarray] = {}
    for k, name in enumerate(outputs):
        tail, code, kind = shapes[name]
        found[name] = np.empty((len(eyes), height, width, *tail), dtype=kind)
        target.read_into(
            found[name].reshape(-1).view(np.uint8),
            components=tail[0] if tail else 1,
            attachment=k,
            alignment=1,
            dtype=code,
        )
        found[name].setflags(write=False)
    return found


def _packed(
    pictures: Mapping[str, np.ndarray], things: Scenery, snapshot: Snapshot, record: CameraRecord
) -> StereoFrame:
    colour = pictures["COLOUR"]
    return StereoFrame(
        camera=record.name,
        left=colour[0],
        right=colour[1] if len(colour) > 1 else None,
        depth=pictures.get("DEPTH"),
        ids=pictures.get("IDS"),
        normals=pictures.get("NORMALS"),
        names=things.names,
        time=snapshot.time,
        build=snapshot.build,
        calibration=record.calibration.undistorted(),
        T_world_camera=np.stack(record.T_world_eyes),
    )
