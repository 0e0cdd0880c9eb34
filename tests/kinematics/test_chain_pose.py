"""Prepared chains against `pose`, which shares nothing with them but the mechanism."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm, names
from trocar.kinematics.chain_pose import ChainPose
from trocar.kinematics.forward import pose

ROUNDING = 1e-14  # of numbers of about 1 m


@pytest.mark.parametrize("name", names("arms"))
def test_a_prepared_chain_has_the_pose_of_every_frame_in_every_other(name: str) -> None:
    mechanism = load_arm(name).mechanism
    rng = np.random.default_rng(3)
    q = rng.uniform(mechanism.lower, mechanism.upper, (5, len(mechanism.joints)))
    frames = [frame.name for frame in mechanism.frames]
    bases = [mechanism.reference, frames[0], frames[-1]]
    for frame in frames:
        for base in bases:
            prepared = ChainPose(mechanism, frame, base)
            np.testing.assert_allclose(
                prepared(q), pose(mechanism, q, frame, base), rtol=0.0, atol=ROUNDING
            )


def test_one_configuration_and_many_have_the_same_poses() -> None:
    mechanism = load_arm("psm").mechanism
    q = np.random.default_rng(4).uniform(-0.2, 0.2, (3, 2, len(mechanism.joints)))
    prepared = ChainPose(mechanism)
    np.testing.assert_allclose(prepared(q)[2, 1], prepared(q[2, 1]), rtol=0.0, atol=ROUNDING)
