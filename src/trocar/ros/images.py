"""Topics and messages of the cameras, and their images in recordings.

Names are those of the dVRK's video pipeline. Source: jhu-dvrk dvrk_video, launch files: the rig's
name, then the eye, then ROS's own names (image_transport's for compressed images); an eye's frame
is `<rig>_<eye>_frame`. The rig's name is the camera's here.

The stamp of an image is that of the sample of the same moment, whose tf and states are published as
well.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.records import Calibration
from trocar.cameras.rectification import camera_infos
from trocar.descriptions.records import RigDescription
from trocar.errors import InputError
from trocar.live.images import SLACK_S, ImageRenderer, Order, Packer, Pictures, Shot, shots
from trocar.messages import cdr_encode, message_type
from trocar.recording import Extra, recorder_of
from trocar.ros.clock import SECOND, Beat, Stamp
from trocar.ros.message_builders import header
from trocar.ros.sample import Sample
from trocar.ros.sampler import Sampler
from trocar.ros.tf import eyes_of, frame_name
from trocar.ros.topic import IMAGES, Message, Topic

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.cameras import CameraRecord

IMAGE, COMPRESSED, INFO = (
    "sensor_msgs/Image",
    "sensor_msgs/CompressedImage",
    "sensor_msgs/CameraInfo",
)
What = Literal[
    "image", "compressed", "info", "depth", "depth info", "ids", "names", "overlay",
    "overlay compressed",
]  # fmt: skip
#: Topic of each kind below its eye's name: (name, type, unit, help).
KINDS: dict[What, tuple[str, str, str, str]] = {
    "image": ("image_raw", IMAGE, "rgb8", "image of {seen}, with its distortion"),
    "compressed": ("image_raw/compressed", COMPRESSED, "", "the same as JPEG or PNG"),
    "info": ("camera_info", INFO, "px", "calibration of {seen}, with every image"),
    "depth": ("depth/image_raw", IMAGE, "m", "32FC1: distance ahead of {seen}, or inf"),
    "depth info": ("depth/camera_info", INFO, "px", "camera_info of the depth"),
    "ids": ("ids/image_raw", IMAGE, "", "32SC1: body at each pixel of {seen}, or 0"),
    "names": ("ids/names", "std_msgs/String", "", 'JSON: {{"id": "name"}} of the bodies'),
    "overlay": ("overlay/image_raw", IMAGE, "rgb8", "image_raw with overlays"),
    "overlay compressed": ("overlay/image_raw/compressed", COMPRESSED, "", "the same, compressed"),
}
#: Kinds of every eye; kinds that are drawn for subscribers only; kinds in a recording.
PLAIN: tuple[What, ...] = ("image", "compressed", "info")
BESIDE: tuple[What, ...] = ("depth", "depth info", "ids", "names")
RECORDED: tuple[What, ...] = ("compressed", "info")
#: Kinds of images with overlays.
OVERLAID: tuple[What, ...] = ("overlay", "overlay compressed")


@dataclass(frozen=True)
class Origin:
    """The source of a topic's messages.

    Attributes:
        camera: name of the camera
        eye: "left" or "right"; "" of a camera that has one
        what: one of KINDS: the picture, the packed picture, the calibration, ...
    """

    camera: str
    eye: str
    what: What

    @property
    def frame_id(self) -> str:
        """Name of the eye's frame: x right, y down, z ahead."""
        return frame_name(self.camera, self.eye)


def camera_topics(rig: RigDescription, *, overlaid: bool = False) -> Iterator[tuple[Topic, Origin]]:
    """Yield the topics of a rig's cameras; overlaid: also those of images with overlays."""
    for camera in rig.cameras:
        names = PLAIN + BESIDE + (OVERLAID if overlaid else ())
        yield from rows_of(camera.name, camera.kind, names)


def rows_of(
    camera: str, kind: str, names: tuple[What, ...] = PLAIN + BESIDE
) -> Iterator[tuple[Topic, Origin]]:
    """Yield the topics of a camera, each with its origin."""
    for eye in eyes_of(kind):
        yield from rows_at(f"{camera}/{eye}" if eye else camera, camera, eye, names)


def rows_at(
    before: str, camera: str, eye: str, names: tuple[What, ...]
) -> Iterator[tuple[Topic, Origin]]:
    """Yield the topics of an eye under another name."""
    seen = f"the {eye} eye of {camera}" if eye else camera
    for what in names:
        name, kind, unit, text = KINDS[what]
        topic = Topic(
            f"{before}/{name}",
            kind,
            "pub",
            "event" if what == "names" else "camera",
            latched=what == "names",
            depth=IMAGES,
            unit=unit,
            help=text.format(seen=seen),
            key=f"{before}/{name}",
        )
        yield topic, Origin(camera, eye, what)


