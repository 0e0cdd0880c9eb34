"""`python -m benchmarks soak`: what it compares, and that it sees what grows."""

from __future__ import annotations

import gc
import logging
import math
import mmap
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks import soak as file
from benchmarks.soak import Soak, Window, soak
from trocar.descriptions import load_rig
from trocar.errors import InputError
from trocar.robot.verification.figures import Figure
from trocar.simulation import World
from trocar.simulation.trials import paper_sine


def by_name(soaked: Soak) -> dict[str, Figure]:
    return {figure.name.removeprefix("soak: "): figure for figure in soaked.figures}


def test_a_sine_in_pieces_is_the_sine() -> None:
    rig = load_rig("psm")
    whole = paper_sine(rig, 3.0, 0.005)
    parts = [paper_sine(rig, 1.25, 0.005), paper_sine(rig, 1.75, 0.005, 1.25)]
    for table in ("positions", "velocities", "expected"):
        joined = np.concatenate([getattr(part, table)["PSM1"] for part in parts])
        np.testing.assert_allclose(joined, getattr(whole, table)["PSM1"], atol=1e-12)


@pytest.mark.parametrize("duration", [0.004, 0.02, 4.0, 25.0, 119.995, 120.0, 130.005, 36000.0])
def test_windows_are_equal_and_cover_the_run_in_pieces(duration: float) -> None:
    windows = list(file.window_edges(duration))
    pieces = [piece for window in windows for piece in window]
    ends = [end for _, end in pieces]
    assert pieces[0][0] == 0.0
    assert [begin for begin, _ in pieces[1:]] == ends[:-1]
    assert ends[-1] == pytest.approx(duration, abs=0.0051)
    assert all(0.0 < end - begin <= 10.0 + 1e-9 for begin, end in pieces)
    lengths = [window[-1][1] - window[0][0] for window in windows]
    assert max(lengths) - min(lengths) <= 0.0051
    assert len(windows) == (int(duration // 60.0) if duration >= 120.0 else min(4, len(pieces)))


def test_a_short_soak_of_the_cart_meets_its_goals_but_for_memory(caplog) -> None:
    said: list[str] = []
    with caplog.at_level(logging.WARNING):
        found = by_name(soak(1.0, said.append))
    assert not caplog.records
    assert said == [f"soak: {end} of 1 s" for end in ("0.25", "0.5", "0.75", "1")]
    for name in ("branch flips", "warnings of MuJoCo", "commands rejected or clipped"):
        assert found.pop(name).value == 0.0
    assert 0.0 < found["loop gap, first 0.25 s"].value <= 0.1
    assert 0.0 < found["remote-centre error, all the time"].value <= 3.0
    assert found["simulated time"].value == 1.0
    if sys.platform.startswith("linux"):
        assert found["growth of it from then on"].upper is None  # a goal for whole minutes


def test_a_soak_is_the_same_each_time_but_for_memory() -> None:
    first, again = (by_name(soak(0.4, rig="psm")) for _ in range(2))
    for name in first:
        if not any(word in name for word in ("memory", "growth", "open files", "later")):
            assert first[name] == again[name]


def test_the_pieces_of_a_soak_are_one_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = by_name(soak(1.2, rig="psm"))
    monkeypatch.setattr(file, "PIECE_S", 0.1)
    pieces = by_name(soak(1.2, rig="psm"))
    for name in ("loop gap, all the time", "remote-centre error, all the time"):
        assert pieces[name].value == pytest.approx(whole[name].value, rel=1e-3)


def grown(monkeypatch: pytest.MonkeyPatch, factor: float) -> dict[str, Figure]:
    """Return the figures of a run whose loops gape by a factor more in its last minute."""

    def play(_: World, begin: float, *__: object) -> Window:
        size = 1e-7 * (factor if begin >= 65.0 else 1.0)
        right = begin < 65.0 or factor == 1.0
        return Window(loop_gap_m=size, rcm_error_m=2.0 * size, branch_ok=right)

    monkeypatch.setattr(file, "play_piece", play)
    return by_name(soak(125.0, rig="psm"))


def test_what_stays_is_met(monkeypatch: pytest.MonkeyPatch) -> None:
    found = grown(monkeypatch, 1.0)
    assert found["loop gap, last 62.5 s"].met
    assert found["remote-centre error, last 62.5 s"].met
    assert found["branch flips"].met


def test_what_grows_is_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    found = grown(monkeypatch, 1.06)
    assert found["loop gap, first 62.5 s"].value == pytest.approx(0.1)
    for name in ("loop gap, last 62.5 s", "remote-centre error, last 62.5 s", "branch flips"):
        assert found[name].met is False


def test_memory_that_grows_after_the_first_minute_is_missed(monkeypatch) -> None:
    sizes = iter([100_000_000, 102_000_000])
    monkeypatch.setattr(file, "resident_memory", lambda: next(sizes))
    found = grown(monkeypatch, 1.0)
    assert found["resident memory after the first 62.5 s"].value == pytest.approx(100.0)
    assert found["growth of it from then on"].value == pytest.approx(2.0)
    assert found["growth of it from then on"].met is False


def test_a_file_that_is_left_open_is_missed(monkeypatch, tmp_path: Path) -> None:
    if file.file_handles() is None:
        pytest.skip("/proc/self/fd is Linux's")
    left_open = []

    def play(*_: object) -> Window:
        left_open.append((tmp_path / "leak").open("wb"))
        return Window()

    monkeypatch.setattr(file, "play_piece", play)
    found = by_name(soak(0.02, rig="psm"))
    for leak in left_open:
        leak.close()
    assert found["more of them later"].value == 3.0
    assert found["more of them later"].met is False


def test_one_psm_of_a_cart_rests_and_the_energy_of_its_motion_is_watched() -> None:
    world = World("three_psm")
    arm = file.resting_arm(world)
    assert arm.startswith("PSM")
    watched = file.RestEnergy(world, arm)
    other = next(a.name for a in world.rig.arms if a.name != arm)
    world.step(100)
    at_rest = watched.kinetic()
    world.arm(other).servo_jp(world.arm(other).joints.positions()[:6] + 0.01)
    world.step(100)
    assert watched.kinetic() <= max(at_rest, 1e-9)  # the others are mounted apart from it
    world.arm(arm).servo_jp(world.arm(arm).joints.positions()[:6] + 0.01)
    world.step(100)
    assert watched.kinetic() > 1e-6


def test_ctrl_c_ends_a_soak_after_its_last_whole_window(monkeypatch) -> None:
    def play(_: World, begin: float, *__: object) -> Window:
        if begin >= 0.5:
            raise KeyboardInterrupt
        return Window()

    monkeypatch.setattr(file, "play_piece", play)
    soaked = soak(1.0, rig="psm")
    assert by_name(soaked)["simulated time"].value == 0.5
    assert [window.end_s for window in soaked.windows] == [0.25, 0.5]


def test_where_nobody_tells_the_memory_the_report_says_so(monkeypatch) -> None:
    monkeypatch.setattr(file, "resident_memory", lambda: None)
    found = by_name(soak(0.02, rig="psm"))
    assert math.isnan(found["resident memory (not available here)"].value)
    assert "growth of it from then on" not in found


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="statm is Linux's")
def test_resident_memory_grows_with_what_is_held() -> None:
    gc.collect()  # what earlier tests left would be given back meanwhile
    before = file.resident_memory()
    with mmap.mmap(-1, 256_000_000) as held:  # new pages; an array may be put where others were
        np.frombuffer(held, dtype=np.uint8).fill(1)
        after = file.resident_memory()
    assert before is not None and after is not None
    assert after - before == pytest.approx(256_000_000, rel=0.1)


def test_refused_commands_and_the_engine_s_warnings_are_counted(monkeypatch) -> None:
    play = file.play_piece

    def clumsy(world: World, begin: float, end: float, arm: str) -> Window:
        world.arm("PSM1").servo_jp([float("nan")] * 6)
        world.mj_data.warning.number[int(mujoco.mjtWarning.mjWARN_CNSTRFULL)] += 2
        return replace(play(world, begin, end, arm), clipped=3)

    monkeypatch.setattr(file, "play_piece", clumsy)
    found = by_name(soak(0.01, rig="psm"))
    assert found["commands rejected or clipped"].value % 4 == 0.0
    assert found["commands rejected or clipped"].met is False
    assert found["warnings of MuJoCo"].met is False


def test_the_engine_s_warnings_are_named_and_end_with_a_reset() -> None:
    world = World("psm")
    assert world.engine_warnings() == {}
    world.mj_data.warning.number[int(mujoco.mjtWarning.mjWARN_CONTACTFULL)] = 3
    assert world.engine_warnings() == {"contactfull": 3}
    world.reset()
    assert world.engine_warnings() == {}


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan"), float("inf")])
def test_a_soak_of_no_time_is_refused(duration: float) -> None:
    with pytest.raises(InputError, match=r"soak: got .* s; allowed: above 0"):
        soak(duration)
