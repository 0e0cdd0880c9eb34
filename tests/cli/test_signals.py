"""How commands end in the background, where SIGINT is ignored, and at SIGTERM."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from trocar.recording import open_recording

ROOT = Path(__file__).parents[2]
#: Ignores the signals that jobs in the background of a shell script and nohup ignore.
BACKGROUND = ("sh", "-c", 'trap "" INT HUP; exec "$@"', "sh")
pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows has no such signals")


@contextmanager
def started(*words: str) -> Iterator[subprocess.Popen[str]]:
    """Start a command line that ignores SIGINT; kill it in the end if it still runs."""
    process = subprocess.Popen(
        [*BACKGROUND, sys.executable, "-m", "trocar", *words],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src"), "PYTHONUNBUFFERED": "1"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        try:
            yield process
        finally:
            process.kill()


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Return exit status, stdout and stderr."""
    out, err = process.communicate(timeout=30.0)
    return process.returncode, out, err


STUBBORN = "import time\nwhile True:\n    try: time.sleep(0.1)\n    except: pass\n"
#: Each script waits for its end at both speeds; the second repeats the first's law.
SPEEDS = ["max", pytest.param("realtime", marks=pytest.mark.slow)]


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("while True: pass", "2: while True: pass"),
        ("import time\ntime.sleep(1e6)", "3: time.sleep(1e6)"),
        pytest.param(STUBBORN, "", marks=pytest.mark.slow),
        (
            "import signal\nfor s in (1, 2, 14, 15): signal.signal(s, signal.SIG_IGN)\n"
            "while True: pass",
            "4: while True: pass",
        ),
    ],
)
def test_a_script_in_the_background_is_ended(
    tmp_path: Path, text: str, told: str, speed: str
) -> None:
    script = tmp_path / "script.py"
    script.write_text(f"print('begun')\n{text}")
    words = ("run", "--rig", "psm", "--timeout", "0.5", "--speed", speed, str(script))
    with started(*words) as process:
        status, out, err = ended(process)
    assert (status, out) == (1, "begun\n")
    assert f"error: script.py: not finished after 0.5 s; it was at line {told}" in err
    assert "Traceback" not in err


def test_a_script_whose_c_code_lets_no_other_thread_run_is_ended(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text("x = sum(range(10**13))\n")
    with started("run", "--rig", "psm", "--timeout", "0.5", str(script)) as process:
        status, _, err = ended(process)
    assert status == 1
    assert f'File "{script}", line 1 in <module>' in err


@pytest.mark.slow
@pytest.mark.parametrize("last", ["", "while True: pass\n"])
def test_a_script_whose_thread_outlives_it_is_ended(tmp_path: Path, last: str) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import threading\nthreading.Thread(target=threading.Event().wait).start()\n" + last
    )
    with started("run", "--rig", "psm", "--timeout", "0.5", str(script)) as process:
        status, _, err = ended(process)
    assert status == 1
    assert "not finished" in err or "Timeout" in err


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize(
    "text", ["while True: pass", pytest.param(STUBBORN, marks=pytest.mark.slow)]
)
def test_the_recording_of_a_script_that_is_ended_is_whole(
    tmp_path: Path, text: str, speed: str
) -> None:
    script, file = tmp_path / "script.py", tmp_path / "run.mcap"
    script.write_text(f"import time\ntime.sleep(0.3)\n{text}")
    words = ("run", "--rig", "psm", "--timeout", "1", "--record", str(file), "--speed", speed)
    with started(*words, str(script)) as process:
        assert ended(process)[0] == 1
    recorded = open_recording(file)
    assert recorded.problem == ""
    assert recorded.end >= 0.3


@pytest.mark.parametrize(
    ("text", "speed"),
    [
        ("while True: time.sleep(0.1)", "realtime"),
        pytest.param("while True: time.sleep(0.1)", "max", marks=pytest.mark.slow),
        pytest.param(STUBBORN, "max", marks=pytest.mark.slow),
        pytest.param(STUBBORN, "realtime", marks=pytest.mark.slow),
    ],
)
def test_sigterm_ends_a_script_and_its_recording(tmp_path: Path, text: str, speed: str) -> None:
    script, file = tmp_path / "script.py", tmp_path / "run.mcap"
    script.write_text(f"import time\nprint('begun')\n{text}")
    words = ("run", "--rig", "psm", "--record", str(file), "--speed", speed, str(script))
    with started(*words) as process:
        assert process.stdout is not None and process.stdout.readline() == "begun\n"
        process.terminate()
        status, _, err = ended(process)
    assert (status, err.splitlines()[-1]) == (143, "trocar: terminated")
    assert open_recording(file).problem == ""


SERVING = {
    "sim": ("sim", "--rig", "psm", "--port", "0", "--websocket-port", "0"),
    "sim without viewer": ("sim", "--rig", "psm", "--no-page", "--websocket-port", "0"),
    "play": ("play", "peg-board", "--port", "0", "--websocket-port", "0", "--no-cameras"),
    "teleop": ("teleop", "--rig", "psm", "--port", "0", "--websocket-port", "0"),
}


@pytest.mark.parametrize("name", SERVING)
def test_sigterm_ends_what_is_served_as_ctrl_c_does(tmp_path: Path, name: str) -> None:
    file = tmp_path / "run.mcap"
    with started(*SERVING[name], "--record", str(file)) as process:
        assert process.stdout is not None
        assert any("Ctrl-C stops" in line for line in process.stdout)
        process.send_signal(signal.SIGINT)  # is ignored
        process.terminate()
        process.terminate()  # as `timeout` does
        status, _, err = ended(process)
    assert (status, "Traceback" in err) == (0, False), err
    assert open_recording(file).problem == ""


def test_sigterm_ends_another_command_with_status_143() -> None:
    with started("sim", "--headless", "--rig", "psm", "--duration", "1000") as process:
        assert process.stderr is not None
        assert "trocar: " in process.stderr.readline()
        process.terminate()
        status, out, err = ended(process)
    assert (status, out, err.splitlines()[-1]) == (143, "", "trocar: terminated")