#: Encodings of sensor_msgs/Image. Source: sensor_msgs/image_encodings.h.
ENCODINGS = {"image": "rgb8", "overlay": "rgb8", "depth": "32FC1", "ids": "32SC1"}
#: Images that are drawn only for subscribers.
DRAWN = ("depth", "ids")


class Images:
    """Publish pictures, and take them with samples, so that stamps agree.

    Args:
        pictures: draws them
        world: that is drawn
        rows: topics of cameras with their origins
        rate_hz: pictures a second
        transports: returns the transports with the subscribed topics of each
        hand: hands a batch to a transport
    """

    def __init__(
        self,
        pictures: Pictures,
        world: World,
        rows: Iterable[tuple[Topic, Origin]],
        rate_hz: float,
        transports: Callable[[], Iterable[tuple[Any, frozenset[str]]]],
        hand: Callable[[Any, list[tuple[Topic, Message]]], None],
    ) -> None:
        self._pictures, self._world = pictures, world
        self._transports, self._hand = transports, hand
        self._topics: dict[str, Topic] = {}
        self._origins: dict[str, Origin] = {}
        for topic, origin in rows:
            self._topics[topic.name], self._origins[topic.name] = topic, origin
        self._names = frozenset(n for n, o in self._origins.items() if o.what != "names")
        self._named: dict[str, Mapping[int, str]] = {}
        self._publish: Callable[[str, Mapping[str, object]], None] = lambda _name, _values: None
        self._beat = Beat(rate_hz)
        self._subscribed: Callable[[], frozenset[str]] = frozenset
        self._leave: Callable[[], None] = lambda: None

    def cameras(self) -> Mapping[str, CameraRecord]:
        """Return the cameras as they are now; call it before the loop runs, or in its thread."""
        return self._pictures.cameras(self._world)

    def start(self, sampler: Sampler) -> None:
        """Take pictures with samples from now on."""
        self._subscribed, self._publish = lambda: sampler.wanted, sampler.put
        sampler.look = self.look
        self._pictures.led = True
        self._leave = self._pictures.add(self, self._beside)

    def stop(self) -> None:
        """Take no more."""
        self._leave()

    def look(self, sample: Sample) -> Sample:
        """Have a picture taken when one is due, in the loop's thread."""
        if not self._pictures.takes(self._beat.due(sample.elapsed)):
            return sample
        cameras = self._pictures.shoot(self._world, sample.stamp)
        return replace(sample, cameras=cameras) if cameras else sample

    def wanted(self) -> frozenset[str]:
        """Return the cameras with subscribed topics."""
        return frozenset(self._origins[name].camera for name in self._subscribed() & self._names)

    def _beside(self) -> Mapping[str, Collection[str]]:
        """Return the subscribed images of each camera beside its colours."""
        found: dict[str, set[str]] = {}
        for name in self._subscribed() & self._names:
            origin = self._origins[name]
            if origin.what in DRAWN:
                found.setdefault(origin.camera, set()).add(origin.what)
        return found

    def take(self, shot: Shot) -> None:
        """Publish a picture to its subscribers."""
        if shot.stamp is None:
            return
        made: dict[str, tuple[Topic, Message]] = {}
        self._publish_names(shot)
        for transport, names in self._transports():
            batch: list[tuple[Topic, Message]] = []
            for name in sorted(names & self._names):
                origin = self._origins[name]
                if origin.camera == shot.camera and _has(shot, origin):
                    if name not in made:
                        made[name] = self._topics[name], message(shot, origin, shot.stamp)
                    batch.append(made[name])
            if batch:
                self._hand(transport, batch)

    def _publish_names(self, shot: Shot) -> None:
        """Publish the id-to-name table when it changes."""
        if shot.frame.ids is None or self._named.get(shot.camera) == shot.frame.names:
            return
        self._named[shot.camera] = shot.frame.names
        text = json.dumps({str(number): name for number, name in shot.frame.names.items()})
        for name, origin in self._origins.items():
            if origin.camera == shot.camera and origin.what == "names":
                self._publish(name, {"data": text})


