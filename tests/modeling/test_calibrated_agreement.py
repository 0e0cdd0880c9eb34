"""Calibrated arms: kinematics and compiled model agree on every frame, as for nominal ones."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.kinematics import forward
from trocar.modeling import naming
from trocar.modeling.build import build, lone_rig
from trocar.modeling.options import LAYERS, ModelOptions

#: As for nominal arms: twenty products of matrices of size 1; loops close to 1e-13 m besides.
AGREED = 1e-9


@pytest.mark.parametrize("name", ["psm", "ecm"])
@pytest.mark.parametrize("kind", ["parallel_overlay", "skew_overlay"])
def test_every_frame_of_a_calibrated_arm_is_where_the_compiled_model_has_it(
    name, kind, request, rng, random_positions
):
    arm = load_arm(name, calibration=request.getfixturevalue(kind)(name, rng))
    mechanism = arm.mechanism
    model = build(lone_rig(arm), ModelOptions(decoration=True)).mj
    data = mujoco.MjData(model)
    for q in random_positions(arm, rng, 30):
        coordinate = forward.coordinates(mechanism, q)
        for index, frame in enumerate(mechanism.frames):
            if frame.motion != "fixed":
                data.joint(naming.scoped("arm", frame.name)).qpos = coordinate[index]
        mujoco.mj_kinematics(model, data)
        analytic = forward.poses(mechanism, q, relative_to=arm.root)
        for frame in mechanism.frames:
            body = mujoco.mj_name2id(
                model, mujoco.mjtObj.mjOBJ_BODY, naming.scoped("arm", frame.name)
            )
            site = mujoco.mj_name2id(
                model, mujoco.mjtObj.mjOBJ_SITE, naming.scoped("arm", frame.name)
            )
            at, turn = (
                (data.xpos[body], data.xmat[body])
                if body >= 0
                else (data.site_xpos[site], data.site_xmat[site])
            )
            assert np.abs(analytic[frame.name][:3, 3] - at).max() < AGREED, frame.name
            assert np.abs(analytic[frame.name][:3, :3] - turn.reshape(3, 3)).max() < AGREED
        for closure in mechanism.closures:
            for side in ("a", "b"):
                site = data.site(naming.closing_site("arm", closure.name, side))
                assert np.abs(site.xpos - analytic[closure.name][:3, 3]).max() < AGREED


def test_a_loop_that_is_no_parallelogram_is_held_by_equal_layers_and_no_guard(skew_overlay, rng):
    def equalities(arm):
        model = build(lone_rig(arm)).mj
        return [model.equality(k).name for k in range(model.neq)]

    found = equalities(load_arm("psm", calibration=skew_overlay("psm", rng)))
    for closure in ("c1", "c2"):
        layers = [name for name in found if name.split("/")[1] == closure]
        assert len(layers) == LAYERS
    assert not [name for name in found if "/guard/" in name]
    assert len([n for n in equalities(load_arm("psm")) if n.split("/")[1] == "c1"]) == 1
