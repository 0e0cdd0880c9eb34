"""Web pages of other origins in a real browser: a disabled arm stays disabled."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar

import pytest
import viser
from viser.infra import Message, WebsockServer

pytest.importorskip("selenium", reason="selenium is not installed")
from tests.viewer.browser import Browser, chromium
from tests.viewer.program import program

pytestmark = pytest.mark.browser

ROOT = Path(__file__).parents[2]
TOKEN = "0123456789abcdef"
#: In this order a disabled arm is enabled, homed and moved.
COMMANDS = [
    ("state_command", {"string": "enable"}),
    ("state_command", {"string": "home"}),
    ("move_jp", {"position": [0.5, 0.0, 0.12, 0.0, 0.0, 0.0]}),
]
#: What a stranger's script does in a page of ours: it presses our buttons, and tries the WebSocket.
SCRIPT = """
const frame = document.body.appendChild(document.createElement("iframe"));
frame.src = "/";
setInterval(() => {
  const buttons = [...frame.contentDocument.querySelectorAll("button")];
  for (const name of ["Enable", "Home"])
    buttons.find((button) => button.innerText.trim() === name)?.click();
}, 500);
const socket = new WebSocket("{rosbridge}");
socket.onopen = () => { for (const said of {said}) socket.send(JSON.stringify(said)); };
"""
#: A page that connects by itself, to both sockets, and tells what came of it in its title.
DIRECT = """<!doctype html><title>tries</title><script>
const found = [];
function attempt(name, url, protocols, opened) {
  const socket = new WebSocket(url, protocols);
  let open = false;
  const end = () => { found.push(`${name}: ${open ? "opened" : "refused"}`);
                      if (found.length === 2) document.title = found.sort().join(", "); };
  socket.onopen = () => { open = true; opened(socket); setTimeout(() => socket.close(), 1000); };
  socket.onclose = end;
}
attempt("rosbridge", "{rosbridge}", [],
        (socket) => { for (const said of {said}) socket.send(JSON.stringify(said)); });
attempt("viewer", "{viewer}", ["viser-v{version}"], () => {});
</script>"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with chromium(tmp_path_factory.mktemp("profile")) as found:
        yield found


@dataclass(frozen=True)
class Simulator:
    """The command, as a user runs it; `entrance` is the address of the page that it prints."""

    viewer: str
    entrance: str
    rosbridge: str
    token: str | None


