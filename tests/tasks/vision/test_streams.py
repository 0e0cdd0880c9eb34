"""Images from bags and videos: pairs of one moment, and errors that name what is wrong."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.tasks.vision.drawn import before_the_eyes, drawn, small_eyes
from trocar.cameras import write_camera
from trocar.cli import main
from trocar.errors import InputError, LogError
from trocar.recording.bags import open_bag
from trocar.tasks.vision.images import opencv
from trocar.tasks.vision.streams import bag_pairs, eye_topics, video_pairs

pytest.importorskip("cv2", reason="needs the extra vision")
rosbags = pytest.importorskip("rosbags", reason="needs the extra bags")


def bag_of(path: Path, stamps: Sequence[tuple[float, float]], images: Sequence[Any]) -> Path:
    """Write a rosbag 1 with raw images of both eyes; of a right eye in BGR."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    Image, Header, Time = (
        types[name]
        for name in ("sensor_msgs/msg/Image", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    with Writer(path) as writer:
        connections = [
            writer.add_connection(
                f"/scope/{side}/image_raw", "sensor_msgs/msg/Image", typestore=store
            )
            for side in ("left", "right")
        ]
        for k, (pair, times) in enumerate(zip(images, stamps, strict=True)):
            for eye, (image, time) in enumerate(zip(pair, times, strict=True)):
                stamp = Time(sec=int(time), nanosec=round(1e9 * (time % 1.0)))
                header = Header(seq=k, stamp=stamp, frame_id="eye")
                pixels = image if eye == 0 else image[..., ::-1]
                height, width = image.shape[:2]
                message = Image(
                    header=header, height=height, width=width, encoding=("rgb8", "bgr8")[eye],
                    is_bigendian=0, step=3 * width, data=np.ascontiguousarray(pixels).ravel(),
                )  # fmt: skip
                data = store.serialize_ros1(message, "sensor_msgs/msg/Image")
                writer.write(connections[eye], 1000 + round(1e9 * time), data)
    return path


@pytest.fixture(scope="module")
def images() -> list[Any]:
    rng = np.random.default_rng(1)
    return [drawn(small_eyes(), before_the_eyes(), rng) for _ in range(3)]


def test_a_bag_gives_pairs_of_one_moment_in_the_colours_that_were_written(
    tmp_path: Path, images: list[Any]
) -> None:
    stamps = [(5.0, 5.001), (5.033, 5.034), (5.066, 5.2)]
    bag = open_bag(bag_of(tmp_path / "scope.bag", stamps, images))
    pairs = list(bag_pairs(bag, *eye_topics(bag)))
    assert [round(pair.time, 3) for pair in pairs] == [5.0, 5.033]  # the last two are 134 ms apart
    for pair, (left, right) in zip(pairs, images, strict=False):
        assert (pair.left == left).all() and (pair.right == right).all()


def test_bags_that_cannot_be_tracked_are_named(tmp_path: Path, images: list[Any]) -> None:
    bag = open_bag(bag_of(tmp_path / "back.bag", [(5.0, 5.0), (4.0, 4.0)], images[:2]))
    with pytest.raises(LogError, match=r"stamp 4.000000 s comes after 5.000000 s"):
        list(bag_pairs(bag, *eye_topics(bag)))
    with pytest.raises(LogError, match=r"no topic /other; it has /scope/left/image_raw, /scope/r"):
        eye_topics(bag, "other")
    apart = open_bag(bag_of(tmp_path / "apart.bag", [(5.0, 5.5)], images[:1]))
    with pytest.raises(LogError, match="have stamps within 16 ms"):
        list(bag_pairs(apart, *eye_topics(apart)))


def test_a_needle_is_tracked_from_a_bag_by_the_command(
    tmp_path: Path, images: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    eyes = small_eyes()
    files = [str(path) for path in write_camera(eyes, [tmp_path / "l.yaml", tmp_path / "r.yaml"])]
    bag = bag_of(tmp_path / "scope.bag", [(5.0, 5.0), (5.033, 5.033), (5.066, 5.066)], images)
    needle = ["--needle", "135,10,0.8,3"]
    assert main(["track", "--bag", str(bag), "--calibration", *files, *needle, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["images"] == 3 and found["tracked"] >= 2
    off = np.array(found["estimates"][-1]["position_m"]) - before_the_eyes()[:3, 3]
    assert np.linalg.norm(off) < 5e-4
    assert main(["track", "--bag", str(bag), "--calibration", *files, "--needle", "1,2"]) == 2
    assert "needle: got '1,2'; allowed: a size or ARC_DEG" in capsys.readouterr().err
    assert main(["track", "--bag", str(bag), "--calibration", "hd_1280x720", *needle]) == 2
    assert "got 400x300; allowed: 1280x720" in capsys.readouterr().err


def test_a_video_ends_and_a_device_that_stops_is_an_error(
    tmp_path: Path, images: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    cv2 = opencv()
    path = tmp_path / "both.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (800, 300))
    for pair in images:
        writer.write(np.concatenate(pair, axis=1)[..., ::-1].copy())
    writer.release()
    pairs = list(video_pairs(str(path)))
    assert [pair.time for pair in pairs] == pytest.approx([0.0, 0.04, 0.08])
    assert np.abs(pairs[0].left.astype(int) - images[0][0]).mean() < 12.0  # JPEG of noise
    monkeypatch.setattr("trocar.tasks.vision.streams.is_file", lambda _: False)
    with pytest.raises(InputError, match="stopped after 3 images"):
        list(video_pairs(str(path)))
    with pytest.raises(InputError, match="cannot be opened; allowed: a video file, the number"):
        list(video_pairs(str(tmp_path / "none.avi")))
