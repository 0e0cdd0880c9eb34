"""Hands in a real browser: pressed keys move a tool, a dragged handle carries a master."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.live import Loop
from trocar.ros import Core
from trocar.simulation import World
from trocar.teleoperation.session import Session
from trocar.viewer.page import PERIOD_S, Page
from trocar.viewer.server import LocalServer, address, run_there, serving

pytest.importorskip("selenium", reason="selenium is not installed")
from selenium.common.exceptions import ElementClickInterceptedException
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement

from tests.viewer.browser import Browser, chromium

pytestmark = pytest.mark.browser

Array = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
#: One master, one instrument, and nothing to look at but them.
RIG = """
schema = 1
name = "one_hand"
title = "a master and an instrument"
source = "this test"

[display]
xyz_m = [0.0, 0.0, 1.15]
rpy_deg = [150.0, 0.0, 0.0]
source = "this test"

[[arm]]
name = "PSM1"
description = "psm"
place = "rcm"
xyz_m = [0.0, 1.5, 1.0]
source = "this test"

[[arm]]
name = "MTMR"
description = "mtmr"
on = "HRSV"
place = "base"
xyz_m = [-0.18, 0.4, 0.475]
rotation = [[-1.0, 0.0, 0.0], [0.0, 0.866025403784439, 0.5], [0.0, 0.5, -0.866025403784439]]
source = "this test"

[[teleop]]
kind = "psm"
master = "MTMR"
slave = "PSM1"
source = "this test"

[[pose]]
name = "start"
source = "this test"
q_rad_m = { PSM1 = [0.0, 0.0, 0.12, 0, 0, 0, 0], MTMR = [-0.1, 0.3, 0.1, 0, 0.6, 0, 0, 1.0] }
"""
#: How far from a handle the eye is: its arrows are then larger than fingers. [m]
AWAY_M = 0.6
#: Where the arrow that points to the right is seen, from the middle of the view. [px]
ARROW_PX = 165
#: How far it is pulled, from there. [px]
PULL_PX = 60
#: Longer than the hand takes to carry the master there. Source: our own choice, on a slow
#: machine. [s]
CARRIED_S = 3.0
#: How long a key is held [s].
HELD_S = 1.0
#: Notes of the library's that lie over what a person would press.
NOTES = "for (const n of document.querySelectorAll('.mantine-Notification-root')) n.remove()"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with chromium(tmp_path_factory.mktemp("profile")) as found:
        found.tab.set_window_size(1300, 700)
        yield found


@contextmanager
def teleop(*words: str) -> Iterator[str]:
    """Run the command, and give the address of its page."""
    code = "import sys; from trocar.cli import main; sys.exit(main())"
    line = [sys.executable, "-c", code, "teleop", "--port", "0", "--websocket-port", "0", *words]
    env = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(line, env=env, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        try:
            page = next(m for said in running.stdout if (m := re.search(r"http://\S+", said)))
            yield page[0]
        finally:
            running.terminate()
            running.communicate(timeout=30)


def test_keys_go_to_the_tool_only_while_the_frame_has_them(browser: Browser) -> None:
    with teleop("--rig", "psm", "--no-cameras") as page:
        browser.open(page, "keys")
        frame = browser.tab.find_element(By.CSS_SELECTOR, '[data-trocar="keys"]')
        depth = browser.slider_value("insertion mm")
        ActionChains(browser.tab).key_down("s").perform()
        time.sleep(HELD_S)
        ActionChains(browser.tab).key_up("s").perform()
        assert browser.slider_value("insertion mm") == depth
        browser.wait(lambda: clicked(browser, frame), "the frame can be clicked on")
        ActionChains(browser.tab).key_down("s").perform()
        browser.wait(lambda: browser.slider_value("insertion mm") > depth + 3.0, "it goes down")
        ActionChains(browser.tab).key_up("s").perform()
        time.sleep(HELD_S)
        depth = browser.slider_value("insertion mm")
        time.sleep(HELD_S)
        assert browser.slider_value("insertion mm") == depth


def clicked(browser: Browser, element: WebElement) -> bool:
    """Click as a mouse does; a note of the page may lie over what is clicked on."""
    browser.tab.execute_script(NOTES)
    try:
        element.click()
    except ElementClickInterceptedException:
        return False
    return True


@contextmanager
def one_hand(tmp_path: Path) -> Iterator[tuple[Loop, LocalServer]]:
    """Serve a page with one master, in this process."""
    path, over = tmp_path / "one_hand.toml", threading.Event()
    path.write_text(RIG, encoding="utf-8")
    loop = Loop(World(str(path)))
    with (
        closing(Session("masters")) as session,
        closing(Core(loop, components=session.components(loop))) as core,
        serving("127.0.0.1", 0, "test") as server,
        closing(loop),
    ):
        core.begin()
        page = run_there(
            server, lambda: Page(server, loop.world, loop, driving=session.driving(None))
        )
        loop.start()

        def refresh() -> None:
            while not over.is_set() and not loop.wait(PERIOD_S):
                run_there(server, page.refresh)

        thread = threading.Thread(target=refresh)
        thread.start()
        try:
            yield loop, server
        finally:
            over.set()
            thread.join()


def pinch(browser: Browser) -> None:
    """Close and open the master's gripper by its slider, as the page says."""
    browser.choose("Arm", "MTMR")
    browser.wait(lambda: browser.labelled("gripper deg"), "the sliders are the master's")
    for angle in (10.0, 58.0):
        browser.type_number("gripper deg", angle)
        time.sleep(0.5)


