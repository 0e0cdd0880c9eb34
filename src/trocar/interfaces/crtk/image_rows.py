"""The rows of cameras, and what each is of; names are those of the dVRK's video pipeline.

Source: jhu-dvrk dvrk_video, launch files: the rig's name, then the eye, then ROS's own names
(image_transport's for compressed images); an eye's frame is `<rig>_<eye>_frame`. The rig's name is
the camera's here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from trocar.descriptions.records import RigDescription
from trocar.interfaces.crtk.topics import IMAGES, Topic

IMAGE, COMPRESSED, INFO = (
    "sensor_msgs/Image",
    "sensor_msgs/CompressedImage",
    "sensor_msgs/CameraInfo",
)
EYES = ("left", "right")
What = Literal["image", "compressed", "info", "depth", "depth info", "ids", "names"]
#: What stands behind the name of an eye: the type, the unit, the help.
KINDS: dict[What, tuple[str, str, str, str]] = {
    "image": ("image_raw", IMAGE, "rgb8", "what {seen} sees, as its lens throws it"),
    "compressed": ("image_raw/compressed", COMPRESSED, "", "the same as JPEG or PNG"),
    "info": ("camera_info", INFO, "px", "lens and size of {seen}, with every image"),
    "depth": ("depth/image_raw", IMAGE, "m", "32FC1: how far ahead what {seen} sees is, or inf"),
    "depth info": ("depth/camera_info", INFO, "px", "the same as camera_info, beside the depth"),
    "ids": ("ids/image_raw", IMAGE, "", "32SC1: what {seen} sees in each pixel, 0: nothing"),
    "names": ("ids/names", "std_msgs/String", "", 'JSON: {{"id": "name"}}, once ids are drawn'),
}
#: What everybody has; what is drawn with them where somebody wants it; what a recording holds.
PLAIN: tuple[What, ...] = ("image", "compressed", "info")
BESIDE: tuple[What, ...] = ("depth", "depth info", "ids", "names")
RECORDED: tuple[What, ...] = ("compressed", "info")


@dataclass(frozen=True)
class Origin:
    """What a topic's messages are made of.

    Attributes:
        camera: name of the camera
        eye: "left" or "right"; "" of a camera that has one
        what: the picture, the picture packed, what the lens is like, ...: of KINDS
    """

    camera: str
    eye: str
    what: What

    @property
    def frame_id(self) -> str:
        """Name of the eye's frame: x right, y down, z ahead."""
        return frame_name(self.camera, self.eye)


def frame_name(camera: str, eye: str = "") -> str:
    """Return the name of an eye's frame."""
    return f"{camera}_{eye}_frame" if eye else f"{camera}_frame"


def eyes_of(kind: str) -> tuple[str, ...]:
    """Return the eyes of a kind of camera."""
    return EYES if kind == "endoscope" else ("",)


def topics_of(rig: RigDescription) -> Iterator[tuple[Topic, Origin]]:
    """Return the topics of a rig's cameras."""
    for camera in rig.cameras:
        yield from rows_of(camera.name, camera.kind)


def endoscope_eyes(rig: RigDescription) -> Iterator[tuple[str, str]]:
    """Return the first endoscope's name with each of its eyes; nothing without one."""
    for camera in rig.cameras:
        if camera.kind == "endoscope":
            yield from ((camera.name, eye) for eye in EYES)
            return


def rows_of(
    camera: str, kind: str, names: tuple[What, ...] = PLAIN + BESIDE
) -> Iterator[tuple[Topic, Origin]]:
    """Return the topics of a camera, each with what it is of."""
    for eye in eyes_of(kind):
        yield from rows_at(f"{camera}/{eye}" if eye else camera, camera, eye, names)


def rows_at(
    before: str, camera: str, eye: str, names: tuple[What, ...]
) -> Iterator[tuple[Topic, Origin]]:
    """Return the topics of an eye under a name of their own."""
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
