"""A run with a token: a program of the same user finds what it has to show."""

from __future__ import annotations

import json
import os
import threading
import time
from pathlib import Path

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from trocar.cli import main

TOKEN = "0123456789abcdef"


def test_a_program_of_the_same_user_connects_by_the_file_that_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("TROCAR_TOKEN", TOKEN)
    path = tmp_path / "trocar" / f"{os.getpid()}.json"
    heard: list[str] = []

    def program() -> None:
        end = time.monotonic() + 20.0
        while not (path.exists() and path.stat().st_size) and time.monotonic() < end:
            time.sleep(0.01)
        url = json.loads(path.read_text(encoding="utf-8"))["websocket"]
        try:
            connect(url.partition("/?")[0])
        except InvalidStatus as refused:
            heard.append(str(refused.response.status_code))
        with connect(url) as socket:
            socket.send(json.dumps({"op": "subscribe", "topic": "/PSM1/measured_js"}))
            heard.append(json.loads(socket.recv(timeout=20))["op"])

    thread = threading.Thread(target=program)
    thread.start()
    words = ["--rig", "psm", "--no-page", "--websocket-port", "0", "--duration", "3"]
    assert main(["sim", *words]) == 0
    thread.join()
    printed = capsys.readouterr().out
    assert heard == ["401", "publish"]
    assert str(path) in printed
    assert TOKEN not in printed
    assert not path.exists()
