"""trocar view: recordings and logs in the web viewer, and their errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trocar.recording import record
from trocar.simulation import World

pytest.importorskip("mcap", reason="the extra `record` is not there")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("view") / "run.mcap"
    world = World("psm")
    with record(world, file):
        world.step(300)
    return file


@pytest.fixture
def log(tmp_path: Path) -> Path:
    t = np.arange(50) / 100.0
    head = "time," + ",".join(
        f"{arm}_{joint}_position"
        for arm in ("PSM1", "PSM2")
        for joint in ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw")
    )
    one = np.column_stack([0.1 * t, 0 * t, 0.1 + 0 * t, 0 * t, 0 * t, 0 * t, 0.3 + 0 * t])
    file = tmp_path / "log.csv"
    table = np.column_stack([t, one, one])
    np.savetxt(file, table, delimiter=",", header=head, comments="")
    return file


def test_a_recording_is_served(trocar, run):
    answer = trocar("view", run, "--port", "0", "--duration", "0.2")
    assert answer.status == 0
    assert answer.out.startswith("http://127.0.0.1:")


def test_with_a_host_it_has_an_address_for_others_that_only_watches(
    trocar, run, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("TROCAR_TOKEN", raising=False)
    words = ("--host", "0.0.0.0", "--port", "0", "--no-cameras", "--duration", "0.2")
    answer = trocar("view", run, *words)
    assert answer.status == 0
    own, others, file = answer.out.splitlines()
    assert own.startswith("http://127.0.0.1:") and "watch, request control" in others
    secrets = [line.partition("?token=")[2].partition(" ")[0] for line in (own, others)]
    assert all(len(secret) > 40 for secret in secrets) and secrets[0] != secrets[1]
    assert "addresses with the secret" in file and not list((tmp_path / "trocar").glob("*.json"))


def test_a_log_is_served_with_all_arms_of_a_rig_or_one_alone(trocar, log):
    words = ("--port", "0", "--no-cameras", "--duration", "0.2")
    answer = trocar("view", log, "--rig", "two_psm_ecm", *words)
    assert answer.status == 0
    assert "PSM1: 7 joints at 100.0 Hz" in answer.err and "PSM2: 7 joints" in answer.err
    answer = trocar("view", log, "--of", "PSM2", *words)
    assert answer.status == 0 and "PSM1" not in answer.err


def test_what_is_no_recording_is_one_clear_error(trocar, run, tmp_path):
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(run.read_bytes()[:300])
    for file in (torn, tmp_path / "missing.mcap", tmp_path):
        answer = trocar("view", file, "--port", "0", "--duration", "0.1")
        assert answer.status == 2
        assert str(file) in answer.err and "Traceback" not in answer.err


def test_options_of_logs_do_nothing_with_a_recording_and_are_refused(trocar, run):
    answer = trocar("view", run, "--arm", "psm")
    assert answer.status == 2
    assert "--arm: has no effect here; allowed with the log of a real arm only" in answer.err