@pytest.fixture(scope="module", params=[None, TOKEN], ids=["without token", "with token"])
def simulator(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    words = ["sim", "--rig", "psm", "--port", "0", "--websocket-port", "0"]
    words += [] if request.param is None else ["--token", request.param]
    code = "import sys; from trocar.cli import main; sys.exit(main())"
    env = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "PYTHONUNBUFFERED": "1"}
    line = [sys.executable, "-c", code, *words]
    with subprocess.Popen(line, env=env, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        try:
            entrance, rosbridge = (
                next(found[0] for said in running.stdout if (found := re.search(kind, said)))
                for kind in (r"http://[^\s]+", r"ws://[^\s]+")
            )
            viewer = entrance.partition("/?")[0]
            assert (viewer != entrance) == (request.param is not None)
            yield Simulator(viewer, entrance, rosbridge, request.param)
        finally:
            running.terminate()
            running.communicate(timeout=30)


@dataclass
class RunJavascriptMessage(Message):
    """viser's message of this name, by which its client finds the kind."""

    source: str
    include_in_scene_serialization: ClassVar[bool] = True

    def redundancy_key(self) -> str:
        return self.source


@dataclass
class Stranger:
    """A web server of another origin, and a server that speaks viser's protocol."""

    pages: dict[str, bytes] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    visits: list[int] = field(default_factory=list)
    port: int = 0
    viser: str = ""


@pytest.fixture
def stranger(simulator: Simulator) -> Iterator[Stranger]:
    found = Stranger()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            path = self.path.partition("?")[0]
            found.asked.append(path)
            self.send_response(200 if path in found.pages else 404)
            self.send_header("Access-Control-Allow-Origin", "*")
            self.send_header(
                "Content-Type", "text/html" if path == "/" else "application/octet-stream"
            )
            self.end_headers()
            self.wfile.write(found.pages.get(path, b""))

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            pass

    attack = RunJavascriptMessage(source=filled(SCRIPT, simulator))
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    server = WebsockServer("127.0.0.1", port, Message, verbose=False)
    server.on_client_connect(lambda client: found.visits.append(client.client_id))
    server.start()
    recording = server.get_message_serializer(lambda _: True)
    server.queue_message(attack)
    found.pages["/attack.viser"] = recording.serialize()
    found.viser = f"ws://127.0.0.1:{port}"
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as web:
        found.port = web.server_port
        thread = threading.Thread(target=web.serve_forever)
        thread.start()
        try:
            yield found
        finally:
            web.shutdown()
            thread.join()
            server.stop()


def filled(text: str, simulator: Simulator) -> str:
    said = [
        {"op": "publish", "topic": f"/PSM1/{name}", "msg": message} for name, message in COMMANDS
    ]
    words = {
        "{rosbridge}": simulator.rosbridge,
        "{viewer}": simulator.viewer.replace("http", "ws"),
        "{version}": viser.__version__,
        "{said}": json.dumps(said),
    }
    for name, value in words.items():
        text = text.replace(name, value)
    return text


@contextmanager
def arm_stays_disabled(simulator: Simulator) -> Iterator[Callable[[], bool]]:
    """Disable the arm; after the block it must still be disabled and stand where it stood."""
    with program(simulator.rosbridge, simulator.token) as reader:
        reader.say("publish", topic="/PSM1/state_command", msg={"string": "disable"})
        reader.hear("/PSM1/operating_state", lambda it: it["state"] == "DISABLED")
        before = reader.joints
        yield lambda: reader.state != "DISABLED"
        assert reader.state == "DISABLED"
        assert reader.joints == pytest.approx(before, abs=1e-4)  # held as by a brake


def shows_the_page(browser: Browser, simulator: Simulator) -> bool:
    at_home = browser.tab.current_url in (f"{simulator.viewer}/", simulator.entrance)
    return at_home and browser.read("time") is not None


def asks_for_the_token(browser: Browser) -> bool:
    told = browser.tab.execute_script("return document.body.innerText")
    return told.startswith("open the address that trocar printed")


def test_a_page_in_an_iframe_of_a_stranger_is_not_shown(
    browser: Browser, simulator: Simulator, stranger: Stranger
) -> None:
    stranger.pages["/"] = (
        f'<iframe width=800 height=600 src="{simulator.viewer}/?websocket={stranger.viser}">'
        f'</iframe><iframe src="{simulator.viewer}/"></iframe>'
    ).encode()

    def blocked(frame: int) -> bool:
        browser.tab.switch_to.frame(frame)
        try:
            return browser.tab.execute_script("return location.protocol") == "chrome-error:"
        finally:
            browser.tab.switch_to.default_content()

    with arm_stays_disabled(simulator) as driven:
        browser.tab.get(f"http://127.0.0.1:{stranger.port}/")
        browser.wait(lambda: (blocked(0) and blocked(1)) or driven(), "both frames are blocked")
    assert not stranger.visits


@pytest.mark.parametrize("parameter", ["websocket", "playbackPath"])
def test_a_stranger_who_sends_the_browser_to_the_page_cannot_choose_what_it_connects_to(
    parameter: str, browser: Browser, simulator: Simulator, stranger: Stranger
) -> None:
    recording = f"http://127.0.0.1:{stranger.port}/attack.viser"
    value = stranger.viser if parameter == "websocket" else recording
    stranger.pages["/"] = (
        f"<script>location = '{simulator.viewer}/?{parameter}={value}'</script>"
    ).encode()
    with arm_stays_disabled(simulator) as driven:
        browser.tab.get(f"http://127.0.0.1:{stranger.port}/")
        shown = (
            (lambda: shows_the_page(browser, simulator))
            if simulator.token is None
            else (lambda: asks_for_the_token(browser))
        )
        browser.wait(lambda: shown() or driven(), "our page is shown")
    assert not stranger.visits
    assert "/attack.viser" not in stranger.asked


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_a_page_of_a_stranger_opens_no_socket_though_the_browser_has_ours_open(
    host: str, browser: Browser, simulator: Simulator, stranger: Stranger
) -> None:
    """Of the same host, whose cookies the browser would send, and of another."""
    stranger.pages["/"] = filled(DIRECT, simulator).encode()
    if not shows_the_page(browser, simulator):  # of the test before
        browser.open(simulator.entrance)
    with arm_stays_disabled(simulator):
        with closing(Tab(browser)):
            browser.tab.get(f"http://{host}:{stranger.port}/")
            browser.wait(lambda: "," in browser.tab.title, "both sockets are tried")
            assert browser.tab.title == "rosbridge: refused, viewer: refused"
        browser.wait(lambda: shows_the_page(browser, simulator), "our page is still there")


class Tab:
    """Another tab, in front while it is open."""

    def __init__(self, browser: Browser) -> None:
        self._tab = browser.tab
        self._before = self._tab.current_window_handle
        self._tab.switch_to.new_window("tab")

    def close(self) -> None:
        self._tab.close()
        self._tab.switch_to.window(self._before)
