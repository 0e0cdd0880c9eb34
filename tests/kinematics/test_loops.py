"""Loops: when they close, on which branch, and where they are singular."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trocar.descriptions import load_arm, names
from trocar.descriptions.paper import load_printed
from trocar.errors import LoopError
from trocar.kinematics import loops
from trocar.kinematics.forward import coordinates, pose
from trocar.kinematics.mechanism import Mechanism, check_mechanism

LOOPED = ["psm", "ecm", "mtml", "mtmr"]


def bent(mechanism: Mechanism, longer_m: float) -> Mechanism:
    """Return a PSM whose upper bar is longer than the lower one."""
    c1, c2 = mechanism.closures
    changed = replace(c2, point_a=c2.point_a + np.array([longer_m, 0.0, 0.0]))
    return replace(mechanism, closures=(c1, changed))


@pytest.mark.parametrize("name", LOOPED)
def test_couplings_close_the_built_in_loops_to_rounding(name, rng, random_positions):
    arm = load_arm(name)
    q = random_positions(arm, rng, 500)
    assert loops.loops_are_parallelograms(arm.mechanism)
    assert loops.gaps(arm.mechanism, coordinates(arm.mechanism, q)).max() < 1e-12


def test_other_loops_are_closed_and_their_frames_move(rng, random_positions):
    arm = load_arm("psm")
    mechanism = bent(arm.mechanism, 2e-3)
    q = random_positions(arm, rng, 200)
    assert not loops.loops_are_parallelograms(mechanism)
    found = coordinates(mechanism, q)
    assert loops.gaps(mechanism, found).max() < 1e-12
    branch = np.sign(loops.branch_determinants(mechanism, found))
    assert (branch == branch[0]).all()
    moved = pose(mechanism, q, "pitch_end") - pose(arm.mechanism, q, "pitch_end")
    assert np.abs(moved).max() > 1e-3


def test_a_loop_that_cannot_close_is_an_error():
    mechanism = bent(load_arm("psm").mechanism, 0.2)
    with pytest.raises(LoopError, match=r"loop error is .* allowed 1e-09 m"):
        coordinates(mechanism, np.zeros(7))


#: Where a loop is flat as the pitch turns. Source: architecture.md, The mechanism, 2.
FLAT = {"psm": (-1.28, 1.46), "ecm": (-1.43, 1.65)}


@pytest.mark.parametrize("name", FLAT)
def test_mended_tables_flatten_only_outside_the_joint_range(name):
    found = loops.flattenings(load_arm(name).mechanism)
    below, above = max(f.below for f in found), min(f.above for f in found)
    assert (below, above) == pytest.approx(FLAT[name], abs=0.006)  # given to two digits
    assert min(f.margin for f in found) > 0.2


@pytest.mark.parametrize(("table", "flat"), [("table4", -0.88), ("table5", -0.96)])
def test_printed_tables_flatten_near_or_inside_the_joint_range(table, flat):
    arm = load_printed(table)
    found = loops.flattenings(arm.mechanism)
    assert max(f.below for f in found) == pytest.approx(flat, abs=0.006)
    assert min(f.margin for f in found) < 0.2


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_the_determinant_vanishes_where_the_loop_is_flat(name):
    mechanism = load_arm(name).mechanism
    for row, found in enumerate(loops.flattenings(mechanism)):
        q = np.zeros(len(mechanism.joints))
        q[1] = found.above
        at = loops.coupled_coordinates(mechanism, q)
        assert abs(loops.branch_determinants(mechanism, at)[row]) < 1e-9
        q[1] = 0.0
        at = loops.coupled_coordinates(mechanism, q)
        assert abs(loops.branch_determinants(mechanism, at)[row]) > 0.2


def test_an_anti_parallelogram_closes_too_but_shows_on_the_branch():
    """A gap alone is no health check: the crossed linkage closes with the tool 0.3 m off."""
    mechanism = load_arm("psm").mechanism
    index = mechanism.frame_index
    straight = loops.coupled_coordinates(mechanism, np.array([0, -0.5, 0.1, 0, 0, 0, 0]))
    crossed = straight.copy()
    passive = [index["pitch_top"], index["pitch_end"]]
    crossed[passive] += [0.4, -2.5]
    for _ in range(60):
        miss = loops.residuals(mechanism, crossed)[1]
        slope = loops.residual_jacobian(mechanism, crossed)[3:6][:, passive]
        step = np.linalg.lstsq(slope, miss, rcond=None)[0]
        crossed[passive] -= np.clip(step, -0.2, 0.2)
    assert loops.gaps(mechanism, crossed)[1] < 1e-9
    assert np.abs(crossed - straight).max() > 0.5
    signs = [np.sign(loops.branch_determinants(mechanism, c))[1] for c in (straight, crossed)]
    assert signs[0] == -signs[1]


@pytest.mark.parametrize("name", names("arms"))
def test_every_built_in_mechanism_hangs_together(name):
    check_mechanism(load_arm(name).mechanism)


def test_a_frame_before_its_parent_is_rejected():
    mechanism = load_arm("psm").mechanism
    backwards = replace(mechanism, frames=mechanism.frames[::-1])
    with pytest.raises(LoopError, match="comes before its parent"):
        check_mechanism(backwards)
