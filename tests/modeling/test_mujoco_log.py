"""MuJoCo's warnings go to the log, not into a file of the working folder."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trocar.errors import DivergedError
from trocar.modeling.mujoco_log import OnceAMinute, log_mujoco_warnings
from trocar.simulation import World


@pytest.fixture(autouse=True)
def fresh() -> Iterator[None]:
    """Begin without a handler, and with nothing said yet."""
    log, handler = logging.getLogger("trocar.mujoco"), mujoco.get_mju_user_warning()
    filters, log.filters = log.filters, []
    mujoco.set_mju_user_warning(None)
    yield
    log.filters = filters
    mujoco.set_mju_user_warning(handler)


def test_a_world_that_diverges_logs_mujoco_s_warning_and_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(3):
        world = World("psm")
        world.mj_data.qvel[:] = 1e30
        with pytest.raises(DivergedError):
            world.step()
    assert not list(tmp_path.iterdir())
    said = [r.getMessage() for r in caplog.records if r.name == "trocar.mujoco"]
    assert len(said) == 2  # one for velocities and one for accelerations, of three worlds
    assert all(text.startswith("MuJoCo: Nan, Inf or huge value in Q") for text in said)


def test_a_handler_of_the_program_s_own_stays() -> None:
    heard: list[str] = []
    mujoco.set_mju_user_warning(heard.append)
    log_mujoco_warnings()
    data = mujoco.MjData(World("psm").model.mj)
    data.qvel[:] = np.inf
    mujoco.mj_step(World("psm").model.mj, data)
    assert heard


def test_a_kind_is_logged_once_a_minute_with_the_number_left_out() -> None:
    said, once = list[str](), OnceAMinute()
    for second in range(130):
        record = logging.LogRecord(
            "x", logging.WARNING, "", 0, "at DOF %d. Time = %f", (second, 0.1 * second), None
        )
        record.created = 1e9 + second
        if once.filter(record):
            said.append(record.getMessage())
    assert said == [
        "at DOF 0. Time = 0.000000",
        "at DOF 60. Time = 6.000000 (59 more since the last)",
        "at DOF 120. Time = 12.000000 (59 more since the last)",
    ]
