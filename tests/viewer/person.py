"""A person at a page: mouse, keyboard, and what there is to act on."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from selenium.common.exceptions import (
    ElementClickInterceptedException,
    ElementNotInteractableException,
    MoveTargetOutOfBoundsException,
    StaleElementReferenceException,
)
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement

from tests.viewer.browser import PATIENCE_S, Browser

IN_THE_WAY = (
    ElementClickInterceptedException,
    ElementNotInteractableException,
    MoveTargetOutOfBoundsException,
    StaleElementReferenceException,
)
"""Something lies over what a person would press, or the page draws it anew: tried again."""

CONTROLS = """
const ours = /^(file_upload_)?[0-9a-f]{8}-[0-9a-f]{4}-/;  // viser's own settings have other ids
const text = (element) => element.textContent.replace(/\\s+/g, " ").trim();
const found = [];
for (const label of document.querySelectorAll("label")) {
  if (!ours.test(label.htmlFor)) continue;
  const row = label.parentElement.parentElement.parentElement;
  const buttons = [...row.querySelectorAll("button")]
    .filter((button) => !button.className.includes("NumberInput"));
  if (buttons.length) found.push(...buttons.map((each) => `${text(label)}/${text(each)}`));
  else if (!row.querySelector("input:disabled") || row.querySelector("[role=slider]")
           || row.querySelector("[aria-haspopup], [type=checkbox]")) found.push(text(label));
}
for (const button of document.querySelectorAll("button"))
  if (ours.test(button.id)) found.push(text(button));
for (const element of document.querySelectorAll("[data-trocar-send], [data-trocar=full-screen]"))
  found.push(element.dataset.trocarSend ?? text(element));
const tree = window.__viserSceneTree?.getState() ?? {};
for (const [name, node] of Object.entries(tree))
  if (node?.message?.type === "TransformControlsMessage") found.push(name);
