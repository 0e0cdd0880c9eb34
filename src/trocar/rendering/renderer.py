"""The renderer: one image of a moment, from a snapshot of a world.

snapshot -> scenery (uploaded once a build) -> draw list -> GPU -> frame
"""

from __future__ import annotations

import io
import logging
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from trocar.errors import OvertakenError, TrocarError, UnknownNameError
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.geometry.se3 import check_transform, inverse
from trocar.rendering.buffers import Scenery, drawn_scenery, scenery
from trocar.rendering.context import driver, load, on_processor
from trocar.rendering.draw_list import PlacedObjects, draw_list, placed
from trocar.rendering.exposure import ENDLESS, metered, to_be_measured
from trocar.rendering.frames import Picture, StereoFrame
from trocar.rendering.gpu import NOTHING, Gpu
from trocar.rendering.look import AUTO, Look
from trocar.rendering.optics import Optics, optics
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import ShapeRecord, Snapshot

Array = NDArray[np.float64]
Shapes = Sequence[ShapeRecord]

_log = logging.getLogger("trocar")

#: Cameras whose optics are kept. Source: our own choice.
KEPT = 16


@dataclass(frozen=True)
class Channels:
    """Images that are rendered beside colour, and objects whose visible share is measured."""

    depth: bool = False
    ids: bool = False
    normals: bool = False
    visible: tuple[str, ...] = ()

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the card's outputs."""
        ids = self.ids or bool(self.visible)
        optional = (("DEPTH", self.depth), ("IDS", ids), ("NORMALS", self.normals))
        return ("COLOUR", *(name for name, on in optional if on))

    def with_(self, names: Collection[str]) -> Channels:
        """Return these and more."""
        return replace(self, **dict.fromkeys(names, True)) if names else self


