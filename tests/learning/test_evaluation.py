"""Summaries of episodes."""

import math

import pytest

from trocar.errors import InputError
from trocar.learning.evaluation import summarise, wilson
from trocar.tasks import Episode


def episode(success: bool, time_s: float, force: float, reason: str = "done") -> Episode:
    each = {"PSM1": 1.0, "PSM2": 2.0}
    forces = {"PSM1": force, "PSM2": 0.5}
    return Episode(
        "s",
        0,
        success,
        reason,
        1.0,
        time_s,
        1,
        1,
        2,
        each,
        forces,
        each,
        each,
        "friction",
        "cad",
        "",
    )


def test_intervals_of_ratios_are_wilsons() -> None:
    # Source: Newcombe, Statistics in Medicine 17, 1998, table I, method 3: 81/263 and 0/20.
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)


def test_times_are_those_of_successes_and_forces_those_of_all() -> None:
    rows = [episode(True, 4.0, 1.0), episode(True, 6.0, 2.0), episode(False, 20.0, 6.0, "time")]
    found = summarise("p", rows)
    assert (found.episodes, found.successes, found.drops) == (3, 2, 6)
    assert found.time_s == 5.0
    assert found.force_n == (3.0, 6.0)
    assert found.distance_m == 3.0
    assert found.failures == {"time": 1}
    assert found.interval == wilson(2, 3)


def test_a_policy_that_never_succeeds_has_no_time() -> None:
    assert math.isnan(summarise("p", [episode(False, 20.0, 1.0, "time")]).time_s)


def test_no_episode_is_an_error() -> None:
    with pytest.raises(InputError, match="got no episode; allowed: one or more"):
        summarise("p", [])
