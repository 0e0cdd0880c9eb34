"""Images that are really drawn, beside tf and camera_info of their stamp, while things move."""

from __future__ import annotations

import itertools
import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from tests.ros.served import stamp_ns
from tests.ros.test_images import EYES, Filmed, frames, in_world
from trocar.descriptions.catalogue import DATA
from trocar.geometry.rotations import matrix_from_quaternion, matrix_from_rpy
from trocar.geometry.se3 import inverse, transform, transform_points
from trocar.kinematics.forward import poses
from trocar.simulation import World

pytest.importorskip("moderngl", reason="the extra `scope` is not there")
from trocar.rendering import Look, Renderer, Series
from trocar.rendering.primitives import surface

#: Edge of boxes before the scope, and where they hang in the camera's frame at first [m].
pytestmark = pytest.mark.usefixtures("opengl")

EDGE = 0.010
COLUMNS, ROWS = (-0.036, -0.012, 0.012, 0.036), (-0.015, 0.015)
HANGING = [(x, y, 0.09 + 0.3 * abs(x)) for x in COLUMNS for y in ROWS]
#: Askew, so that no edge runs along a row of pixels. [deg]
TURN = (40.0, 20.0, 10.0)
TURNED = matrix_from_rpy(*np.deg2rad(TURN))
CORNERS = 0.5 * EDGE * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
#: How the instrument moves. [rad, m]
MOVE = np.array([0.02, 0.02, -0.004, 0.4, 0.3, 0.0])
#: What tf says and an image shows: of each box, and in the mean. Source: the project's own goal,
#: and a tenth of it.
MOST_PX, MEAN_PX = 0.1, 0.01


def begun(rig: Path, places: dict[str, tuple[float, float, float]], more: str) -> Filmed:
    """Serve an ECM with boxes before its scope, at these places in the camera's frame."""
    camera = World("ecm").cameras()["endoscope"].T_world_camera
    text = (DATA / "rigs" / "ecm.toml").read_text(encoding="utf-8")
    size = 3 * [1e3 * EDGE]
    for name, at in places.items():
        place = transform_points(camera, np.array([at]))[0]
        text += f"""
[[prop]]
name = "{name}"
xyz_m = {place.tolist()}
rpy_deg = {list(TURN)}
shape = [{{ kind = "box", center_mm = [0, 0, 0], size_mm = {size} }}]
{more}"""
    rig.write_text(text, encoding="utf-8")
    seen = [f"endoscope/{eye}/{what}" for eye in EYES for what in ("ids/image_raw", "camera_info")]
    served = Filmed(str(rig), wanted=[*seen, "tf", "scene/stone/measured_cp"])
    world = served.world

    def shapes() -> tuple:
        return world.snapshot(arms=False).build, world.shapes()

    served.renderer = Series(Renderer(shapes, None, Look(exposure=0.0)))  # type: ignore[assignment]
    return served


