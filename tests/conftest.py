"""What tests share: choice by --quick and --skipped-before, random positions, logs."""

from __future__ import annotations

import gzip
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import load_arm
from trocar.descriptions.overlay import Overlay, overlay_between
from trocar.descriptions.overlay_records import ClosurePatch, FramePatch
from trocar.descriptions.records import ArmDescription
from trocar.errors import TrocarError
from trocar.geometry import matrix_from_rotation_vector, rpy_from_matrix
from trocar.robot.mocap.robots import perturbed

SKIPPED = "trocar/skipped"
ROOT = Path(__file__).parents[1]
#: As in test_architecture: a package imports only those before it.
PACKAGES = (
    "geometry", "kinematics", "fitting", "cameras", "messages", "descriptions", "modeling",
    "formats", "simulation", "recording", "plotting", "rendering", "live", "ros", "viewer",
    "teleoperation", "scripts", "tasks", "conformance", "robot", "learning", "cli",
)  # fmt: skip
#: Tests of the whole repository that take a second.
ALWAYS = ("test_architecture.py", "test_repository.py", "test_exports.py", "test_startup.py")
#: With --quick, no test begins later than this after the start [s]. Source: our own choice; the
#: slowest test without the mark `slow` ends within a minute then.
QUICK_S = 45.0


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--skipped-before",
        action="store_true",
        help="run only the tests that the last run skipped, for instance after more is installed",
    )
    parser.addoption(
        "--quick",
        action="store_true",
        help="run the tests of packages that changed since the last commit (or in it), then those"
        " above, for as long as a minute allows",
    )


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--quick"):
        config.pluginmanager.register(Quick(config))
    elif not hasattr(config, "workerinput"):  # the controller of pytest-xdist sees every report
        config.pluginmanager.register(Skipped(config))


def changed() -> set[str]:
    """Return names of packages, folders and files that the work tree or the last commit changed."""
    for words in (("status", "--porcelain", "-uall"), ("diff", "--name-only", "HEAD~1")):
        said = subprocess.run(
            ["git", *words], cwd=ROOT, capture_output=True, text=True, check=False
        )
        paths = [Path(line.split(" ")[-1]).parts for line in said.stdout.splitlines()]
        if paths:
            return {part for path in paths if path[0] in ("src", "tests") for part in path[1:4]}
    return set()


class Quick:
    """Chooses tests by what changed, nearest first, and stops in time."""

    def __init__(self, config: pytest.Config) -> None:
        self._end = time.monotonic() + QUICK_S
        named = config.invocation_params.args and config.args != config.getini("testpaths")
        self._changed = names = changed()
        touched = [name for name in PACKAGES if name in names]
        above = PACKAGES[PACKAGES.index(touched[0]) :] if touched else ()
        files = sorted(name for name in names if name.startswith("test_"))
        nearest_first = list(dict.fromkeys([*files, *touched, *ALWAYS, *above]))
        #: Folders and files in order; None: the command line names what to run.
        self._order = None if named else nearest_first

    def pytest_ignore_collect(self, collection_path: Path) -> bool | None:
        if self._order is None or not collection_path.is_relative_to(ROOT / "tests"):
            return None
        parts = collection_path.relative_to(ROOT / "tests").parts
        return True if parts and parts[0] not in (*self._order, "conftest.py") else None

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        places = self._order or []

        def place(item: pytest.Item) -> tuple[int, bool]:
            first, *rest = item.path.relative_to(ROOT / "tests").parts
            names = {name for part in rest for name in (part, part.removeprefix("test_"))}
            near = {*names, *(name.removesuffix(".py") for name in names)} & self._changed
            return places.index(first) if first in places else len(places), not near

        items.sort(key=place)

    def pytest_runtest_setup(self) -> None:
        if time.monotonic() > self._end:
            pytest.skip("no time left in make quick; make test runs it")


class Skipped:
    """Remembers in pytest's cache which tests, or whole files, were skipped."""

    def __init__(self, config: pytest.Config) -> None:
        self._cache = getattr(config, "cache", None)  # none with -p no:cacheprovider
        self._skipped: dict[str, bool] = {}

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.skipped:
            self._skipped[report.nodeid] = True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._skipped[report.nodeid] = self._skipped.get(report.nodeid, False) or report.skipped

    def pytest_sessionfinish(self) -> None:
        if self._cache is not None and self._skipped:
            before = dict.fromkeys(self._cache.get(SKIPPED, []), True)
            now = {**before, **self._skipped}
            self._cache.set(SKIPPED, sorted(name for name, skipped in now.items() if skipped))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--skipped-before"):
        return
    skipped = set(config.cache.get(SKIPPED, []))
    chosen = [i for i in items if i.nodeid in skipped or i.nodeid.split("::")[0] in skipped]
    config.hook.pytest_deselected(items=[i for i in items if i not in chosen])
    items[:] = chosen


