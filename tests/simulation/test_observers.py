"""Observers of a world are called as physics goes on, and change nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from trocar.errors import DivergedError, InputError
from trocar.simulation import World


def test_an_observer_is_called_after_every_period() -> None:
    world, seen = World("psm"), list[tuple[int, float]]()
    world.step(3)
    stop = world.observe(lambda: seen.append((world.periods, world.time)))
    world.step(7)
    world.play({"PSM1": np.full((2, 7), 0.1)}, every=2)
    stop()
    world.step(5)
    assert [period for period, _ in seen] == list(range(4, 15))
    np.testing.assert_allclose([time for _, time in seen], np.arange(4, 15) * 0.001)


def test_an_observer_of_every_fifth_period_waits_no_longer_than_that() -> None:
    world, seen = World("psm"), list[int]()
    stop = world.observe(lambda: seen.append(world.periods), every=5)
    world.step(3)
    world.step(100)
    stop()
    assert seen[0] == 3 and seen[-1] == 103
    assert max(np.diff(seen)) == 5


def test_motion_does_not_depend_on_observers() -> None:
    worlds = [World("two_psm_ecm") for _ in range(3)]
    worlds[1].observe(worlds[1].sample)
    worlds[2].observe(worlds[2].snapshot, every=7)
    for world in worlds:
        world.arm("PSM1").move_jp([0.3, 0.2, 0.15, 0.4, 0.2, -0.3])
        world.step(333)
    first = worlds[0].arm("PSM1").joints.readings()
    for world in worlds[1:]:
        assert np.array_equal(world.arm("PSM1").joints.readings(), first)


def test_a_state_that_is_not_finite_is_not_observed() -> None:
    world, seen = World("psm"), list[bool]()
    world.observe(
        lambda: seen.append(bool(np.isfinite(world.arm("PSM1").joints.readings()[0]).all()))
    )
    world.step(5)
    world.mj_data.qvel[0] = np.nan
    with pytest.raises(DivergedError):
        world.step(5)
    assert seen == [True] * 5


@pytest.mark.parametrize("every", [0, -1, 1.5, True, "1"])
def test_a_number_of_periods_that_is_not_whole_is_rejected(every: Any) -> None:
    with pytest.raises(InputError, match=r"every: got .*; allowed: a whole number above 0"):
        World("psm").observe(lambda: None, every)
