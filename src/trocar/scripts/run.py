"""Run a script over a simulation: its rig, its modules, its arguments, its end."""

from __future__ import annotations

import _thread
import ast
import faulthandler
import gc
import linecache
import os
import re
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FrameType, ModuleType, TracebackType

from trocar.descriptions import load_rig
from trocar.errors import InputError, TrocarError
from trocar.recording import recorder_of
from trocar.scripts import crtk_client, dvrk_client
from trocar.scripts.messages import Edition
from trocar.scripts.modules import MissingPackageError, on_import, script_modules
from trocar.scripts.ros import Node, ROSInterruptException
from trocar.scripts.ros2 import Ros2
from trocar.scripts.simulation import Flow, Stepped
from trocar.scripts.virtual_time import answering, virtual_modules

FAILED = 1
#: Period of a watchdog [s]. Source: our own choice.
LOOK_S = 0.1
#: Longest time for an interrupted script to clean up [s]. Source: our own choice.
GRACE_S = 2.0
#: Interrupts the script's thread. Source: Go's runtime preempts by SIGURG, which shells do not
#: ignore for jobs in the background, debuggers and libc leave alone, and programs hardly use.
WAKE = getattr(signal, "SIGURG", signal.SIGINT)


class OverdueError(BaseException):
    """A script that took too long; no `except Exception` of its own holds it back."""


class ScriptError(TrocarError):
    """A script that could not be run to its end; `script` is its path."""

    def __init__(self, script: Path, problem: str) -> None:
        self.script = script
        super().__init__(f"{script.name}: {problem}")


@dataclass(frozen=True)
class Outcome:
    """The end of a run.

    Attributes:
        status: exit status of the script, 1 after an error of its own
        simulated_s: how long the simulation ran [s]
        wall_s: how long that took [s]
    """

    status: int
    simulated_s: float
    wall_s: float


def run_script(
    script: Path,
    arguments: Sequence[str],
    flow: Flow,
    timeout_s: float | None = None,
    linger: Callable[[], None] | None = None,
    edition: Edition | None = None,
) -> Outcome:
    """Run a script as `python SCRIPT ...` does, with the simulation in the place of ROS.

    Args:
        script: its path
        arguments: what follows its name on the command line
        flow: the simulation, not started yet; it is closed in the end
        timeout_s: how long the script may take, in simulated time where it is stepped [s]; the
            process ends with a script that holds out against an interruption, see `Watchdog`
        linger: called when the script is over, before the simulation is closed
        edition: 1 with rospy, 2 with rclpy; by what the script imports, when omitted

    Raises:
        InputError: the script cannot be read, or needs a package that is not there
        ScriptError: it took too long
        DivergedError: the simulation left the finite numbers
    """
    code = _compiled(script)
    began = time.perf_counter()
    modules: dict[str, ModuleType] = {}
    if isinstance(flow, Stepped):
        flow.over = OverdueError
        modules = virtual_modules(flow.scheduler)
    thread = modules.get("threading", threading).Thread
    node = Node(flow, thread)
    edition = edition or edition_of(script)
    ros = Ros2(flow, thread) if edition == 2 else None
    modules |= script_modules(node, script.parent, ros)
    watchdog = Watchdog(script, flow, timeout_s)
    try:
        flow.start()
        gc.freeze()  # what is there by now stays
        answers = answering(flow.scheduler) if isinstance(flow, Stepped) else nullcontext()
        with watchdog, answers, on_import(modules, script.parent, edition):
            status = _outcome(watchdog, lambda: _execute(script, code, arguments, node, ros))
        flow.look()  # raises the error of a simulation that broke down beside the script
        if linger is not None:
            linger()
    finally:
        gc.unfreeze()
        flow.close()
    return Outcome(status, flow.simulated_s, time.perf_counter() - began)


def _compiled(script: Path) -> CodeType:
    try:
        return compile(script.read_bytes(), str(script), "exec")
    except (OSError, ValueError) as problem:
        raise InputError(f"{script}: cannot be read: {problem}") from problem
    except SyntaxError as problem:
        raise InputError(f"{script}: {_wrong_line(problem)}") from problem


def _wrong_line(problem: SyntaxError) -> str:
    """Return line and cause of a syntax error, and a hint at a script for Python 2."""
    hint = f"; {PYTHON_2}" if _is_python_2(problem) else ""
    return f"line {problem.lineno}: {problem.msg}{hint}"


