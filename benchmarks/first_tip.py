"""Time from a clone of the repository to a tip that a mouse has dragged in the web viewer.

python -m benchmarks first-tip [--source URL] [--rig RIG]

It follows the first lines of the README: `git clone`, `make run`, open the address, drag the handle
at the tip. Chromium does what a browser does, without a graphics card.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.drawing import FLAGS
from trocar.cli.arguments import Parser, add_json, options
from trocar.cli.output import print_result, table
from trocar.errors import InputError, TrocarError
from trocar.robot.verification.figures import Figure, figure_rows

ROOT = Path(__file__).parents[1]
#: Source: the project's own goal. [s]
GOAL_S = 120.0
#: Time limits of the environment, and of the page and each of its answers [s].
INSTALLED_S, SHOWN_S, ANSWER_S = 1800.0, 180.0, 30.0
#: Way of the mouse [px], and of a joint that shows that the tip followed [deg or mm].
PULL_PX, MOVED = 40, 0.5
#: Places on a handle's axes at which it is taken, over its scale. Source: by eye: cone and shaft.
GRIPS = (0.9, 0.8, 0.7, 1.0, 0.55)
#: Scale of a tip's handle [m]. Source: `trocar.viewer.handles`.
SCALE_M = 0.06

#: Where a handle is on the screen: its middle, and places along its axes [px].
PLACES = """
const page = window.__viserMutable, found = page.nodeRefFromName[arguments[0]];
const node = found?.matrixWorld ? found : found?.current;
if (!node) return null;
node.updateWorldMatrix(true, false);
const times = (m, [x, y, z, w]) => [0, 1, 2, 3].map(
  r => m[r] * x + m[r + 4] * y + m[r + 8] * z + m[r + 12] * w);
const box = page.canvas.getBoundingClientRect();
return arguments[1].map(point => {
  const world = times(node.matrixWorld.elements, [...point, 1]);
  const seen = times(page.camera.matrixWorldInverse.elements, world);
  const [x, y, , w] = times(page.camera.projectionMatrix.elements, seen);
  return [box.left + box.width * (1 + x / w) / 2, box.top + box.height * (1 - y / w) / 2];
});
"""
#: Measured joints of the chosen arm.
JOINTS = """
return [...document.querySelectorAll('[data-trocar$="/measured"]')]
  .map(cell => Number.parseFloat(cell.innerText));
