"""Serving the page: where, how it begins, and how it ends."""

from __future__ import annotations

import logging
import os
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import pytest
from viser.infra import Message, WebsockMessageHandler

import trocar
from tests.live.fake_world import FakeWorld
from trocar.errors import DivergedError, InputError
from trocar.live import Loop
from trocar.live.access import PageAccess
from trocar.viewer import serve
from trocar.viewer.desk import SILENT_S
from trocar.viewer.page import Page
from trocar.viewer.server import LocalServer, address, serving


def fake(**options: Any) -> Any:
    return FakeWorld(**options)


def test_it_serves_for_the_given_time_and_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    pages: list[str] = []
    world = fake()

    def look(url: str) -> None:
        with urllib.request.urlopen(url, timeout=10) as answer:
            pages.append(answer.read().decode())

    serve(world, port=0, speed="max", duration_s=5.0, on_ready=look)
    assert "<html" in pages[0].lower()
    assert world.time == pytest.approx(5.0)
    assert capfd.readouterr() == ("", "")


def test_the_port_is_free_again_afterwards() -> None:
    used: list[str] = []

    def read(url: str) -> None:  # whom the server leaves first lingers at its port
        used.append(url)
        with urllib.request.urlopen(url, timeout=10) as answer:
            answer.read()

    serve(fake(), port=0, speed="max", duration_s=1.0, on_ready=read)
    port = int(used[0].rsplit(":", 1)[1])
    serve(fake(), port=port, speed="max", duration_s=0.1, on_ready=used.append)
    assert used[0] == used[1]


def test_a_port_that_is_taken_is_one_clear_error() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port} on 127.0.0.1 is in use; .*--port"):
            serve(fake(), port=port)


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_does_not_exist_is_refused(port: int) -> None:
    with pytest.raises(InputError, match=f"port {port}; allowed: 1 to 65535"):
        serve(fake(), port=port)


@pytest.mark.parametrize("host", ["198.51.100.5", "no.such.name.invalid", ""])
def test_an_address_of_another_machine_is_one_clear_error(host: str) -> None:
    with pytest.raises(InputError, match=rf"--host: got '{host}'; allowed: an address of this"):
        serve(fake(), host=host, access=PageAccess(token="0123456789abcdef"))


def test_other_machines_are_served_with_a_token_only() -> None:
    with pytest.raises(InputError, match=r"0\.0\.0\.0.*set a token"):
        serve(fake(), host="0.0.0.0", access=PageAccess())


def test_beyond_this_machine_the_address_has_a_secret_that_nobody_gave() -> None:
    pages: list[str] = []

    def look(url: str) -> None:
        for page in (url, url.partition("?")[0]):
            try:
                with urllib.request.urlopen(page, timeout=10) as answer:
                    pages.append(answer.read().decode())
            except urllib.error.HTTPError as refused:
                pages.append(str(refused.code))

    serve(fake(), host="0.0.0.0", port=0, speed="max", duration_s=5.0, on_ready=look)
    assert "<html" in pages[0].lower() and pages[1] == "401"


def test_localhost_means_the_loopback_address() -> None:
    with serving("localhost", 0, "test") as server:
        assert address(server).startswith("http://127.0.0.1:")


@pytest.mark.usefixtures("strangers")
def test_of_somebody_who_hangs_up_or_sends_no_http_nothing_is_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with serving("127.0.0.1", 0, "test") as server:
        for said in (b"", b"GE", b"\x16\x03\x01" * 100 + b"\r\n\r\n", b"GET / HTTP/9\r\n\r\n"):
            with socket.create_connection((server.get_host(), server.get_port())) as stranger:
                stranger.sendall(said)
        with urllib.request.urlopen(address(server), timeout=10) as answer:
            assert "<html" in answer.read().decode().lower()  # all before it has been looked at
    assert not caplog.records


@pytest.fixture
def strangers(monkeypatch: pytest.MonkeyPatch) -> logging.Logger:
    """Return the logger that reports strangers, without the filters that viser leaves there."""
    logger = logging.getLogger("websockets.server")
    monkeypatch.setattr(logger, "filters", [])
    return logger


def test_of_another_failure_of_the_handshake_is_told(
    strangers: logging.Logger, caplog: pytest.LogCaptureFixture
) -> None:
    with serving("127.0.0.1", 0, "test"):
        try:
            raise KeyError("a defect")
        except KeyError:
            strangers.exception("opening handshake failed")
    assert len(caplog.records) == 1


def test_the_page_cannot_be_tunnelled_to_the_outside() -> None:
    with serving("127.0.0.1", 0, "test") as server:
        assert server.request_share_url() is None


class OpenPage(Page):
    """A page that a browser has open from the start."""

    def __init__(self, server: LocalServer, *rest: Any, **more: Any) -> None:
        super().__init__(server, *rest, **more)
        self.open(server)


def test_the_page_speaks_from_visers_own_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    speakers: list[str] = []
    queue = WebsockMessageHandler.queue_message

    def listen(self: WebsockMessageHandler, message: Message) -> None:
        speakers.append(threading.current_thread().name)
        queue(self, message)

    def begin(_: str) -> None:
        monkeypatch.setattr(WebsockMessageHandler, "queue_message", listen)

    monkeypatch.setattr("trocar.viewer.page.Page", OpenPage)
    serve(fake(), port=0, duration_s=SILENT_S + 0.5, on_ready=begin)
    assert len(speakers) > 10
    assert threading.current_thread().name not in speakers and len(set(speakers)) == 1


def test_a_diverged_simulation_is_shown_and_raised() -> None:
    with pytest.raises(DivergedError, match=r"t = 0\.10.*PSM1/yaw.*0\.3"):
        serve(fake(fail_at=0.1), port=0, speed="max")


def test_what_goes_wrong_in_on_ready_stops_everything() -> None:
    before = set(threading.enumerate())

    def fail(_: str) -> None:
        raise ValueError("no browser to open")

    with pytest.raises(ValueError, match="no browser"):
        serve(fake(), port=0, on_ready=fail)
    end = time.monotonic() + 5.0  # the thread ends just after its loop
    while left := [t for t in set(threading.enumerate()) - before if t.name == "trocar-loop"]:
        assert time.monotonic() < end, left
        time.sleep(0.01)


@pytest.mark.skipif(sys.platform == "win32", reason="a console's Ctrl-C cannot be sent there")
def test_ctrl_c_ends_it_cleanly(tmp_path: Path) -> None:
    program = tmp_path / "serve.py"
    program.write_text(
        "import signal\n"
        "from trocar.viewer import serve\n"
        "from trocar.simulation import World\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "serve(World('psm'), port=0, on_ready=lambda url: print(url, flush=True))\n"
        "print('ended')\n"
    )
    source = str(Path(trocar.__file__).parents[1])
    with subprocess.Popen(
        [sys.executable, str(program)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": source},
    ) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        process.send_signal(2)
        out, err = process.communicate(timeout=30)
    assert first.startswith("http://127.0.0.1:")
    assert (process.returncode, out, err) == (0, "ended\n", "")


def test_a_loop_that_others_talk_to_is_run_and_ended() -> None:
    world = fake()
    loop = Loop(world, speed="max")
    running: list[bool] = []
    serve(world, port=0, duration_s=0.5, loop=loop, on_ready=lambda _: running.append(loop.running))
    assert running == [True]
    assert not loop.running
    assert world.time == pytest.approx(0.5)
