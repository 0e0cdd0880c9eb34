"""Frames that a browser without a graphics card draws of the moving cart, at each level."""

from __future__ import annotations

import ctypes
import math
import os
import re
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from trocar.errors import InputError
from trocar.live import Command, Loop
from trocar.robot.verification.figures import Figure
from trocar.simulation import World
from trocar.viewer import page as viewer_page
from trocar.viewer.drawing import LEVELS
from trocar.viewer.server import run_there

#: Source: the project's own goal for the level that a browser chooses. [frames/s]
GOAL_HZ = 8.0
#: Width and height of a window whose view is 900 pixels wide beside both panels.
WINDOW = 1640, 740
#: Time until a level is drawn, and over which frames are counted [s]; rounds through the levels.
SETTLE_S, COUNT_S, ROUNDS = 6.0, 8.0, 2
#: Sine of the first two joints of each PSM: amplitude [rad], angular frequency [rad/s].
SWING = (0.3, 1.0), (0.2, 1.3)
#: Longest time by which the swing goes on between two commands [s].
LARGEST_STEP_S = 0.1
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=gl-egl",
    "--ignore-gpu-blocklist",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-watchdog",
    "--no-first-run",
    "--disable-background-networking",
)
#: Source: linux/prctl.h, linux/capability.h.
PR_CAPBSET_DROP, CAP_SYS_NICE = 24, 23
FRAMES = "return [performance.now(), __viserTestpoints.rendererInfo.render.frame]"


def drawing() -> list[Figure]:
    """Return frames a second and processor time of a frame of each level, the mean of the rounds.

    Raises:
        InputError: Chromium or its driver is not installed
    """
    world = World("full_cart")
    loop = Loop(world)
    ready = threading.Event()
    found: list[Any] = []

    class KeptPage(viewer_page.Page):
        def __init__(self, *rest: Any, **more: Any) -> None:
            super().__init__(*rest, **more)
            found.append(self)

    url: list[str] = []

    def serve() -> None:
        def on_ready(address: str) -> None:
            url.append(address)
            ready.set()

        viewer_page.Page = KeptPage  # type: ignore[misc]  # levels are chosen from here
        viewer_page.serve(world, port=0, on_ready=on_ready, loop=loop)

    server = threading.Thread(target=serve, daemon=True)
    server.start()
    ready.wait()
    over = threading.Event()
    mover = threading.Thread(target=move_psms, args=(loop, over))
    mover.start()
    try:
        return _measure(found[0], url[0], loop)
    finally:
        over.set()
        mover.join()
        loop.stop()
        server.join()  # it prints, which the end of the program would cut off


def _measure(page: viewer_page.Page, url: str, loop: Loop) -> list[Figure]:
    profile = tempfile.mkdtemp()
    tab = chromium(profile)
    rows: dict[str, list[tuple[float, float]]] = {level.name: [] for level in LEVELS}
    try:
        tab.get(url)
        while not any(desk.seen for desk in tuple(page.desks.values())):
            time.sleep(0.2)
        (desk,) = page.desks.values()
        for name in [level.name for level in reversed(LEVELS)] * ROUNDS:
            run_there(page.server, lambda name=name: desk.drawing.choose(name))
            time.sleep(SETTLE_S)
            used_s, (before_ms, before) = _processor_s(profile), tab.execute_script(FRAMES)
            time.sleep(COUNT_S)
            (after_ms, after), used_s = tab.execute_script(FRAMES), _processor_s(profile) - used_s
            frames = max(after - before, 1)
            rows[name].append((1000 * frames / (after_ms - before_ms), used_s / frames))
    finally:
        tab.quit()
        shutil.rmtree(profile, ignore_errors=True)
    found: list[Figure] = []
    for name, row in rows.items():
        rate = sum(hz for hz, _ in row) / len(row)
        cost = sum(s for _, s in row) / len(row)
        goal = GOAL_HZ if name == LEVELS[-1].name else None
        found.append(Figure(f"{name}: frames a second", rate, "1/s", lower=goal))
        found.append(Figure(f"{name}: processor time of a frame", cost, "s"))
    found.append(Figure("real-time factor at the end", loop.real_time_factor, ""))
    return found


def chromium(profile: str) -> Any:
    """Open Chromium with a profile, without a graphics card.

    Raises:
        InputError: it or its driver is not installed
    """
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    driver = shutil.which("chromedriver")
    if chromium is None or driver is None:
        raise InputError("drawing: needs Chromium and chromedriver on the PATH")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    size = "--window-size={},{}".format(*WINDOW)
    for flag in (*FLAGS, size, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    tab = webdriver.Chrome(options, driver_service(driver))
    tab.set_script_timeout(60)
    return tab


def driver_service(driver: str) -> Any:
    """Return a service that starts chromedriver: Mesa draws in software on every machine.

    Chromium that runs as root puts its drawing before all other programs (niceness -8), the
    simulator among them; it has no right to that here.
    """
    from selenium import webdriver

    def give_up_niceness() -> None:
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE, 0, 0, 0)

    given = {"preexec_fn": give_up_niceness} if sys.platform == "linux" else {}
    environment = {**os.environ, "LIBGL_ALWAYS_SOFTWARE": "1"}
    return webdriver.ChromeService(driver, env=environment, popen_kw=given)


def move_psms(loop: Loop, over: threading.Event) -> None:
    """Swing the PSMs, which start slowly; however late a command is, no arm jumps."""
    arms, before_s, t = loop.latest.arms, loop.latest.time, 0.0
    while not over.wait(0.02):
        now_s = loop.latest.time
        t, before_s = t + min(now_s - before_s, LARGEST_STEP_S), now_s
        for name in ("PSM1", "PSM2"):
            q = [float(value) for value in arms[name].setpoint[:6]]
            for k, (amplitude, speed) in enumerate(SWING):
                q[k] += amplitude * min(1.0, t / 3.0) ** 2 * math.sin(speed * t)
            loop.post(Command(name, "servo_jp", {"q": tuple(q)}))


def _processor_s(profile: str) -> float:
    """Return the processor time of the browser's processes so far [s]; Linux only."""
    ticks = 0
    for folder in Path("/proc").iterdir():
        if re.fullmatch(r"\d+", folder.name):
            try:
                if profile in (folder / "cmdline").read_text(errors="replace"):
                    words = (folder / "stat").read_text().rpartition(")")[2].split()
                    ticks += int(words[11]) + int(words[12])
            except OSError:  # it has ended
                continue
    return ticks / os.sysconf("SC_CLK_TCK")
