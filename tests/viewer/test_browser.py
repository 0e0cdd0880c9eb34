"""The page in a real browser: a slider moves an arm, and the browser changes nothing else."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from tests.live.fake_renderer import FakeRenderer
from trocar.live import Command, Loop
from trocar.live.images import Pictures
from trocar.ros import Core
from trocar.simulation import World
from trocar.teleoperation.session import Session
from trocar.viewer.page import PERIOD_S, Page
from trocar.viewer.server import address, run_there, serving

pytest.importorskip("selenium", reason="selenium is not installed")
from selenium.common.exceptions import (
    ElementClickInterceptedException,
    StaleElementReferenceException,
)
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By

from tests.viewer.browser import Browser, chromium

pytestmark = pytest.mark.browser

Script = list[tuple[int, Command]]
#: Notes of the library's that lie over what a person would press.
NOTES = "for (const n of document.querySelectorAll('.mantine-Notification-root')) n.remove()"
#: Time in which the page reports a new width and gets its layout [s]. Source: 0.5 s, measured.
RESIZED_S = 1.0
#: Whether the largest canvas has a size.
DRAWN = "return [...document.querySelectorAll('canvas')].some((c) => c.width > 300)"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with chromium(tmp_path_factory.mktemp("profile")) as found:
        yield found


def test_the_policy_blocks_nothing_that_the_page_needs(browser: Browser) -> None:
    browser.violations()  # those of pages before

    def act() -> None:
        browser.wait(lambda: browser.read("PSM1/yaw/measured") is not None, "the table")
        browser.wait(lambda: bool(browser.tab.execute_script(DRAWN)), "the scene is drawn")

    Stage("psm").play(browser, act)
    # viser's sorter of Gaussian splats, of which the page has none, compiles scripts at its start.
    assert [line for line in browser.violations() if "as JavaScript" not in line] == []


def test_a_page_that_was_left_open_shows_the_next_run(browser: Browser) -> None:
    with serving("127.0.0.1", 0, "before") as server:
        port = server.get_port()
        browser.tab.get(address(server))
        browser.wait(lambda: "before" in body(browser), "the first run is shown")
    with serving("127.0.0.1", port, "afterwards"):
        browser.wait(lambda: "afterwards" in body(browser), "the next run is shown")


def body(browser: Browser) -> str:
    return browser.tab.execute_script("return document.body.innerText")


class Stage:
    """A rig that runs with its page, in this process."""

    def __init__(self, rig: str, *, pictures: bool = False) -> None:
        self.world, self.script = World(rig), Script()
        self.loop = Loop(self.world, on_apply=lambda tick, command: self.note(tick, command))
        self.pictures = Pictures(self.loop, FakeRenderer) if pictures else None

    def note(self, tick: int, command: Command) -> None:
        self.script.append((tick, command))

    def play(self, browser: Browser, act) -> None:
        over = threading.Event()
        with serving("127.0.0.1", 0, "test") as server, closing(self.loop):
            page = run_there(server, lambda: Page(server, self.world, self.loop, self.pictures))
            if self.pictures is not None:
                self.pictures.start()
            self.loop.start()

            def refresh() -> None:
                while not over.is_set() and not self.loop.wait(PERIOD_S):
                    run_there(server, page.refresh)

            thread = threading.Thread(target=refresh)
            thread.start()
            try:
                browser.open(address(server))
                act()
            finally:
                over.set()
                thread.join()
                if self.pictures is not None:
                    self.pictures.close()


def test_a_slider_moves_the_arm_and_nothing_but_commands_counts(browser: Browser) -> None:
    stage = Stage("psm")

    def act() -> None:
        assert abs(browser.number("PSM1/yaw/measured")) < 1.0
        browser.type_number("yaw deg", 20)
        browser.wait(lambda: abs(browser.number("PSM1/yaw/measured") - 20) < 0.1, "yaw at 20 deg")
        browser.press_arrows("yaw deg", 5)
        browser.wait(lambda: abs(browser.number("PSM1/yaw/measured") - 20.5) < 0.05, "yaw at 20.5")
        browser.click("home")
        browser.wait(lambda: abs(browser.slider_value("yaw deg")) < 0.1, "the slider follows home")

    stage.play(browser, act)
    assert stage.script, "the browser posted nothing"
    assert np.array_equal(final_positions(stage.loop), replayed("psm", stage))


def final_positions(loop: Loop) -> np.ndarray:
    return np.concatenate([loop.latest.positions.ravel(), loop.latest.arms["PSM1"].q])


def replayed(rig: str, stage: Stage) -> np.ndarray:
    """Run the same commands at the same ticks without a page."""
    loop = Loop(World(rig), speed="max")
    waiting = iter([*stage.script, (sys.maxsize, None)])
    due, command = next(waiting)
    for tick in range(stage.loop.state.ticks):
        while due == tick and command is not None:
            loop.post(command)
            due, command = next(waiting)
        loop.tick()
    loop.run(0.0)
    return final_positions(loop)


@pytest.mark.slow
def test_another_arm_starts_at_its_own_set_points(browser: Browser) -> None:
    stage = Stage("two_psm_ecm")

    def act() -> None:
        browser.type_number("insertion mm", 150)
        browser.wait(lambda: browser.number("PSM1/insertion/measured") > 149, "insertion")
        before = stage.loop.latest.arms["PSM2"].setpoint
        browser.choose("Arm", "PSM2")
        browser.wait(lambda: browser.read("PSM2/yaw/measured") is not None, "the table of PSM2")
        shown = browser.slider_value("insertion mm")
        assert shown == pytest.approx(1000 * before[2], abs=0.06)
        browser.type_number("yaw deg", 5)
        browser.wait(lambda: abs(browser.number("PSM2/yaw/measured") - 5) < 0.1, "yaw of PSM2")
        now = stage.loop.latest.arms["PSM2"].setpoint
        assert np.array_equal(np.delete(now, 0), np.delete(before, 0))

    stage.play(browser, act)
    assert {getattr(command, "arm", None) for _, command in stage.script} == {"PSM1", "PSM2"}


def test_effort_mode_gravity_and_pause_work_from_the_page(browser: Browser) -> None:
    stage = Stage("psm")

    def act() -> None:
        browser.choose("Mode", "effort (open loop)")
        browser.wait(lambda: browser.read("PSM1/yaw/command") == "-", "effort mode")
        browser.type_number("yaw N m", 0.6)
        browser.wait(lambda: abs(browser.number("PSM1/yaw/measured")) > 2.0, "yaw is pushed")
        browser.click("Pause")
        browser.wait(lambda: browser.read("rtf") == "paused", "the pause")
        at = stage.loop.latest.time
        browser.click("Reset")
        browser.wait(lambda: browser.number("time") == 0.0, "the reset")
        assert stage.loop.latest.time < at
        browser.click("Resume")
        browser.wait(lambda: browser.number("time") > 0.2, "time flows again")

    stage.play(browser, act)


def test_pictures_come_and_one_fills_the_screen_until_it_is_left(browser: Browser) -> None:
    def full() -> bool:
        return browser.tab.execute_script("return document.fullscreenElement?.tagName") == "IMG"

    def press() -> bool:
        browser.tab.execute_script(NOTES)
        try:
            browser.tab.find_element(By.CSS_SELECTOR, '[data-trocar="full-screen"]').click()
        except (StaleElementReferenceException, ElementClickInterceptedException):
            return False  # the page drew it anew in between, or laid a note over it
        return True

    def filled() -> bool:
        """Press again where the page drew the button anew between press and release."""
        if not full() and press():
            browser.draw()
        return full()

    def act() -> None:
        browser.wait(lambda: "a second" in (browser.read("scope") or ""), "pictures come")
        browser.wait(filled, "the picture fills the screen")
        time.sleep(RESIZED_S)
        assert full()

    Stage("ecm", pictures=True).play(browser, act)


def test_the_tab_of_the_browser_is_called_trocar_and_a_letter_presses_a_pedal(
    browser: Browser,
) -> None:
    loop, session = Loop(World("psm")), Session()
    with (
        closing(loop),
        closing(Core(loop, components=session.components(loop))) as core,
        serving("127.0.0.1", 0, "test") as server,
    ):
        core.begin()
        driving = session.driving(None)
        page = run_there(server, lambda: Page(server, loop.world, loop, driving=driving))
        loop.start()
        browser.tab.get(address(server))

        def pressed() -> bool:
            run_there(server, page.refresh)
            ActionChains(browser.tab).send_keys("g").perform()
            time.sleep(0.5)
            return "coag" in session.engine.pedals.pressed  # type: ignore[union-attr]

        browser.wait(pressed, "coag is pressed")
        assert browser.tab.title == "trocar"
        browser.wait(lambda: not pressed(), "coag is released")
