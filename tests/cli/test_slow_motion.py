"""--speed as a factor of real time: the same motion, slower by the wall clock."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from trocar.cli import main
from trocar.errors import InputError
from trocar.live import Loop
from trocar.simulation import World

SCRIPT = """
import crtk, dvrk, time
arm = dvrk.psm(crtk.ral("slow"), "PSM1")
arm.enable(); arm.home()
begun = time.time()
time.sleep(0.3)
print(round(time.time() - begun, 2), arm.measured_jp()[0].tolist())
"""


def test_a_loop_at_half_speed_takes_twice_the_time() -> None:
    loop = Loop(World("psm"), speed=0.5)
    begun = time.perf_counter()
    loop.run(0.2)
    assert time.perf_counter() - begun >= 0.39
    assert loop.world.time == pytest.approx(0.2)
    with pytest.raises(InputError, match="speed: got 0; allowed: above 0"):
        Loop(World("psm"), speed=0.0)


def test_a_script_in_slow_motion_has_simulated_time_and_the_same_motion(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    seen, wall = {}, {}
    for speed in ("max", "0.5"):
        begun = time.perf_counter()
        assert main(["run", "--rig", "psm", "--speed", speed, str(tmp_path / "script.py")]) == 0
        wall[speed] = time.perf_counter() - begun
        seen[speed] = capsys.readouterr().out
    assert seen["0.5"] == seen["max"]
    assert seen["max"].startswith("0.3 ")
    assert wall["0.5"] > 0.6


def test_a_served_simulation_runs_in_slow_motion(capsys: pytest.CaptureFixture[str]) -> None:
    begun = time.perf_counter()
    words = ["sim", "--rig", "psm", "--no-page", "--websocket-port", "0", "--duration", "0.2"]
    assert main([*words, "--speed", "0.25"]) == 0
    assert time.perf_counter() - begun > 0.78
    capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["sim", "--speed", "0"], "allowed: realtime, max, or a factor of real time above 0"),
        (["sim", "--speed", "slow"], "got 'slow'; allowed: realtime, max"),
        (["sim", "--headless", "--speed", "0.5"], "--speed: got 0.5 with --headless"),
        (
            ["play", "peg-board", "--headless", "--speed", "0.5"],
            "got 0.5 with --headless; allowed: max",
        ),
        (["run", "--page", "--speed", "0.5", "SCRIPT"], "--page: got --speed 0.5; allowed"),
    ],
)
def test_a_speed_that_does_nothing_is_refused(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    assert main([str(tmp_path / "script.py") if w == "SCRIPT" else w for w in words]) == 2
    assert said in capsys.readouterr().err
