"""The rooms of trocar may only look down, and each heavy library has one home.

CONTRIBUTING.md shows the house; this file holds its walls. Everything is read with `ast`:
no file of trocar is run, so a broken room cannot hide what it imports.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

SRC = Path(__file__).parents[1] / "src" / "trocar"
FILES = sorted(SRC.rglob("*.py"))

# Lowest first. A room may import itself and any room before it.
ROOMS = [
    "errors",
    "geometry",
    "kinematics",
    "fitting",
    "cameras",
    "descriptions",
    "modeling",
    "simulation",
    "recording",
    "rendering",
    "interfaces",
    "apps",
    "cli",
]

# Library -> the folders (or files, without .py) allowed to import it.
HOMES = {
    "mujoco": (
        "modeling",
        "simulation",
        "recording",
        "rendering",
        "apps/verification",
        "apps/trials",
        "apps/timing",
        "apps/benchmarks",
        "apps/importers",
    ),
    "ruckig": ("simulation",),
    "yaml": ("cameras",),
    "tomli_w": ("descriptions",),
    "gymnasium": ("interfaces/gym",),
    "viser": ("interfaces/viewer",),
    "msgspec": ("apps/dvrk_config", "interfaces/crtk/transports/websocket", "interfaces/viewer"),
    "websockets": ("interfaces/viewer", "interfaces/crtk/transports/websocket"),
    "rospy": ("interfaces/crtk/transports/ros1",),
    "PyKDL": ("interfaces/crtk/scripts",),
    "rosgraph": ("interfaces/crtk/transports/ros1",),
    "genpy": ("interfaces/crtk/transports/ros1",),
    "rclpy": ("interfaces/crtk/transports/rclpy_node",),
    "cyclonedds": ("interfaces/crtk/transports/ros2",),
    "foxglove": ("interfaces/crtk/transports/foxglove",),
    "moderngl": ("rendering",),
    "mcap": ("recording",),
    "zstandard": ("recording",),
    "rosbags": ("apps/replay",),
    "lz4": ("apps/mirroring",),
    "matplotlib": ("apps",),
    "imageio_ffmpeg": ("apps/filming",),
    "lxml": ("modeling", "apps/exports", "apps/importers"),
    # Outside the package: the benchmarks, and the drawing of solids with its library.
    "benchmarks": (),
    "tools": (),
    "build123d": (),
    "OCP": (),
    "trimesh": ("apps/importers", "interfaces/viewer"),
    "coacd": ("apps/importers",),
    # Judges of the exports, which only tests call.
    "drake": (),
    "pydrake": (),
    "pinocchio": (),
    "yourdfpy": (),
}
# Siblings inside these folders must not know each other.
ISOLATED = ("interfaces", "apps")

# The witnesses against MuJoCo: what they may import beside trocar and the standard library ...
LIBRARIES = {"geometry": {"numpy"}, "kinematics": {"numpy", "scipy"}, "fitting": {"numpy"}}
# ... in which they open no file.
FILE_ACCESS = {"io", "os", "pathlib", "shutil", "tempfile", "tomllib", "importlib"}

# Below the interfaces there is simulation time only.
TIMELESS = tuple(ROOMS[: ROOMS.index("rendering")])
WALL_CLOCKS = {"time", "datetime", "sched"}
# Who talks to trocar is none of the simulation's business.
OUTSIDE_WORLD = {"socket", "socketserver", "http", "asyncio", "selectors", "ssl", "urllib"}

# Robots and their parts, which the witnesses do not know.
ROBOTS = ("psm", "ecm", "suj", "mtm", "davinci", "da_vinci", "dvrk", "needle_driver")


@dataclass(frozen=True)
class Import:
    """One imported name: where it stands and whether a function has to run to reach it."""

    line: int
    name: str
    deferred: bool

    @property
    def library(self) -> str:
        return self.name.split(".")[0]


def names_of(node: ast.Import | ast.ImportFrom, package: list[str]) -> list[str]:
    """Every absolute name that one statement imports."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    up = len(package) - node.level + 1
    base = ".".join(package[:up]) if node.level else ""
    base = ".".join(filter(None, [base, node.module]))
    return [f"{base}.{alias.name}" for alias in node.names]


def imports(path: Path, tree: ast.AST | None = None) -> list[Import]:
    """Every import of a file, deferred ones included."""
    package = ["trocar", *path.relative_to(SRC).parent.parts]

    def walk(node: ast.AST, deferred: bool) -> Iterator[Import]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import | ast.ImportFrom):
                yield from (Import(child.lineno, n, deferred) for n in names_of(child, package))
            inside = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            yield from walk(child, deferred or inside)

    return list(walk(tree or ast.parse(path.read_text(encoding="utf-8")), deferred=False))


def place(path: Path) -> str:
    """Where a file lives: its folder, or its own name for a file at the top; "" for the root."""
    relative = path.relative_to(SRC)
    here = relative.parent.as_posix() if len(relative.parts) > 1 else relative.stem
    return "" if here in ("__init__", "__main__") else here


def module_path(path: Path) -> str:
    return path.relative_to(SRC).with_suffix("").as_posix()


