"""`trocar teleop`: its help shows every mapping, and what it cannot do it says."""

from __future__ import annotations

import gc

import pytest

from trocar.cli import main
from trocar.cli import teleop as command
from trocar.teleoperation.devices import TABLES


@pytest.mark.parametrize("device", TABLES)
def test_the_help_shows_what_everything_does(device: str) -> None:
    lines = [" ".join(line.split()) for line in (command.__doc__ or "").splitlines()]
    for line in TABLES[device]:
        assert " ".join(f"{line.touch} {line.does}".split()) in lines


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--no-page"], "requires the web viewer and the WebSocket"),
        (["--no-websocket"], "requires the web viewer and the WebSocket"),
        (["--device", "masters", "--rig", "psm"], "e.g. full_cart_mtm"),
        (["--arm", "PSM9", "--duration", "0.1"], "allowed: PSM1, PSM2"),
        (["--scale", "3"], "above 0 to 1"),
        (["--pose", "nowhere"], "nowhere"),
        (["--motion", "x.mcap"], "with --device masters"),
        (["--duration", "0"], "above 0 s"),
    ],
)
def test_what_cannot_be_done_is_said(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["teleop", "--port", "0", "--websocket-port", "0", "--no-cameras", *words]) == 2
    assert says in capsys.readouterr().err


def test_it_serves_and_says_what_keys_do(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser")
    words = ["--port", "0", "--websocket-port", "0", "--no-cameras", "--duration", "0.3"]
    try:
        assert main(["teleop", *words]) == 0
    finally:
        gc.unfreeze()  # serving freezes what there is, which other libraries stumble over
    told = capsys.readouterr().out
    assert "W  S" in told
    assert "select PSM1, PSM2\n" in told  # the rig's
    assert "http://127.0.0.1:" in told
    assert "ws://127.0.0.1:" in told
