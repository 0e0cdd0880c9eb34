"""Faults during a run with everything on: what is lost, and after what time service is back.

One round: the full cart serves the web viewer, a WebSocket, ROS 1 and DDS as far as they are
installed, and records. It suffers each fault in a seeded order, then kill -9, starts again on the
same ports and records onto a disk that fills up.

A client sends a numbered set-point every 50 ms and notes when it comes back as a state. So the
newest number in the recording says what the recording lost.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any, cast
from xmlrpc.client import ServerProxy

import numpy as np
import viser
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.sync.connection import Connection
from websockets.typing import Subprotocol

from benchmarks.attack import Tally
from benchmarks.attack._simulator import HOUR_NS, ROSPY
from trocar.errors import TrocarError
from trocar.recording.mcap_file import mcap_library
from trocar.recording.reader import open_recording

ALONE = True

ROOT = Path(__file__).parents[2]
RIG = "full_cart"
#: Time within which service is back, and the end of a recording that may be lost. Source: the
#: project's own goals. [s]
BACK_S, LOST_S = 5.0, 1.0
#: Time that a process is stopped for, and that no master runs. Source: the project's own goal; our
#: own choice, more than one look at the master. [s]
STOP_S, MASTERLESS_S = 30.0, 3.0
#: Size of the disk that fills up. Source: our own choice, ten seconds of the cart. [bytes]
DISK = 4 * 1024 * 1024
#: Numbered set-points: their time apart, and the yaw of PSM1 that each adds. Source: our own
#: choice; ten minutes of them are 0.24 rad. [s, rad]
EVERY_S, STEP_RAD = 0.05, 2e-5
#: Time limits of a start, of an end, and of one attempt to connect. [s]
START_S, END_S, ATTEMPT_S = 60.0, 30.0, 2.0
#: DDS of these runs keeps apart from every other on this machine.
DDS_RANGE = {
    "ROS_DOMAIN_ID": "113",
    "CYCLONEDDS_URI": "<General><Interfaces><NetworkInterface address='127.0.0.1'"
    " multicast='true'/></Interfaces></General>",
}
SERVO, STATE = "/PSM1/servo_jp", "/PSM1/setpoint_js"
HEARD = "/PSM1/measured_js"
LOOPBACK = "127.0.0.1"
SERVED = "served"
#: What a service that is not there raises.
ABSENT = (OSError, HTTPException, WebSocketException, EOFError, LookupError, ValueError)


class FaultError(TrocarError):
    """A fault had an effect that it must not have."""


def attack(seed: int, seconds: float) -> Tally:
    """Let runs suffer every fault, in an order by the seed; one round takes about 90 s."""
    rng, began = np.random.default_rng(seed), time.monotonic()
    os.environ |= DDS_RANGE
    outcomes: list[Outcome] = []
    rounds, rospy = 0, has_rospy()
    while not rounds or (time.monotonic() - began) * (rounds + 1) / rounds <= seconds:
        with TemporaryDirectory() as folder, started(Path(folder), rospy) as run:
            faults = list(run.faults().items())
            for k in rng.permutation(len(faults)).tolist():
                outcomes.append(run.suffer(*faults[k]))
                if run.simulator.ended:
                    break
            else:
                outcomes += run.kill_simulator()
        rounds += 1
    failed = [f"{each.fault}: {each.problem}" for each in outcomes if each.problem]
    return Tally("faults", len(outcomes), failed, rows(outcomes))


def rows(outcomes: list[Outcome]) -> list[list[str]]:
    """Return a table of faults, of each its worst outcome, the head first."""
    worst: dict[str, Outcome] = {}
    for each in outcomes:
        known = worst.get(each.fault)
        if known is None or (bool(each.problem), each.back_s or 0.0, each.lost_s or 0.0) > (
            bool(known.problem), known.back_s or 0.0, known.lost_s or 0.0
        ):  # fmt: skip
            worst[each.fault] = each

    def text(value: float | None) -> str:
        return "-" if value is None else f"{value:.2f}"

    head = [
        "fault",
        "what is lost",
        "without states [s]",
        "back after [s]",
        "recording lost [s]",
        "",
    ]
    return [
        head,
        *(
            [
                *(each.fault, each.lost or "-"),
                *(text(each.gap_s), text(each.back_s), text(each.lost_s)),
                "FAILED" if each.problem else "met",
            ]
            for each in sorted(worst.values(), key=lambda each: each.fault)
        ),
    ]


# ------------------------------------------------------------------ the simulator and its master


def free_port() -> int:
    """Return a port of the loopback that nobody listens on."""
    with socket.socket() as free:
        free.bind((LOOPBACK, 0))
        return free.getsockname()[1]


def has_rospy() -> bool:
    """Return whether a simulator can join ROS 1 here."""
    code = f"import sys; sys.path.append({ROSPY!r}); import genpy, rosgraph, rospy"
    probe = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    return probe.returncode == 0 and shutil.which("rosmaster") is not None


class RosMaster:
    """A rosmaster on a port of its own."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.environment = {
            "ROS_MASTER_URI": f"http://{LOOPBACK}:{self.port}",
            "ROS_HOSTNAME": LOOPBACK,
            "ROS_HOME": str(folder),
            "ROS_LOG_DIR": str(folder),
        }
        self.start()

    def start(self) -> None:
        """Start it and wait for its first answer."""
        self._process = subprocess.Popen(
            ["rosmaster", "--core", "-p", str(self.port)],
            env={**os.environ, **self.environment},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        seconds_until(lambda: self.ask("getPid"), "the ROS master", START_S)

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()
        self._process.wait()

    def ask(self, verb: str, *arguments: Any) -> Any:
        """Return an answer's value."""
        with ServerProxy(self.environment["ROS_MASTER_URI"]) as proxy:
            answer: Any = getattr(proxy, verb)("/faults", *arguments)
        if answer[0] != 1:
            raise KeyError(answer[1])
        return answer[2]


class Simulator:
    """`trocar sim` in a process, its lines with the times at which they came.

    Args:
        words: options of `trocar sim`
        environment: variables added to this process's
        before: command that runs it; none for itself
    """

    def __init__(
        self, words: list[str], environment: Mapping[str, str], before: list[str] | None = None
    ) -> None:
        self._process = subprocess.Popen(
            [*(before or []), sys.executable, "-m", "benchmarks.attack._simulator", "sim", *words],
            cwd=ROOT,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,  # signals reach what `before` started, too
        )
        self.lines: list[tuple[float, str]] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in cast(IO[str], self._process.stdout):
            self.lines.append((time.monotonic(), line))

    @property
    def text(self) -> str:
        """Everything that it printed."""
        return "".join(line for _, line in self.lines)

    @property
    def ended(self) -> bool:
        """Whether it has ended."""
        return self._process.poll() is not None

    def send(self, number: signal.Signals) -> None:
        """Send it a signal, and what runs it."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, number)

    def end(self, timeout_s: float = END_S) -> int:
        """Return its exit code, or kill it.

        Raises:
            FaultError: it did not end in time
        """
        try:
            return self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise FaultError(f"did not end within {timeout_s:g} s") from None
        finally:
            self.send(signal.SIGKILL)
            self._process.wait()
            self._reader.join()


# ------------------------------------------------------------------ its clients


def seconds_until(try_it: Callable[[], object], what: str, limit_s: float) -> float:
    """Repeat an attempt until it succeeds; return the time that it took [s].

    Raises:
        FaultError: it did not succeed in time
    """
    began = time.monotonic()
    while True:
        try:
            try_it()
        except ABSENT as error:
            if time.monotonic() - began > limit_s:
                reason = f"{type(error).__name__}: {error}"
                raise FaultError(f"no {what} after {limit_s:g} s ({reason})") from error
            time.sleep(0.02)
        else:
            return time.monotonic() - began


def client(port: int, *protocols: Subprotocol) -> ClientConnection:
    """Connect to a WebSocket as most clients do: without pings of their own.

    A server that stands still for longer than a client waits for its pings loses that client.
    """
    return connect(
        f"ws://{LOOPBACK}:{port}",
        subprotocols=protocols or None,
        ping_interval=None,
        compression=None,
        max_size=None,
        open_timeout=ATTEMPT_S,
        close_timeout=0.1,
    )


def subscribe(link: Connection, topic: str) -> None:
    """Subscribe to a topic over rosbridge."""
    link.send(json.dumps({"op": "subscribe", "topic": topic}))


def websocket_messages(port: str, patience_s: float | None) -> Iterator[object]:
    """Yield states as a new client of the WebSocket."""
    with client(int(port)) as link:
        subscribe(link, HEARD)
        while True:
            yield link.recv(patience_s)


def page_messages(port: str, patience_s: float | None) -> Iterator[object]:
    """Load the web viewer, and yield what it shows."""
    page = HTTPConnection(LOOPBACK, int(port), timeout=ATTEMPT_S)
    page.request("GET", "/")
    answer = page.getresponse()
    if answer.status != 200 or b"trocar" not in answer.read():
        raise LookupError(f"the web viewer answered {answer.status}")
    page.close()
    with client(int(port), Subprotocol(f"viser-v{viser.__version__}")) as link:
        while True:
            yield link.recv(patience_s)


def ros1_messages(master_uri: str, patience_s: float | None) -> Iterator[object]:
    """Yield the header and states as a new subscriber of ROS 1.

    Source: the ROS wiki, Slave API (requestTopic) and TCPROS (the header).
    """
    with ServerProxy(master_uri) as proxy:
        code, status, uri = cast(Any, proxy.lookupNode("/faults", "/trocar"))
        if code != 1:
            raise LookupError(status)
        published = cast(Any, proxy.getPublishedTopics("/faults", ""))[2]
    if HEARD not in dict(published):
        raise LookupError(f"{HEARD} is not registered")
    with ServerProxy(uri) as node:
        answer = cast(Any, node.requestTopic("/faults", HEARD, [["TCPROS"]]))
    _, host, port = answer[2]
    with socket.create_connection((host, port), ATTEMPT_S) as link:
        # rospy closes the connection of a subscriber when another of the same name comes
        caller = f"/faults_{link.getsockname()[1]}"
        fields = {"callerid": caller, "topic": HEARD, "type": "*", "md5sum": "*"}
        parts = [f"{name}={value}".encode() for name, value in fields.items()]
        header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
        link.sendall(struct.pack("<I", len(header)) + header)
        link.settimeout(patience_s)
        packets = link.makefile("rb")
        while size := packets.read(4):
            yield packets.read(*struct.unpack("<I", size))
    raise EOFError("the node hung up")


def dds_messages(_: str, patience_s: float | None) -> Iterator[object]:
    """Yield states as a new participant of DDS."""
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.qos import Qos
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    from benchmarks.ros2 import RELIABLE, JointState

    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    topic = Topic(participant, f"rt{HEARD}", JointState)
    patience = duration(infinite=True) if patience_s is None else duration(seconds=patience_s)
    yield from DataReader(participant, topic, Qos(RELIABLE)).take_iter(timeout=patience)
    raise TimeoutError("no message over DDS")


#: What a client of each service receives, by (its address, time to wait for a message [s]).
STREAMS: dict[str, Callable[[str, float | None], Iterator[object]]] = {
    "WebSocket": websocket_messages,
    "web viewer": page_messages,
    "ROS 1": ros1_messages,
    "DDS": dds_messages,
}


def attempt(service: str, address: str) -> None:
    """Receive a state as a new client; ROS 1 sends its header first."""
    messages = STREAMS[service](address, ATTEMPT_S)
    for _ in range(2):
        next(messages)


def hold(service: str, address: str) -> None:
    """Receive for ever, as a client that will be killed; print a line as soon as it is served."""
    for k, _ in enumerate(STREAMS[service](address, None)):
        if k == 1:
            print(SERVED, flush=True)


@dataclass
class Commander:
    """A client that sends numbered set-points and notes when they come back.

    Attributes:
        port: of the WebSocket
        came: (arrival by the monotonic clock [s], header stamp [ns], newest number in force)
        sent: newest number that was sent
        drops: how often the connection was lost
        back_ns: how much the client's clock was set back [ns]
    """

    port: int
    came: list[tuple[float, int, int]] = field(default_factory=list[tuple[float, int, int]])
    sent: int = 0
    drops: int = 0
    back_ns: int = 0

    def __post_init__(self) -> None:
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End."""
        self._over.set()
        self._thread.join()

    def gap_s(self, since_s: float) -> float:
        """Return the longest time without a state since a moment of the monotonic clock [s]."""
        times = [since_s, *(at for at, _, _ in list(self.came) if at > since_s), time.monotonic()]
        return float(np.diff(times).max())

    def in_force(self, number: int) -> bool:
        """Return whether a set-point with this number or a later one has come back."""
        return bool(self.came) and self.came[-1][2] >= number

    def backward_ns(self) -> int:
        """Return the largest step back of header stamps [ns]."""
        stamps = np.array([stamp for _, stamp, _ in list(self.came)], dtype=np.int64)
        return int(max(0, -np.diff(stamps).min(initial=0)))

    def _run(self) -> None:
        while not self._over.is_set():
            with suppress(*ABSENT):
                self._converse()
            if not self._over.wait(0.1):
                self.drops += bool(self.came)

    def _converse(self) -> None:
        with client(self.port) as link:
            subscribe(link, STATE)
            due = 0.0
            while not self._over.is_set():
                if time.monotonic() >= due:
                    due = time.monotonic() + EVERY_S
                    self._send(link)
                with suppress(TimeoutError):
                    message = json.loads(link.recv(EVERY_S))["msg"]
                    stamp = message["header"]["stamp"]
                    nanoseconds = stamp["secs"] * 1_000_000_000 + stamp["nsecs"]
                    number = round(message["position"][0] / STEP_RAD)
                    self.came.append((time.monotonic(), nanoseconds, number))

    def _send(self, link: Connection) -> None:
        self.sent += 1
        seconds, nanoseconds = divmod(time.time_ns() - self.back_ns, 1_000_000_000)
        message = {
            "header": {"stamp": {"secs": seconds, "nsecs": nanoseconds}, "frame_id": ""},
            "position": [self.sent * STEP_RAD, 0.0, 0.12, 0.0, 0.0, 0.0],
        }
        kind = "sensor_msgs/JointState"
        document = {"op": "publish", "topic": SERVO, "type": kind, "msg": message}
        link.send(json.dumps(document))


# ------------------------------------------------------------------ a run and its faults


@dataclass(frozen=True)
class Outcome:
    """The measured effects of a fault.

    Attributes:
        fault: its name
        lost: what was lost, in words
        gap_s: longest time in which a client that stays got no state [s]; None: not measured
        back_s: time until every service answered new clients [s]; None: not measured
        lost_s: end of the recording that is missing [s]; None: not measured
        problem: what must not be, "" where nothing
    """

    fault: str
    lost: str
    gap_s: float | None = None
    back_s: float | None = None
    lost_s: float | None = None
    problem: str = ""


class Round:
    """A simulator with everything on, its clients, and what can happen to them."""

    def __init__(self, folder: Path, master: RosMaster | None) -> None:
        self._folder, self.master = folder, master
        self._environment: dict[str, str] = {} if master is None else dict(master.environment)
        self._page, self._socket = free_port(), free_port()
        self._words = ["--rig", RIG, "--no-cameras", "--port", str(self._page)]
        self._words += ["--websocket-port", str(self._socket)]
        self.services = {"WebSocket": str(self._socket), "web viewer": str(self._page)}
        if master is not None:
            self._words.append("--ros1")
            self.services["ROS 1"] = master.environment["ROS_MASTER_URI"]
        if importlib.util.find_spec("cyclonedds") is not None:
            self._words += ["--ros2", "dds"]
            self.services["DDS"] = ""
        self._file = folder / "run.mcap"
        self.simulator = Simulator([*self._words, "--record", str(self._file)], self._environment)
        self._commander: Commander | None = None
        self._clients: dict[str, subprocess.Popen[bytes]] = {}

    @property
    def commander(self) -> Commander:
        """The client that stays; made as the simulator serves."""
        if self._commander is None:
            self._commander = Commander(self._socket)
        return self._commander

    def begin(self) -> None:
        """Wait until everything is served, and start the clients that will be killed."""
        self._served(START_S)
        for name in self.services:
            self._hold(name)
        commander = self.commander
        seconds_until(lambda: commander.came[100], "states for the client", START_S)

    def close(self) -> None:
        """End everything."""
        if self._commander is not None:
            self._commander.close()
        for one in self._clients.values():
            one.kill()
            one.wait()
        if not self.simulator.ended:
            self.simulator.send(signal.SIGKILL)
            self.simulator.end()

    def faults(self) -> dict[str, Callable[[], str]]:
        """Return {name: inflicts it, returns what is lost} of the faults that a run survives."""
        found: dict[str, Callable[[], str]] = {
            f"kill -9 of a client ({name})": lambda name=name: self._kill(name)
            for name in self._clients
        }
        found |= {
            "port stolen": self._steal_ports,
            "the same command again": self._start_again,
            f"SIGSTOP for {STOP_S:g} s": self._stop,
            "clock set back an hour": self._set_clock_back,
        }
        master = self.master
        if master is not None:
            found["kill -9 and restart of rosmaster"] = lambda: restart(master)
        return found

    def suffer(self, name: str, inflict: Callable[[], str]) -> Outcome:
        """Inflict a fault, and measure what it does to the services."""
        began = time.monotonic()
        lost, back = "", None
        drops = self.commander.drops
        try:
            lost = inflict()
            ended, commander = time.monotonic(), self.commander
            number = commander.sent + 2  # the next may have its stamp already
            self._served(BACK_S)
            while not commander.in_force(number):
                time.sleep(0.02)
                if time.monotonic() - ended > 2.0 * BACK_S:
                    raise FaultError("a client's set-points are not in force")
            back = time.monotonic() - ended
            if back > BACK_S:
                raise FaultError(f"service was back after {back:.2f} s; goal: {BACK_S:g} s")
            if commander.backward_ns() > 0:
                raise FaultError(f"header stamps went back by {1e-9 * commander.backward_ns():g} s")
            if self.simulator.ended:
                raise FaultError("the simulator ended")
        except FaultError as error:
            said = self.simulator.text[-300:] if self.simulator.ended else ""
            return Outcome(
                name, lost, self.commander.gap_s(began), back, None, f"{error} {said}".strip()
            )
        gap_s = self.commander.gap_s(began)
        dropped = [each for each, one in self._clients.items() if one.poll() is not None]
        if dropped or self.commander.drops > drops:
            lost = f"{lost}; connections".removeprefix("; ")
        for each in dropped:
            self._hold(each)
        return Outcome(name, lost or "nothing", gap_s, back)

    # faults that a run survives

    def _served(self, limit_s: float) -> float:
        """Wait until every service has served a new client; return the time that it took [s]."""
        return sum(
            seconds_until(partial(attempt, name, address), name, limit_s)
            for name, address in self.services.items()
        )

    def _hold(self, name: str) -> None:
        """Start a client of a service in a process, and wait until it is served."""
        code = f"from benchmarks.attack.faults import hold; hold({name!r}, {self.services[name]!r})"
        log = self._folder / name
        with log.open("wb") as said:
            self._clients[name] = subprocess.Popen(
                [sys.executable, "-c", code], cwd=ROOT, stdout=said, stderr=said
            )
        seconds_until(lambda: log.read_text(encoding="utf-8").index(SERVED), name, START_S)

    def _kill(self, name: str) -> str:
        victim = self._clients.pop(name)
        victim.kill()
        victim.wait()
        return "that client"

    def _steal_ports(self) -> str:
        taken: list[str] = []
        for port in (self._page, self._socket):
            for family, host in ((socket.AF_INET, LOOPBACK), (socket.AF_INET, "0.0.0.0")):
                with socket.socket(family) as thief:
                    thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
                    with suppress(OSError):
                        thief.bind((host, port))
                        thief.listen()
                        taken.append(f"{host}:{port}")
        if taken:
            raise FaultError(f"another program could listen on {', '.join(taken)}")
        return ""

    def _start_again(self) -> str:
        words = [*self._words, "--record", str(self._file), "--overwrite"]
        second = Simulator(words, self._environment)
        code = second.end(START_S)
        if code != 2:
            raise FaultError(f"the second ended with {code}: {second.text[-300:]}")
        if "Traceback" in second.text:
            raise FaultError(f"the second printed a traceback: {second.text[-300:]}")
        return ""

    def _stop(self) -> str:
        self.simulator.send(signal.SIGSTOP)
        time.sleep(STOP_S)
        self.simulator.send(signal.SIGCONT)
        return f"{STOP_S:g} s of simulated time, which are skipped"

    def _set_clock_back(self) -> str:
        self.simulator.send(signal.SIGUSR1)
        self.commander.back_ns += HOUR_NS
        return ""

    # faults that end it

    def kill_simulator(self) -> list[Outcome]:
        """Kill the simulator; start it again on the same ports, onto a disk that fills up."""
        self.simulator.send(signal.SIGKILL)
        killed = time.monotonic()
        self.simulator.end()
        outcomes = [self._judged("kill -9 of the simulator", self._file, killed)]
        folder = self._folder / "small"
        folder.mkdir()
        file = folder / "full.mcap"
        self.simulator = Simulator(
            [*self._words, "--record", str(file)], self._environment, small_disk(folder)
        )
        name = "start on the same ports"
        try:
            outcomes.append(Outcome(name, "nothing", None, self._served(START_S)))
        except FaultError as error:
            problem = f"{error} {self.simulator.text[-300:]}"
            return [*outcomes, Outcome(name, "", problem=problem)]
        return [*outcomes, self._disk_full(self._folder / file.name, file)]

    def _disk_full(self, copy: Path, file: Path) -> Outcome:
        """Wait until the disk is full, which ends the run; the shell then copies the file.

        The recording is compared with the last state that the client received.
        """
        name = "disk full"
        try:
            code = self.simulator.end(START_S)
        except FaultError as error:
            return Outcome(name, "", problem=f"the run goes on unrecorded: {error}")
        text = self.simulator.text
        if code != 1 or file.name not in text or "Traceback" in text:
            return Outcome(name, "", problem=f"ended with {code}: {text[-300:]}")
        found = self._judged(name, copy, self.commander.came[-1][0])
        if not found.problem and not can_seek(copy):
            return Outcome(name, found.lost, problem="MCAP's seeking reader cannot read the file")
        return found

    def _judged(self, name: str, file: Path, at_s: float) -> Outcome:
        """Compare a recording with what had come back to the client until a moment."""
        try:
            recorded = open_recording(file)
            arm = recorded.columns("PSM1")
            newest = -1
            if arm is not None:
                newest = round(recorded.states(arm).setpoint[:, 0].max() / STEP_RAD)
        except TrocarError as error:
            return Outcome(name, "", problem=str(error))
        late = [at for at, _, number in self.commander.came if number > newest and at <= at_s]
        lost_s = at_s - min(late) if late else 0.0
        problem = f"more than {LOST_S:g} s" if lost_s > LOST_S else ""
        return Outcome(name, "the recording's end", lost_s=lost_s, problem=problem)


def restart(master: RosMaster) -> str:
    """Kill a master, and start it again after a while without one."""
    master.kill()
    time.sleep(MASTERLESS_S)
    master.start()
    return "new connections while no master runs"


@contextmanager
def started(folder: Path, rospy: bool) -> Iterator[Round]:
    """Start a round with everything on, and end what it started."""
    master = RosMaster(folder) if rospy else None
    run = Round(folder, master)
    try:
        run.begin()
        yield run
    except FaultError as error:
        raise FaultError(f"{error}\n{run.simulator.text}") from error
    finally:
        run.close()
        if master is not None:
            master.kill()


def can_seek(file: Path) -> bool:
    """Return whether the MCAP library's seeking reader reads a file."""
    mcap_library("reading a recording")
    from mcap.exceptions import McapError
    from mcap.reader import SeekingReader

    with file.open("rb") as stream:
        try:
            return sum(1 for _ in SeekingReader(stream).iter_messages()) > 0
        except McapError:
            return False


def small_disk(folder: Path) -> list[str]:
    """Return the words before a command that let it see a small disk in a folder.

    The disk is a tmpfs in a mount namespace of its own. As the command ends, its file full.mcap
    is copied to the folder above. Where namespaces are not allowed, a limit of the size of files
    stands in for the disk: writing fails in the same call, with another reason.
    """
    inside, outside = folder, folder.parent
    mount = f"mount -t tmpfs -o size={DISK} tmpfs {inside}"
    save = f"cp {inside}/full.mcap {outside}/full.mcap"
    test = subprocess.run(
        ["unshare", "--mount", "--map-root-user", "sh", "-c", mount],
        capture_output=True,
        check=False,
    )
    if test.returncode == 0:
        script = f'{mount} && "$@"; code=$?; {save}; exit $code'
        return ["unshare", "--mount", "--map-root-user", "sh", "-c", script, "sh"]
    script = f'ulimit -f {DISK // 512}; "$@"; code=$?; {save}; exit $code'
    return ["sh", "-c", script, "sh"]