"""
#: Of the programs that are cloned: they run their own sources.
ENVIRONMENT = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
DRAWN = "return (window.__viserTestpoints?.rendererInfo.render.triangles ?? 0) > 500"


def main(words: Sequence[str]) -> int:
    """Measure, print the times, and return the exit status."""
    parser = Parser(prog="benchmarks first-tip", description=__doc__)
    options(parser, """
        --source URL     repository that is cloned (default: this one)
        --rig RIG = psm  rig that is served
    """)  # fmt: skip
    add_json(parser)
    try:
        args = parser.parse_args(list(words))
        found = first_tip(args.source or str(ROOT), args.rig)
    except TrocarError as error:
        print(f"benchmarks: error: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1
    print_result(args, {"figures": found}, lambda: table(*figure_rows(found)))
    return 0


def first_tip(source: str, rig: str) -> list[Figure]:
    """Return the times since the start of the clone [s].

    Args:
        source: of the clone
        rig: that is served; its first arm has a tip

    Raises:
        InputError: git, make, Chromium, its driver or selenium are not installed
        TrocarError: a step failed or took too long
    """
    for program in ("git", "make", "chromium", "chromedriver"):
        if shutil.which(program) is None:
            raise InputError(f"{program}: not installed; needed are git, make and Chromium")
    before = time.perf_counter()
    times: dict[str, float] = {}

    def done(step: str) -> None:
        times[step] = time.perf_counter() - before
        print(f"{step}: {times[step]:.1f} s", file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "trocar"
        _run(["git", "clone", "--quiet", source, str(clone)], Path(folder))
        done("cloned")
        _run(["make", ".venv/.ready-run"], clone)
        done("installed")
        with _served(clone, rig) as url:
            done("served")
            drag_first_tip(url, Path(folder), lambda: done("drawn"))
            done("tip dragged")
    rows = [Figure(f"clone to {step}", seconds, "s") for step, seconds in times.items()]
    return [*rows[:-1], Figure("clone to tip dragged", times["tip dragged"], "s", GOAL_S)]


def _run(command: Sequence[str], folder: Path) -> None:
    try:
        found = subprocess.run(
            command,
            cwd=folder,
            env=ENVIRONMENT,
            capture_output=True,
            text=True,
            timeout=INSTALLED_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise TrocarError(f"{' '.join(command)}: not done within {INSTALLED_S:g} s") from error
    if found.returncode != 0:
        raise TrocarError(f"{' '.join(command)}: {(found.stderr or found.stdout)[-500:]}")


@contextmanager
def _served(clone: Path, rig: str) -> Iterator[str]:
    """Serve a rig by `make run` until the block ends; yield the address that it prints."""
    words = f"--rig {rig} --port 0 --websocket-port 0"
    process = subprocess.Popen(
        ["make", "run", f"ARGS={words}"],
        cwd=clone,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        for line in process.stdout or ():
            if line.startswith("http"):
                yield line.split()[0]
                return
        raise TrocarError("make run: it ended without an address")
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait()


def drag_first_tip(url: str, profile: Path, drawn: Any) -> None:
    """Open a page and drag the handle of the chosen arm until a joint has followed.

    Args:
        url: of the page
        profile: folder for the browser
        drawn: called once the arms are on the screen

    Raises:
        InputError: selenium is not installed
        TrocarError: the page shows no arm or no handle, or nothing follows the mouse
    """
    try:
        from selenium import webdriver
        from selenium.common.exceptions import TimeoutException
        from selenium.webdriver.common.action_chains import ActionChains
        from urllib3.exceptions import HTTPError
    except ImportError as error:
        raise InputError("selenium is not installed: pip install 'trocar[browser]'") from error
    chosen = webdriver.ChromeOptions()
    chosen.binary_location = shutil.which("chromium") or ""
    for flag in (*FLAGS, "--window-size=1320,760", f"--user-data-dir={profile / 'profile'}"):
        chosen.add_argument(flag)
    driver = webdriver.ChromeService(shutil.which("chromedriver") or "")
    tab = webdriver.Chrome(chosen, driver)
    tab.set_script_timeout(ANSWER_S)

    def ask(script: str, *values: object) -> Any:
        end = time.monotonic() + SHOWN_S
        while time.monotonic() < end:
            try:
                if answer := tab.execute_script(script, *values):
                    return answer
            except TimeoutException:
                pass  # building shaders
            time.sleep(0.1)
        raise TrocarError(f"{url}: nothing that can be dragged within {SHOWN_S:g} s")

    try:
        tab.get(url)
        ask(DRAWN)
        ask("return document.querySelector('[data-trocar=bar]')?.innerText.length > 5")
        drawn()
        before = ask(JOINTS)
        name = ask(
            "return Object.keys(window.__viserMutable.nodeRefFromName)"
            ".find(name => /^\\/hands\\/tip_[^/]+$/.test(name))"
        )
        for share in GRIPS:
            for axis in range(3):
                grip = [SCALE_M * share * (k == axis) for k in range(3)]
                (x0, y0), (x, y) = ask(PLACES, name, [[0.0, 0.0, 0.0], grip])
                length = max(((x - x0) ** 2 + (y - y0) ** 2) ** 0.5, 1.0)
                dx, dy = PULL_PX * (x - x0) / length, PULL_PX * (y - y0) / length
                hand = ActionChains(tab, duration=300)
                hand.w3c_actions.pointer_action.move_to_location(round(x), round(y))
                hand.click_and_hold().move_by_offset(round(dx / 2), round(dy / 2))
                hand.move_by_offset(round(dx / 2), round(dy / 2)).pause(1.0).release().perform()
                now = ask(JOINTS)
                if any(abs(a - b) > MOVED for a, b in zip(now, before, strict=True)):
                    return
        raise TrocarError(f"{url}: no joint followed the mouse")
    except HTTPError as error:
        raise TrocarError(f"{url}: the browser has not answered its driver: {error}") from error
    finally:
        tab.quit()