PYTHON_2 = "a script for Python 2 has to be converted first (2to3 -w)"
#: Built-in names of Python 2. Source: docs.python.org, What's new in Python 3.0.
NAMES_2 = ("raw_input", "xrange", "unicode", "unichr", "basestring", "long", "reload", "execfile")


def _is_python_2(problem: BaseException) -> bool:
    """Return whether an error comes of a script for Python 2."""
    if isinstance(problem, SyntaxError):
        text = str(problem.msg)
        return "print" in text or "exec" in text or "inconsistent use of tabs" in text
    return isinstance(problem, NameError) and problem.name in NAMES_2


def _execute(
    script: Path, code: CodeType, arguments: Sequence[str], node: Node, ros: Ros2 | None
) -> None:  # fmt: skip
    main = ModuleType("__main__")
    main.__file__ = str(script)
    sys.modules["__main__"] = main
    sys.argv[:] = [str(script), *arguments]
    if ros is None:
        node.remap(sys.argv)
    try:
        exec(code, main.__dict__)
        _join(node.flow)
    finally:
        with suppress(OverdueError):
            node.signal_shutdown()
            if ros is not None:
                ros.try_shutdown()


def _join(flow: Flow) -> None:
    """Wait for the script's threads, as Python does at its end."""
    made = getattr(sys.modules.get("threading"), "Thread", None)
    for thread in getattr(made, "started", ()) if flow.virtual else ():
        if not thread.daemon:
            thread.join()


def _outcome(watchdog: Watchdog, work: Callable[[], None]) -> int:
    """Run a script's code; return its exit status."""
    status, script = 0, watchdog.script
    try:
        work()
    except OverdueError as problem:
        raise watchdog.error(script_line(script, problem.__traceback__)) from None
    except KeyboardInterrupt as problem:
        if not isinstance(problem, ROSInterruptException):
            raise
        _print_error(script, problem)
        status = FAILED
    except SystemExit as end:
        status = _status(end)
    except MissingPackageError as problem:
        number = script_line(script, problem.__traceback__)
        raise InputError(f"{script.name}: line {number}: {problem}") from problem
    except TrocarError:
        raise
    except BaseException as problem:  # noqa: BLE001  printed whole, as Python does
        _print_error(script, problem)
        status = FAILED
    if watchdog.overdue:
        raise watchdog.error(0)
    return status


def _status(end: SystemExit) -> int:
    if end.code is None or isinstance(end.code, int):
        return end.code or 0
    sys.stderr.write(f"{end.code}\n")
    return FAILED


def _print_error(script: Path, problem: BaseException) -> None:
    """Print a traceback as Python does, from the script's own lines on."""
    tb = problem.__traceback__
    while tb is not None and tb.tb_frame.f_code.co_filename != str(script):
        tb = tb.tb_next
    traceback.print_exception(type(problem), problem, tb or problem.__traceback__)
    if _is_python_2(problem):
        sys.stderr.write(f"trocar: {PYTHON_2}\n")
    if _is_older_call(problem):
        sys.stderr.write(f"trocar: {OLDER}\n")
    source = sys.modules.get(str(getattr(problem, "name", None)))
    if isinstance(problem, ImportError) and getattr(source, "__all__", None) and tb is not None:
        sys.stderr.write(f"{problem.name} has: {', '.join(source.__all__)}\n")  # type: ignore[union-attr]


#: Hint at calls of another version.
OLDER = (
    "crtk and dvrk are those of dVRK 2.4, whose readings are (value, time) and whose arms take a"
    " ral first; an arm that is made by its name alone has the calls of 2.2 and 1.x; for a script"
    " of 2.3 put its dvrk_python and crtk on PYTHONPATH"
)


def _is_older_call(problem: BaseException) -> bool:
    """Return whether an error may come of a call that dVRK 2.4 has no longer."""
    if getattr(sys.modules.get("dvrk"), "__file__", None):
        return False  # an installed one
    text, own = str(problem), {**vars(crtk_client), **vars(dvrk_client)}
    if isinstance(problem, AttributeError):
        places = {kind.__module__ for kind in type(problem.obj).__mro__}
        own_places = {crtk_client.__name__, dvrk_client.__name__}
        return bool(places & own_places) or "'tuple' object" in text
    if not isinstance(problem, TypeError):
        return False
    called = own.get(re.split(r"\W", text, maxsplit=1)[0])
    module = getattr(called, "__module__", "")
    return "tuple" in text or module in (crtk_client.__name__, dvrk_client.__name__)


