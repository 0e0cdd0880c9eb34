"""The spine: analytic kinematics and the compiled model agree on every frame."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from trocar.descriptions import load_arm, names
from trocar.descriptions.records import ArmDescription
from trocar.kinematics import forward
from trocar.modeling import naming
from trocar.modeling.build import build, lone_rig
from trocar.modeling.options import ModelOptions

#: The Si arms are serial chains without masses (their [[missing]] says so).
SIMULATED = names("arms")
#: Both sides compute in float64 over about twenty products of matrices of size 1.
AGREED = 1e-9


def model_poses(
    arm: ArmDescription, model: mujoco.MjModel, data: mujoco.MjData
) -> dict[str, np.ndarray]:
    """Return the pose of each frame that the compiled model has, (4, 4)."""
    found: dict[str, np.ndarray] = {}
    for frame in arm.mechanism.frame_names:
        for kind, poses, turns in (
            (mujoco.mjtObj.mjOBJ_BODY, data.xpos, data.xmat),
            (mujoco.mjtObj.mjOBJ_SITE, data.site_xpos, data.site_xmat),
        ):
            index = mujoco.mj_name2id(model, kind, naming.scoped("arm", frame))
            if index >= 0:
                found[frame] = np.eye(4)
                found[frame][:3, 3] = poses[index]
                found[frame][:3, :3] = turns[index].reshape(3, 3)
    return found


@pytest.mark.parametrize("name", SIMULATED)
def test_every_frame_is_where_the_compiled_model_has_it(name, rng, random_positions):
    arm = load_arm(name)
    mechanism = arm.mechanism
    model = build(lone_rig(arm), ModelOptions(decoration=True)).mj
    data = mujoco.MjData(model)
    for q in random_positions(arm, rng, 50):
        coordinate = forward.coordinates(mechanism, q)
        for index, frame in enumerate(mechanism.frames):
            if frame.motion != "fixed":
                data.joint(naming.scoped("arm", frame.name)).qpos = coordinate[index]
        mujoco.mj_kinematics(model, data)
        analytic = forward.poses(mechanism, q, relative_to=arm.root)
        compiled = model_poses(arm, model, data)
        for closure in mechanism.closures:
            for side in ("a", "b"):
                site = data.site(naming.closing_site("arm", closure.name, side))
                assert np.abs(site.xpos - analytic[closure.name][:3, 3]).max() < AGREED
            del analytic[closure.name]
        assert set(analytic) == set(compiled)
        for frame, pose in analytic.items():
            assert np.abs(pose - compiled[frame]).max() < AGREED, frame


def test_wrong_sign_of_one_coupling_is_seen(rng, random_positions):
    """The agreement is no tautology: a model moved by -q2 at the top link does not agree."""
    arm = load_arm("psm")
    q = random_positions(arm, rng, 1)[0]
    q[1] = 0.5
    model = build(lone_rig(arm), ModelOptions(decoration=True)).mj
    data = mujoco.MjData(model)
    coordinate = forward.coordinates(arm.mechanism, q)
    coordinate[arm.mechanism.frame_index["pitch_top"]] *= -1.0
    for index, frame in enumerate(arm.mechanism.frames):
        if frame.motion != "fixed":
            data.joint(naming.scoped("arm", frame.name)).qpos = coordinate[index]
    mujoco.mj_kinematics(model, data)
    analytic = forward.poses(arm.mechanism, q, relative_to=arm.root)
    turned = model_poses(arm, model, data)["pitch_top"]
    assert np.abs(turned - analytic["pitch_top"]).max() > 0.1
