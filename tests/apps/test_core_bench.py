"""What `trocar bench core` measures."""

from __future__ import annotations

import math

from trocar.apps.benchmarks import core
from trocar.apps.benchmarks.core import _holding_a_block, _skewed
from trocar.simulation import World


def test_every_figure_is_a_cost() -> None:
    told: list[str] = []
    found = core(told.append)
    assert all(math.isfinite(figure.value) for figure in found)
    assert all(figure.value > 0.0 for figure in found if "Python's share" not in figure.name)
    assert {"verbs of calibrated psm", "solver", "batch"} <= set(told)


def test_the_calibrated_arm_has_loops_that_are_no_parallelograms() -> None:
    world = World("psm", calibration=_skewed())
    assert not world.joints.arms["PSM1"].parallel
    assert World("psm").joints.arms["PSM1"].parallel


def test_the_block_is_in_the_jaws_and_off_the_board() -> None:
    world = _holding_a_block()
    pairs = [{c.body, c.other} for c in world.contacts().contacts if "block2" in (c.body, c.other)]
    assert pairs
    assert all(any("finger" in name for name in pair) for pair in pairs)
