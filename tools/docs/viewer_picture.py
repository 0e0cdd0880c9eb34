"""Draw docs/images/cart.png, teleoperation.png and viewer-*.png: the web viewer in Chromium.

python tools/docs/viewer_picture.py NAME [FILE] [--window WIDTH,HEIGHT]

NAME: cart, teleoperation, viewer-scene, viewer-gallery, viewer-gone, viewer-phone,
viewer-recording, viewer-upload, viewer-outline, viewer-hands, viewer-depth, viewer-forces,
viewer-reach, viewer-help, viewer-levels, viewer-people or viewer-branch. With --window the whole
page is saved as it is in another size.

Needs the extra `browser` and Chromium with its driver, which draw without a display.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image
from selenium import webdriver
from selenium.common.exceptions import TimeoutException
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.support.wait import WebDriverWait

from trocar.viewer.desk import REQUEST
from trocar.viewer.timeline import BACK, CONTINUE

IMAGES = Path(__file__).parents[2] / "docs" / "images"
SERVE = ("--port", "0", "--camera-rate", "4")
CLOSE = "document.querySelectorAll('[class*=Notification-closeButton]').forEach(b => b.click())"
#: Where the panels of measurements and of commands end and begin, in pixels of the picture.
PANELS = """
const edges = [0, innerWidth];
for (const [k, mark] of [[0, '[data-trocar=time], [data-trocar=keys]'], [1, 'button']]) {
  let found = [...document.querySelectorAll(mark)];
  if (k) found = found.filter(b => b.innerText === 'Pause');
  for (let e = found[0]; e; e = e.parentElement) {
    const box = e.getBoundingClientRect();
    if (box.width >= innerWidth / 2) break;
    edges[k] = k ? Math.min(edges[k], box.left) : Math.max(edges[k], box.right);
  }
}
return edges.map(edge => Math.ceil(edge * devicePixelRatio));
"""
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=gl-egl",
    "--ignore-gpu-blocklist",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
)
#: Until all meshes are drawn in software, and until the arms have moved [s].
DRAWN_S, MOVED_S = 30.0, 12.0
#: Between two pictures side by side, and below this width a window is a phone's.
GAP_PX, PHONE_PX = 6, 576


@dataclass(frozen=True)
class Shot:
    """A picture.

    Attributes:
        command: of trocar; {folder} is an empty one
        before: command of trocar that ends before it
        press: what is clicked once all is drawn, in JavaScript
        window: width and height [px], so wide that the panels leave the arms free
        scale: of the window in the picture
        left, right: whether the panels of measurements and of commands are kept
        level: of drawing; "": what the browser chooses, which is plain without a graphics card
        phone: whether the window is a phone's
        gone: whether the simulator is ended before the picture
        moved_s: time from the press to the picture [s]
        until: what is waited for before, in JavaScript
        other: what is clicked in a second browser, which opened the page later; its picture stands
            on the right of the first one's
        levels: of drawing, whose pictures stand side by side
        look: node of the scene in the middle of the view, and from how far [m]
        pull: a handle's node, the axis at which it is taken, and by how far [m]
    """

    command: tuple[str, ...]
    press: str
    window: str
    scale: float
    left: bool = True
    right: bool = True
    level: str = ""
    phone: bool = False
    gone: bool = False
    moved_s: float = MOVED_S
    until: str = "return true"
    before: tuple[str, ...] = ()
    other: str = ""
    levels: tuple[str, ...] = ()
    look: tuple[str, float] | None = None
    pull: tuple[str, int, float] | None = None


def press(button: str) -> str:
    """Return the script that presses a button."""
    found = "[...document.querySelectorAll('button')]"
    return f"{found}.find(b => b.innerText === '{button}').click()"


#: Opens the folder of own files, scrolls to it, and uploads a hexagonal nut of 40 mm.
UPLOAD = """
const title = [...document.querySelectorAll('*')]
  .find(e => e.children.length < 3 && e.innerText?.trim() === 'Own files');
