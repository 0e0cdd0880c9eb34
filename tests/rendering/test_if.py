"""Ground truth of frames, and pictures of worlds with objects elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from tests.rendering.scenes import camera, disc, mesh, plate, snapshot, stereo
from trocar.descriptions.cameras import load_camera
from trocar.errors import UnknownNameError
from trocar.geometry.rotations import rotation_y
from trocar.geometry.se3 import transform
from trocar.rendering import Channels, Endoscope, Look, Renderer
from trocar.simulation import World

pytestmark = pytest.mark.usefixtures("opengl")

BACK = mesh("back", plate(transform(np.eye(3), [0.0, 0.0, 0.12]), 0.4, 0.4))
BALL = mesh("ball", disc(np.zeros(3), 0.005)[0], body=1)
LID = mesh("lid", plate(np.eye(4), 0.02, 0.02), body=2)
AWAY = transform(np.eye(3), [0.0, 0.0, -1.0])
HERE = transform(np.eye(3), [0.006, -0.004, 0.09])
EYES = {"eye": camera(stereo((-0.2, 0.05, 0.001, -0.001)))}
LOOK = Look(distortion=True, exposure=0.0)


@pytest.fixture(scope="module")
def renderer(opengl: str) -> Renderer:  # noqa: ARG001  skips without
    return Renderer(lambda: (1, [BACK, BALL, LID]), Channels(True, True), LOOK)


def test_projected_points_lie_in_the_middle_of_what_is_seen_there(renderer: Renderer) -> None:
    frame = renderer.render(snapshot([HERE, AWAY]), EYES, "eye")
    assert frame.ids is not None
    number = {name: k for k, name in frame.names.items()}["ball"]
    for eye in (0, 1):
        seen = np.argwhere(frame.ids[eye] == number)[:, ::-1].mean(axis=0)
        assert np.abs(frame.project(HERE[:3, 3], eye) - seen).max() < 0.2
    assert np.isnan(frame.project([[0.0, 0.0, -0.1]])).all()


def test_objects_elsewhere_are_drawn_as_if_they_were_there(renderer: Renderer) -> None:
    true = renderer.render(snapshot([HERE, AWAY]), EYES, "eye")
    imagined = renderer.render(snapshot([AWAY, AWAY]), EYES, "eye", poses={"ball": HERE})
    assert (true.side_by_side == imagined.side_by_side).all()


def test_only_chosen_objects_are_there_and_throw_shadows(renderer: Renderer) -> None:
    where = snapshot([HERE, AWAY])
    alone = renderer.render(where, EYES, "eye", only=["ball"])
    assert alone.ids is not None and set(np.unique(alone.ids)) == {0, 2}
    bare = renderer.render(where, EYES, "eye", only=["back"])
    empty = renderer.render(snapshot([AWAY, AWAY]), EYES, "eye")
    assert (bare.side_by_side == empty.side_by_side).all()
    with pytest.raises(UnknownNameError, match=r"unknown object 'needle'.*ball"):
        renderer.render(where, EYES, "eye", only=["needle"])


@pytest.mark.parametrize("samples", [0, 4])
def test_the_visible_share_is_what_is_left_beside_a_lid(samples: int) -> None:
    look = Look(distortion=True, samples=samples)
    renderer = Renderer(lambda: (1, [BACK, BALL, LID]), Channels(visible=("ball", "lid")), look)
    # The lid's edge passes ahead of the disc's middle for the left eye alone.
    lid = transform(np.eye(3), HERE[:3, 3] * 0.5 + [0.01, 0.0, 0.0])
    shares = {
        name: renderer.render(snapshot([HERE, T]), EYES, "eye").visible
        for name, T in (("free", AWAY), ("half", lid))
    }
    assert np.allclose(shares["free"]["ball"], 1.0) and np.isnan(shares["free"]["lid"]).all()
    assert shares["half"]["ball"][0] == pytest.approx(0.5, abs=0.02)
    assert shares["half"]["lid"][0] == 1.0
    assert renderer.render(snapshot([HERE, lid]), EYES, "eye").ids is None
    renderer.close()


def test_frames_have_the_joints_of_their_stamp_and_cameras_may_be_elsewhere() -> None:
    world = World("training")
    scope = Endoscope(world, calibration=load_camera("dvrk_sd_640x480"))
    world.arm("PSM1").move_jp(world.arm("PSM1").setpoint_js().position + 0.05)
    world.step(100)
    frame = scope.capture()
    assert (frame.arms["PSM1"].q == world.snapshot().arms["PSM1"].q).all()
    T = world.camera("endoscope").T_world_camera @ transform(rotation_y(0.1), np.zeros(3))
    now, cameras = world.snapshot(), world.cameras()
    there = scope.render(now, cameras, T_world_camera=T)
    middle = 0.5 * (there.T_world_camera[0] + there.T_world_camera[1])[:3, 3]
    assert np.allclose(middle, T[:3, 3], atol=1e-9)
    assert (there.left != frame.left).mean() > 0.1
    scope.close()
