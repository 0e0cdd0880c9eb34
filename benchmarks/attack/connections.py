"""Strangers at the sockets of `trocar sim`: nobody gets in, and an honest reader notices nothing.

Half-open connections, clients that never read, slow readers, aborted handshakes and connections,
wrong names, origins and tokens, garbage, huge headers, invalid frames and floods, in random order,
against the WebSocket and the web viewer of a run with a token.
"""

from __future__ import annotations

import json
import math
import random
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

import viser
from websockets.sync.client import connect

from benchmarks.attack import Tally
from benchmarks.served import Served, served

#: It measures the rate of a reader, which other load changes.
ALONE = True
TOKEN = "token-of-an-attack"
JOINTS = "/PSM1/measured_js"
#: How long an answer may take, on a busy machine. [s]
PATIENCE_S = 5.0
#: Time to measure the honest reader alone, and between two looks at it. [s]
ALONE_S, LOOK_S = 3.0, 2.0
#: A client that takes nothing is gone after so long: 15 s, and what a busy machine adds. [s]
GONE_S = 20.0
#: Connections that are held at a time, of each kind: more than the server has places.
HELD = 150
#: What an honest reader gets under attack, of what it gets alone, and its longest wait. Source: our
#: own choice; a process that only sleeps misses as much while another one opens connections. [s]
LEAST_SHARE, LONGEST_S = 0.8, 1.0
#: Growth of the server's memory that fails. Source: 64 clients of the most that one may hold. [MB]
MOST_GROWN_MB = 64 * 4.5
FLOOD = 200

#: Ports by server, and what opens each with the secret of the run.
Door = tuple[int, str]


def attack(seed: int, seconds: float) -> Tally:
    """Attack a simulator of a process of its own.

    Args:
        seed: of the order and of the contents
        seconds: how long; from 30 s on, clients that never read are waited for, too [s]

    Raises:
        TrocarError: the simulator does not start
    """
    tally = Tally("connections")
    with TemporaryDirectory() as folder:
        words = ["--rig", "psm", "--port", "0", "--websocket-port", "0", "--token", TOKEN]
        with served(words, r"\S+\.json", {"XDG_RUNTIME_DIR": folder}) as server:
            _attack(server, random.Random(seed), seconds, tally)
    return tally


def _attack(server: Served, rng: random.Random, seconds: float, tally: Tally) -> None:
    urls = json.loads(Path(server.address).read_text(encoding="utf-8"))
    doors = {name: _door(urls[name]) for name in ("websocket", "web_viewer")}
    memory = server.memory_mb()
    with closing(Reader(urls["websocket"])) as reader:
        time.sleep(ALONE_S)
        alone = reader.rate()
        strangers = Strangers(rng, doors)
        end, look, rates = time.monotonic() + seconds, time.monotonic() + LOOK_S, [alone]
        while time.monotonic() < end:
            kind = rng.choice(KINDS)
            _try(tally, kind.__name__, lambda kind=kind: kind(strangers))
            if time.monotonic() >= look:
                _try(tally, "newcomer", lambda: _newcomer(urls["websocket"]))
                _try(tally, "honest reader", lambda: reader.complaint(alone))
                _try(tally, "never reads", strangers.stayed)
                rates.append(reader.last_rate)
                look = time.monotonic() + LOOK_S
        strangers.close()
    grown = server.memory_mb() - memory
    _try(tally, "memory", lambda: f"grew by {grown:.0f} MB" if grown > MOST_GROWN_MB else None)
    tally.table = [
        ["honest reader", "messages/s"],
        ["alone", f"{alone:.0f}"],
        ["under attack, mean", f"{sum(rates[1:]) / max(1, len(rates) - 1):.0f}"],
        ["under attack, least", f"{min(rates[1:], default=math.nan):.0f}"],
    ]


def _try(tally: Tally, name: str, work: Callable[[], str | None]) -> None:
    tally.tried += 1
    try:
        problem = work()
    except OSError as error:  # the server is gone, or takes nobody
        problem = f"{type(error).__name__}: {error}"
    if problem is not None:
        tally.failed.append(f"{name}: {problem}")


def _door(url: str) -> Door:
    parts = urlsplit(url)
    return parts.port or 0, parts.query


def _newcomer(url: str) -> str | None:
    """Connect as a program of the same user does, and read one message."""
    end = time.monotonic() + PATIENCE_S
    problem = "no time"
    while time.monotonic() < end:
        try:
            with connect(url, compression=None, open_timeout=PATIENCE_S) as client:
                client.send(json.dumps({"op": "subscribe", "topic": JOINTS}))
                client.recv(timeout=PATIENCE_S)
            return None
        except Exception as error:  # noqa: BLE001  whatever keeps a newcomer out is a failure
            problem = f"{type(error).__name__}: {error}"
            time.sleep(0.1)
    return f"kept out for {PATIENCE_S:g} s: {problem}"