def script_line(script: Path, tb: TracebackType | None) -> int:
    """Return the number of the script's own line that a traceback is of, 0 without one."""
    found = 0
    while tb is not None:
        if tb.tb_frame.f_code.co_filename == str(script):
            found = tb.tb_lineno
        tb = tb.tb_next
    return found


class Watchdog:
    """Ends a script that takes too long, or that SIGTERM is to end; it needs no other signal.

    Simulated time is bounded by the simulation itself, where it is stepped; this one sees when
    nothing goes on any more, or when the wall clock's time is over. It raises OverdueError in the
    script's thread. If the script still runs GRACE_S later, it closes the recording and ends the
    process. Where the script's C code keeps all other threads of Python from running, faulthandler
    prints tracebacks and ends the process; so it does where other threads of the script outlive it.

    Args:
        script: its path
        flow: the simulation
        timeout_s: how long the script may take [s]; None: for ever
    """

    def __init__(self, script: Path, flow: Flow, timeout_s: float | None) -> None:
        self.script, self._flow, self._timeout = script, flow, timeout_s
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="trocar-watchdog", daemon=True)
        self._terminated = False
        self.overdue = False

    def __enter__(self) -> Watchdog:
        self._others = set(threading.enumerate())
        self._wake = signal.signal(WAKE, self._raise)
        self._terminate = signal.getsignal(signal.SIGTERM)
        if callable(self._terminate):
            signal.signal(signal.SIGTERM, self._note_termination)
        self._look_again()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        signal.signal(WAKE, self._wake)
        signal.signal(signal.SIGTERM, self._terminate)
        left = set(threading.enumerate()) - self._others
        if all(thread.daemon for thread in left):
            faulthandler.cancel_dump_traceback_later()

    def error(self, line: int) -> ScriptError:
        """Return the error to raise, with the line number in the script, 0 if unknown."""
        text = linecache.getline(str(self.script), line).strip() if line else ""
        where = f"; it was at line {line}: {text}" if line else ""
        return ScriptError(self.script, f"not finished after {self._timeout:g} s{where}")

    def _raise(self, number: int, frame: FrameType | None) -> None:
        if self.overdue and not self._over.is_set():
            raise OverdueError
        if callable(self._wake):
            self._wake(number, frame)

    def _note_termination(self, number: int, frame: FrameType | None) -> None:
        self._terminated = True
        self._terminate(number, frame)  # type: ignore[operator]

    def _watch(self) -> None:
        limit = float("inf") if self._timeout is None else self._timeout
        steps, since = self._flow.steps, time.monotonic()
        while not self._over.wait(LOOK_S):
            self._look_again()
            if self._terminated:
                self._end("terminated", 128 + signal.SIGTERM)
            elif self._flow.steps != steps:
                steps, since = self._flow.steps, time.monotonic()
            elif time.monotonic() - since > limit:
                self.overdue = True
                self._flow.fail(OverdueError())
                interrupt(threading.main_thread())
                error = self.error(_line_of(self.script, threading.main_thread()))
                self._end(f"error: {error}", FAILED)

    def _look_again(self) -> None:
        """Have the process ended unless this is called again in time."""
        if self._timeout is not None and sys.__stderr__ is not None:
            patience_s = self._timeout + 2.0 * GRACE_S
            faulthandler.dump_traceback_later(patience_s, exit=True, file=sys.__stderr__)

    def _end(self, reason: str, status: int) -> None:
        """End the process with a script that goes on though it was interrupted."""
        if self._over.wait(GRACE_S):
            return
        try:
            sys.stderr.write(f"trocar: {reason}\n")
            self._flow.close()
            if (recorder := recorder_of(self._flow.world)) is not None:
                recorder.stop()
            sys.stdout.flush()
        except TrocarError as problem:
            sys.stderr.write(f"trocar: error: {problem}\n")
        finally:
            os._exit(status)


def _line_of(script: Path, thread: threading.Thread) -> int:
    """Return the number of the script's own line where a thread is, 0 without one."""
    frame = sys._current_frames().get(thread.ident or 0)  # pyright: ignore[reportPrivateUsage]  documented
    while frame is not None and frame.f_code.co_filename != str(script):
        frame = frame.f_back
    return 0 if frame is None else frame.f_lineno


def interrupt(thread: threading.Thread) -> None:
    """Have the handler of WAKE called in the main thread, also while that waits in a C call."""
    if hasattr(signal, "pthread_kill") and thread.ident is not None:
        signal.pthread_kill(thread.ident, WAKE)
    else:
        _thread.interrupt_main(WAKE)


