"""Images on a transport in memory: names, stamps, and what tf and camera_info say of them."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.live.fake_renderer import FakeRenderer
from tests.ros.served import HandClock, Served, stamp_ns
from trocar.cameras.lens import project
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.geometry.se3 import inverse, transform
from trocar.live import Loop
from trocar.live.images import Overlay, Pictures
from trocar.live.loop import SERVER_TICK_S
from trocar.messages import cdr_decode, cdr_encode, ros1_decode, ros1_encode, to_json
from trocar.ros import Core
from trocar.ros.transports.memory import MemoryTransport
from trocar.simulation import World

RIG = "two_psm_ecm"
EYES = ("left", "right")


class Filmed(Served):
    """A served world whose cameras are drawn; `run` waits for every picture."""

    def __init__(
        self,
        rig: str = RIG,
        *,
        wanted: list[str] | None = None,
        renderer: FakeRenderer | None = None,
        calibrations: dict | None = None,
        overlay: Overlay | None = None,
        **options: Any,
    ) -> None:
        self.world, self.clock = World(rig), HandClock()
        self.loop = Loop(self.world, tick_s=SERVER_TICK_S, clock=self.clock)
        self.renderer = renderer or FakeRenderer()
        self.pictures = Pictures(self.loop, lambda: self.renderer, calibrations=calibrations)
        self.pictures.overlay = overlay
        self.pictures.start()
        self.core = Core(self.loop, pictures=self.pictures, **options)
        self.transport = MemoryTransport(wanted)
        self.core.attach(self.transport)
        self.core.begin()

    def run(self, seconds: float = SERVER_TICK_S) -> None:
        for _ in range(round(seconds / SERVER_TICK_S)):
            super().run()
            end = time.monotonic() + 20
            while not self.pictures.idle:
                assert time.monotonic() < end
                time.sleep(0.0005)

    def close(self) -> None:
        self.core.close()
        self.pictures.close()


@pytest.fixture
def filmed() -> Iterator[Callable[..., Filmed]]:
    made: list[Filmed] = []

    def make(*args: Any, **kwargs: Any) -> Filmed:
        made.append(Filmed(*args, **kwargs))
        return made[-1]

    yield make
    for one in made:
        one.close()


TOPICS = [
    f"endoscope/{eye}/{what}"
    for eye in EYES
    for what in ("image_raw", "image_raw/compressed", "camera_info")
]


def matrix(transform_message: dict) -> np.ndarray:
    """The pose that a geometry_msgs/Transform tells, (4, 4)."""
    turn, move = transform_message["rotation"], transform_message["translation"]
    quaternion = [turn[k] for k in "wxyz"]
    return transform(matrix_from_quaternion(quaternion), [move[k] for k in "xyz"])


def frames(served: Served, stamp: tuple[int, int]) -> dict[str, tuple[str, np.ndarray]]:
    """{child: (parent, pose)} as told with one stamp, and once for all."""
    found: dict[str, tuple[str, np.ndarray]] = {}
    told = [m for m in served.messages("tf") if m["transforms"][0]["header"]["stamp"] == stamp]
    for message in (*served.messages("tf_static"), *told):
        for entry in message["transforms"]:
            at = entry["header"]["frame_id"], matrix(entry["transform"])
            found[entry["child_frame_id"]] = at
    return found


def in_world(found: dict[str, tuple[str, np.ndarray]], frame: str) -> np.ndarray:
    """The pose of a frame in the world, by tf alone, (4, 4)."""
    T = np.eye(4)
    while frame != "world":
        frame, T_parent = found[frame]
        T = T_parent @ T
    return T


def test_cameras_have_the_names_of_the_dvrks_video_and_no_topics_without_pictures(filmed) -> None:
    with_them = filmed(wanted=[])
    assert {t.name for t in with_them.core.topics.values() if t.rate == "camera"} >= set(TOPICS)
    assert all(with_them.core.topics[name].depth == 2 for name in TOPICS)
    assert not [t for t in Served(RIG).core.topics.values() if t.rate == "camera"]


def test_a_view_has_one_eye_and_says_so(filmed) -> None:
    names = {t.name for t in filmed("full_cart", wanted=[]).core.topics.values()}
    assert {"room/image_raw", "room/image_raw/compressed", "room/camera_info"} <= names
    assert "room/left/image_raw" not in names


def test_only_what_somebody_wants_is_drawn(filmed) -> None:
    served = filmed(wanted=["ECM/measured_cp"])
    served.run(0.1)
    assert served.renderer.drawn == 0
    served.transport.want("endoscope/left/camera_info")
    served.run(0.1)
    assert set(served.transport.received) >= {"endoscope/left/camera_info"}
    assert "endoscope/left/image_raw" not in served.transport.received


def test_images_come_at_their_rate_with_the_stamps_of_states_and_tf(filmed) -> None:
    served = filmed(wanted=[*TOPICS, "tf", "ECM/measured_cp"])
    served.run(0.5)
    stamps = {name: [stamp_ns(m) for m in served.messages(name)] for name in TOPICS}
    assert 29 <= len(stamps[TOPICS[0]]) <= 31
    assert len({tuple(each) for each in stamps.values()}) == 1
    states = {stamp_ns(m) for m in served.messages("ECM/measured_cp")}
    told = [m["transforms"][0]["header"]["stamp"] for m in served.messages("tf")]
    nanoseconds = [s * 10**9 + ns for s, ns in told]
    assert states >= set(stamps[TOPICS[0]])
    assert set(nanoseconds) >= set(stamps[TOPICS[0]])
    assert len(nanoseconds) == len(set(nanoseconds))  # tf2 complains of what is told twice


def test_an_image_is_the_picture_and_a_compressed_one_its_jpeg(filmed) -> None:
    served = filmed(wanted=TOPICS)
    served.run(0.02)
    raw = served.last("endoscope/right/image_raw")
    eye = served.world.cameras()["endoscope"].calibration.right
    assert (raw["width"], raw["height"]) == (eye.width, eye.height)
    assert (raw["encoding"], raw["step"], raw["is_bigendian"]) == ("rgb8", 3 * eye.width, 0)
    assert len(raw["data"]) == eye.height * raw["step"]
    assert raw["header"]["frame_id"] == "endoscope_right_frame"
    packed = served.last("endoscope/right/image_raw/compressed")
    assert packed["format"] == "jpeg"
    assert Image.open(io.BytesIO(packed["data"])).size == (eye.width, eye.height)


@pytest.mark.parametrize("rig", [RIG, "full_cart"])
def test_tf_and_camera_info_say_where_a_point_is_seen(rig: str, filmed) -> None:
    """A client that knows tf, K and the distortion alone finds what the image shows."""
    served = filmed(rig, wanted=[*TOPICS, "tf", "tf_static"])
    served.run(0.05)
    camera = served.world.cameras()["endoscope"]
    rng = np.random.default_rng(3)
    points = np.concatenate([rng.uniform(-0.02, 0.02, (40, 2)), np.full((40, 1), 0.1)], axis=1)
    served.renderer.points = points @ camera.T_world_camera[:3, :3].T + camera.T_world_camera[:3, 3]
    served.core.receive("ECM/state_command", {"header": {}, "string": "enable"})
    served.core.receive("ECM/state_command", {"header": {}, "string": "home"})
    served.core.receive("ECM/move_jp", {"position": [0.03, -0.02, 0.01, 0.2]})
    served.run(0.2)
    for eye in EYES:
        image, info = (served.last(f"endoscope/{eye}/{w}") for w in ("image_raw", "camera_info"))
        stamp = image["header"]["stamp"]
        T = inverse(in_world(frames(served, stamp), image["header"]["frame_id"]))
        seen = served.renderer.points @ T[:3, :3].T + T[:3, 3]
        wanted = project(seen, info["k"].reshape(3, 3), info["d"])
        shown = np.argwhere(image["data"].reshape(info["height"], info["width"], 3)[..., 0])[
            :, ::-1
        ]
        assert len(shown) > 30
        distance = np.linalg.norm(shown[:, None] - wanted[None], axis=-1).min(axis=1)
        assert distance.max() < 0.75  # the middle of the pixel that the point lies in


def test_the_right_eyes_projection_carries_the_baseline(filmed) -> None:
    served = filmed(wanted=TOPICS)
    served.run(0.02)
    left, right = (served.last(f"endoscope/{eye}/camera_info") for eye in EYES)
    baseline = served.world.cameras()["endoscope"].calibration.baseline
    assert left["p"].reshape(3, 4)[0, 3] == 0.0
    f = right["p"].reshape(3, 4)[0, 0]
    assert right["p"].reshape(3, 4)[0, 3] == pytest.approx(-f * baseline)
    assert left["distortion_model"] == "plumb_bob"


@pytest.mark.parametrize("what", ["image_raw", "image_raw/compressed", "camera_info"])
def test_messages_of_cameras_are_what_every_transport_can_write(what: str, filmed) -> None:
    served = filmed(wanted=TOPICS)
    served.run(0.02)
    name = f"endoscope/left/{what}"
    kind, message = served.core.topics[name].type, served.last(name)
    for encode, decode in ((cdr_encode, cdr_decode), (ros1_encode, ros1_decode)):
        back = decode(kind, encode(kind, message))
        assert back["header"] == message["header"]
        if "data" in message:
            assert back["data"] == bytes(message["data"])
    assert to_json(kind, message)["header"]["frame_id"] == "endoscope_left_frame"


BESIDE = [f"endoscope/{eye}/{what}/image_raw" for eye in EYES for what in ("depth", "ids")]


def test_depth_and_ids_are_drawn_while_somebody_listens_to_them(filmed) -> None:
    served = filmed(wanted=["endoscope/left/image_raw"])
    served.run(0.05)
    assert served.renderer.drawn > 0 and not served.renderer.beside
    served.transport.want("endoscope/left/image_raw", "endoscope/left/depth/image_raw")
    served.run(0.05)
    assert served.renderer.beside == {"depth"}
    served.transport.want(*BESIDE)
    served.run(0.05)
    assert served.renderer.beside == {"depth", "ids"}
    served.transport.want("endoscope/left/image_raw")
    served.run(0.05)
    assert not served.renderer.beside


def test_depth_and_ids_are_the_frames_and_say_what_they_are(filmed) -> None:
    served = filmed(wanted=[*BESIDE, "endoscope/left/depth/camera_info"])
    camera = served.world.cameras()["endoscope"]
    served.renderer.points = camera.T_world_camera[:3, 3] + 0.1 * camera.T_world_camera[:3, 2]
    served.renderer.points = served.renderer.points.reshape(1, 3)
    served.run(0.05)
    for eye in EYES:
        depth, ids = (served.last(f"endoscope/{eye}/{w}/image_raw") for w in ("depth", "ids"))
        assert (depth["encoding"], ids["encoding"]) == ("32FC1", "32SC1")
        size = depth["height"], depth["width"]
        assert depth["step"] == ids["step"] == 4 * size[1]
        metres = depth["data"].view(np.float32).reshape(size)
        numbers = ids["data"].view(np.int32).reshape(size)
        assert metres.max() == pytest.approx(0.1) and numbers.max() == 7
        assert ((metres > 0.0) == (numbers == 7)).all() and (numbers == 7).sum() == 1
        assert depth["header"] == ids["header"]
        kind = served.core.topics[f"endoscope/{eye}/depth/image_raw"].type
        assert cdr_decode(kind, cdr_encode(kind, depth))["data"] == bytes(depth["data"])
    info = served.last("endoscope/left/depth/camera_info")
    eye = camera.calibration.left
    assert (info["height"], info["width"]) == (eye.height, eye.width)


def test_the_names_of_ids_are_told_once_and_to_those_who_come_late(filmed) -> None:
    served = filmed(wanted=["endoscope/left/image_raw"])
    served.run(0.05)
    assert served.core.latched("endoscope/left/ids/names") is None
    served.transport.want(*BESIDE)
    served.run(0.1)
    (told,) = served.messages("endoscope/left/ids/names")
    assert json.loads(told["data"]) == {"7": "point"}
    assert served.core.latched("endoscope/right/ids/names") == told
    served.renderer.names = {7: "another"}
    served.run(0.1)
    assert json.loads(served.last("endoscope/left/ids/names")["data"]) == {"7": "another"}


def test_a_rig_without_cameras_has_none(filmed) -> None:
    served = filmed("psm", wanted=None)
    served.run(0.02)
    assert served.renderer.drawn == 0


def test_overlays_have_topics_of_their_own_with_the_stamp_of_the_image(
    filmed: Callable[..., Filmed],
) -> None:
    drawn: list[int] = []

    def overlay(frame: Any, eye: int) -> np.ndarray:
        drawn.append(eye)
        picture = (frame.left, frame.right)[eye].copy()
        picture[:4] = (10, 20, 30)
        return picture

    topics = [f"endoscope/{e}/{o}image_raw" for e in EYES for o in ("", "overlay/")]
    served = filmed(
        wanted=[*topics, "endoscope/left/overlay/image_raw/compressed"], overlay=overlay
    )
    served.run(0.1)
    for eye in EYES:
        plain = served.messages(f"endoscope/{eye}/image_raw")
        over = served.messages(f"endoscope/{eye}/overlay/image_raw")
        assert [m["header"] for m in plain] == [m["header"] for m in over] and len(over) > 2
        pixels = over[-1]["data"].reshape(over[-1]["height"], over[-1]["width"], 3)
        assert (pixels[:4] == (10, 20, 30)).all() and not pixels[4:].any()
        assert not plain[-1]["data"].any()
    (packed, *_) = served.messages("endoscope/left/overlay/image_raw/compressed")
    opened = np.asarray(Image.open(io.BytesIO(bytes(packed["data"]))))
    assert np.abs(opened[:2].astype(int) - (10, 20, 30)).max() < 12
    # Once for each eye and image, however many look.
    assert drawn.count(0) == len(served.messages("endoscope/left/overlay/image_raw"))


@pytest.mark.parametrize("wrong", [None, np.zeros((4, 4, 3), np.uint8), "text"])
def test_what_draws_no_image_of_the_frames_size_is_named(
    filmed: Callable[..., Filmed], wrong: Any
) -> None:
    served = filmed(wanted=["endoscope/left/overlay/image_raw"], overlay=lambda *_: wrong)
    served.run(0.02)
    assert "overlay: got an image of" in served.pictures.failure


def test_without_anything_to_draw_there_are_no_topics_of_overlays(
    filmed: Callable[..., Filmed],
) -> None:
    assert not [name for name in filmed().core.topics if "overlay" in name]