class Reader:
    """An honest client in a thread of its own, which reads all that comes.

    Args:
        url: of the WebSocket, with the token

    Attributes:
        last_rate: what the last call of `rate` returned [1/s]
    """

    def __init__(self, url: str) -> None:
        self._socket = connect(url, compression=None)
        self._socket.send(json.dumps({"op": "subscribe", "topic": JOINTS}))
        self._lock = threading.Lock()
        self._arrivals: list[float] = []
        self._since, self.last_rate = time.monotonic(), 0.0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End."""
        self._socket.close()
        self._thread.join(PATIENCE_S)

    def rate(self) -> float:
        """Return the messages a second since the last call."""
        return self._look()[0]

    def complaint(self, alone: float) -> str | None:
        """Say what is wrong with what came since the last call, if anything is."""
        rate, gap = self._look()
        if rate < LEAST_SHARE * alone:
            return f"{rate:.0f} messages/s, {alone:.0f} alone"
        return f"nothing for {gap:.1f} s" if gap > LONGEST_S else None

    def _look(self) -> tuple[float, float]:
        """Return the rate [1/s] and the longest gap [s] since the last call."""
        with self._lock:
            now = time.monotonic()
            times = [self._since, *self._arrivals, now]
            self.last_rate = len(self._arrivals) / (now - self._since)
            self._arrivals, self._since = [], now
        return self.last_rate, max(b - a for a, b in pairwise(times))

    def _run(self) -> None:
        with suppress(Exception):  # whatever ends it is seen in the rate
            for _ in self._socket:
                with self._lock:
                    self._arrivals.append(time.monotonic())


class Strangers:
    """Hostile connections; each method returns None, or the description of a defect.

    Args:
        rng: chooses
        doors: {server: its port, and the query that opens it}
    """

    def __init__(self, rng: random.Random, doors: dict[str, Door]) -> None:
        self._rng, self._doors = rng, doors
        self._half_open: list[socket.socket] = []
        self._silent: list[tuple[float, socket.socket]] = []
        self._slow: list[socket.socket] = []

    def close(self) -> None:
        """Leave."""
        for wire in (*self._half_open, *self._slow, *(wire for _, wire in self._silent)):
            wire.close()

    def half_open(self) -> str | None:
        """Connect, send a part of a request or nothing, and stay."""
        wire = self._connect()
        wire.sendall(self._handshake()[: self._rng.choice((0, 1, 20, 60))])
        self._hold(self._half_open, wire)
        return None

    def silent(self) -> str | None:
        """Subscribe to everything and never read."""
        wire = self._subscribed()
        if wire is not None:
            self._silent.append((time.monotonic(), wire))
        return None

    def slow(self) -> str | None:
        """Subscribe to everything and read a little now and then."""
        wire = self._subscribed()
        if wire is not None:
            self._hold(self._slow, wire)
        for one in self._slow:
            with suppress(OSError):
                one.recv(self._rng.randrange(1, 4096))
        return None

    def stayed(self) -> str | None:
        """Say who never read and was not let go."""
        old = [wire for begun, wire in self._silent if time.monotonic() - begun > GONE_S]
        self._silent = self._silent[len(old) :]
        stayed = sum(_held(wire) for wire in old)
        return f"{stayed} of {len(old)} still connected after {GONE_S:g} s" if stayed else None

    def abort(self) -> str | None:
        """Reset the connection in the middle of a request, or right after it."""
        wire = self._connect()
        request = self._handshake(self._door()[1] if self._rng.random() < 0.5 else "")
        wire.sendall(request[: self._rng.randrange(len(request) + 1)])
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        wire.close()
        return None

    def wrong_host(self) -> str | None:
        """Come by a name that is not this machine's."""
        host = self._rng.choice(("example.org", "127.0.0.1.nip.io", "[::1", "", "localhost.evil"))
        return self._refused(self._handshake(self._door()[1], host=host), b"403")

    def wrong_origin(self) -> str | None:
        """Come as a page of another origin, with the secret."""
        origin = self._rng.choice(
            ("https://example.org", "null", "http://localhost:3000", "http://127.0.0.1", "file://")
        )
        return self._refused(self._handshake(self._door()[1], f"Origin: {origin}"), b"403")

    def wrong_token(self) -> str | None:
        """Come with no token, or a wrong one."""
        more = self._rng.choice(("", "Authorization: Bearer x", f"Authorization: {TOKEN}"))
        query = self._rng.choice(("", "token=", "token=x", f"token=x&token={TOKEN}", "%00=%ff"))
        return self._refused(self._handshake(query, more), b"401")

    def garbage(self) -> str | None:
        """Send bytes that are not HTTP."""
        bytes_ = self._rng.randbytes(self._rng.randrange(1, 3000))
        start = self._rng.choice((b"", b"GET ", b"GET / HTTP/1.1\r\n", b"\x16\x03\x01"))
        return self._refused(start + bytes_ + b"\r\n\r\n", b"400", b"431", b"403", b"")

    def huge_headers(self) -> str | None:
        """Send a line, or a number of lines, without end."""
        line = b"X: " + b"x" * 100_000 if self._rng.random() < 0.5 else b"X: y\r\n" * 10_000
        head = b"GET / HTTP/1.1\r\nHost: localhost\r\n"
        return self._refused(head + line + b"\r\n\r\n", b"400", b"431", b"")

    def invalid_frames(self) -> str | None:
        """Come in with the secret and send frames that the protocol forbids."""
        with closing(self._connect("websocket")) as wire:
            wire.sendall(self._handshake(self._doors["websocket"][1]))
            if b" 101 " not in wire.recv(4096):
                return None  # full, for this moment: who comes next is looked at by itself
            frame = self._rng.choice(
                (
                    b"\x81\x05hello",
                    b"\xf1\x80mask",
                    b"\x83\x80mask",
                    b"\x81\xff" + (1 << 60).to_bytes(8, "big") + b"mask",
                    b"\x89\xfe\x00\x7e" + b"x" * 130,
                )
            )
            wire.sendall(frame)
            return None if _ended(wire) else f"{frame[:4]!r} did not end the connection"

    def flood(self) -> str | None:
        """Open many connections at once and leave them."""
        port, _ = self._door()
        wires: list[socket.socket] = []
        for _ in range(FLOOD):
            wire = socket.socket()
            wire.setblocking(False)
            wire.connect_ex(("127.0.0.1", port))
            wires.append(wire)
        for wire in wires:
            wire.close()
        return None

    def _door(self) -> Door:
        return self._doors[self._rng.choice([*self._doors])]

    def _connect(self, name: str | None = None) -> socket.socket:
        port, _ = self._door() if name is None else self._doors[name]
        return socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)

    def _handshake(self, query: str = "", *more: str, host: str = "localhost") -> bytes:
        lines = (
            f"GET /?{query} HTTP/1.1",
            f"Host: {host}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Version: 13",
            f"Sec-WebSocket-Protocol: viser-v{viser.__version__}",
            *filter(None, more),
        )
        return "\r\n".join((*lines, "", "")).encode()

    def _refused(self, request: bytes, *codes: bytes) -> str | None:
        """Send a request; complain unless it is answered with one of these codes, or b"": none."""
        with closing(self._connect()) as wire:
            answer = b""
            try:
                wire.sendall(request)
                answer = wire.recv(4096)
            except TimeoutError:
                return f"no answer to {request[:60]!r}"
            except OSError:  # reset: it had more to say than is read
                pass
        code = answer.split(b" ")[1] if answer.startswith(b"HTTP/1.1 ") else b""
        allowed = (*codes, b"503")
        return None if code in allowed else f"{request[:80]!r}: got {answer[:60]!r}"

    def _subscribed(self) -> socket.socket | None:
        """Come in, by either door, and subscribe to what there is; None if there is no place."""
        name = self._rng.choice([*self._doors])
        wire = self._connect(name)
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        wire.sendall(self._handshake(self._doors[name][1]))
        if b" 101 " not in wire.recv(len("HTTP/1.1 101 ")):
            wire.close()
            return None
        if name == "websocket":
            for topic in ("measured_js", "setpoint_js", "measured_cp", "period_statistics"):
                text = json.dumps({"op": "subscribe", "topic": f"/PSM1/{topic}"}).encode()
                wire.sendall(bytes([0x81, 0x80 | len(text), 0, 0, 0, 0]) + text)
        return wire

    def _hold(self, held: list[socket.socket], wire: socket.socket) -> None:
        held.append(wire)
        if len(held) > HELD:
            held.pop(0).close()


def _ended(wire: socket.socket) -> bool:
    """Whether the other side ends a connection once all that it sent is read."""
    wire.settimeout(0.5)
    end = time.monotonic() + PATIENCE_S
    with suppress(ConnectionError):
        while time.monotonic() < end:
            try:
                if not wire.recv(1 << 20):
                    break
            except TimeoutError:
                continue
        else:
            return False
    wire.close()
    return True


def _held(wire: socket.socket) -> bool:
    """Whether the other side still holds a connection; to who has left it, words bring a reset.

    Nothing is read, which would be progress.
    """
    with closing(wire), suppress(ConnectionError):
        for _ in range(10):
            wire.sendall(b"\x8a\x80mask")  # a pong that nobody asked for
            time.sleep(0.05)
            if wire.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                return False
        return True
    return False


KINDS = (
    Strangers.half_open,
    Strangers.silent,
    Strangers.slow,
    Strangers.abort,
    Strangers.wrong_host,
    Strangers.wrong_origin,
    Strangers.wrong_token,
    Strangers.garbage,
    Strangers.huge_headers,
    Strangers.invalid_frames,
    Strangers.flood,
)