#: Packages by which a script shows its edition of ROS.
EDITIONS: dict[Edition, frozenset[str]] = {
    1: frozenset(("rospy", "rosbag", "roslib", "tf", "tf_conversions", "genpy", "actionlib")),
    2: frozenset(
        ("rclpy", "rosbag2_py", "rosidl_runtime_py", "ament_index_python", "rcl_interfaces",
         "builtin_interfaces", "launch_ros", "tf_transformations", "sensor_msgs_py")
    ),
}  # fmt: skip


def edition_of(script: Path) -> Edition:
    """Return the edition of ROS that a script, and what lies beside it, imports packages of.

    Where it imports those of both or of none, ROS_VERSION counts, else it is 1.
    """
    found = _packages(script, set())
    first, second = (bool(names & found) for names in EDITIONS.values())
    if first != second:
        return 2 if second else 1
    return 2 if os.environ.get("ROS_VERSION") == "2" else 1


def _packages(script: Path, seen: set[Path]) -> set[str]:
    """Return the packages that a script imports, and those that lie beside it import."""
    seen.add(script)
    found: set[str] = set()
    for node in ast.walk(_tree(script.read_bytes())):
        if isinstance(node, ast.Import):
            found |= {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add((node.module or "").split(".")[0])
    for name in tuple(found):
        beside = script.parent / f"{name}.py"
        if beside not in seen and beside.is_file():
            with suppress(InputError):  # it may never be imported
                found |= _packages(beside, seen)
    return found


#: Built-in rigs that have arms of different kinds, the fastest first.
RIGS = ("psm", "ecm", "mtm", "three_psm", "two_psm_ecm", "full_cart", "full_cart_mtm")
#: Has every arm of a patient's cart; taken where a script names none.
EVERY = "full_cart"
#: Classes of dvrk that need more than one arm; teleoperation is served where masters are.
PARTS = {
    "suj": ("SUJ",),
    "console": ("MTML", "MTMR", "PSM1"),
    "teleop_psm": ("MTML", "MTMR", "PSM1"),
}
ARM = re.compile(r"PSM[123]|ECM|MTM[LR]|SUJ")
#: Names of topics of cameras.
SEEN = re.compile(r"image_(raw|rect|color|mono)|camera_info|/compressed")


def rig_for(source: bytes, arguments: Sequence[str]) -> str:
    """Return the first rig that has all arms that a script names, and a camera for its images.

    Args:
        source: of the script; texts in it count, remarks and docstrings do not
        arguments: of the script; where one names an arm, the script's texts do not count
    """
    tree = _tree(source)
    named = {name for word in arguments for name in ARM.findall(word)}
    named = named or {name for text in _texts(tree) for name in ARM.findall(text)}
    named |= set(_parts(tree))
    if not named:
        return EVERY
    sees = any(SEEN.search(text) for text in (*arguments, *_texts(tree)))
    for rig in RIGS:
        found = load_rig(rig)
        arms = {arm.name for arm in found.arms}
        arms |= {"SUJ"} if any(name.startswith("SUJ_") for name in arms) else set()
        if named <= arms and (found.cameras or not sees):
            return rig
    return RIGS[-1]


def _tree(source: bytes) -> ast.AST:
    try:
        return ast.parse(source)
    except SyntaxError as problem:
        raise InputError(f"cannot read the script: {_wrong_line(problem)}") from problem
    except ValueError as problem:
        raise InputError(f"cannot read the script: {problem}") from problem


def _texts(tree: ast.AST) -> Iterator[str]:
    remarks = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        text = node.value if isinstance(node, ast.Constant) else None
        if isinstance(text, str) and id(node) not in remarks:
            yield text


def _parts(tree: ast.AST) -> Iterator[str]:
    """Yield the arms without which the classes that a script takes from dvrk have no topics."""
    modules, names = _imported(tree)
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id in modules
        ):
            names.append(node.attr)
    for name in names:
        yield from PARTS.get(name, ())


def _imported(tree: ast.AST) -> tuple[set[str], list[str]]:
    """Return a script's name of the module dvrk, and the names that it imports from it."""
    modules: set[str] = set()
    names: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for name in node.names:
                package, *below = name.name.split(".")
                if package == "dvrk":
                    modules.add(name.asname or package)
                    names += below
        elif isinstance(node, ast.ImportFrom):
            package, *below = (node.module or "").split(".")
            if package == "dvrk":
                names += [*below, *(name.name for name in node.names)]
    return modules, names