title.click();
const corners = [[40, 0], [40, 20], [20, 0], [20, 20]];
const points = [...Array(6).keys()].flatMap(k => corners.map(([r, z]) =>
  `v ${(r / 1e3 * Math.cos(k * Math.PI / 3)).toFixed(6)} ${
    (r / 1e3 * Math.sin(k * Math.PI / 3)).toFixed(6)} ${z / 1e3}`));
const at = (k, c) => 4 * (k % 6) + c + 1;
const faces = [...Array(6).keys()].flatMap(k => [[0, 0, 1, 1], [3, 3, 2, 2], [1, 1, 3, 3],
  [2, 2, 0, 0]].map(([a, b, c, d]) =>
  `f ${at(k, a)} ${at(k + 1, b)} ${at(k + 1, c)} ${at(k, d)}`));
const files = new DataTransfer();
files.items.add(new File([[...points, ...faces].join('\\n')], 'nut.obj'));
setTimeout(() => {
  const input = [...document.querySelectorAll('input[type=file]')].pop();
  input.files = files.files;
  input.dispatchEvent(new Event('change', {bubbles: true}));
  title.scrollIntoView();
}, 1500);
"""

#: Shows the workspace of the chosen arm, and picks one of its links in the outline.
OUTLINE = """
const open = name => [...document.querySelectorAll('*')]
  .filter(e => e.children.length < 3 && e.innerText?.trim() === name).pop().click();
const send = words => document.querySelector(`[data-trocar-send="outline/${words}"]`).click();
open('See');
setTimeout(() => {
  const label = [...document.querySelectorAll('label')].find(l => l.innerText === 'Workspace');
  document.getElementById(label.htmlFor).click();
}, 3000);
setTimeout(() => open('Outline'), 6000);
setTimeout(() => send('open/PSM1'), 10000);
setTimeout(() => send('pick/PSM1/pitch_end'), 13000);
setTimeout(() => send('see/PSM2'), 16000);
setTimeout(() => document.querySelector('[data-trocar=outline]').parentElement.scrollIntoView(),
  19000);
"""

#: Draws the tips' paths on the way to a pose, plots a joint, and scrolls to the timeline.
HANDS = """
const named = name => [...document.querySelectorAll('*')]
  .filter(e => e.children.length < 3 && e.innerText?.trim() === name).pop();
const field = name => document.getElementById(
  [...document.querySelectorAll('label')].find(l => l.innerText === name).htmlFor);
const press = name => [...document.querySelectorAll('button')]
  .find(b => b.innerText === name).click();
named('See').click();
named('Plots, 60 s').click();
setTimeout(() => field('Tip paths').click(), 4000);
setTimeout(() => { field('Plot 1').focus(); field('Plot 1').click(); }, 6000);
setTimeout(() => [...document.querySelectorAll('[role=option]')]
  .find(o => o.innerText === 'PSM1 yaw measured').click(), 8000);
setTimeout(() => press('home'), 10000);
setTimeout(() => named('Timeline').scrollIntoView(), 15000);
"""

#: Draws the forces of contacts, begins the episode again, and stops when the jaw holds.
FORCES = """
const named = name => [...document.querySelectorAll('*')]
  .filter(e => e.children.length < 3 && e.innerText?.trim() === name).pop();
const press = name => [...document.querySelectorAll('button')]
  .find(b => b.innerText === name).click();
named('See').click();
setTimeout(() => {
  const label = [...document.querySelectorAll('label')].find(l => l.innerText === 'Contact forces');
  document.getElementById(label.htmlFor).click();
  named('See').scrollIntoView();
  press('Again');
}, 4000);
setTimeout(() => {
  let begun = false;
  const watch = setInterval(() => {
    const bar = document.querySelector('[data-trocar=bar]').innerText;
    const before = Number.parseFloat(bar.match(/([0-9.]+) of [0-9]+ s/)?.[1]) < HOLDS_S;
    begun ||= before;
    if (!begun || before) return;
    clearInterval(watch);
    press('Pause');
  }, 20);
}, 4500);
""".replace("HOLDS_S", "1.6")

#: Shows the folder with the reason, and no camera.
REACH = """
[...document.querySelectorAll('button')].find(b => b.innerText === 'off').click();
[...document.querySelectorAll('*')].filter(e => e.children.length < 3
  && e.innerText?.trim() === 'Timeline').pop().scrollIntoView();
