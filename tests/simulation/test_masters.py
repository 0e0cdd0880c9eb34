"""The masters at the console: where they stand, and how their parallelograms move."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.geometry.dh import standard_dh
from trocar.simulation import World
from trocar.simulation.trials import TICK_S, loop_health, paper_sine

RIGHT = np.pi / 2
MASTERS = {"MTML": 0.180, "MTMR": -0.180}


def printed_base(x: float) -> np.ndarray:
    """T_HRSV_base. Source: SAW system-full-system-simulated.json; 0.866025 means cos 30 deg."""
    cos = np.cos(np.pi / 6)
    return np.array(
        [[-1, 0, 0, x], [0, cos, 0.5, 0.400], [0, 0.5, -cos, 0.475], [0, 0, 0, 1]], dtype=float
    )


def printed_chain(q: np.ndarray) -> np.ndarray:
    """T_base_tip. Source: SAW MTML.json and MTMR.json."""
    return (
        standard_dh(0.0, RIGHT, 0.0, q[0] - RIGHT)
        @ standard_dh(0.2794, 0.0, 0.0, q[1] - RIGHT)
        @ standard_dh(0.3645, -RIGHT, 0.0, q[2] + RIGHT)
        @ standard_dh(0.0, RIGHT, 0.1506, q[3])
        @ standard_dh(0.0, -RIGHT, 0.0, q[4])
        @ standard_dh(0.0, RIGHT, 0.0, q[5] - RIGHT)
        @ standard_dh(0.0, 0.0, 0.0, q[6] + RIGHT)
    )


@pytest.fixture(scope="module")
def console():
    return World("mtm")


@pytest.mark.parametrize("rig", ["mtm", "full_cart_mtm"])
@pytest.mark.parametrize("name", MASTERS)
def test_a_master_is_seen_from_the_stereo_display_as_on_the_dvrk(rig, name):
    world = World(rig)
    seen = world.arm(name).measured_cp()
    q = world.arm(name).measured_js().position
    assert seen.frame_id == "HRSV"
    expected = printed_base(MASTERS[name]) @ printed_chain(q)
    np.testing.assert_allclose(seen.matrix, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(world.arm(name).setpoint_cp().matrix, expected, rtol=0, atol=1e-12)


def test_the_display_s_place_in_the_world_does_not_change_what_it_sees(console):
    beside = World("full_cart_mtm").arm("MTML").measured_cp().matrix
    np.testing.assert_allclose(console.arm("MTML").measured_cp().matrix, beside, atol=1e-12)


def test_the_bases_stand_level_and_the_hands_before_the_surgeon(console):
    for name in MASTERS:
        base = console.reference_pose(name)
        np.testing.assert_allclose(base[:3, 2], [0, 0, 1], atol=1e-12)
        assert 0.5 < base[2, 3] < 1.2  # between a seated surgeon's knees and eyes
    left, right = (console.arm(name).measured_cp().matrix[:3, 3] for name in MASTERS)
    assert left[0] > 0.0 > right[0]  # x of HRSV points left


def test_a_master_without_a_display_is_seen_from_its_own_base(tmp_path):
    path = tmp_path / "lone.toml"
    path.write_text(
        'schema = 1\nname = "lone"\nsource = "test"\n'
        '[[arm]]\nname = "MTML"\ndescription = "mtml"\nxyz_m = [0.0, 0.0, 1.0]\n'
        '[[pose]]\nname = "start"\n[pose.q_rad_m]\n'
        f"MTML = {load_rig('mtm').poses['start']['MTML'].tolist()}\n",
        encoding="utf-8",
    )
    arm = World(path).arm("MTML")
    assert arm.measured_cp().frame_id == "MTML_base"
    np.testing.assert_array_equal(arm.measured_cp().matrix, arm.local.measured_cp().matrix)


def test_the_forearms_parallelograms_hold_in_motion(console):
    """Whole amplitudes of the test sine; a PSM's loops reach 0.1 um."""
    sine = paper_sine(console.rig, 10.0, TICK_S)
    assert set(sine.positions) == set(MASTERS)
    gap, _, branch = loop_health(console, sine, round(TICK_S / console.timestep))
    assert 0.0 < gap <= 0.1e-6
    assert branch


def test_what_holds_a_master_hands_off_is_gravity_compensation():
    world = World("mtm", friction="paper")
    heights = {}
    for on in (True, False):
        world.reset()
        left = world.arm("MTML")
        left.joints.set_mode("effort")
        left.joints.use_gravity_compensation(on)
        before = left.local.measured_cp().matrix[2, 3]
        world.step(2000)
        heights[on] = abs(left.local.measured_cp().matrix[2, 3] - before)
    assert heights[True] < 1e-4 < 5e-3 < heights[False]


def test_a_push_moves_a_floating_master_and_friction_stops_it():
    """Of 0.3 N m on the shoulder its friction takes 0.03; let go, it stays where it stops."""
    world = World("mtm")
    left = world.arm("MTML")
    left.joints.set_mode("effort")
    effort = np.zeros(7)
    effort[1] = 0.3
    left.servo_jf(effort)
    world.step(300)
    left.servo_jf(np.zeros(7))
    moved = left.measured_js().position[1] - left.joints.poses["start"][1]
    world.step(3000)
    rest = left.measured_js()
    assert moved > 0.01
    np.testing.assert_allclose(rest.velocity, 0.0, atol=1e-3)
    assert rest.position[1] > left.joints.poses["start"][1] + moved


def test_a_master_that_is_pushed_away_is_not_at_fault():
    """Source: SAW mtsIntuitiveResearchKitMTM.h, should_use_measured_setpoint_check: false."""
    world = World("mtm")
    left = world.arm("MTML")
    left.servo_jp(left.joints.poses["start"][:7] + 0.8 * np.eye(7)[0])
    world.step(100)
    off = left.setpoint_js().position[0] - left.measured_js().position[0]
    assert off > left.description.joint("outer_yaw").tracking_tolerance
    assert left.operating_state().state == "ENABLED"