return found;
"""

#: Where a point of a node is seen [CSS px], from the upper left of the page.
PIXEL = """
const [name, x, y, z] = arguments, page = __viserMutable;
const node = page.nodeRefFromName[name], camera = page.camera;
node.updateWorldMatrix(true, true);
const at = node.position.clone().set(x, y, z).applyMatrix4(node.matrixWorld).project(camera);
const box = page.canvas.getBoundingClientRect();
return [box.left + (at.x + 1) / 2 * box.width, box.top + (1 - at.y) / 2 * box.height];
"""

#: Look at a node from a place on one of its axes, 0 to 2, at a distance of either sign [m].
LOOK = """
const [name, axis, away] = arguments, page = __viserMutable;
const node = page.nodeRefFromName[name];
node.updateWorldMatrix(true, true);
const e = node.matrixWorld.elements, from = [0, 1, 2].map((k) => e[4 * axis + k]);
const far = away / Math.hypot(...from), [x, y, z] = from.map((part, k) => e[12 + k] + far * part);
page.cameraControl.setLookAt(x, y, z, e[12], e[13], e[14], false);
"""
#: The axes and their sides from which a person tries to see what is not to be hidden.
SIDES = (2, 1.0), (2, -1.0), (1, 1.0), (1, -1.0)

#: Test whether nothing of the page lies over points of the scene.
FREE = """
return arguments[0].every(([x, y]) => document.elementFromPoint(x, y)?.tagName === "CANVAS");
"""

VISIBLE = """
let node = __viserMutable.nodeRefFromName[arguments[0]];
if (!node) return false;
for (; node; node = node.parent) if (!node.visible) return false;
return true;
"""


class Person:
    """Mouse and keyboard at one tab."""

    def __init__(self, browser: Browser) -> None:
        self.browser, self.tab = browser, browser.tab

    @property
    def mouse(self) -> ActionChains:
        """A new sequence of moves and keys."""
        return ActionChains(self.tab, duration=80)

    def controls(self) -> set[str]:
        """Return everything on the page that can be acted on, as "label" or "label/button"."""
        return set(self.tab.execute_script(CONTROLS))

    # ------------------------------------------------------------------ widgets

    def press(self, label: str, button: str) -> None:
        """Press a button of a row once it can be."""
        self.click(f"{self._row(label)}//button[normalize-space()='{button}']")

    def pick(self, label: str, option: str) -> None:
        """Choose from a list."""
        found = f"//*[@role='option'][normalize-space()='{option}']"

        def act() -> None:
            """Open the list, which closes where the page makes it anew, and click."""
            if not (shown := [each for each in self.all(found) if each.is_displayed()]):
                field = self.one(f"{self._row(label)}//input[not(@type='hidden')]")
                self._centre(field)
                field.click()
                time.sleep(0.2)
                raise ElementNotInteractableException(option)
            shown[0].click()

        self._try(act, f"the option {option} of {label}")

    def tick(self, label: str) -> None:
        """Press a check box."""
        self.click(f"{self._row(label)}//input[@type='checkbox']")

    def slide(self, label: str, share: float, exact: float = 0.04) -> tuple[float, float]:
        """Drag a slider to a share of its way, as exact as another; return both in its unit."""
        track = f"{self._row(label)}//*[contains(@class, 'Slider-trackContainer')]"

        def reached() -> tuple[float, float]:
            low, high = self._thumb(label, "min"), self._thumb(label, "max")  # of a timeline: now
            return low + share * (high - low), exact * (high - low)

        def drag() -> None:
            thumb, way = self.one(f"{self._row(label)}//*[@role='slider']"), self.one(track)
            self._centre(thumb)
            aside = round((share - 0.5) * way.rect["width"])
            hand = self.mouse.move_to_element(thumb).click_and_hold().pause(0.05)
            hand.move_to_element_with_offset(way, aside, 0).pause(0.05).release().perform()
            goal, near = reached()
            if abs(self._thumb(label, "now") - goal) > near:  # a busy page missed a part of it
                raise ElementNotInteractableException(label)

        self._try(drag, f"the slider {label}")
        return reached()

    def share(self, label: str) -> float:
        """Return the share of its way at which a slider stands."""
        low, high, now = (self._thumb(label, what) for what in ("min", "max", "now"))
        return (now - low) / (high - low)

    def _centre(self, element: WebElement) -> None:
        """Scroll an element into the middle of its panel: a list beside it is hidden with it."""
        self.tab.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)

    def _thumb(self, label: str, what: str) -> float:
        thumb = self.one(f"{self._row(label)}//*[@role='slider']")
        return float(thumb.get_attribute(f"aria-value{what}") or "nan")

    def arrow(self, label: str) -> None:
        """Move a slider by one step with the keyboard."""
        self.one(f"{self._row(label)}//*[@role='slider']").send_keys(Keys.ARROW_RIGHT)

    def type(self, label: str, value: float, box: int = 1) -> None:
        """Type into a box of numbers."""
        found = f"({self._row(label)}//input[contains(@class,'NumberInput-input')])[{box}]"
        self.click(found)
        self.one(found).send_keys(Keys.CONTROL, "a")
        self.one(found).send_keys(f"{value:g}", Keys.TAB)

    def unfold(self, folder: str) -> None:
        """Open or close a folder by its title."""
        self.click(f"//div[normalize-space(text())='{folder}']")

    def key(self, key: str) -> None:
        """Press a key while the page has the focus."""
        self.tab.execute_script("document.activeElement?.blur()")
        self.mouse.send_keys(key).perform()

    # ------------------------------------------------------------------ the scene

    def sees(self, node: str) -> bool:
        """Test whether a node of the scene is shown."""
        return self.tab.execute_script(VISIBLE, node)

    def pull(self, handle: str, arrow_m: float, by_m: float) -> None:
        """Take a handle at its x arrow and pull it along.

        Args:
            handle: node
            arrow_m: from the handle's middle to where the arrow is taken [m]
            by_m: way of the hand [m]
        """
        (x, y), (to_x, to_y) = self._free(handle, 10.0 * arrow_m, (arrow_m, arrow_m + by_m))
        hand = ActionChains(self.tab, duration=200)
        hand.w3c_actions.pointer_action.move_to_location(round(x), round(y))
        hand.pause(0.3).click_and_hold()
        for share in (0.25, 0.5, 0.75, 1.0):
            at = round(x + share * (to_x - x)), round(y + share * (to_y - y))
            hand.w3c_actions.pointer_action.move_to_location(*at)
        hand.pause(0.3).release().perform()

    def click_on(self, node: str, away_m: float) -> None:
        """Click on the middle of a node in the scene, from a distance [m]."""
        ((x, y),) = self._free(node, away_m, (0.0,))
        hand = ActionChains(self.tab, duration=200)
        hand.w3c_actions.pointer_action.move_to_location(round(x), round(y))
        hand.click().perform()

    def _free(self, node: str, away_m: float, along_x_m: tuple[float, ...]) -> list[list[float]]:
        """Turn the view until no window lies over points on the x axis of a node; return them."""
        for axis, side in SIDES:
            self.tab.execute_script(LOOK, node, axis, side * away_m)
            self.browser.draw(3)
            points = [self.tab.execute_script(PIXEL, node, x, 0.0, 0.0) for x in along_x_m]
            if self.tab.execute_script(FREE, points):
                return points
        raise AssertionError(f"windows lie over {node} from all sides")

    # ------------------------------------------------------------------ elements

    def click(self, xpath: str) -> None:
        """Click as a mouse does, once the element is there, free and not grey."""

        def act() -> None:
            found = self.all(xpath)
            if not found or not found[0].is_enabled():
                raise ElementNotInteractableException(xpath)
            found[0].click()

        self._try(act, f"{xpath} can be clicked")

    def all(self, xpath: str) -> list[WebElement]:
        """Return the elements of a path."""
        return self.tab.find_elements(By.XPATH, xpath)

    def one(self, xpath: str) -> WebElement:
        """Return the element of a path once it is there."""
        self.browser.wait(lambda: bool(self.all(xpath)), xpath, PATIENCE_S)
        return self.all(xpath)[0]

    def _try(self, act: Callable[[], Any], what: str) -> None:
        def done() -> bool:
            try:
                act()
            except IN_THE_WAY:
                return False
            return True

        self.browser.wait(done, what, PATIENCE_S)

    def _row(self, label: str) -> str:
        return f"//label[normalize-space()='{label}']/../../.."