class Renderer:
    """Draw what cameras see; from any thread, one picture at a time.

    Args:
        shapes: returns the shapes of a world and their build, called at first and when a snapshot
            is of another build: `lambda: (world.snapshot().build, world.shapes())`
        channels: images beside colour
        look: light, exposure, lens and sensor

    Attributes:
        contexts: number of times the graphics library was opened: more than 1 after it was lost
        driver: "llvmpipe (LLVM 15.0.6, 256 bits)" or a graphics card
        on_processor: whether that is the processor, and no graphics card
        triangles: of the newest picture, for each eye

    Raises:
        MissingExtraError: the extra `scope` is not installed
        TrocarError: there is no OpenGL; the Debian packages that bring it are named
    """

    def __init__(
        self,
        shapes: Callable[[], tuple[int, Shapes]],
        channels: Channels | None = None,
        look: Look | None = None,
    ) -> None:
        self._shapes, self.channels, self.look = shapes, channels or Channels(), look or Look()
        self._lock = threading.Lock()
        self._build: int | None = None
        self._things = NOTHING
        self._optics: dict[tuple[object, ...], tuple[CameraRecord, Optics, Optics]] = {}
        self.contexts = self.triangles = 0
        self._lost = load().Error, _LostError
        self._gpu: Gpu | None = None
        self._open()

    def render(
        self,
        snapshot: Snapshot,
        cameras: Mapping[str, CameraRecord],
        camera: str,
        *,
        stops: float | None = None,
        channels: Channels | None = None,
        poses: Mapping[str, ArrayLike] | None = None,
        only: Collection[str] | None = None,
    ) -> StereoFrame:
        """Draw what a camera sees, or would see if objects were elsewhere or not there.

        Args:
            snapshot: of the world
            cameras: its cameras; they are moved to where the snapshot has them
            camera: name of the one that is drawn
            stops: exposure; as the look has it when omitted, where it is automatic measured on
                this snapshot alone
            channels: images beside colour; as the renderer has it when omitted
            poses: {object: T_world_object (4, 4)} of objects that are elsewhere
            only: names of the objects that are there: "PSM1/wrist_yaw", "needle"; all when omitted

        Raises:
            UnknownNameError: no such camera or object; the known ones are listed
            InputError: a picture larger than the driver allows
            OvertakenError: a camera of another build
            TrocarError: the graphics library was lost and cannot be opened again
        """
        if camera not in cameras:
            raise UnknownNameError("camera", camera, cameras)

        def drawn() -> StereoFrame:
            chosen = channels or self.channels
            return self._drawn(snapshot, record, stops, chosen, poses or {}, only)

        with self._lock:
            record = cameras[camera].at(snapshot)
            try:
                return drawn()
            except self._lost as problem:
                _log.warning("the graphics context was lost (%s); it is made anew", problem)
                self._open()
                try:
                    return drawn()
                except self._lost as again:
                    raise TrocarError(f"the graphics context was lost twice: {again}") from again

    def meter(
        self, snapshot: Snapshot, cameras: Mapping[str, CameraRecord], camera: str
    ) -> tuple[float, float]:
        """Return automatic exposure of an endoscope [stops], and the median brightness then.

        Both are of this snapshot alone, and measured on small pictures without shadows.
        """
        with self._lock:
            gpu = self._gpu or self._open()
            with gpu.context:
                record = cameras[camera].at(snapshot)
                things = self._loaded(gpu, snapshot)
                objects = placed(things, snapshot, inverse(record.T_world_camera))
                return self._metered(gpu, objects, self._lenses(gpu, record)[1])

    def close(self) -> None:
        """Release the graphics library; `render` opens it again."""
        with self._lock:
            gpu, self._gpu = self._gpu, None
            if gpu is not None:
                gpu.release()

    # ------------------------------------------------------------------ inside

    def _open(self) -> Gpu:
        gpu = Gpu(self.look)
        with gpu.context:
            gpu.load(self._things)
        self._gpu = gpu
        self.driver, self.on_processor = driver(gpu.context), on_processor(gpu.context)
        self.contexts += 1
        return gpu

    def _drawn(
        self,
        snapshot: Snapshot,
        record: CameraRecord,
        stops: float | None,
        channels: Channels,
        poses: Mapping[str, ArrayLike],
        only: Collection[str] | None,
    ) -> StereoFrame:
        look, gpu = self.look, self._gpu or self._open()
        T_world_eyes = np.stack(record.T_world_eyes)
        with gpu.context:
            things = self._loaded(gpu, snapshot)
            there = None if only is None else np.isin(things.ids, things.numbers(only))
            moved = _posed(snapshot, things, poses)
            lenses, small = self._lenses(gpu, record)
            objects = placed(things, moved, inverse(record.T_world_camera))
            if stops is None:
                stops = self._exposure(gpu, objects, small, record.kind)
            listed = draw_list(objects, lenses, look.shadows, there, look.style == "plain")
            self.triangles = int(listed.seen[:, 0].sum()) // 3
            images = gpu.draw(listed, lenses, channels.outputs, snapshot.time, stops)
            visible = {
                name: self._visible(gpu, objects, lenses, number, images["IDS"])
                for name, number in zip(
                    channels.visible, things.numbers(channels.visible), strict=True
                )
            }
            error = gpu.context.error
        if error != "GL_NO_ERROR":
            raise _LostError(error)
        colour = _compressed(images["COLOUR"], look.jpeg) if look.jpeg else images["COLOUR"]
        return StereoFrame(
            camera=record.name,
            left=colour[0],
            right=colour[1] if len(lenses.eyes) > 1 else None,
            depth=images.get("DEPTH"),
            ids=images["IDS"] if channels.ids else None,
            normals=images.get("NORMALS"),
            names=things.names,
            time=snapshot.time,
            build=snapshot.build,
            calibration=lenses.shown,
            T_world_camera=T_world_eyes,
            exposure=stops,
            arms=snapshot.arms,
            visible=visible,
        )

    def _loaded(self, gpu: Gpu, snapshot: Snapshot) -> Scenery:
        """Upload the shapes of the snapshot's build and its drawings, and return all objects."""
        if snapshot.build != self._build:
            build, shapes = self._shapes()
            if build != snapshot.build:
                raise OvertakenError(
                    f"the snapshot is of build {snapshot.build} of the world, its shapes are of"
                    f" build {build}; ask for a new snapshot"
                )
            self._things, self._build = scenery(shapes), build
            gpu.load(self._things)
        if not snapshot.drawings:
            return self._things
        drawn = drawn_scenery(snapshot.drawings, self._things)
        gpu.load(self._things, drawn)
        return self._things.with_(drawn)

    def _lenses(self, gpu: Gpu, record: CameraRecord) -> tuple[Optics, Optics]:
        """Return a camera's optics, and those of the small picture that measures exposure."""
        key = id(record.calibration), record.kind
        if key not in self._optics:
            while len(self._optics) >= KEPT:
                self._optics.pop(next(iter(self._optics)))
            small = record.seeing(to_be_measured(record.calibration))
            distorted = self.look.distortion
            own, measuring = (optics(each, distorted, gpu.most) for each in (record, small))
            self._optics[key] = record, own, measuring
        return self._optics[key][1:]

    def _exposure(self, gpu: Gpu, objects: PlacedObjects, small: Optics, kind: str) -> float:
        """Return the stops of a picture alone."""
        if self.look.exposure != AUTO:
            return self.look.exposure
        if kind != "endoscope":
            return 0.0
        return self._metered(gpu, objects, small)[0]

    def _metered(self, gpu: Gpu, objects: PlacedObjects, small: Optics) -> tuple[float, float]:
        """Return exposure and median brightness, measured on two pictures of the left eye."""
        listed = draw_list(objects, small, shadows=False, alike=self.look.style == "plain")
        seen = [gpu.draw(listed, small, ("COLOUR",), 0.0, each) for each in (0.0, ENDLESS)]
        return metered(seen[0]["COLOUR"][0], seen[1]["COLOUR"][0], self.look.style)

    def _visible(
        self,
        gpu: Gpu,
        objects: PlacedObjects,
        lenses: Optics,
        number: int,
        ids: NDArray[np.int32],
    ) -> Array:
        """Return the visible ratio of an object for each eye, NaN out of its picture, (eyes,)."""
        alike = self.look.style == "plain"
        listed = draw_list(objects, lenses, False, objects.things.ids == number, alike)
        alone = gpu.draw(listed, lenses, ("IDS",), 0.0, 0.0)["IDS"]
        most, now = (np.count_nonzero(each == number, axis=(1, 2)) for each in (alone, ids))
        return np.where(most > 0, now / np.maximum(most, 1), np.nan)


class _LostError(Exception):
    """The graphics context is gone."""


def _posed(snapshot: Snapshot, things: Scenery, poses: Mapping[str, ArrayLike]) -> Snapshot:
    """Return a snapshot with objects elsewhere."""
    if not poses:
        return snapshot
    at, turn = snapshot.positions.copy(), snapshot.quaternions.copy()
    for number, given in zip(things.numbers(poses), poses.values(), strict=True):
        T, body = check_transform(given), things.bodies[things.ids == number][0]
        at[body], turn[body] = T[:3, 3], quaternion_from_matrix(T[:3, :3])
    return snapshot._replace(positions=at, quaternions=turn)


def _compressed(eyes: Picture, quality: int) -> Picture:
    """Compress pictures (eyes, h, w, 3) and return them decompressed, read-only."""
    found = np.empty_like(eyes)
    for k, eye in enumerate(eyes):
        stream = io.BytesIO()
        Image.fromarray(eye).save(stream, "jpeg", quality=quality)
        found[k] = np.asarray(Image.open(stream))
    found.setflags(write=False)
    return found