def lies_in(here: str, folders: tuple[str, ...]) -> bool:
    return any(f"{here}/".startswith(f"{folder}/") for folder in folders)


def complaint(here: str, name: str) -> str | None:
    """Why a file `here`, as `module_path` has it, may not import `name`, or None."""
    parts = name.split(".")
    if parts[0] != "trocar":
        homes = HOMES.get(parts[0])
        if homes is not None and not lies_in(here, homes):
            return f"{parts[0]} may only be imported under {homes or 'tests'}"
        return None
    room = here.split("/")[0]
    if room == "":  # the front doors may open onto any room
        return None
    if room not in ROOMS:
        return f"{here} lies in no known room"
    if parts[1:] == ["__version__"]:
        return None
    if len(parts) < 2 or parts[1] not in ROOMS:
        return "import from the room that owns the name, not from the package root"
    if ROOMS.index(parts[1]) > ROOMS.index(room):
        return f"{room} may not look up into {parts[1]}"
    if room in ISOLATED and parts[1] == room and "/" in here:
        sibling = len(parts) > 2 and (SRC / room / parts[2]).is_dir()
        if sibling and parts[2] != here.split("/")[1]:
            return f"{here} may not know its sibling {room}/{parts[2]}"
    return None


def each_file(files: list[Path] = FILES) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("path", files, ids=[module_path(p) for p in files])


def rooms(*names: str) -> list[Path]:
    return [path for path in FILES if place(path).split("/")[0] in names]


@each_file()
def test_imports_point_down(path: Path) -> None:
    here = place(path) and module_path(path)
    bad = [
        f"line {i.line}: {i.name}: {why}" for i in imports(path) if (why := complaint(here, i.name))
    ]
    assert not bad, "\n".join(bad)


@each_file()
def test_a_deferred_import_is_a_subcommand_or_an_optional_library(path: Path) -> None:
    if lies_in(place(path), ("cli",)) or place(path) == "":
        return
    bad = [f"line {i.line}: {i.name}" for i in imports(path) if i.deferred]
    assert not [b for b in bad if b.split()[-1].split(".")[0] not in HOMES], "\n".join(bad)


@each_file(rooms(*LIBRARIES))
def test_the_witnesses_need_no_library_but_their_own_and_open_no_file(path: Path) -> None:
    allowed = LIBRARIES[place(path).split("/")[0]] | {"trocar"}
    standard = set(sys.stdlib_module_names) - FILE_ACCESS
    bad = [f"line {i.line}: {i.name}" for i in imports(path) if i.library not in allowed | standard]
    assert not bad, "\n".join(bad)


@each_file(rooms(*LIBRARIES))
def test_the_witnesses_know_no_robot_by_name(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    bad = [
        f"line {line}: {word}"
        for line, word in words(tree)
        if any(robot in word.lower() for robot in ROBOTS)
    ]
    assert not bad, "\n".join(bad)


def words(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Every identifier and string of the code; docstrings may speak of robots."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            node.value.value = ""  # a docstring
        elif isinstance(node, ast.Name):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute):
            yield node.lineno, node.attr
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


@each_file(rooms(*TIMELESS))
def test_no_wall_clock_below_the_interfaces(path: Path) -> None:
    bad = [f"line {i.line}: {i.name}" for i in imports(path) if i.library in WALL_CLOCKS]
    assert not bad, "\n".join(bad)


@each_file(rooms(*TIMELESS))
def test_no_socket_below_the_interfaces(path: Path) -> None:
    bad = [f"line {i.line}: {i.name}" for i in imports(path) if i.library in OUTSIDE_WORLD]
    assert not bad, "\n".join(bad)


@pytest.mark.parametrize(
    ("here", "name", "why"),
    [
        ("geometry", "trocar.kinematics.forward.pose", "look up"),
        ("kinematics", "trocar.fitting.fit_hinge", "look up"),
        ("simulation", "trocar.interfaces.loop", "look up"),
        ("descriptions", "mujoco.MjModel", "may only be imported"),
        ("interfaces", "viser.ViserServer", "may only be imported"),
        ("apps/importers", "pinocchio", "under tests"),
        ("apps/trials", "trocar.apps.benchmarks.core.core", "sibling"),
        ("kinematics", "trocar.load_arm", "room that owns the name"),
        ("modelling", "trocar.errors.InputError", "no known room"),
    ],
)
def test_the_walls_stop_what_they_are_for(here: str, name: str, why: str) -> None:
    assert why in (complaint(here, name) or "")


def test_siblings_are_strangers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "interfaces" / "crtk").mkdir(parents=True)
    monkeypatch.setitem(globals(), "SRC", tmp_path)
    assert "sibling" in (complaint("interfaces/viewer", "trocar.interfaces.crtk.codec") or "")
    assert complaint("interfaces/viewer", "trocar.interfaces.loop.Loop") is None


def test_relative_and_deferred_imports_are_seen() -> None:
    source = "from . import rotations\ndef late():\n    from ..errors import InputError\n"
    found = imports(SRC / "geometry" / "se3.py", ast.parse(source))
    assert found == [
        Import(1, "trocar.geometry.rotations", deferred=False),
        Import(3, "trocar.errors.InputError", deferred=True),
    ]
