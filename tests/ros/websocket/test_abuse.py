"""What a client may do wrong, by mistake or not: the arms move on and memory stays bounded."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest
from websockets.exceptions import ConnectionClosed, InvalidMessage, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from tests.ros.websocket.conftest import PATIENCE_S, Served, Talk, until
from trocar.live import connections
from trocar.live.access import PageAccess
from trocar.ros.transports.websocket import server

JS = "/PSM1/measured_js"
TOKEN = "a token of the tests"
HOME = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]


def far(yaw: float) -> str:
    message = {"position": [yaw, *HOME[1:]]}
    return json.dumps({"op": "publish", "topic": "/PSM1/servo_jp", "msg": message})


def moves_on(served: Served) -> bool:
    """Whether time flows."""
    before = served.loop.latest.time
    return until(lambda: served.loop.latest.time > before)


def gone(served: Served) -> bool:
    return until(lambda: not served.transport.wanted())


@pytest.mark.parametrize(
    "origin",
    ["https://example.org", "null", "http://127.0.0.1.evil.org", "http://localhost:8080"],
)
def test_pages_of_other_sites_cannot_connect(served: Served, origin: str) -> None:
    with pytest.raises(InvalidStatus) as caught:
        connect(served.url, origin=origin)  # type: ignore[arg-type]
    assert caught.value.response.status_code == 403


def test_a_name_that_another_site_lets_lead_here_is_refused(served: Served) -> None:
    where = ("127.0.0.1", served.transport.port)
    wire = socket.create_connection(where, timeout=20)
    with pytest.raises(InvalidStatus) as caught:
        connect(f"ws://example.org:{served.transport.port}", sock=wire)
    assert caught.value.response.status_code == 403


def test_a_page_that_is_named_can(served: Served) -> None:
    named = PageAccess(["http://localhost:3000"])
    with closing(Served(pages=named)) as other:
        with closing(Talk(other.url, origin="http://localhost:3000").socket) as it:
            assert it.response is not None
        with pytest.raises(InvalidStatus):
            connect(served.url, origin=Origin("http://localhost:3000"))


def test_the_token_is_asked_for_on_the_wire() -> None:
    with closing(Served(pages=PageAccess(token=TOKEN))) as guarded:
        for url, headers in (
            (guarded.url, {}),
            (f"{guarded.url}/?token=wrong", {}),
            (guarded.url, {"Authorization": "Bearer wrong"}),
        ):
            with pytest.raises(InvalidStatus) as caught:
                connect(url, additional_headers=headers)
            assert caught.value.response.status_code == 401
        word = TOKEN.replace(" ", "%20")
        connect(f"{guarded.url}/?token={word}").close()
        connect(guarded.url, additional_headers={"Authorization": f"Bearer {TOKEN}"}).close()


def test_a_message_of_100_mb_ends_the_connection_unread(served: Served, talk: Talk) -> None:
    with contextlib.suppress(ConnectionClosed):
        talk.socket.send("x" * 100_000_000)
    with pytest.raises(ConnectionClosed):
        talk.hear()
    # 1009: too big; 1006: the server had left before its reason could be read.
    assert talk.socket.close_code in (1009, 1006)
    assert moves_on(served)


def test_a_header_that_announces_an_exabyte_costs_nothing(served: Served, talk: Talk) -> None:
    talk.socket.socket.sendall(b"\x81\xff" + (1 << 60).to_bytes(8, "big") + b"mask" + b"x" * 100)
    with pytest.raises(ConnectionClosed):
        talk.hear()
    assert talk.socket.close_code == 1009
    assert moves_on(served)


def test_a_flood_is_cut_and_told_and_the_newest_set_point_counts(
    served: Served, meet: Callable[..., Talk], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "MESSAGES_PER_S", 200.0)  # the machine may be too busy for more
    served.core.forget_refusals()
    talk = meet()
    talk.send(op="subscribe", topic="/PSM1/warning")
    talk.wait_for_server()
    for k in range(10_000):
        talk.socket.send(far(1e-5 * k))
    assert "sends too fast" in talk.hear_op("status")["msg"]
    assert "sends too fast" in talk.hear_on("/PSM1/warning")["data"]
    assert moves_on(served)
    other = meet()
    assert until(lambda: other.socket.send(far(0.0)) is None and abs(yaw(served)) < 1e-9)


def yaw(served: Served) -> float:
    return float(served.loop.latest.arms["PSM1"].setpoint[0])


@pytest.mark.parametrize("ratio", [5e-324, 1e-300, 1e-13, 1e-6])
def test_a_trajectory_ratio_too_small_for_any_move_is_refused_and_the_simulator_goes_on(
    served: Served, meet: Callable[..., Talk], ratio: float
) -> None:
    served.core.forget_refusals()
    talk = meet()
    talk.send(op="subscribe", topic="/PSM1/warning")
    talk.wait_for_server()
    for topic in ("set_ratio", "set_ratio_v", "set_ratio_a"):
        talk.send(op="publish", topic=f"/PSM1/trajectory_j/{topic}", msg={"data": ratio})
    assert "allowed: " in talk.hear_on("/PSM1/warning")["data"]
    for goal in (0.1, 0.0):
        message = {"position": [goal, *HOME[1:]]}
        talk.send(op="publish", topic="/PSM1/move_jp", msg=message)
        assert until(lambda goal=goal: abs(yaw(served) - goal) < 1e-9)
    assert moves_on(served)


def test_a_reader_that_sleeps_misses_old_states_gets_the_newest_and_no_memory_grows(
    served: Served, meet: Callable[..., Talk], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "MOST_BUFFERED", 4096)
    monkeypatch.setattr(connections, "SEND_BUFFER", 4096)
    talk = meet(max_queue=1)
    talk.socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    for name, topic in served.core.topics.items():
        if topic.direction == "pub" and topic.rate == "state" and not topic.later:
            talk.send(op="subscribe", topic=f"/{name}")
    assert until(lambda: len(served.transport.wanted()) > 5)
    ours = next(iter(served.transport.clients))
    assert until(lambda: ours.connection.paused)
    asleep = served.loop.latest.time
    assert until(lambda: served.loop.latest.time > asleep + 0.5)
    buffered = ours.connection.transport.get_write_buffer_size()
    assert buffered < 4096 + 64 * 1024  # one batch of states beyond the bound
    told = r"reads too slowly: the states of \d\d+ periods and 0 other messages"
    talk.hear_until(lambda it: it["op"] == "status" and bool(re.search(told, it["msg"])))
    js = talk.hear_on(JS)
    assert js["header"]["stamp"]["secs"] > 0


class Silent:
    """A client that subscribes to every topic and never reads."""

    def __init__(self, served: Served) -> None:
        self.socket = socket.socket()
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self.socket.connect(("127.0.0.1", served.transport.port))
        self.socket.sendall(HANDSHAKE)
        assert b"101 Switching" in self.socket.recv(len("HTTP/1.1 101 Switching"))
        for name in served.core.topics:
            self.socket.sendall(masked(json.dumps({"op": "subscribe", "topic": name})))

    def read_slowly(self) -> None:
        """Take a little of what waits."""
        self.socket.recv(512)


@pytest.fixture
def crowded(monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    """A server for few clients, which loses patience soon."""
    monkeypatch.setattr(connections, "MOST_BUFFERED", 4096)
    monkeypatch.setattr(connections, "SEND_BUFFER", 4096)
    monkeypatch.setattr(connections, "MOST_CLIENTS", 3)
    monkeypatch.setattr(connections, "LOOK_S", 0.05)
    monkeypatch.setattr(connections, "STALE_S", 0.4)
    monkeypatch.setattr(connections, "GONE_S", 1.0)
    with closing(Served()) as served:
        yield served


def test_a_client_that_subscribes_and_never_reads_is_let_go_and_one_that_reads_slowly_stays(
    crowded: Served, caplog: pytest.LogCaptureFixture
) -> None:
    silent, slow, idle = Silent(crowded), Silent(crowded), Talk(crowded.url)
    with silent.socket, slow.socket, closing(idle.socket):
        assert until(lambda: len(crowded.transport.clients) == 3)
        while len(crowded.transport.clients) == 3:
            slow.read_slowly()
            time.sleep(0.01)
        port = silent.socket.getsockname()[1]
        left = {client.peer for client in crowded.transport.clients}
        assert len(left) == 2 and f"127.0.0.1:{port}" not in left
        assert f"websocket: disconnected 127.0.0.1:{port}, which read nothing for 1 s" in (
            caplog.text
        )
        idle.wait_for_server()


def test_clients_that_never_read_make_room_for_a_newcomer(
    crowded: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "GONE_S", 1000.0)
    silent = [Silent(crowded) for _ in range(3)]
    assert until(lambda: _gets_in(crowded))
    for it in silent:
        it.socket.close()


HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


def masked(text: str) -> bytes:
    """Return a short text as a client's frame, under a mask of zeros."""
    payload = text.encode()
    assert len(payload) < 126
    return bytes([0x81, 0x80 | len(payload)]) + bytes(4) + payload


