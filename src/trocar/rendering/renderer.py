"""Draws what cameras see from snapshots of a world; knows nothing of how the world moves."""

from __future__ import annotations

import io
import logging
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from trocar.errors import OvertakenError, TrocarError, UnknownNameError
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.geometry.se3 import check_transform, inverse
from trocar.rendering.buffers import Scenery, drawn_scenery, scenery
from trocar.rendering.context import driver, load, on_processor, read
from trocar.rendering.draw_list import Stage, stage
from trocar.rendering.exposure import ENDLESS, TARGET, aim_at, stops_of, to_be_measured
from trocar.rendering.frames import Picture, StereoFrame
from trocar.rendering.gpu import NOTHING, Card
from trocar.rendering.look import AUTO, Look
from trocar.rendering.optics import Optics, optics
from trocar.rendering.painter import Drawn, Painter
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import ShapeRecord, Snapshot

Array = NDArray[np.float64]
#: Returns what was drawn: {output: (eyes, height, width[, components])}.
Pictures = Callable[[], dict[str, np.ndarray]]
Shapes = Sequence[ShapeRecord]

_log = logging.getLogger("trocar")

#: How many cameras' lenses are kept at hand. Source: our own choice.
KEPT = 16
#: Moments that are drawn while pictures of the one before are on their way. Source: our own choice.
AHEAD = 2
#: What is read of each output: components, and the type of each.
READ = {
    "COLOUR": (3, np.uint8),
    "DEPTH": (1, np.float32),
    "IDS": (1, np.int32),
    "NORMALS": (3, np.float32),
}


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
    """Draws; may be called from any thread, one after the other.

    Args:
        shapes: asked for the shapes of a world and the build that they are of, at first and when a
            snapshot is of another build: `lambda: (world.snapshot().build, world.shapes())`
        channels: images beside colour
        look: light, exposure, lens and sensor

    Attributes:
        contexts: how often the graphics library was opened: more than once when it was lost
        driver: who draws: "llvmpipe (LLVM 15.0.6, 256 bits)" or a graphics card
        on_processor: whether that is the processor, and no graphics card
        triangles: how many the newest picture was drawn of, of each eye

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
        self._ask, self.channels, self.look = shapes, channels or Channels(), look or Look()
        self._lock = threading.Lock()
        self._build: int | None = None
        self._things = self._shown = scenery(())
        self._optics: dict[tuple[object, ...], tuple[CameraRecord, Optics]] = {}
        self.contexts = self.triangles = 0
        self._card: Card | None = None
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
            camera: which
            stops: exposure; as the look has it when omitted, where it is automatic measured on
                this snapshot alone
            channels: images beside colour; as the renderer has it when omitted
            poses: {object: T_world_object (4, 4)}: where these are instead
            only: what is there, by name: "PSM1/wrist_yaw", "needle"; everything when omitted

        Raises:
            UnknownNameError: no such camera or object; the known ones are listed
            InputError: a picture larger than the driver allows
            OvertakenError: a camera of another build
            TrocarError: the graphics library was lost and cannot be opened again
        """
        if camera not in cameras:
            raise UnknownNameError("camera", camera, cameras)
        lost = load().Error, _LostError
        channels, poses = channels or self.channels, poses or {}
        with self._lock:
            record = cameras[camera].at(snapshot)
            order = _Order(snapshot, record, stops, channels, poses, only)
            try:
                return self._drawn(order)
            except lost as problem:
                _log.warning("the graphics context was lost (%s); it is made anew", problem)
                self._open()
                try:
                    return self._drawn(order)
                except lost as again:
                    raise TrocarError(f"the graphics context was lost twice: {again}") from again

    def render_each(
        self,
        moments: Iterable[tuple[Snapshot, Mapping[str, CameraRecord]]],
        camera: str,
        *,
        stops: float | None = None,
        channels: Channels | None = None,
    ) -> Iterator[StereoFrame]:
        """Draw many moments, as `render` draws each, and yield their frames in order.

        A graphics card draws the next ones while pictures are on their way from it, which takes
        exposures that are given; processors gain nothing.

        Args:
            moments: snapshots of the world, and its cameras
            camera, stops, channels: as of `render`

        Raises:
            UnknownNameError, InputError, OvertakenError: as `render`
            TrocarError: the graphics library was lost
        """
        waiting: deque[Callable[[], StereoFrame]] = deque()
        for snapshot, cameras in moments:
            if camera not in cameras:
                raise UnknownNameError("camera", camera, cameras)
            with self._lock:
                card = self._card or self._open()
                with card.context:
                    record = cameras[camera].at(snapshot)
                    order = _Order(snapshot, record, stops, channels or self.channels)
                    waiting.append(self._begun(card, partial(_requested, card), order))
            if len(waiting) > AHEAD:
                yield self._taken(waiting.popleft())
        while waiting:
            yield self._taken(waiting.popleft())

    def close(self) -> None:
        """Let go of the graphics library; `render` opens it again."""
        with self._lock:
            card, self._card = self._card, None
            if card is not None:
                card.release()

    # ------------------------------------------------------------------ inside

    def _taken(self, waiting: Callable[[], StereoFrame]) -> StereoFrame:
        try:
            with self._lock:
                return waiting()
        except load().Error as problem:
            raise TrocarError(f"the graphics context was lost: {problem}") from problem

    def _open(self) -> Card:
        card = Card()
        with card.context:
            card.load(self._things, self.look)
        self._card, self._painter = card, Painter(card, self.look)
        self.driver, self.on_processor = driver(card.context), on_processor(card.context)
        self.contexts += 1
        return card

    def _drawn(self, order: _Order) -> StereoFrame:
        card = self._card or self._open()
        with card.context:
            finish = self._begun(card, _read, order)
            error = card.context.error
        if error != "GL_NO_ERROR":
            raise _LostError(error)
        return finish()

    def _begun(
        self,
        card: Card,
        read: Callable[[Mapping[str, Drawn], Optics], Pictures],
        order: _Order,
    ) -> Callable[[], StereoFrame]:
        """Draw, read with a function, and return what makes a frame of it."""
        snapshot, record, stops, channels, poses, only = order
        self._follow(card, snapshot)
        things = self._shown
        there = None if only is None else np.isin(things.ids, things.numbers(only))
        snapshot = _posed(snapshot, things, poses)
        exposure = self._exposed(card, snapshot, record) if stops is None else stops
        lenses = self._lenses(record, card.most)
        seen = self._staged(snapshot, record, lenses, self.look.shadows, there)
        self.triangles = int(seen.seen[:, 0].sum()) // 3
        paint = self._painter.paint
        pictures = read(paint(seen, lenses, channels.outputs, snapshot.time, exposure), lenses)
        numbers = things.numbers(channels.visible)
        alone: list[Pictures] = []
        for number in numbers:
            one = self._staged(snapshot, record, lenses, False, things.ids == number)
            alone.append(read(paint(one, lenses, ("IDS",), 0.0, 0.0), lenses))

        def frame() -> StereoFrame:
            images = pictures()
            colour = images["COLOUR"]
            if self.look.jpeg:
                colour = _compressed(colour, self.look.jpeg)
            visible: dict[str, Array] = {}
            for name, number, ids in zip(channels.visible, numbers, alone, strict=True):
                most, now = (
                    np.count_nonzero(each == number, axis=(1, 2))
                    for each in (ids()["IDS"], images["IDS"])
                )
                visible[name] = np.where(most > 0, now / np.maximum(most, 1), np.nan)
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
                T_world_camera=np.stack(record.T_world_eyes),
                exposure=exposure,
                arms=snapshot.arms,
                visible=visible,
            )

        return frame

    def _staged(
        self,
        snapshot: Snapshot,
        record: CameraRecord,
        lenses: Optics,
        shadows: bool,
        only: NDArray[np.bool_] | None = None,
    ) -> Stage:
        T_reference_world = inverse(record.T_world_camera)
        alike = self.look.style == "plain"
        return stage(self._shown, snapshot, T_reference_world, lenses, shadows, only, alike)

    def _exposed(self, card: Card, snapshot: Snapshot, record: CameraRecord) -> float:
        """Return the stops of a picture that is taken alone, of small ones without shadows."""
        if self.look.exposure != AUTO:
            return self.look.exposure
        if record.kind != "endoscope":
            return 0.0
        plain, endless = self._measured(card, snapshot, record, (0.0, ENDLESS))
        return stops_of(plain, endless, self._aim(endless))

    def _measured(
        self, card: Card, snapshot: Snapshot, record: CameraRecord, stops: Sequence[float]
    ) -> list[Picture]:
        """Return small pictures of the left eye without shadows, with some stops each."""
        small = record.seeing(to_be_measured(record.calibration))
        lenses = self._lenses(small, card.most)
        seen = self._staged(snapshot, small, lenses, shadows=False)
        paint = self._painter.paint
        drawn = (paint(seen, lenses, ("COLOUR",), 0.0, each) for each in stops)
        return [_read(one, lenses)()["COLOUR"][0] for one in drawn]

    def _aim(self, endless: Picture) -> float:
        return TARGET if self.look.style == "plain" else aim_at(endless)

    def aim(self, snapshot: Snapshot, cameras: Mapping[str, CameraRecord], camera: str) -> float:
        """Return the median brightness that automatic exposure aims at, 0 to 1."""
        if self.look.style == "plain":
            return TARGET
        with self._lock:
            card = self._card or self._open()
            with card.context:
                self._follow(card, snapshot)
                record = cameras[camera].at(snapshot)
                return self._aim(*self._measured(card, snapshot, record, (ENDLESS,)))

    def _follow(self, card: Card, snapshot: Snapshot) -> None:
        """Take the shapes of the snapshot's build, and its drawings."""
        if snapshot.build != self._build:
            build, shapes = self._ask()
            if build != snapshot.build:
                raise OvertakenError(
                    f"the snapshot is of build {snapshot.build} of the world, its shapes are of"
                    f" build {build}; ask for a new snapshot"
                )
            self._things, self._build = scenery(shapes), build
        self._shown = self._things
        drawn = NOTHING
        if snapshot.drawings:
            drawn = drawn_scenery(snapshot.drawings, self._things)
            self._shown = self._things.with_(drawn)
        card.load(self._things, self.look, drawn)

    def _lenses(self, record: CameraRecord, most: int) -> Optics:
        """Return a camera's optics, computed at the first call."""
        key = id(record.calibration), record.kind
        if key not in self._optics:
            while len(self._optics) >= KEPT:
                self._optics.pop(next(iter(self._optics)))
            self._optics[key] = record, optics(record, self.look.distortion, most)
        return self._optics[key][1]


