"""Two real browsers at once, and one whose connection or simulator goes and comes back."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("selenium", reason="selenium is not installed")
from tests.viewer.browser import chromium
from tests.viewer.person import Person
from tests.viewer.program import Program, program

pytestmark = pytest.mark.browser

ROOT = Path(__file__).parents[2]
BAR = "return document.querySelector('[data-trocar=bar]')?.innerText ?? ''"
BANNER = "return document.querySelector('[data-trocar=banner]')?.innerText ?? ''"
#: Time after which a command that a page sent would have acted [s]. Source: our own choice.
ACTED_S = 1.5


@dataclass
class Simulator:
    """The command, as a user runs it."""

    process: subprocess.Popen[str]
    viewer: str
    rosbridge: str

    @property
    def ports(self) -> tuple[int, int]:
        """Ports of the page and the WebSocket."""
        page, socket_ = (int(url.rsplit(":", 1)[1]) for url in (self.viewer, self.rosbridge))
        return page, socket_


@contextmanager
def simulator(ports: tuple[int, int] = (0, 0)) -> Iterator[Simulator]:
    """Serve one PSM until the `with` block ends."""
    words = ["sim", "--rig", "psm", "--port", str(ports[0]), "--websocket-port", str(ports[1])]
    code = "import sys; from trocar.cli import main; sys.exit(main())"
    env = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "PYTHONUNBUFFERED": "1"}
    line = [sys.executable, "-c", code, *words]
    with subprocess.Popen(line, env=env, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        try:
            found = [
                next(m[0] for said in running.stdout if (m := re.search(kind, said)))
                for kind in (r"http://[^\s]+", r"ws://[^\s]+")
            ]
            yield Simulator(running, *found)
        finally:
            running.terminate()
            running.communicate(timeout=30)


class Cable:
    """A connection to a port of this machine that can be cut and mended.

    Attributes:
        port: to connect to instead
    """

    def __init__(self, port: int) -> None:
        self._to = port
        self._open: list[socket.socket] = []
        self._ends = socket.create_server(("127.0.0.1", 0))
        self.port = self._ends.getsockname()[1]
        self._whole = True
        self._threads: list[threading.Thread] = []
        self._door = threading.Thread(target=self._accept)
        self._door.start()

    def cut(self) -> None:
        """End all connections, and let none through."""
        self._whole = False
        for end in self._open:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join()
        for end in self._open:
            end.close()
        self._threads.clear()
        self._open.clear()

    def mend(self) -> None:
        """Let connections through again."""
        self._whole = True

    def close(self) -> None:
        """End for good."""
        self._ends.shutdown(socket.SHUT_RDWR)
        self._door.join()
        self.cut()
        self._ends.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                here, _ = self._ends.accept()
                if not self._whole:
                    here.close()
                    continue
                there = socket.create_connection(("127.0.0.1", self._to))
                self._open += [here, there]
                for a, b in ((here, there), (there, here)):
                    self._threads.append(threading.Thread(target=self._carry, args=(a, b)))
                    self._threads[-1].start()

    @staticmethod
    def _carry(source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while content := source.recv(65536):
                sink.sendall(content)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


@contextmanager
def person(folder: Path, name: str) -> Iterator[Person]:
    with chromium(folder / name) as browser:
        screen = {"width": 1100, "height": 500, "deviceScaleFactor": 0.5, "mobile": False}
        browser.tab.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        yield Person(browser)


def shows(at: Person, words: str, script: str = BAR) -> None:
    """Wait until the line above the scene, or the banner, has some words."""
    at.browser.wait(lambda: words in at.tab.execute_script(script), words, 60.0)


def comes(at: Person, url: str) -> None:
    """Open the page and wait for its sliders."""
    at.tab.get(url)
    at.browser.wait(lambda: at.browser.labelled("yaw deg"), "the sliders", 60.0)
    shows(at, "real time")


def turns(at: Person, reads: Program, degrees: float) -> None:
    """Type an angle, and wait until the set-point is there."""
    at.type("yaw deg", degrees)
    reads.hear("/PSM1/setpoint_js", yaw_is(degrees))


def yaw_is(degrees: float) -> Callable[[dict], bool]:
    return lambda it: abs(np.degrees(it["position"][0]) - degrees) < 0.01


def test_one_drives_the_other_watches_and_control_is_passed(tmp_path: Path) -> None:
    with (
        simulator() as served,
        person(tmp_path, "a") as first,
        person(tmp_path, "b") as second,
        program(served.rosbridge) as reads,
    ):
        comes(first, served.viewer)
        comes(second, served.viewer)
        shows(first, "you drive")
        shows(second, "browser 1 drives, you watch")
        turns(first, reads, 12.0)
        attempt(second, -30.0)  # two people at one arm: the one who watches changes nothing
        turns(first, reads, 14.0)
        time.sleep(ACTED_S)
        assert yaw_is(14.0)(reads.hear("/PSM1/setpoint_js"))

        second.press("Driver", "Request control")
        shows(first, "requests control")
        first.press("Driver", "Keep")
        second.browser.wait(
            lambda: "Driver/Request control" in second.controls(), "it was declined", 30.0
        )
        attempt(second, -30.0)
        assert yaw_is(14.0)(reads.hear("/PSM1/setpoint_js"))

        second.press("Driver", "Request control")
        first.press("Driver", "Give")
        shows(second, "you drive")
        shows(first, "browser 2 drives, you watch")
        turns(second, reads, -8.0)
        attempt(first, 40.0)
        assert yaw_is(-8.0)(reads.hear("/PSM1/setpoint_js"))

        second.tab.get("about:blank")  # who drives leaves
        shows(first, "real time")
        turns(first, reads, 5.0)


def attempt(at: Person, degrees: float) -> None:
    """Type into a box that is grey, as far as the page lets one; nothing has to come of it."""
    box = at.all("//label[normalize-space()='yaw deg']/../../..//input[@type='text']")[0]
    at.tab.execute_script("arguments[0].focus(); arguments[0].select()", box)
    at.mouse.send_keys(f"{degrees:g}\n").perform()
    time.sleep(ACTED_S)


@pytest.mark.slow
def test_who_loses_the_connection_gives_the_arm_to_the_other_and_watches_when_back(
    tmp_path: Path,
) -> None:
    with (
        simulator() as served,
        closing(Cable(served.ports[0])) as cable,
        person(tmp_path, "a") as first,
        person(tmp_path, "b") as second,
        program(served.rosbridge) as reads,
    ):
        comes(first, f"http://127.0.0.1:{cable.port}/")
        comes(second, served.viewer)
        shows(first, "you drive")
        turns(first, reads, 10.0)
        cable.cut()
        shows(first, "No connection to the simulator since", BANNER)
        second.browser.wait(lambda: "watch" not in second.tab.execute_script(BAR), "alone", 30.0)
        turns(second, reads, -10.0)
        cable.mend()
        first.browser.wait(lambda: not first.tab.execute_script(BANNER), "it is back", 60.0)
        shows(first, "browser 1 drives, you watch")
        shows(second, "you drive")
        turns(second, reads, -12.0)


@pytest.mark.slow
def test_a_page_that_was_open_drives_the_simulator_that_was_started_anew(tmp_path: Path) -> None:
    with person(tmp_path, "a") as at:
        with simulator() as served, program(served.rosbridge) as reads:
            comes(at, served.viewer)
            turns(at, reads, 15.0)
            os.kill(served.process.pid, signal.SIGSTOP)
            try:
                shows(at, "has not answered since", BANNER)
            finally:
                os.kill(served.process.pid, signal.SIGCONT)
            at.browser.wait(lambda: not at.tab.execute_script(BANNER), "it answers again", 60.0)
            turns(at, reads, 16.0)
            ports = served.ports
        shows(at, "No connection to the simulator since", BANNER)
        with simulator(ports) as served, program(served.rosbridge) as reads:
            at.browser.wait(lambda: not at.tab.execute_script(BANNER), "the next one", 60.0)
            at.browser.wait(lambda: at.browser.labelled("yaw deg"), "the sliders", 60.0)
            shows(at, "real time")
            turns(at, reads, -15.0)
