"""Pairs of images of a real endoscope: from a bag, a video file, a video device or its address."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, LogError
from trocar.inputs import check_numbers, check_type, is_file
from trocar.recording.bags import Bag
from trocar.tasks.vision.images import opencv

Picture = NDArray[np.uint8]

#: Largest difference of both eyes' stamps at one moment [s]. Source: half of the time between
#: images at 30 Hz.
TOGETHER_S = 0.016
#: Ends of topics of an eye's images. Source: image_transport, dvrk_video.
ENDS = ("image_raw", "image_raw/compressed", "image_rect_color", "image_color")


class Pair(NamedTuple):
    """Both eyes' images of a moment [s]."""

    time: float
    left: Picture
    right: Picture


def eye_topics(bag: Bag, left: str = "", right: str = "") -> tuple[str, str]:
    """Return the topics of both eyes: as given, or found by names like `.../left/image_raw`.

    Raises:
        LogError: no such topics, or several
    """
    found: list[str] = []
    for side, given in (("left", left), ("right", right)):
        name = given.lstrip("/")
        if name and name not in bag.topics:
            raise LogError(bag.file, f"no topic /{name}; it has {_listed(bag)}")
        candidates = [
            topic
            for topic in bag.topics
            if f"/{side}/" in f"/{topic}" and any(topic.endswith(end) for end in ENDS)
        ]
        if not name and len(candidates) != 1:
            raise LogError(
                bag.file,
                f"got {len(candidates)} topics of the {side} eye; allowed: one, or --{side} TOPIC;"
                f" it has {_listed(bag)}",
            )
        found.append(name or candidates[0])
    return found[0], found[1]


def _listed(bag: Bag) -> str:
    images = [f"/{topic}" for topic, kind in sorted(bag.topics.items()) if kind.endswith("Image")]
    return ", ".join(images) or "no images"


def bag_pairs(bag: Bag, left: str, right: str) -> Iterator[Pair]:
    """Yield pairs of images whose stamps agree, in the order of the bag.

    Raises:
        LogError: images whose stamps go back, or no two of one moment
    """
    waiting: dict[str, list[tuple[float, Picture]]] = {left: [], right: []}
    count, last = 0, -np.inf
    for topic, stamp, image in bag.images((left, right)):
        other = waiting[right if topic == left else left]
        match = next((k for k, (time, _) in enumerate(other) if abs(time - stamp) < TOGETHER_S), -1)
        if match < 0:
            waiting[topic].append((stamp, image))
            continue
        time, there = other[match]
        del other[: match + 1]
        waiting[topic].clear()
        first = stamp if topic == left else time
        if first <= last:
            raise LogError(bag.file, f"/{left}: stamp {first:.6f} s comes after {last:.6f} s")
        count, last = count + 1, first
        yield Pair(first, image, there) if topic == left else Pair(first, there, image)
    if not count:
        raise LogError(
            bag.file,
            f"no images of /{left} and /{right} have stamps within {1e3 * TOGETHER_S:g} ms",
        )


def video_pairs(source: str, rate_hz: float = 30.0) -> Iterator[Pair]:
    """Yield pairs of a video whose images show both eyes side by side, left first.

    A file ends; a device or an address that ends is an error.

    Args:
        source: path of a file, number of a video device, or an address that OpenCV opens
        rate_hz: of images, where the source does not say its own

    Raises:
        InputError: it cannot be opened, is not twice as wide as an eye, or stopped
    """
    cv2 = opencv()
    check_numbers(rate_hz, (), "rate_hz", 1e-3, 1e6)
    ends = is_file(check_type(source, str, "camera"))
    capture = cv2.VideoCapture(int(source) if source.isdigit() else source)
    try:
        if not capture.isOpened():
            raise InputError(
                f"camera {source}: cannot be opened; allowed: a video file, the number of a video"
                " device, or an address that OpenCV reads"
            )
        rate = float(capture.get(cv2.CAP_PROP_FPS))
        rate = rate if 1.0 <= rate <= 1000.0 else rate_hz
        count = 0
        while True:
            there, image = capture.read()
            if not there:
                break
            width = image.shape[1]
            if width % 2:
                raise InputError(
                    f"camera {source}: got {width} columns; allowed: both eyes side by side, an"
                    " even number"
                )
            colours = np.ascontiguousarray(image[..., ::-1])
            half = width // 2
            yield Pair(count / rate, colours[:, :half], colours[:, half:])
            count += 1
    finally:
        capture.release()
    if not count:
        raise InputError(f"camera {source}: gave no image")
    if not ends:
        raise InputError(f"camera {source}: stopped after {count} images")