"""

#: Goes back by steps, begins a branch there, lets it run, and stops.
BRANCH = """
const press = name => [...document.querySelectorAll('button')]
  .find(b => b.innerText === name).click();
press('Pause');
for (const k of Array(8).keys()) setTimeout(() => press('BACK'), 3000 + 1000 * k);
setTimeout(() => press('CONTINUE'), 14000);
setTimeout(() => [...document.querySelectorAll('*')].filter(e => e.children.length < 3
  && e.innerText?.trim() === 'Timeline').pop().scrollIntoView(), 17000);
""".replace("BACK", BACK).replace("CONTINUE", CONTINUE)

#: Opens the sheet of keys.
HELP = "document.querySelector('[data-trocar-send=\"help/\"]').click()"

SHOTS = {
    "cart": Shot(
        ("sim",),
        press("work"),
        "2060,1280",
        0.62,
        left=False,
        level="full",
    ),
    "teleoperation": Shot(
        ("teleop",),
        "document.querySelector('[data-trocar=keys]').focus()",
        "1700,900",
        0.8,
        right=False,
        level="full",
    ),
    "viewer-scene": Shot(("play", "needle-pick"), press("Next seed"), "1500,860", 0.8, moved_s=1.2),
    "viewer-gallery": Shot(("play", "needle-pick"), press("Scenes and rigs"), "1200,800", 0.8),
    "viewer-gone": Shot(("play", "needle-pick"), "", "1320,700", 0.8, gone=True),
    "viewer-recording": Shot(
        ("view", "{folder}/run.mcap"),
        press("Play"),
        "1500,860",
        0.8,
        moved_s=2.5,
        before=(
            *("sim", "--headless", "--rig", "pegs", "--duration", "5"),
            *("--record", "{folder}/run.mcap"),
        ),
    ),
    "viewer-upload": Shot(("sim", "--rig", "two_psm_ecm"), UPLOAD, "1320,800", 0.9, moved_s=15.0),
    "viewer-outline": Shot(
        ("sim", "--rig", "two_psm_ecm"), OUTLINE, "1500,900", 0.9, left=False, moved_s=120.0
    ),
    "viewer-hands": Shot(
        ("sim", "--rig", "two_psm_ecm"), HANDS, "1500,1000", 0.85, left=False, moved_s=18.0
    ),
    "viewer-forces": Shot(
        ("play", "needle-pick"),
        FORCES,
        "2000,900",
        0.7,
        left=False,
        moved_s=5.0,
        until="return document.querySelector('[data-trocar=bar]').innerText.includes('paused')",
        look=("/world/needle", 0.45),
    ),
    "viewer-reach": Shot(
        ("sim", "--rig", "two_psm_ecm"),
        REACH,
        "2100,900",
        0.7,
        left=False,
        moved_s=8.0,
        until="return document.querySelector('[data-trocar=reach]')?.innerText.length > 5",
        look=("/hands/tip_PSM1", 0.6),
        pull=("/hands/tip_PSM1", 0, 0.13),
    ),
    "viewer-help": Shot(("sim", "--rig", "two_psm_ecm"), HELP, "1320,960", 0.7, moved_s=6.0),
    "viewer-depth": Shot(
        ("sim", "--rig", "pegs"), press("depth"), "1320,800", 0.9, left=False, right=False
    ),
    "viewer-levels": Shot(
        ("sim", "--rig", "two_psm_ecm"),
        press("off"),
        "1500,900",
        0.6,
        left=False,
        right=False,
        moved_s=2.0,
        levels=("full", "no shadows", "plain"),
        look=("/hands/tip_PSM1", 0.8),
    ),
    "viewer-people": Shot(
        ("sim", "--rig", "two_psm_ecm"),
        "",
        "1100,700",
        0.7,
        other=press(REQUEST),
        moved_s=2.0,
    ),
    "viewer-branch": Shot(
        ("sim", "--rig", "pegs", "--record", "{folder}/run.mcap"),
        BRANCH,
        "1500,860",
        0.8,
        moved_s=20.0,
    ),
    "viewer-phone": Shot(("play", "needle-pick"), press("Next seed"), "390,844", 1.0, phone=True),
}


#: Chooses a level of drawing.
LEVEL = """
const label = [...document.querySelectorAll('label')].find(l => l.innerText === 'Drawing');
const box = document.getElementById(label.htmlFor);
box.focus(); box.click();
setTimeout(() => [...document.querySelectorAll('[role=option]')]
  .find(o => o.innerText === arguments[0]).click(), 500);
