"""Rigs and scenes with Si arms in place of Classic ones: the same ports, tips and instruments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trocar.descriptions import load_arm, load_rig
from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.generation import on_si
from trocar.descriptions.rig_frames import Places
from trocar.errors import InputError
from trocar.kinematics.chain_pose import chain_pose


@pytest.mark.parametrize("name", ["training", "psm", "pegs"])
def test_ports_and_tips_stay_where_they_were(name):
    before = load_rig(name)
    after = on_si(before, load_arm)
    places = [Places(rig, lambda arm, rig=rig: rig.poses["start"][arm]) for rig in (before, after)]
    for arm in before.arms:
        tips = []
        for rig, at in zip((before, after), places, strict=True):
            own = chain_pose(rig.arm(arm.name).arm.mechanism)(rig.poses["start"][arm.name])
            tips.append(at.reference_pose(arm.name) @ own)
        np.testing.assert_allclose(tips[1], tips[0], rtol=0.0, atol=1e-9)
        ports = [at.remote_centres()[arm.name] for at in places]
        np.testing.assert_allclose(ports[1], ports[0], rtol=0.0, atol=1e-12)
        assert after.arm(arm.name).arm.generation == "Si"


def test_instruments_are_those_of_the_same_name_with_the_long_shaft():
    found = on_si(load_rig("training"), load_arm)
    assert found.arm("PSM1").arm.tool == "LARGE_NEEDLE_DRIVER:420006"


def test_setup_joints_stay_classic_and_are_named():
    with pytest.raises(InputError, match=r"got Si for the rig full_cart, which has SUJ_PSM1"):
        on_si(load_rig("full_cart"), load_arm)


def test_a_pose_that_an_si_arm_does_not_reach_names_arm_and_joint():
    rig = load_rig("psm")
    start = {"PSM1": rig.poses["start"]["PSM1"].copy()}
    start["PSM1"][1] = -0.9  # the shaft leans away from the base by more than an Si's can
    with pytest.raises(InputError, match=r"PSM1 of an Si does not reach its pose 'start' in psm"):
        on_si(replace(rig, poses={**rig.poses, "start": start}), load_arm)


def test_a_scene_takes_its_generation_by_a_setting():
    scene = load_scene("needle-reach", {"generation": "Si"})
    assert {arm.arm.generation for arm in scene.rig.arms} == {"Si"}
    assert load_scene("needle-reach").rig.arm("PSM1").arm.generation == "Classic"
