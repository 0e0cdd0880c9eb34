"""RViz, on a screen that nobody sees, draws the cart, and the picture changes as it moves."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.ros.ros1.robot_os import SYSTEM_PYTHON, Master, Simulator, need, until
from trocar.descriptions import load_rig
from trocar.formats.links import rig_links
from trocar.formats.urdf import rviz_config

PUBLISHER = "/usr/lib/robot_state_publisher/robot_state_publisher"
CLIENT = Path(__file__).parents[2] / "clients" / "rospy" / "move.py"
pytestmark = pytest.mark.slow


@pytest.fixture
def screen(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """An X server of its own: its name, and the file that has what it shows."""
    need("Xvfb")
    reading, writing = os.pipe()
    with subprocess.Popen(
        ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1280x900x24",
         "-fbdir", str(tmp_path)],
        pass_fds=[writing], stderr=subprocess.DEVNULL,
    ) as server:  # fmt: skip
        os.close(writing)
        with os.fdopen(reading) as told:
            number = told.readline().strip()
        yield f":{number}", tmp_path / "Xvfb_screen0"
        server.terminate()


def shown(path: Path) -> NDArray[np.int16]:
    """What a screen shows, (rows, columns, 3). Source: X11/XWDFile.h, version 7."""
    content = path.read_bytes()
    head = struct.unpack(">25I", content[:100])
    size, width, height, line, colours = head[0], head[4], head[5], head[12], head[19]
    pixels = np.frombuffer(content, np.uint8, height * line, size + 12 * colours)
    return (
        pixels.reshape(height, line)[:, : 4 * width]
        .reshape(height, width, 4)[..., :3]
        .astype(np.int16)
    )


def drawn(path: Path) -> int:
    """How many pixels of the view, right of the panels, are not its white background."""
    view = shown(path)[80:650, 320:900]
    return int((view.min(axis=-1) < 230).sum())


def test_rviz_shows_the_cart_and_that_it_moves(
    screen: tuple[str, Path], master: Master, tmp_path: Path
) -> None:
    need("rviz", PUBLISHER, SYSTEM_PYTHON)
    display, picture = screen
    view = tmp_path / "view.rviz"
    view.write_text(rviz_config(rig_links(load_rig("full_cart")), 1), encoding="utf-8")
    software = {**master.env, "DISPLAY": display, "LIBGL_ALWAYS_SOFTWARE": "1"}
    with ExitStack() as stack:
        stack.enter_context(closing(Simulator(master.env, "--rig", "full_cart")))
        until(lambda: master.ask("hasParam", "/robot_description")[2], "the model is there")
        for command in ([PUBLISHER], ["rviz", "-d", str(view)]):
            process = stack.enter_context(
                subprocess.Popen(
                    command, env=software, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
                )
            )
            stack.callback(process.kill)
        until(lambda: drawn(picture) > 40_000, "RViz draws the cart")
        time.sleep(3.0)  # until every mesh is there
        before = shown(picture)
        master.run(SYSTEM_PYTHON, str(CLIENT), "PSM1")
        until(
            lambda: int((np.abs(shown(picture) - before).max(axis=-1) > 30).sum()) > 500,
            "the picture changes",
        )
        keep = os.environ.get("TROCAR_RVIZ_PICTURE")
        if keep:
            shutil.copy(picture, keep)
