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

import trocar
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


def test_beyond_this_machine_the_web_viewer_has_an_address_for_others_that_only_watches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("TROCAR_TOKEN", raising=False)
    words = ["--rig", "psm", "--host", "0.0.0.0", "--port", "0", "--websocket-port", "0"]
    assert main(["sim", *words, "--duration", "0.2"]) == 0
    own, others, *_ = capsys.readouterr().out.splitlines()
    secrets = [line.partition("?token=")[2].partition(" ")[0] for line in (own, others)]
    assert own.startswith("http://127.0.0.1:") and "watch" in others
    assert all(len(secret) > 40 for secret in secrets) and secrets[0] != secrets[1]


def test_a_world_that_is_loaded_keeps_the_addresses_of_its_run() -> None:
    from argparse import ArgumentParser

    from trocar.cli.serving import add_serving, serve

    parser = ArgumentParser()
    add_serving(parser)
    words = ["--port", "0", "--host", "0.0.0.0", "--no-websocket", "--no-cameras"]
    args = parser.parse_args(words)
    args.duration, args.speed, args.record, args.given = 0.1, "max", None, {}
    queries: list[str] = []
    for _ in range(2):
        serve(trocar.World("psm"), args)
        queries.append(args.access.watch_query)
    assert queries[0] == queries[1]