@pytest.fixture(scope="session")
def opengl() -> str:
    """Return who draws, or skip the test: no extra `scope`, or no OpenGL."""
    from trocar.rendering.context import open_context

    try:
        context = open_context()
    except TrocarError as problem:
        pytest.skip(str(problem))
    name = str(context.info["GL_RENDERER"])
    context.release()
    return name


@pytest.fixture
def rng() -> np.random.Generator:
    """Return the generator that every test starts from."""
    return np.random.default_rng(20260 + 1)


Sampler = Callable[[ArmDescription, np.random.Generator, int], NDArray[np.float64]]


@pytest.fixture
def random_positions() -> Sampler:
    """Return the function that draws joint positions over an arm's whole range."""
    return _random_positions


def _random_positions(
    arm: ArmDescription, rng: np.random.Generator, count: int
) -> NDArray[np.float64]:
    """Return joint positions, jaws from shut on, (count, n)."""
    mechanism = arm.mechanism
    q = rng.uniform(mechanism.lower, mechanism.upper, (count, len(mechanism.joints)))
    if arm.has_jaw:
        q[:, -1] = np.abs(q[:, -1])
    return q


#: The hinges of the pitch linkage.
HINGES = ("pitch_back", "pitch_front", "pitch_bottom", "pitch_top", "pitch_end")
OverlayMaker = Callable[[str, np.random.Generator], Overlay]


@pytest.fixture
def skew_overlay() -> OverlayMaker:
    """Return the function that makes a robot of a PSM or an ECM with no side and no axis as drawn.

    Points are off by up to 0.5 mm and axes by 0.2 deg, so the pins must slide.
    """
    return _skew_overlay


def _skew_overlay(name: str, rng: np.random.Generator) -> Overlay:
    mechanism = load_arm(name).mechanism
    frames: dict[str, FramePatch] = {}
    for hinge in (*HINGES, "yaw", "insertion"):
        before = mechanism.frame(hinge).before
        tilt = matrix_from_rotation_vector(np.radians(0.2) * rng.uniform(-1.0, 1.0, 3))
        off = 5e-4 * rng.uniform(-1.0, 1.0, 3)
        frames[hinge] = FramePatch(before[:3, 3] + off, rpy_from_matrix(before[:3, :3] @ tilt))
    closures = {
        c.name: ClosurePatch(
            c.point_a + 5e-4 * rng.uniform(-1.0, 1.0, 3),
            c.point_b + 5e-4 * rng.uniform(-1.0, 1.0, 3),
            slides=True,
        )
        for c in mechanism.closures
    }
    return Overlay(name, "general", frames, closures)


@pytest.fixture
def parallel_overlay() -> OverlayMaker:
    """Return the function that makes a robot with sides off by up to 3 mm, its loops exact."""
    return lambda name, rng: overlay_between(load_arm(name), perturbed(load_arm(name), rng))


Rows = NDArray[np.float64]
LogWriter = Callable[[Path, Rows, Rows, Rows], Path]

# Wrist pitch, wrist yaw and jaw from their motors. Source: Wang 2019, the recording script.
JOINT_FROM_MOTOR = np.array([[1.0186, 0.0, 0.0], [-0.8306, 0.6089, 0.6089], [0.0, -1.2177, 1.2177]])


@pytest.fixture
def write_psm_log() -> LogWriter:
    """Return the function that writes positions, velocities and efforts, (k, 7) each.

    As the recorder of a PSM does: wrist and jaw motor-side; gzip when the path says so.
    """
    return _write_psm_log


def _write_psm_log(path: Path, positions: Rows, velocities: Rows, efforts: Rows) -> Path:
    positions, velocities, efforts = positions.copy(), velocities.copy(), efforts.copy()
    motor_from_joint = np.linalg.inv(JOINT_FROM_MOTOR)
    positions[:, 4:] = positions[:, 4:] @ motor_from_joint.T
    velocities[:, 4:] = velocities[:, 4:] @ motor_from_joint.T
    efforts[:, 4:] = efforts[:, 4:] @ JOINT_FROM_MOTOR
    rows = np.hstack([positions, velocities, efforts])
    text = "".join(",".join(f"{value:.17g}" for value in row) + "\n" for row in rows)
    packed = path.suffix == ".gz"
    path.write_bytes(gzip.compress(text.encode()) if packed else text.encode())
    return path