"""
#: Looks at a node from where the eye is, nearer.
LOOK = """
const [name, away] = arguments, page = __viserMutable, eye = page.camera.position;
const node = page.nodeRefFromName[name];
if (!node) return false;
node.updateWorldMatrix(true, true);
const at = node.matrixWorld.elements.slice(12, 15);
const from = [eye.x - at[0], eye.y - at[1], eye.z - at[2]], far = Math.hypot(...from);
page.cameraControl.setLookAt(...at.map((m, k) => m + away / far * from[k]), ...at, false);
return true;
"""
#: Places on an axis of a node, in the page [CSS px].
PLACES = """
const [name, axis, along] = arguments, page = __viserMutable;
const node = page.nodeRefFromName[name], box = page.canvas.getBoundingClientRect();
return along.map(metres => {
  const at = node.position.clone().set(...[0, 1, 2].map(k => k === axis ? metres : 0))
    .applyMatrix4(node.matrixWorld).project(page.camera);
  return [box.left + (at.x + 1) / 2 * box.width, box.top + (1 - at.y) / 2 * box.height];
});
"""
#: From the middle of a tip's handle to where it is taken [m]. Source: by eye: its arrow's shaft.
GRIP_M = 0.045
BAR = "return document.querySelector('[data-trocar=bar]')?.innerText.length > 5"


def screenshot(url: str, shot: Shot, end: Callable[[], object], whole: bool) -> Image.Image:
    """Return what a browser shows at an address.

    Args:
        url: of the page
        shot: what is pressed and waited for
        end: ends the simulator
        whole: whether the panels of measurements and of commands are kept in any case
    """
    with browser(shot) as tab:
        wait = open_page(tab, url, shot)
        with ExitStack() as stack:
            others = [stack.enter_context(browser(shot))] if shot.other else []
            for other in others:
                open_page(other, url, shot)
                other.execute_script(shot.other)
            if look := shot.look:
                wait.until(lambda _: tab.execute_script(LOOK, *look))
                time.sleep(2.0)
            tab.execute_script(shot.press)
            if shot.pull:
                pull(tab, *shot.pull)
            if shot.gone:
                end()
            wait.until(lambda _: tab.execute_script(shot.until))
            time.sleep(shot.moved_s)
            tab.execute_script(CLOSE)
            seen = []
            for level in shot.levels or ("",):
                if level:
                    tab.execute_script(LEVEL, level)
                    time.sleep(DRAWN_S)
                seen += [seen_by(one, shot, whole) for one in (tab, *others)]
            return beside(seen)


@contextmanager
def browser(shot: Shot) -> Iterator[webdriver.Chrome]:
    """Open a Chromium of the size of a picture."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for flag in (
        *FLAGS,
        f"--window-size={shot.window}",
        f"--force-device-scale-factor={shot.scale}",
    ):
        options.add_argument(flag)
    driver = shutil.which("chromedriver") or ""
    environment = {**os.environ, "LIBGL_ALWAYS_SOFTWARE": "1"}
    tab = webdriver.Chrome(options, webdriver.ChromeService(driver, env=environment))
    try:
        if shot.phone:
            width, height = map(int, shot.window.split(","))
            screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": True}
            tab.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        tab.set_script_timeout(180.0)
        yield tab
    finally:
        tab.quit()


