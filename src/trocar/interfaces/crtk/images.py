"""Messages from pictures: what the cameras saw, with what their lenses are like.

The pictures' thread calls `take`; the stamp is that of the sample of the same moment, whose tf and
states are published as well.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.records import Calibration
from trocar.cameras.rectification import camera_infos
from trocar.interfaces.crtk.carriers import Carriers
from trocar.interfaces.crtk.clock import Beat, Stamp
from trocar.interfaces.crtk.image_rows import Origin
from trocar.interfaces.crtk.sample import Sample
from trocar.interfaces.crtk.say import header
from trocar.interfaces.crtk.topics import Topic
from trocar.interfaces.crtk.transport import Message
from trocar.interfaces.crtk.watching import Watch
from trocar.interfaces.pictures import Pictures
from trocar.interfaces.shots import Shot

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.cameras import CameraRecord


#: What sensor_msgs/Image calls them. Source: sensor_msgs/image_encodings.h.
ENCODINGS = {"image": "rgb8", "depth": "32FC1", "ids": "32SC1"}
#: What is drawn only while somebody wants it.
BESIDE = ("depth", "ids")


class Images:
    """Publishes pictures, and says when they are taken: with a sample, so that stamps agree.

    Args:
        pictures: draws them
        world: what is drawn
        rows: topics of cameras and what each is of
        rate_hz: how often
        carriers: the transports
    """

    def __init__(
        self,
        pictures: Pictures,
        world: World,
        rows: Iterable[tuple[Topic, Origin]],
        rate_hz: float,
        carriers: Carriers,
    ) -> None:
        self._pictures, self._world, self._carriers = pictures, world, carriers
        self._topics: dict[str, Topic] = {}
        self._origins: dict[str, Origin] = {}
        for topic, origin in rows:
            self._topics[topic.name], self._origins[topic.name] = topic, origin
        self._names = frozenset(n for n, o in self._origins.items() if o.what != "names")
        self._told: dict[str, Mapping[int, str]] = {}
        self._tell: Callable[[str, Mapping[str, object]], None] = lambda *_: None
        self._beat = Beat(rate_hz)
        self._asked: Callable[[], frozenset[str]] = frozenset
        self._leave: Callable[[], None] = lambda: None

    def cameras(self) -> Mapping[str, CameraRecord]:
        """Return where the cameras are now; before the loop runs, or in its thread."""
        return self._pictures.cameras(self._world)

    def start(self, watch: Watch) -> None:
        """Take pictures with the samples of a watch from now on."""
        self._asked, self._tell = lambda: watch.asked, watch.put
        watch.look = self.look
        self._pictures.led = True
        self._leave = self._pictures.add(self)

    def stop(self) -> None:
        """Take no more."""
        self._leave()

    def look(self, sample: Sample) -> Sample:
        """Let a picture be taken when one is due, in the loop's thread."""
        if not self._pictures.takes(self._beat.due(sample.elapsed)):
            return sample
        cameras = self._pictures.shoot(self._world, sample.stamp, self._beside())
        return replace(sample, cameras=cameras) if cameras else sample

    def wanted(self) -> frozenset[str]:
        """Return the cameras whose topics somebody wants."""
        return frozenset(self._origins[name].camera for name in self._asked() & self._names)

    def _beside(self) -> Mapping[str, Collection[str]]:
        """Return what somebody wants of each camera beside its colours."""
        found: dict[str, set[str]] = {}
        for name in self._asked() & self._names:
            origin = self._origins[name]
            if origin.what in BESIDE:
                found.setdefault(origin.camera, set()).add(origin.what)
        return found

    def take(self, shot: Shot) -> None:
        """Publish a picture to those who want it."""
        if shot.stamp is None:
            return
        made: dict[str, tuple[Topic, Message]] = {}
        self._tell_names(shot)
        for transport, names in self._carriers.wanted():
            batch: list[tuple[Topic, Message]] = []
            for name in sorted(names & self._names):
                origin = self._origins[name]
                if origin.camera == shot.camera and _has(shot, origin):
                    if name not in made:
                        made[name] = self._topics[name], message(shot, origin, shot.stamp)
                    batch.append(made[name])
            if batch:
                self._carriers.send(transport, batch)

    def _tell_names(self, shot: Shot) -> None:
        """Tell what ids mean, once, and again when they mean something else."""
        if shot.frame.ids is None or self._told.get(shot.camera) == shot.frame.names:
            return
        self._told[shot.camera] = shot.frame.names
        text = json.dumps({str(number): name for number, name in shot.frame.names.items()})
        for name, origin in self._origins.items():
            if origin.camera == shot.camera and origin.what == "names":
                self._tell(name, {"data": text})


def message(shot: Shot, origin: Origin, stamp: Stamp) -> Message:
    """Return the message of a topic, of something that the picture has."""
    head = header(stamp, origin.frame_id)
    if origin.what in ("info", "depth info"):
        infos = _infos(shot.calibration)
        return {"header": head, **infos[-1 if origin.eye == "right" else 0]}
    if origin.what == "compressed":
        return {"header": head, "format": shot.format, "data": shot.packed(origin.eye)}
    picture = _pixels(shot, origin)
    height, width = picture.shape[:2]
    return {
        "header": head,
        "height": height,
        "width": width,
        "encoding": ENCODINGS[origin.what],
        "is_bigendian": int(sys.byteorder == "big" and origin.what != "image"),
        "step": picture.nbytes // height,
        "data": np.ascontiguousarray(picture).reshape(-1).view(np.uint8),
    }


def _has(shot: Shot, origin: Origin) -> bool:
    """Tell whether something was drawn: it may be wanted only since."""
    return origin.what not in BESIDE or getattr(shot.frame, origin.what) is not None


def _pixels(shot: Shot, origin: Origin) -> NDArray[np.generic]:
    if origin.what not in BESIDE:
        return shot.eye(origin.eye)
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
