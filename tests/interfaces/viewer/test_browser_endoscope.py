"""The window of the cameras in a real browser: pictures come, and one fills the screen."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from trocar.interfaces import Loop
from trocar.interfaces.pictures import Pictures
from trocar.interfaces.viewer.own_thread import run_there
from trocar.interfaces.viewer.page import PERIOD_S, Page
from trocar.interfaces.viewer.server import address, serving
from trocar.simulation import World

from ..fake_renderer import FakeRenderer

pytest.importorskip("selenium", reason="selenium is not installed")
from selenium.common.exceptions import (
    ElementClickInterceptedException,
    StaleElementReferenceException,
)
from selenium.webdriver.common.by import By

from .browser import chromium

pytestmark = [pytest.mark.browser, pytest.mark.slow]
BUTTON = '[data-trocar="full-screen"]'
#: Notes of the library's that lie over what a person would press.
NOTES = "for (const n of document.querySelectorAll('.mantine-Notification-root')) n.remove()"


def test_pictures_come_and_one_fills_the_screen(tmp_path: Path) -> None:
    loop, over = Loop(World("ecm")), threading.Event()
    pictures = Pictures(loop, FakeRenderer)
    pictures.start()
    with chromium(tmp_path) as browser, serving("127.0.0.1", 0, "test") as server:
        page = run_there(server, lambda: Page(server, loop.world, loop, pictures))
        loop.start()

        def refresh() -> None:
            while not over.is_set() and not loop.wait(PERIOD_S):
                run_there(server, page.refresh)

        thread = threading.Thread(target=refresh)
        thread.start()

        def full() -> bool:
            return browser.tab.execute_script("return document.fullscreenElement?.tagName") == "IMG"

        def press() -> bool:
            browser.tab.execute_script(NOTES)
            try:
                browser.tab.find_element(By.CSS_SELECTOR, BUTTON).click()
            except (StaleElementReferenceException, ElementClickInterceptedException):
                return False  # the page drew it anew in between, or laid a note over it
            return True

        try:
            browser.open(address(server))
            browser.wait(lambda: "a second" in (browser.read("scope") or ""), "pictures come")
            browser.wait(lambda: full() or press(), "the button can be pressed")
            browser.wait(full, "the picture fills the screen")
        finally:
            over.set()
            thread.join()
            loop.close()
            pictures.close()
