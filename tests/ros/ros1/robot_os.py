"""A ROS 1 of its own for a test: Debian's rosmaster on a free port, and a simulator in a process.

The simulator runs under a Python that has rospy. Debian's is for /usr/bin/python3, but most of it
is plain Python: where this interpreter can import it from the system's folder, it is used from
there, behind everything else; else the environment of `make ros1-venv`, where there is one.
"""

from __future__ import annotations

import functools
import os
import queue
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xmlrpc.client import ServerProxy

import pytest

ROOT = Path(__file__).parents[3]
SYSTEM = "/usr/lib/python3/dist-packages"
PRELUDE = f"import sys; sys.path.append({SYSTEM!r});"
MAIN = "from trocar.cli import main; sys.exit(main(sys.argv[1:]))"
OWN = ROOT / ".venv-ros1" / "bin" / "python"
#: The Python whose packages Debian's are.
SYSTEM_PYTHON = "/usr/bin/python3"
PATIENCE_S = 60.0


def clean_environment() -> dict[str, str]:
    left_out = ("PYTHONPATH", "ROS_IP", "ROS_NAMESPACE", "ROS_PACKAGE_PATH")
    return {name: value for name, value in os.environ.items() if name not in left_out}


@functools.cache
def python_with_rospy() -> tuple[str, str] | None:
    """A Python that has rospy and trocar's libraries, and what it has to do first."""
    probe = "import genpy, rosgraph, rospy, mujoco, lxml"
    for python, prelude in ((sys.executable, PRELUDE), (str(OWN), "import sys;")):
        if shutil.which(python):
            asked = [python, "-c", f"{prelude} {probe}"]
            if not subprocess.run(asked, env=clean_environment(), capture_output=True).returncode:
                return python, prelude
    return None


def need(*tools: str) -> None:
    """Skip a test where the tools or rospy are not there."""
    for tool in tools:
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed (Debian has it)")
    if python_with_rospy() is None:
        pytest.skip("no Python has rospy: install python3-rospy; make ros1-venv")


class Master:
    """A rosmaster on a port of its own; `env` is what programs need to find it."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.uri = f"http://127.0.0.1:{self.port}"
        home = {"ROS_HOME": str(folder), "ROS_LOG_DIR": str(folder / "log")}
        self.env = {
            **clean_environment(), **home, "ROS_MASTER_URI": self.uri, "ROS_HOSTNAME": "127.0.0.1",
            "ROS_PYTHON_VERSION": "3",
        }  # fmt: skip
        self.start()

    def start(self) -> None:
        self._process = subprocess.Popen(
            ["rosmaster", "--core", "-p", str(self.port)],
            env=self.env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        until(lambda: self.answers(), "the master answers")

    def answers(self) -> bool:
        try:
            return self.ask("getPid")[0] == 1
        except OSError:
            return False

    def ask(self, verb: str, *arguments: Any) -> Any:
        with ServerProxy(self.uri) as proxy:
            return getattr(proxy, verb)("/test", *arguments)

    def close(self) -> None:
        self._process.kill()
        self._process.wait()

    def with_packages(self, folder: Path) -> None:
        """Let tools find crtk_msgs, generated into a folder."""
        python, prelude = python_with_rospy() or ("", "")
        code = f"{prelude} from trocar.ros.transports.ros1.packages import main; main()"
        env = {**clean_environment(), "PYTHONPATH": str(ROOT / "src")}
        subprocess.run([python, "-c", code, str(folder)], env=env, check=True, capture_output=True)
        self.env["PYTHONPATH"] = str(folder / "python")
        self.env["ROS_PACKAGE_PATH"] = f"{folder / 'share'}:/usr/share"

    def run(self, *command: str, check: bool = True) -> str:
        """Run a tool; return what it said."""
        done = subprocess.run(
            command, env=self.env, capture_output=True, text=True, timeout=PATIENCE_S
        )
        assert done.returncode == 0 or not check, f"{command}: {done.stdout}{done.stderr}"
        return done.stdout + done.stderr

    def run_for(self, seconds: float, *command: str) -> str:
        """Run a tool that does not end of itself, and end it as Ctrl-C does."""
        with subprocess.Popen(
            command, env=self.env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        ) as process:  # fmt: skip
            time.sleep(seconds)
            process.send_signal(signal.SIGINT)
            try:
                return process.communicate(timeout=10.0)[0]
            except subprocess.TimeoutExpired:
                process.kill()
                return process.communicate()[0]


class Simulator:
    """`trocar sim --ros1` in a process."""

    def __init__(self, env: Mapping[str, str], *arguments: str) -> None:
        python, prelude = python_with_rospy() or ("", "")
        self._process = subprocess.Popen(
            [python, "-u", "-c", f"{prelude} {MAIN}", "sim", "--ros1", "--no-page",
             "--no-websocket", *arguments],
            env={**env, "PYTHONPATH": str(ROOT / "src"), "OPENBLAS_NUM_THREADS": "1"},
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        self.said: list[str] = []
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.hears("ROS 1: node /trocar")

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.said.append(line)

    def hears(self, words: str) -> None:
        """Wait until it has said something."""
        until(lambda: any(words in line for line in self.said) or self.ended, f"it says {words!r}")
        assert any(words in line for line in self.said), "".join(self.said)

    @property
    def ended(self) -> bool:
        return self._process.poll() is not None

    def close(self) -> None:
        """End, unless it has."""
        if not self.ended:
            self.stop()

    def stop(self) -> int:
        """End as Ctrl-C does; return the exit code."""
        self._process.terminate()
        try:
            code = self._process.wait(30.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        self._reader.join()
        if self._process.stdout is not None:
            self._process.stdout.close()
        return code


def until(holds: Any, what: str, patience_s: float = PATIENCE_S) -> None:
    """Wait for something that is bound to come."""
    end = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < end, f"waited {patience_s:g} s in vain until {what}"
        time.sleep(0.02)


class Ear:
    """A subscriber written from the protocol alone: sockets and XML-RPC."""

    def __init__(self, master: Master, topic: str, *, patience_s: float = 20.0) -> None:
        uri = master.ask("lookupNode", "/trocar")[2]
        with ServerProxy(uri) as node:
            answer: Any = node.requestTopic("/ear", topic, [["TCPROS"]])
        assert answer[0] == 1, answer
        self.address: tuple[str, int] = answer[2][1], answer[2][2]
        self.socket = socket.create_connection(self.address, patience_s)
        fields = {
            "topic": topic,
            "md5sum": "*",
            "type": "*",
            "callerid": "/ear",
            "tcp_nodelay": "1",
        }
        parts = [f"{name}={value}".encode() for name, value in fields.items()]
        head = b"".join(struct.pack("<I", len(part)) + part for part in parts)
        self.socket.sendall(struct.pack("<I", len(head)) + head)
        self.greeting = self.packet()

    def packet(self) -> bytes:
        (size,) = struct.unpack("<I", self._exactly(4))
        return self._exactly(size)

    def _exactly(self, count: int) -> bytes:
        found = b""
        while len(found) < count:
            part = self.socket.recv(count - len(found))
            assert part, "hung up"
            found += part
        return found

    def close(self) -> None:
        self.socket.close()
