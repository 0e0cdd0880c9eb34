"""A headless Chromium that looks at the page and uses it as a person would."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from selenium import webdriver
from selenium.common.exceptions import TimeoutException
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement

from benchmarks.drawing import driver_service

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
DRIVER = shutil.which("chromedriver")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=gl-egl",  # Mesa compiles shaders in a fifth of SwiftShader's time
    "--ignore-gpu-blocklist",
    "--enable-unsafe-swiftshader",  # where there is no Mesa
    "--disable-gpu-watchdog",  # it ends the drawing process on a busy machine
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--window-size=1320,500",  # just wide enough for the measurements, and little to draw
)
PATIENCE_S = 240.0
"""Software rendering on a busy machine is slow; nothing waits longer than it must."""
ANSWER_S = 20.0
"""A page that builds its shaders answers no script; one that waited this long is asked again."""


class Browser:
    """One tab."""

    def __init__(self, tab: webdriver.Chrome) -> None:
        self.tab = tab
        tab.set_script_timeout(ANSWER_S)

    def open(self, url: str, shows: str = "time") -> None:
        """Go to the page and wait until it shows its numbers, or another part of it."""
        self.tab.get(url)
        self.wait(lambda: self.read(shows) is not None, f"the page shows {shows}")

    def read(self, key: str) -> str | None:
        """Read a number of the tables as text; None when it is not there."""
        script = "const cell = document.querySelector(arguments[0]); return cell && cell.innerText"
        return self.tab.execute_script(script, f'[data-trocar="{key}"]')

    def number(self, key: str) -> float:
        """Read a number of the tables."""
        return float((self.read(key) or "nan").split()[0])

    def wait(self, met: Callable[[], bool], what: str, timeout_s: float = PATIENCE_S) -> None:
        """Wait until something holds; a page too busy to answer has not met it yet."""
        end = time.monotonic() + timeout_s
        while not self._answers(met):
            assert time.monotonic() < end, f"in vain: {what}"
            time.sleep(0.1)

    @staticmethod
    def _answers(met: Callable[[], bool]) -> bool:
        try:
            return met()
        except TimeoutException:
            return False

    def draw(self, count: int = 20) -> None:
        """Wait until the page has drawn that many frames, in which sent messages arrive."""
        frame = "requestAnimationFrame(arguments[0])"
        for _ in range(count):
            self.tab.execute_async_script(frame)

    def type_number(self, label: str, value: float) -> None:
        """Type into the box beside a slider."""
        box = self._beside(label, "input")
        self._focus(box)
        box.send_keys(Keys.CONTROL, "a")
        box.send_keys(f"{value:g}", Keys.TAB)

    def press_arrows(self, label: str, times: int) -> None:
        """Move a slider with the keyboard."""
        thumb = self._beside(label, "*[@role='slider']")
        for _ in range(times):
            thumb.send_keys(Keys.ARROW_RIGHT)

    def slider_value(self, label: str) -> float:
        """Read where a slider stands, in the unit that it shows."""
        thumb = self._beside(label, "*[@role='slider']")
        return float(thumb.get_attribute("aria-valuenow") or "nan")

    def choose(self, label: str, option: str) -> None:
        """Pick from a drop-down list."""
        self._focus(self._labelled(label))
        found = f"//*[@role='option'][normalize-space()='{option}']"
        self.wait(lambda: bool(self.elements(found)), f"the option {option}")
        self._focus(self.elements(found)[0])

    def labelled(self, label: str) -> bool:
        """Test whether there is an input of this name."""
        return bool(self.elements(f"//label[normalize-space()='{label}']"))

    def click(self, button: str) -> None:
        """Press a button."""
        self._focus(self.elements(f"//button[normalize-space()='{button}']")[0])

    def violations(self) -> list[str]:
        """Return the console's reports of the page's Content-Security-Policy."""
        told = [entry["message"] for entry in self.tab.get_log("browser")]  # type: ignore[index]
        return [line for line in told if "Content Security Policy" in line]

    def picture(self, path: Path) -> None:
        """Save what is seen, without the notice about software rendering."""
        close = "document.querySelectorAll('[class*=Notification-closeButton]')"
        self.tab.execute_script(f"{close}.forEach(button => button.click())")
        time.sleep(1.0)
        self.tab.save_screenshot(str(path))

    def elements(self, xpath: str) -> list[WebElement]:
        """Return the elements of a path."""
        return self.tab.find_elements(By.XPATH, xpath)

    def _labelled(self, label: str) -> WebElement:
        found = self.elements(f"//label[normalize-space()='{label}']")
        assert found, f"no input called {label!r}"
        return self.tab.find_element(By.ID, found[0].get_attribute("for") or "")

    def _beside(self, label: str, what: str) -> WebElement:
        return self._labelled(label).find_element(
            By.XPATH, f"../descendant::{what}[not(@type='hidden')]"
        )

    def _focus(self, element: WebElement) -> None:
        # A real click waits for the next frame, which takes long in software; this does not.
        self.tab.execute_script("arguments[0].focus(); arguments[0].click()", element)


@contextmanager
def chromium(profile: Path) -> Iterator[Browser]:
    """Open a browser with a fresh profile; skip the test where there is none."""
    if CHROMIUM is None or DRIVER is None:
        pytest.skip("chromium or chromedriver is not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    tab = webdriver.Chrome(options=options, service=driver_service(DRIVER))
    try:
        yield Browser(tab)
    finally:
        tab.quit()