class _Order(NamedTuple):
    """What to draw: arguments of `Renderer.render`."""

    snapshot: Snapshot
    record: CameraRecord
    stops: float | None
    channels: Channels
    poses: Mapping[str, ArrayLike] = {}
    only: Collection[str] | None = None


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
    """Return pictures (eyes, h, w, 3) as a stream that is compressed shows them, read-only."""
    found = np.empty_like(eyes)
    for k, eye in enumerate(eyes):
        stream = io.BytesIO()
        Image.fromarray(eye).save(stream, "jpeg", quality=quality)
        found[k] = np.asarray(Image.open(stream))
    found.setflags(write=False)
    return found


def _read(drawn: Mapping[str, Drawn], lenses: Optics) -> Pictures:
    """Wait for what was drawn: {output: (eyes, height, width[, components])}, read-only."""
    found: dict[str, np.ndarray] = {}
    for name, place in drawn.items():
        array = found[name] = _room(name, lenses)
        read(place.target, place.number, array.reshape(-1, *array.shape[2:]))
        array.setflags(write=False)
    return lambda: found


def _requested(card: Card, drawn: Mapping[str, Drawn], lenses: Optics) -> Pictures:
    """Have the card send what was drawn, and return what waits for it."""
    sent = {
        name: card.request(place.target, place.number, _room(name, lenses))
        for name, place in drawn.items()
    }

    def arrived() -> dict[str, np.ndarray]:
        with card.context:
            return {name: take() for name, take in sent.items()}

    return arrived


def _room(name: str, lenses: Optics) -> np.ndarray:
    """Return an array for an output of all eyes."""
    components, kind = READ[name]
    more = (components,) if components > 1 else ()
    return np.empty((len(lenses.eyes), *lenses.size[::-1], *more), dtype=kind)
