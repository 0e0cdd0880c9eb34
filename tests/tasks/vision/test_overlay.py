"""Overlays: drawn where the projection has them, in distorted images as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.tasks.vision.drawn import NEEDLE, small_eyes
from trocar.cameras.lens import project
from trocar.descriptions.catalogue import load_scene
from trocar.errors import InputError
from trocar.geometry import inverse, matrix_from_rotation_vector, transform
from trocar.rendering import Look, StereoFrame
from trocar.robot.follow.mirror import follow
from trocar.simulation import World
from trocar.tasks import make_task
from trocar.tasks.scenes.vision import AugmentedReality
from trocar.tasks.vision.overlay import (
    Area,
    Banner,
    Curve,
    Item,
    Label,
    View,
    axes,
    distance,
    ghost,
    overlaid,
    stitch,
)

pytest.importorskip("cv2", reason="needs the extra vision")

EYE = small_eyes().left
T_EYE = transform(matrix_from_rotation_vector([0.2, -0.1, 0.3]), [0.01, 0.02, -0.05])
BLACK = np.zeros((EYE.height, EYE.width, 3), np.uint8)


def there(point: list[float]) -> np.ndarray:
    """Return a point ahead of the eye in the world."""
    return T_EYE[:3, :3] @ point + T_EYE[:3, 3]


def test_a_curve_lies_within_a_fifth_of_a_pixel_of_its_projection() -> None:
    # Near the corner of the image, where the lens bends straight lines by pixels.
    ends = np.stack([there([-0.026, -0.018, 0.08]), there([-0.025, 0.02, 0.08])])
    image = overlaid(BLACK, View(EYE, T_EYE), [Curve(ends, (255, 255, 255), 1)])
    t = np.linspace(0.0, 1.0, 4000)[:, None]
    ahead = (ends[0] + t * (ends[1] - ends[0]) - T_EYE[:3, 3]) @ T_EYE[:3, :3]
    line = project(ahead, EYE.K, EYE.distortion)
    straight = line[0] + t * (line[-1] - line[0])
    assert np.linalg.norm(line - straight, axis=1).max() > 1.0
    values = image[..., 0].astype(float)
    for v in range(int(line[:, 1].min()) + 3, int(line[:, 1].max()) - 3):
        u = values[v] @ np.arange(EYE.width) / values[v].sum()
        assert abs(u - np.interp(v, line[:, 1], line[:, 0])) < 0.2


def test_what_lies_behind_the_eye_is_not_drawn() -> None:
    view = View(EYE, T_EYE)
    behind = np.stack([there([0.0, 0.0, -0.05]), there([0.01, 0.0, -0.02])])
    items = [
        Curve(behind),
        Area(np.stack([*behind, there([0, 0.01, 0.05])])),
        Label("x", behind[0]),
    ]
    drawn = overlaid(BLACK, view, [items[0], items[2]])
    assert not drawn.any()
    across = np.stack([there([0.0, 0.0, -0.05]), there([0.0, 0.0, 0.1])])
    overlaid(BLACK, view, [Curve(across), items[1]])  # neither fails


def test_every_kind_of_item_leaves_its_mark_and_the_image_as_it_was() -> None:
    view = View(EYE, T_EYE)
    T = transform(np.eye(3), there([0.0, 0.0, 0.08]))
    square = np.stack(
        [there([x, y, 0.08]) for x, y in ((0, 0), (0.01, 0), (0.01, 0.01), (0, 0.01))]
    )
    down = T_EYE[:3, 2]
    for items in (
        axes(T),
        ghost(NEEDLE, T),
        distance(square[0], square[2]),
        stitch(square[0], square[1], down, 0.01),
        [Area(square)],
        [Label("tip", square[0])],
        [Banner("lost")],
    ):
        assert overlaid(BLACK, view, items).any()
    assert not BLACK.any()


def test_a_stitch_passes_through_both_points_on_the_needles_circle() -> None:
    a, b, down = np.zeros(3), np.array([0.012, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])
    arc = stitch(a, b, down, 0.01)[0]
    assert isinstance(arc, Curve)
    np.testing.assert_allclose(arc.points[[0, -1]], [a, b], atol=1e-12)
    centre = np.array([0.006, 0.0, 0.008])
    np.testing.assert_allclose(np.linalg.norm(arc.points - centre, axis=1), 0.01, atol=1e-12)
    assert arc.points[:, 2].min() == pytest.approx(-0.002, abs=1e-5)
    with pytest.raises(InputError, match="got points 30 mm apart; allowed: above 0, up to 20"):
        stitch(a, [0.03, 0.0, 0.0], down, 0.01)


def test_an_image_of_another_size_is_rejected() -> None:
    with pytest.raises(InputError, match=r"image: got 400x10; allowed: 400x300"):
        overlaid(BLACK[:10], View(EYE, inverse(T_EYE)), [])


def test_overlays_stay_where_they_belong_while_the_scope_moves() -> None:
    pytest.importorskip("moderngl", reason="needs the extra scope")
    task = make_task("augmented-reality")
    assert isinstance(task, AugmentedReality)
    ends = np.array([[-0.02, -0.02, 0.005], [-0.012, 0.015, 0.005]])
    seen: list[tuple[StereoFrame, np.ndarray]] = []

    def see(frame: StereoFrame) -> list[Item]:
        seen.append((frame, ends))
        return [Curve(ends, (255, 255, 255), 1)]

    task.see = see  # type: ignore[method-assign]
    task.reset(1)
    rates = np.concatenate([task.controller.idle()["PSM1"], [0.3, 0.2, 0.0, 0.2]])
    cameras = []
    for _ in range(8):
        task.command(rates)
        if len(seen) > len(cameras):
            (frame, _), shown = seen[-1], task.shown
            assert shown is not None
            cameras.append(frame.T_world_camera[0])
            t = np.linspace(0.0, 1.0, 2000)[:, None]
            line = frame.project(ends[0] + t * (ends[1] - ends[0]))
            line = line[np.argsort(line[:, 1])]
            drawn = np.abs(shown.astype(float) - frame.left).sum(axis=2)
            for v in range(int(line[0, 1]) + 3, int(line[-1, 1]) - 3):
                u = drawn[v] @ np.arange(drawn.shape[1]) / drawn[v].sum()
                # The goal is 0.2 px; noise of the image below weighs 0.03 px of it.
                assert abs(u - np.interp(v, line[:, 1], line[:, 0])) < 0.2
    task.close()
    assert len(cameras) == 4 and np.abs(cameras[0] - cameras[-1]).max() > 1e-3


def test_images_of_a_scene_look_as_the_scene_says() -> None:
    pytest.importorskip("moderngl", reason="needs the extra scope")
    scene = load_scene("augmented-reality")
    changed = replace(scene, look={"style": "plain", "vignette": 0.5})
    for given, look in (
        (scene, Look("surgical", noise=0.03)),
        (changed, Look("plain", noise=0.03, vignette=0.5)),
    ):
        task = make_task(given)
        assert isinstance(task, AugmentedReality)
        task.reset(1)
        drawn = task.scope().renderer.look
        assert replace(drawn, bleeding_at=look.bleeding_at) == look  # the pad's middle in a scene
        # A film begins with them, before anything was looked at.
        assert task.picture(lambda: BLACK).shape == (480, 640, 3)
        task.close()


def test_overlays_of_mirrored_arms_lie_where_the_robots_own_camera_has_them() -> None:
    robot, twin = World("two_psm_ecm"), World("two_psm_ecm")
    rng = np.random.default_rng(3)
    for name in ("PSM1", "ECM"):
        q = robot.arms[name].joints.positions()
        q[:4] += rng.uniform(-0.03, 0.03, 4) * [1.0, 1.0, 0.1, 1.0]
        robot.set_state(name, q)
    eyes = robot.camera("endoscope").calibration
    at = robot.camera("endoscope").T_world_eyes[1]
    line = at @ [[-0.005, 0.008], [0.002, -0.003], [0.08, 0.09], [1.0, 1.0]]
    true = View(eyes.eyes[1], at).pixels(line[:3].T).mean(axis=0)
    on_tool = inverse(robot.arms["PSM1"].measured_cp("world").matrix) @ line
    image = np.zeros((eyes.eyes[1].height, eyes.eyes[1].width, 3), np.uint8)

    def drawn() -> float:
        """Return by how much the middle of a curve on the twin's tool is off in the image [px]."""
        ends = twin.arms["PSM1"].measured_cp("world").matrix @ on_tool
        view = View(eyes.eyes[1], twin.camera("endoscope").T_world_eyes[1])
        shown = overlaid(image, view, [Curve(ends[:3].T, (255, 255, 255), 1)])[..., 0].astype(float)
        v, u = np.nonzero(shown)
        mean = np.array([u, v]) @ shown[v, u] / shown.sum()
        return float(np.linalg.norm(mean - true))

    assert drawn() > 5.0
    for name in ("PSM1", "ECM"):  # the joint states at the image's stamp
        command = follow(name, robot.arms[name].joints.positions(), np.zeros(7), "set")
        assert command.act is not None
        command.act(twin)
    assert drawn() < 0.2