def open_page(tab: webdriver.Chrome, url: str, shot: Shot) -> WebDriverWait[webdriver.Chrome]:
    """Open the page, wait until all of it is drawn, and return what waits for more."""
    tab.get(url)
    wait = WebDriverWait(tab, 180.0, ignored_exceptions=[TimeoutException])
    wait.until(lambda _: tab.execute_script(BAR))
    if shot.level:
        time.sleep(3.0)
        tab.execute_script(LEVEL, shot.level)
    time.sleep(DRAWN_S)
    return wait


def seen_by(tab: webdriver.Chrome, shot: Shot, whole: bool) -> Image.Image:
    """Return the page, without the panels that a picture leaves out."""
    seen = Image.open(io.BytesIO(tab.get_screenshot_as_png())).convert("RGB")
    if whole or (shot.left and shot.right):
        return seen
    left, right = tab.execute_script(PANELS)
    return seen.crop(
        (0 if shot.left else left, 0, seen.width if shot.right else right, seen.height)
    )


def beside(pictures: list[Image.Image]) -> Image.Image:
    """Return pictures side by side, a few pixels apart."""
    width = sum(picture.width for picture in pictures) + GAP_PX * (len(pictures) - 1)
    all_of_them = Image.new("RGB", (width, pictures[0].height), "white")
    left = 0
    for picture in pictures:
        all_of_them.paste(picture, (left, 0))
        left += picture.width + GAP_PX
    return all_of_them


def pull(tab: webdriver.Chrome, node: str, axis: int, by_m: float) -> None:
    """Take a handle at one of its arrows, and pull it along."""
    places: Any = tab.execute_script(PLACES, node, axis, [GRIP_M, GRIP_M + by_m])
    (x, y), (to_x, to_y) = places
    hand = ActionChains(tab, duration=300)
    hand.w3c_actions.pointer_action.move_to_location(round(x), round(y))
    hand.pause(0.5).click_and_hold()
    for share in (0.25, 0.5, 0.75, 1.0):
        at = round(x + share * (to_x - x)), round(y + share * (to_y - y))
        hand.w3c_actions.pointer_action.move_to_location(*at)
    hand.pause(1.0).release().perform()


def main(name: str, file: Path, window: str = "") -> None:
    """Serve a rig and save its page, of a window [px, px] of its own if one is given."""
    shot = SHOTS[name]
    if window:
        phone = int(window.split(",")[0]) < PHONE_PX
        shot = replace(shot, window=window, scale=1.0, phone=phone)
    trocar = [sys.executable, "-u", "-m", "trocar"]
    with ExitStack() as stack:
        folder = stack.enter_context(TemporaryDirectory())
        if shot.before:
            subprocess.run([*trocar, *(w.format(folder=folder) for w in shot.before)], check=True)
        command = [*trocar, *(word.format(folder=folder) for word in shot.command), *SERVE]
        if shot.command[0] != "view":
            command += ["--websocket-port", "0"]
        served = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        try:
            lines = iter(served.stdout or ())
            url = next(found[0] for line in lines if (found := re.search(r"http://\S+", line)))
            picture = screenshot(url, shot, served.kill, bool(window))
        finally:
            served.terminate()
    picture.quantize(256, kmeans=3).save(file, optimize=True)


if __name__ == "__main__":
    PARSER = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    PARSER.add_argument("name", choices=SHOTS, metavar="NAME")
    PARSER.add_argument("file", nargs="?", type=Path, metavar="FILE")
    PARSER.add_argument("--window", default="", metavar="WIDTH,HEIGHT")
    ARGS = PARSER.parse_args()
    main(ARGS.name, ARGS.file or IMAGES / f"{ARGS.name}.png", ARGS.window)
