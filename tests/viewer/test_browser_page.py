"""The page in a real browser: gone, waiting, in three widths, with its sheets and its level."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from trocar.cli.gallery import controls
from trocar.live import Loop
from trocar.simulation import World
from trocar.tasks import make_task
from trocar.tasks.play import scripted
from trocar.tasks.served import ServedTask
from trocar.viewer import Card, Choice, Gallery, serve

pytest.importorskip("selenium", reason="selenium is not installed")
from tests.viewer.browser import Browser, chromium

pytestmark = pytest.mark.browser

BANNER = "return document.querySelector('[data-trocar=banner]').innerText"
BAR = "return document.querySelector('[data-trocar=bar]').innerText"
COVERED = "return document.querySelector('#trocar-cover').className !== 'gone'"
SEEN = "return getComputedStyle(document.querySelector(arguments[0])).visibility"
#: Meshes of bodies and marks that are drawn one by one, or not at all as their indices are no whole
#: numbers, and those that draw all of them.
CALLS = """let own = 0, joint = 0;
__viserMutable.scene.traverseVisible((node) => {
  if (node.material?.isMeshStandardMaterial && node.layers.mask === 1) own++;
  if (node.material?.uniforms?.poses) joint++;
  if (node.material?.uniforms?.poses && !(node.geometry.index.array instanceof Uint32Array)) own++;
});
return [own, joint, __viserTestpoints.rendererInfo.render.triangles > 5000]"""
PRESS = "dispatchEvent(new KeyboardEvent('keydown', {key: '?'}))"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with chromium(tmp_path_factory.mktemp("profile")) as found:
        found.tab.set_window_size(1500, 800)
        yield found


@dataclass
class Served:
    """A world that is served in a thread, until `stop`."""

    world: World
    more: dict[str, object] = field(default_factory=dict)
    port: int = 0
    chosen: list[Choice | None] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.loop = Loop(self.world)
        if isinstance(task := self.more.pop("task", None), ServedTask):
            task.watch(self.loop)
        ready: list[str] = []
        here = threading.Event()

        def on_ready(url: str) -> None:
            ready.append(url)
            here.set()

        def run() -> None:
            more: dict[str, object] = {**self.more, "on_ready": on_ready, "loop": self.loop}
            self.chosen.append(serve(self.world, port=self.port, **more))  # type: ignore[arg-type]

        self.thread = threading.Thread(target=run)
        self.thread.start()
        assert here.wait(60.0)
        self.url = ready[0]
        self.port = int(self.url.rsplit(":", 1)[1])

    def close(self) -> None:
        self.loop.stop()
        self.thread.join()


#: Colours of what stands in the fields: their state, too, which nobody can edit.
INKS = """
return [...document.querySelectorAll('input, textarea')].map(e => getComputedStyle(e).color);
"""


def says(browser: Browser, script: str, words: str) -> Callable[[], bool]:
    return lambda: words in (browser.tab.execute_script(script) or "")


def test_a_page_whose_simulator_is_gone_shows_that_and_comes_back_with_the_next(
    browser: Browser,
) -> None:
    with closing(Served(World("psm"))) as served:
        browser.open(served.url)
        browser.wait(lambda: not browser.tab.execute_script(COVERED), "the cover is gone")
        assert browser.tab.execute_script(BANNER) == ""
        assert browser.tab.execute_script(SEEN, '[data-trocar="rtf"]') == "visible"
        port = served.port
    browser.wait(says(browser, BANNER, "No connection to the simulator since"), "the banner")
    assert browser.tab.execute_script(SEEN, '[data-trocar="rtf"]') == "hidden"
    inks = browser.tab.execute_script(INKS)
    assert len(inks) > 5 and all(re.search(r", 0(\.0*)?\)$", ink) for ink in inks)
    with closing(Served(World("psm"), port=port)):
        browser.wait(
            lambda: browser.read("rtf") is not None and not browser.tab.execute_script(BANNER),
            "the page is back",
        )
        browser.wait(says(browser, BAR, "x real time"), "and the line above the scene")


def test_a_browser_that_draws_in_software_starts_plainly_and_has_no_notice(
    browser: Browser,
) -> None:
    with closing(Served(World("psm"))) as served:
        browser.open(served.url)
        browser.wait(says(browser, BAR, "drawn plainly"), "the level")
        text = "return document.body.innerText.includes('Software WebGL')"
        assert not browser.tab.execute_script(text)
        assert browser.tab.execute_script("return __viserMutable.scene.environment") is None


def test_the_plain_level_draws_bodies_together_and_others_one_by_one(browser: Browser) -> None:
    with closing(Served(World("psm"))) as served:
        browser.open(served.url)
        browser.wait(says(browser, BAR, "drawn plainly"), "the level")

        def drawn() -> list[int]:
            return browser.tab.execute_script(CALLS)

        browser.wait(lambda: drawn() == [0, 1, True], "all together")
        browser.choose("Drawing", "no shadows")
        browser.wait(lambda: drawn()[0] > 20 and drawn()[1] == 0, "the bodies one by one")


def test_a_scene_waits_for_the_browser_and_the_policy_hands_over(
    browser: Browser, tmp_path: Path
) -> None:
    del tmp_path
    task = make_task("needle-reach")
    served_task = ServedTask(task, 0, script=scripted)
    more: dict[str, object] = {
        "task": served_task,
        "scene": controls(served_task),
        "start": "viewer",
    }
    with closing(Served(task.world, more)) as served:
        assert served.loop.latest.time == 0.0
        browser.open(served.url)
        browser.wait(says(browser, BAR, "done"), "the episode ends in sight")
        first = served_task.state()["seed"]
        browser.wait(lambda: clicked(browser, "Next seed"), "the next seed is pressed")
        browser.wait(lambda: served_task.state()["seed"] == first + 1, "it begins")
        browser.wait(says(browser, BAR, "done"), "it ends, too")


def clicked(browser: Browser, name: str) -> bool:
    found = f"//button[normalize-space()='{name}']"
    if not browser.elements(found):
        return False
    browser.click(name)
    return True


def test_question_mark_opens_the_sheet_of_help(browser: Browser) -> None:
    with closing(Served(World("psm"))) as served:
        browser.open(served.url)
        browser.wait(says(browser, BAR, "psm"), "the line above the scene")
        browser.tab.execute_script(PRESS)
        body = "return document.body.innerText"
        browser.wait(says(browser, body, "docs/troubleshooting.md"), "the sheet")


def test_a_card_of_the_gallery_ends_the_world_and_is_returned(browser: Browser) -> None:
    cards = [Card(Choice("rig", "ecm"), "an endoscope"), Card(Choice("scene", "peg-board"), "")]
    more: dict[str, object] = {"gallery": Gallery(lambda: cards, "psm")}
    with closing(Served(World("psm"), more)) as served:
        browser.open(served.url)
        browser.wait(lambda: clicked(browser, "Scenes and rigs"), "the gallery is pressed")
        card = "document.querySelector('[data-trocar-send=\"load/rig/ecm\"]')"
        browser.wait(lambda: bool(browser.tab.execute_script(f"return {card}")), "the cards")
        browser.tab.execute_script(f"{card}.click()")
        browser.wait(lambda: not served.thread.is_alive(), "the world ends")
        assert served.chosen == [Choice("rig", "ecm")]
        assert "Loading ecm" in browser.tab.execute_script(BANNER)


@pytest.mark.parametrize(
    ("width", "sliders", "table"),
    [
        (1500, True, True),
        pytest.param(1100, True, False, marks=pytest.mark.slow),
        (390, False, False),
    ],
)
def test_each_width_has_what_fits(
    browser: Browser, width: int, *, sliders: bool, table: bool
) -> None:
    screen = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.tab.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    try:
        with closing(Served(World("psm"))) as served:
            browser.tab.get(served.url)
            browser.wait(says(browser, BAR, "psm"), "the line above the scene")
            if sliders:
                browser.wait(lambda: browser.labelled("yaw deg"), "the sliders")
            browser.draw()
            assert browser.labelled("yaw deg") == sliders
            assert (browser.read("rtf") is not None) == table
    finally:
        browser.tab.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