def outlined(points: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Return the mean of the pixels within the outline of a box, whose corners P projects, (2,)."""
    ahead = points @ P[:, :3].T + P[:, 3]
    flat = ahead[:, :2] / ahead[:, 2:]
    (left, top), (right, bottom) = np.floor(flat.min(axis=0)), np.ceil(flat.max(axis=0))
    u, v = np.meshgrid(np.arange(left, right + 1), np.arange(top, bottom + 1))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    sides = ConvexHull(flat).equations
    inside = (pixels @ sides[:, :2].T + sides[:, 2] < 0.0).all(axis=1)
    return pixels[inside].mean(axis=0)


def shown(ids: dict, number: int) -> np.ndarray | None:
    """Return the middle of what an image shows of something, None near its edge, (2,) [px]."""
    picture = ids["data"].view(np.int32).reshape(ids["height"], ids["width"])
    v, u = np.nonzero(picture == number)
    high, wide = picture.shape
    if not len(u) or not (u.min() and v.min() and u.max() < wide - 1 and v.max() < high - 1):
        return None
    return np.array([u.mean(), v.mean()])


class Seen:
    """What a client sees and computes of one eye, image by image."""

    def __init__(self, served: Filmed, eye: str) -> None:
        self._served, self.eye = served, eye
        self.images = served.messages(f"endoscope/{eye}/ids/image_raw")
        self.infos = served.messages(f"endoscope/{eye}/camera_info")
        told = json.loads(served.last(f"endoscope/{eye}/ids/names")["data"])
        self.number = {name: int(number) for number, name in told.items()}

    def off(self, name: str, where: dict[int, np.ndarray], later: int = 0) -> np.ndarray:
        """Return image - computed of a box, of each image that shows it whole, (n, 2) [px].

        Args:
            name: of the box
            where: {stamp: its pose in the world}
            later: tf is taken from so many images later
        """
        found = []
        for k, image in enumerate(self.images[: len(self.images) - later]):
            middle = shown(image, self.number[name])
            if middle is None:
                continue
            stamp = self.images[k + later]["header"]["stamp"]
            assert self.infos[k]["header"] == image["header"]
            T = in_world(frames(self._served, stamp), "endoscope_left_frame")
            corners = transform_points(inverse(T) @ where[stamp_ns(image)], CORNERS)
            found.append(middle - outlined(corners, self.infos[k]["p"].reshape(3, 4)))
        return np.array(found).reshape(-1, 2)


@pytest.mark.slow
@pytest.mark.parametrize("eye", EYES)
def test_what_hangs_is_shown_where_tf_and_camera_info_say_while_the_scope_moves(
    eye: str, tmp_path: Path
) -> None:
    marks = {f"mark{k}": at for k, at in enumerate(HANGING)}
    with closing(begun(tmp_path / "marks.toml", marks, "")) as served:
        for order in ("enable", "home"):
            served.core.receive("ECM/state_command", {"header": {}, "string": order})
        served.core.receive("ECM/move_jp", {"position": [0.12, -0.1, 0.015, 0.5]})
        served.run(0.25)
    seen = Seen(served, eye)
    camera = World("ecm").cameras()["endoscope"].T_world_camera
    off, later = [], []
    for name, at in marks.items():
        T = transform(TURNED, transform_points(camera, np.array([at]))[0])
        where = {stamp_ns(image): T for image in seen.images}
        off.append(seen.off(name, where))
        later.append(seen.off(name, where, later=1))
    assert len(np.concatenate(off)) > 100
    assert np.abs(np.concatenate(off)).max() < MOST_PX
    assert np.abs(np.concatenate(off).mean(axis=0)).max() < MEAN_PX
    assert np.abs(np.concatenate(later)).max() > 10.0 * MOST_PX  # tf of another stamp would show


@pytest.mark.parametrize("eye", EYES)
def test_what_falls_is_shown_where_its_topic_says(eye: str, tmp_path: Path) -> None:
    movable = 'movable = true\nmass_g = 5.0\nsource = "our own choice"\n'
    with closing(begun(tmp_path / "stone.toml", {"stone": (0.0, 0.0, 0.09)}, movable)) as served:
        served.run(0.1)
    where = {}
    for message in served.messages("scene/stone/measured_cp"):
        p, q = message["pose"]["position"], message["pose"]["orientation"]
        where[stamp_ns(message)] = transform(
            matrix_from_quaternion([q[k] for k in "wxyz"]), [p[k] for k in "xyz"]
        )
    off = Seen(served, eye).off("stone", where)
    assert len(off) >= 5
    assert np.abs(off).max() < MOST_PX and np.abs(off.mean(axis=0)).max() < MEAN_PX


def covered(triangles: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Return the mean of the pixels that triangles (n, 3, 3) cover, which P projects, (2,)."""
    ahead = triangles @ P[:, :3].T + P[:, 3]
    flat = ahead[..., :2] / ahead[..., 2:]
    low = np.floor(flat.min(axis=(0, 1))).astype(int)
    wide, high = np.ceil(flat.max(axis=(0, 1))).astype(int) - low + 1
    inside = np.zeros((high, wide), dtype=bool)
    for a, b, c in flat:
        left, top = np.floor(np.min([a, b, c], axis=0)).astype(int)
        right, bottom = np.ceil(np.max([a, b, c], axis=0)).astype(int) + 1
        u, v = np.meshgrid(np.arange(left, right), np.arange(top, bottom))
        sides = [
            (q[0] - p[0]) * (v - p[1]) - (q[1] - p[1]) * (u - p[0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        within = np.all([side >= 0 for side in sides], axis=0)
        within |= np.all([side <= 0 for side in sides], axis=0)
        inside[top - low[1] : bottom - low[1], left - low[0] : right - low[0]] |= within
    v, u = np.nonzero(inside)
    return np.array([u.mean(), v.mean()]) + low


@pytest.mark.slow
@pytest.mark.parametrize("eye", EYES)
def test_an_instrument_in_motion_is_shown_where_joints_and_tf_of_the_stamp_have_it(
    eye: str,
) -> None:
    """Its wrist alone is drawn, so that nothing hides a part of it."""
    image, info = f"endoscope/{eye}/ids/image_raw", f"endoscope/{eye}/camera_info"
    wanted = [image, info, f"endoscope/{eye}/ids/names", "tf", "PSM1/measured_js"]
    with closing(Filmed(wanted=wanted)) as served:
        world = served.world
        world.reset(pose="work")
        wrist = [s for s in world.shapes() if (s.arm, s.frame) == ("PSM1", "wrist_pitch")]

        def shapes() -> tuple:
            return world.snapshot(arms=False).build, wrist

        served.renderer = Series(Renderer(shapes, None, Look(exposure=0.0)))  # type: ignore[assignment]
        arm = world.arm("PSM1")
        arm.move_jp(arm.setpoint_js().position + MOVE)
        served.run(0.25)
    surfaces = [surface(shape) for shape in wrist]
    body = np.concatenate([s.points[s.faces] for s in surfaces])
    names = json.loads(served.last(f"endoscope/{eye}/ids/names")["data"])
    number = next(int(k) for k, name in names.items() if name == "PSM1/wrist_pitch")
    joints = {stamp_ns(m): m["position"] for m in served.messages("PSM1/measured_js")}
    shots, lenses = served.messages(image), served.messages(info)

    def off(shot: dict, lens: dict, stamp: int) -> np.ndarray:
        told = frames(served, shot["header"]["stamp"])
        mechanism = world.rig.arm("PSM1").arm.mechanism
        at = poses(mechanism, [*joints[stamp], 0.0])["wrist_pitch"]
        T = inverse(in_world(told, "endoscope_left_frame")) @ in_world(told, "PSM1_base") @ at
        middle = shown(shot, number)
        assert middle is not None and shot["header"] == lens["header"]
        return middle - covered(transform_points(T, body), lens["p"].reshape(3, 4))

    now = [off(*pair, stamp_ns(pair[0])) for pair in zip(shots, lenses, strict=True)]
    stale = [off(s, i, stamp_ns(b)) for b, s, i in zip(shots, shots[1:], lenses[1:], strict=False)]
    assert len(now) > 10
    assert np.abs(now).max() < MOST_PX
    assert np.abs(stale).max() > 10.0 * MOST_PX  # joints of another stamp would show