def message(shot: Shot, origin: Origin, stamp: Stamp) -> Message:
    """Return the message of a topic, from an image that the picture has."""
    head = header(stamp, origin.frame_id)
    if origin.what in ("info", "depth info"):
        infos = _infos(shot.calibration)
        return {"header": head, **infos[-1 if origin.eye == "right" else 0]}
    overlaid = origin.what in OVERLAID
    if origin.what in ("compressed", "overlay compressed"):
        data = shot.packed(origin.eye, overlaid=overlaid)
        return {"header": head, "format": shot.format, "data": data}
    picture = _pixels(shot, origin)
    height, width = picture.shape[:2]
    return {
        "header": head,
        "height": height,
        "width": width,
        "encoding": ENCODINGS[origin.what],
        "is_bigendian": int(sys.byteorder == "big" and picture.itemsize > 1),
        "step": picture.nbytes // height,
        "data": np.ascontiguousarray(picture).reshape(-1).view(np.uint8),
    }


def _has(shot: Shot, origin: Origin) -> bool:
    """Test whether the picture has an image: its subscription may be newer."""
    return origin.what not in DRAWN or getattr(shot.frame, origin.what) is not None


def _pixels(shot: Shot, origin: Origin) -> NDArray[np.generic]:
    if origin.what not in DRAWN:
        return shot.eye(origin.eye, overlaid=origin.what == "overlay")
    return getattr(shot.frame, origin.what)[-1 if origin.eye == "right" else 0]


@lru_cache(maxsize=16)
def _infos(calibration: Calibration) -> tuple[Message, ...]:
    """Return a sensor_msgs/CameraInfo of each eye, without its header."""
    whole = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return tuple(
        {
            "height": info.height,
            "width": info.width,
            "distortion_model": info.distortion_model,
            "d": info.D,
            "k": info.K.ravel(),
            "r": info.R.ravel(),
            "p": info.P.ravel(),
            "binning_x": 0,
            "binning_y": 0,
            "roi": whole,
        }
        for info in camera_infos(calibration)
    )


class RecordedImages:
    """Record the cameras of a world as long as it is recorded.

    Args:
        world: is recorded
        cameras: which of its cameras; all when omitted
    """

    def __init__(self, world: World, cameras: Iterable[str] | None = None) -> None:
        self._world = world
        known = {camera.name: camera.kind for camera in world.rig.cameras}
        names = tuple(known) if cameras is None else tuple(cameras)
        self._rows: dict[str, list[tuple[Topic, Origin]]] = {
            name: list(rows_of(name, known[name], RECORDED)) for name in names
        }

    def wanted(self) -> Collection[str]:
        """Return the cameras, while the world is recorded."""
        return () if recorder_of(self._world) is None else self._rows.keys()

    def take(self, shot: Shot) -> None:
        """Record a picture, stamped with simulation time as everything in a recording."""
        recorder = recorder_of(self._world)
        if recorder is None:
            return
        time = float(shot.frame.time)
        stamp = divmod(round(time * SECOND), SECOND)
        for topic, origin in self._rows.get(shot.camera, ()):
            kind = message_type(topic.type)
            data = cdr_encode(kind, message(shot, origin, stamp))
            recorder.add(Extra(f"/{topic.name}", kind.ros2_name, kind.text_ros2, time, data))


@contextmanager
def images_recorded(
    world: World,
    open_renderer: Callable[[], ImageRenderer],
    rate_hz: float,
    image_format: str = "jpeg",
) -> Generator[None]:
    """Record every picture of the cameras of a world while the `with` block lasts.

    The world waits while it is drawn, so this is for runs that need not keep to the wall clock.

    Args:
        world: is recorded, now or later in the block
        open_renderer: makes the renderer
        rate_hz: pictures a simulated second
        image_format: "jpeg" or "png"

    Raises:
        InputError: a rate that is not above 0
        TrocarError: there is no OpenGL to draw with
    """
    if not 0.0 < rate_hz < float("inf"):
        raise InputError(f"camera rate: got {rate_hz:g} Hz; allowed: above 0")
    images, packer, renderer = RecordedImages(world), Packer(image_format), open_renderer()
    count = -1

    def look() -> None:
        nonlocal count
        due = int((world.time + SLACK_S) * rate_hz)
        wanted = frozenset(images.wanted())
        if due == count or not wanted:
            return
        count = due
        order = Order(None, 0.0, world.snapshot(arms=False), world.cameras(), wanted)
        for shot in shots(renderer, order, packer):
            images.take(shot)

    leave = world.observe(look, every=5)
    try:
        yield
    finally:
        leave()
        renderer.close()
