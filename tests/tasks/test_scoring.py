"""Scores agree with closed forms and are invariant as their definitions say."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.cli import main
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.recording import record
from trocar.simulation import World
from trocar.tasks.scoring import (
    economy,
    fls_score,
    log_dimensionless_jerk,
    low_pass,
    path_length,
    score_forces,
    score_motion,
    score_recording,
)

Array = NDArray[np.float64]

#: Of a straight minimum-jerk reach over A in T: the integral of squared jerk is 720 A^2 / T^5 and
#: the peak speed 15/8 A / T (Flash and Hogan 1985).
MINIMUM_JERK = -math.log(720.0 / (15.0 / 8.0) ** 2)


def reach(length: float = 0.1, time: float = 1.0, count: int = 2001) -> tuple[Array, Array]:
    s = np.linspace(0.0, 1.0, count)
    along = 10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5
    return time * s, length * np.outer(along, [2.0 / 3.0, -1.0 / 3.0, 2.0 / 3.0])


def test_a_minimum_jerk_reach_has_its_closed_form() -> None:
    found = score_motion(*reach())
    # The trapezoidal rule at 2,001 samples.
    assert found.smoothness == pytest.approx(MINIMUM_JERK, abs=2e-4)
    assert found.economy == pytest.approx(1.0, abs=1e-12)
    assert found.path_length_m == pytest.approx(0.1, abs=1e-12)
    assert found.speed_max_m_s == pytest.approx(15.0 / 8.0 * 0.1, rel=1e-5)
    assert found.time_s == 1.0


def test_a_harmonic_reach_has_its_closed_form() -> None:
    # x = A (1 - cos(pi t / T)) / 2: jerk^2 integrates to (A pi^3 / 2 T^3)^2 T / 2, peak A pi / 2 T.
    t = np.linspace(0.0, 1.0, 2001)
    p = np.outer(0.5 - 0.5 * np.cos(np.pi * t), [0.0, 0.3, 0.4])
    assert log_dimensionless_jerk(t, p) == pytest.approx(-math.log(np.pi**4 / 2.0), abs=2e-4)


def test_smoothness_depends_on_neither_duration_nor_size_nor_direction() -> None:
    t, p = reach()
    p = p + 0.01 * np.sin(9.0 * t)[:, None] * [0.0, 1.0, 0.0]
    turn = matrix_from_rotation_vector(np.array([0.3, -1.0, 0.4]))
    other = log_dimensionless_jerk(7.0 * t + 3.0, 0.02 * p @ turn.T + [1.0, 2.0, 3.0])
    assert other == pytest.approx(log_dimensionless_jerk(t, p), abs=1e-5)


def test_tremor_makes_a_reach_less_smooth_longer_and_less_economic() -> None:
    t, p = reach()
    trembling = p + 0.001 * np.sin(60.0 * t)[:, None] * [0.0, 1.0, 0.0]
    calm, shaken = score_motion(t, p), score_motion(t, trembling)
    assert shaken.smoothness < calm.smoothness - 1.0
    assert shaken.path_length_m > calm.path_length_m
    assert shaken.economy < calm.economy


def test_economy_counts_the_stations_of_a_task() -> None:
    there_and_back = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert economy(there_and_back) == 0.0
    assert economy(there_and_back, there_and_back[1:2]) == 1.0
    corner = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 4.0, 0.0]]
    assert (path_length(corner), economy(corner)) == (7.0, 5.0 / 7.0)


def test_a_point_at_rest_has_no_economy_and_no_smoothness() -> None:
    found = score_motion(np.arange(9.0), np.ones((9, 3)))
    assert (found.path_length_m, found.speed_max_m_s) == (0.0, 0.0)
    assert math.isnan(found.economy) and math.isnan(found.smoothness)


def test_the_low_pass_keeps_a_reach_and_removes_rounding() -> None:
    t, p = reach(time=2.0)
    rough = p + np.random.default_rng(0).normal(0.0, 1e-6, p.shape)
    assert log_dimensionless_jerk(t, rough) < MINIMUM_JERK - 5.0
    # The jerk of a reach steps at its ends, which 10 Hz round off.
    assert log_dimensionless_jerk(t, low_pass(t, rough)) == pytest.approx(MINIMUM_JERK, abs=0.05)


def test_forces_have_peak_mean_and_impulse() -> None:
    t = np.linspace(0.0, 2.0, 201)
    found = score_forces(t, np.outer(t, [0.0, 3.0, 4.0]))
    assert (found.peak, found.mean) == pytest.approx((10.0, 5.0))
    assert found.impulse == pytest.approx(10.0)


def test_an_fls_score_counts_seconds_and_lost_objects() -> None:
    assert fls_score(60.0, objects=6) == 240.0
    assert fls_score(60.0, objects=6, drops=1, wrong=2) == pytest.approx(240.0 - 50.0)
    assert fls_score(301.0, objects=6) == fls_score(250.0, objects=1, drops=1) == 0.0


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: score_motion([0.0, 1.0, 2.0], np.zeros((3, 3))), "got 3 samples"),
        (lambda: score_motion([0.0, 1.0, 2.0, 9.0], np.zeros((4, 3))), "evenly spaced"),
        (lambda: score_motion([0.0, 1.0, 1.0, 2.0], np.zeros((4, 3))), "rising"),
        (lambda: score_motion(np.arange(4.0), np.full((4, 3), np.nan)), "finite"),
        (lambda: path_length(np.zeros((4, 2))), "(4, 2)"),
        (lambda: fls_score(-1.0, 6), "-1 s"),
        (lambda: fls_score(1.0, 0), "0 objects"),
    ],
)
def test_what_cannot_be_scored_is_one_clear_error(act, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        act()


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mcap")
    path = tmp_path_factory.mktemp("scores") / "run.mcap"
    world = World("psm")
    world.exchange_tool("PSM1", "PROGRASP_FORCEPS:420093")
    with record(world, path):
        world.arm("PSM1").move_jp([0.2, 0.1, 0.15, 0.4, 0.2, -0.3])
        world.step(1200)
    return path


def test_a_recording_is_scored_by_forward_kinematics_of_the_mounted_tool(file: Path) -> None:
    found = score_recording(file)
    one = found.arms["PSM1"].motion
    world = World("psm")
    world.exchange_tool("PSM1", "PROGRASP_FORCEPS:420093")
    tips = [world.arm("PSM1").local.measured_cp().matrix[:3, 3]]
    world.arm("PSM1").move_jp([0.2, 0.1, 0.15, 0.4, 0.2, -0.3])
    for _ in range(240):
        world.step(5)
        tips.append(world.arm("PSM1").local.measured_cp().matrix[:3, 3])
    assert one.path_length_m == pytest.approx(path_length(tips), rel=2e-3)
    assert one.time_s == pytest.approx(1.2)
    assert 0.9 < one.economy <= 1.0
    assert -12.0 < one.smoothness < MINIMUM_JERK


def test_score_prints_one_json_document(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["score", str(file), "--json", "--start", "0.1", "--end", "0.9"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["start_s"], document["end_s"]) == (0.1, 0.9)
    motion = document["arms"]["PSM1"]["motion"]
    assert motion["path_length_m"] == pytest.approx(
        score_recording(file, "PSM1", 0.1, 0.9).arms["PSM1"].motion.path_length_m
    )
    assert main(["score", str(file)]) == 0
    assert "PSM1" in capsys.readouterr().out


def test_an_unknown_arm_and_a_wrong_interval_are_rejected(file: Path) -> None:
    with pytest.raises(UnknownNameError, match="PSM9"):
        score_recording(file, "PSM9")
    with pytest.raises(InputError, match="a part of"):
        score_recording(file, start_s=0.5, end_s=99.0)
