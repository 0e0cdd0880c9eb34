"""`trocar learn drive` over a WebSocket, and its errors."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from trocar.cli import main

REACH = Path(__file__).parents[2] / "examples" / "policies" / "reach.py"


@pytest.mark.slow
def test_a_policy_drives_a_scene_that_another_program_serves(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["play", "needle-reach", "--policy", "none", "--seed", "4", "--no-page"]
    command = [sys.executable, "-m", "trocar", *words, "--websocket-port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as served:
        try:
            address = next(iter(served.stdout or ())).split()[0]
            drive = ["learn", "drive", "needle-reach", "--seed", "4", "--json"]
            assert main([*drive, "--policy", str(REACH), "--websocket", address]) == 0
        finally:
            served.terminate()
    found = json.loads(capsys.readouterr().out)
    assert (found["success"], found["seed"], found["met"]) == (True, 4, 1)


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        ("needle-reach --policy scripted", 2, "one of the arguments --ros1 --ros2 --websocket"),
        ("needle-reach --websocket ws://x", 2, "required: --policy"),
        ("needle-reach --policy scripted --websocket x", 2, "got 'x'; allowed: ws://HOST:PORT"),
        ("needle-reach --policy scripted --trust --ros1", 2, "allowed with --policy FILE.zip only"),
        ("needle-reach --policy none.py --ros1", 2, "none.py: cannot be read"),
        ("needle-reach --policy scripted --seed -1 --ros1", 2, "--seed: got -1"),
        ("needle-rech --policy scripted --ros1", 2, "did you mean 'needle-reach'?"),
        ("needle-reach --policy scripted --websocket ws://127.0.0.1:1", 1, "no connection to ws:"),
    ],
)
def test_bad_options_are_one_line(
    words: str, status: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["learn", "drive", *words.split()]) == status
    complaint = capsys.readouterr().err
    assert message in complaint
    assert complaint.count("\n") == 1