@pytest.mark.parametrize("junk", [b"\x00" * 500, b"GET /../../etc/passwd HTTP/1.1\r\n\r\n", b"\n"])
def test_what_is_no_websocket_is_turned_away(served: Served, junk: bytes) -> None:
    with socket.create_connection(("127.0.0.1", served.transport.port), timeout=20) as stranger:
        stranger.sendall(junk)
        stranger.shutdown(socket.SHUT_WR)
        answer = b""
        while more := stranger.recv(4096):
            answer += more
    assert b"root:" not in answer
    assert b"101" not in answer
    assert moves_on(served)


def test_no_more_than_so_many_clients_come_in(
    served: Served, meet: Callable[..., Talk], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "MOST_CLIENTS", 2)
    first, _ = meet(), meet()
    with pytest.raises(InvalidStatus) as caught:
        meet()
    assert caught.value.response.status_code == 503
    first.socket.close()
    assert until(lambda: len(served.transport.clients) == 1)
    meet()


def test_connections_that_say_nothing_keep_nobody_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """There are a few of them at most: the oldest end first, and a newcomer comes in."""
    monkeypatch.setattr(server, "OPEN_S", 1000.0)
    monkeypatch.setattr(connections, "MOST_CLIENTS", 1)
    monkeypatch.setattr(connections, "MOST_STRANGERS", 3)
    with closing(Served()) as served, contextlib.ExitStack() as stack:
        address = ("127.0.0.1", served.transport.port)
        silent = [stack.enter_context(socket.create_connection(address)) for _ in range(6)]
        talk = Talk(served.url)
        talk.wait_for_server()
        talk.socket.close()
        for it in silent[:3]:
            it.settimeout(PATIENCE_S)
            with contextlib.suppress(ConnectionResetError):
                assert it.recv(1) == b""
        silent[-1].setblocking(False)
        with pytest.raises(BlockingIOError):
            silent[-1].recv(1)