def drag_along_x(browser: Browser, away_px: int) -> float:
    """Take hold of the red arrow in the middle of the view, pull at it, return the view's height.

    In the page's pixels: viser's own height shrinks with the resolution on a slow machine.
    """
    canvas = browser.tab.execute_script("return __viserMutable.canvas")
    hand = ActionChains(browser.tab, duration=600)
    hand.move_to_element_with_offset(canvas, ARROW_PX, 0).click_and_hold()
    hand.move_by_offset(away_px // 2, 0).move_by_offset(away_px - away_px // 2, 0)
    hand.pause(CARRIED_S).release().perform()
    return canvas.size["height"]


@pytest.mark.slow
def test_a_handle_that_is_dragged_carries_the_master_and_the_tool_follows(
    browser: Browser, tmp_path: Path
) -> None:
    with one_hand(tmp_path) as (loop, server):
        browser.open(address(server), "teleop")

        def says(word: str) -> bool:
            return word in (browser.read("teleop") or "")

        def tip(arm: str, pose: str) -> Array:
            T = getattr(loop.world.arm(arm).local, pose)().matrix
            return loop.world.reference_pose(arm) @ T

        browser.wait(lambda: says("ALIGNING") and says("pinch"), "it aligns")
        pinch(browser)
        browser.wait(lambda: says("follows"), "the tool follows")
        master, tool = tip("MTMR", "measured_cp"), tip("PSM1", "setpoint_cp")
        (client,) = run_there(server, server.get_clients).values()
        _x, y, z = master[:3, :3].T

        def look() -> None:
            client.camera.position = master[:3, 3] + AWAY_M * z
            client.camera.look_at = master[:3, 3]
            client.camera.up_direction = y

        run_there(server, look)
        browser.draw()
        height_px = drag_along_x(browser, PULL_PX)
        across_m = 2.0 * AWAY_M * np.tan(client.camera.fov / 2.0)
        way_m = PULL_PX / height_px * across_m
        carried = tip("MTMR", "measured_cp")
        np.testing.assert_allclose(
            master[:3, :3].T @ (carried[:3, 3] - master[:3, 3]), [way_m, 0.0, 0.0], atol=0.1 * way_m
        )
        followed = tip("PSM1", "setpoint_cp")
        hand = np.linalg.norm(carried[:3, 3] - master[:3, 3])
        assert np.linalg.norm(followed[:3, 3] - tool[:3, 3]) == pytest.approx(0.2 * hand, rel=0.01)
