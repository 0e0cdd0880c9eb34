"""Belts of an Si: rigid unless a world has them stretch, and then by torque / stiffness."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from trocar.cli import main
from trocar.descriptions import load_arm
from trocar.errors import DescriptionError, InputError
from trocar.modeling.hinges import followers
from trocar.simulation import World


def sag(world: World) -> dict[str, float]:
    """Return how far each belt-driven link stands from where a rigid belt has it [rad]."""
    (place,) = world.rig.arms
    q = {frame: world.mj_data.joint(f"{place.name}/{frame}").qpos[0] for frame in frames(place.arm)}
    tied = {frame: (leader, ratio) for frame, leader, ratio in followers(place.arm)}
    return {
        frame: float(q[frame] - ratio * q[leader])
        for frame, (leader, ratio) in tied.items()
        if frame in place.arm.belts
    }


def frames(arm: Any) -> list[str]:
    return [frame.name for frame in arm.mechanism.frames if frame.motion != "fixed"]


@pytest.mark.parametrize(("rig", "poses"), [("psm_si", ("start", "folded")), ("ecm_si", ("back",))])
def test_the_static_sag_of_a_link_is_its_torque_by_the_stiffness(rig: str, poses: Any) -> None:
    world = World(rig, belts="stretch", gravity_compensation=True, friction="paper")
    (place,) = world.rig.arms
    for pose in poses:
        world.reset(pose=pose)
        world.step(3000)
        data = mujoco.MjData(world.mj_model)
        data.qpos[:] = world.mj_data.qpos
        mujoco.mj_forward(world.mj_model, data)  # at rest the bias is gravity's torque
        for frame, stretched in sag(world).items():
            torque = -data.qfrc_bias[world.mj_model.joint(f"{place.name}/{frame}").dofadr[0]]
            assert abs(torque) > 0.5
            assert stretched == pytest.approx(torque / place.arm.belts[frame], rel=1e-3)


def test_rigid_belts_do_not_sag() -> None:
    world = World("psm_si")
    world.step(1000)
    assert max(map(abs, sag(world).values())) < 1e-7


def test_a_world_with_rigid_belts_is_that_of_a_description_without_belts() -> None:
    """Off is bit-identical: the stiffness is not in the model."""
    rigid, stretching = World("psm_si"), World("psm_si", belts="stretch")
    assert rigid.mj_model.ntendon == stretching.mj_model.ntendon - 2
    assert rigid.mj_model.neq == stretching.mj_model.neq + 2


def test_the_encoders_do_not_see_the_stretch() -> None:
    """As on the robot: motors sit before the belts."""
    world = World("psm_si", belts="stretch", friction="paper")
    arm, home = world.arm("PSM1"), world.rig.poses["start"]["PSM1"]
    world.step(3000)
    assert max(map(abs, sag(world).values())) > 1e-4
    np.testing.assert_allclose(arm.joints.readings()[0], home, atol=5e-5)


def test_a_stretching_belt_passes_through_a_saved_state() -> None:
    world = World("psm_si", belts="stretch")
    world.arm("PSM1").move_jp([0.1, -0.6, 0.15, 0.1, 0.0, 0.0])
    world.step(100)
    state = world.save()
    world.step(200)
    first = world.mj_data.qpos.copy()
    world.load(state)
    world.step(200)
    np.testing.assert_array_equal(first, world.mj_data.qpos)


def test_a_rig_without_belts_rejects_that_they_stretch(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(
        InputError, match="belts: got 'stretch' for the rig psm, whose arms have no"
    ):
        World("psm", belts="stretch")
    assert main(["sim", "--rig", "psm", "--belts", "stretch", "--duration", "0.01"]) == 2
    assert "belts: got 'stretch'" in capsys.readouterr().err


def test_only_a_frame_that_follows_a_joint_has_a_belt(tmp_path: Any) -> None:
    own = load_arm("psm_si", "none")
    with open(own.file, encoding="utf-8") as file:
        text = file.read()
    for wrong in ("pitch_1", "yaw", "insertion_middle"):
        path = tmp_path / f"{wrong}.toml"
        path.write_text(
            text.replace("pitch_2 = { stiffness_nm", wrong + " = { stiffness_nm"), encoding="utf-8"
        )
        with pytest.raises(DescriptionError, match=rf"belts: got '{wrong}'; allowed: pitch_2, pit"):
            load_arm(path, "none")