def _gets_in(served: Served) -> bool:
    try:
        Talk(served.url).socket.close()
    except (OSError, InvalidMessage, InvalidStatus, ConnectionClosed):
        return False
    return True


VANISHING = """
import json, sys
from websockets.sync.client import connect
with connect(sys.argv[1], compression=None) as it:
    for topic in json.loads(sys.argv[2]):
        it.send(json.dumps({"op": "subscribe", "topic": topic}))
    it.recv()
    print("here", flush=True)
    for _ in it:
        pass
"""


@pytest.fixture
def killed(served: Served) -> Iterator[list[subprocess.Popen[str]]]:
    topics = ["/PSM1/measured_js", "/PSM1/setpoint_js", "/PSM1/measured_cp"]
    words = [sys.executable, "-c", VANISHING, served.url, json.dumps(topics)]
    them = [subprocess.Popen(words, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    yield them
    for it in them:
        it.kill()
        it.wait()
        assert it.stdout
        it.stdout.close()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no kill -9")
def test_killed_clients_are_forgotten(served: Served, killed: list[subprocess.Popen[str]]) -> None:
    for it in killed:
        assert it.stdout
        assert it.stdout.readline() == "here\n"
    for it in killed:
        os.kill(it.pid, signal.SIGKILL)
    assert gone(served)
    assert moves_on(served)


@pytest.mark.slow
def test_24_clients_come_and_go_while_the_arm_moves_and_no_tick_is_lost(
    served: Served, meet: Callable[..., Talk]
) -> None:
    """Every millisecond of simulated time is stepped, whoever comes and goes."""
    stop = threading.Event()
    failures: list[BaseException] = []

    def visit(number: int) -> None:
        try:
            while not stop.is_set():
                talk = Talk(served.url)
                talk.send(op="subscribe", topic=JS)
                talk.send(op="subscribe", topic="/PSM1/operating_state")
                for _ in range(number % 5):
                    talk.hear()
                if number % 2:
                    talk.socket.close()
                else:
                    talk.socket.close_socket()
        except Exception as error:  # noqa: BLE001  raised below, in the test's own thread
            failures.append(error)

    visitors = [threading.Thread(target=visit, args=(k,)) for k in range(24)]
    before = served.loop.state
    for visitor in visitors:
        visitor.start()
    driver = meet()
    for k in range(30):
        driver.socket.send(far(0.1 * (k % 2)))
        time.sleep(0.05)
    stop.set()
    for visitor in visitors:
        visitor.join()
    driver.socket.send(far(0.0))
    assert not failures, failures[0]
    assert moves_on(served)
    assert gone(served)
    after = served.loop.state
    stepped = (after.snapshot.time - before.snapshot.time) / served.world.timestep
    assert round(stepped) == after.ticks - before.ticks
