"""The outline in a real browser: a click in the scene picks a link, a dot hides it."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

pytest.importorskip("selenium", reason="selenium is not installed")
from selenium.webdriver.common.action_chains import ActionChains

from benchmarks.first_tip import PLACES
from benchmarks.served import served
from tests.viewer.browser import chromium

pytestmark = pytest.mark.browser

FOLDER = """
[...document.querySelectorAll('*')]
  .filter(e => e.children.length < 3 && e.innerText?.trim() === 'Outline').pop().click();
"""
PRESS = "document.querySelector(`[data-trocar-send='${arguments[0]}']`).click()"
PICKED = "return document.querySelector('.picked')?.innerText"
#: Whether a node of the scene that all browsers share is drawn in this one.
SHOWN = """
const node = window.__viserMutable?.nodeRefFromName[arguments[0]];
let meshes = 0;
node?.traverseVisible(part => { meshes += Boolean(part.isMesh); });
return meshes;
"""


def test_a_click_in_the_scene_picks_a_link_and_its_dot_hides_it(tmp_path: Path) -> None:
    words = ["--rig", "two_psm_ecm", "--no-cameras", "--no-websocket", "--port", "0"]
    with served(words, r"http://\S+") as simulator, chromium(tmp_path) as browser:
        tab = browser.tab
        browser.open(simulator.address, "bar")
        browser.wait(lambda: bool(tab.execute_script(SHOWN, "/world/table")), "the table")
        tab.execute_script(FOLDER)
        browser.wait(lambda: browser.read("outline") is not None, "the outline is open")
        browser.click("Click in the scene")
        browser.wait(
            lambda: bool(browser.elements("//button[contains(., 'click a link')]")), "a pick"
        )
        ((x, y),) = tab.execute_script(PLACES, "/world/table", [[0.0, 0.0, 0.0]])
        hand = ActionChains(tab)
        hand.w3c_actions.pointer_action.move_to_location(round(x), round(y))
        hand.click().perform()
        browser.wait(lambda: tab.execute_script(PICKED) == "table", "the table is picked")
        for shown in (False, True):
            tab.execute_script(PRESS, "outline/see/table")
            browser.wait(
                lambda shown=shown: bool(tab.execute_script(SHOWN, "/world/table")) == shown,
                f"the table is shown: {shown}",
            )
            time.sleep(0.2)
        assert [line for line in browser.violations() if "as JavaScript" not in line] == []
