"""The rules of the packages: which may import which, and where each heavy library lives.

CONTRIBUTING.md shows the packages. Files are parsed, never run, and imports under TYPE_CHECKING
count like any other.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
SRC = ROOT / "src" / "trocar"

# Lowest first. A package may import itself and any package before it.
PACKAGES = [
    "errors",
    "inputs",
    "outputs",
    "geometry",
    "kinematics",
    "fitting",
    "cameras",
    "messages",
    "descriptions",
    "modeling",
    "formats",
    "simulation",
    "recording",
    "plotting",
    "rendering",
    "live",
    "ros",
    "viewer",
    "teleoperation",
    "scripts",
    "tasks",
    "conformance",
    "robot",
    "learning",
    "cli",
]
# Rooms that must not import each other ...
ISOLATED = ("viewer", "teleoperation", "scripts", "tasks", "conformance", "robot")
# ... but for these: (room, the sibling that it may import) and the reason.
SIDEWAYS = {
    ("teleoperation", "viewer"): "a gamepad or mouse in the browser is an operator's master",
}
# Folders beside src/, which import trocar and which trocar never imports.
OUTSIDE_THE_WHEEL = ("benchmarks", "tools", "tests", "examples")

# Library -> the folders (or files, without .py) allowed to import it.
HOMES = {
    "mujoco": (
        "modeling",
        "simulation",
        "recording",
        "rendering",
        "formats",
        "robot/verification",
    ),
    "ruckig": ("simulation",),
    "yaml": ("cameras", "formats/xacro"),
    "tomli_w": ("descriptions", "learning/policies"),
    "viser": ("viewer",),
    "msgspec": ("messages", "live/inbox", "ros", "viewer", "scripts", "robot/dvrk_config"),
    "websockets": ("live/connections", "viewer", "ros/transports/websocket"),
    "rich": ("cli",),
    "ray": ("tasks",),
    "gymnasium": ("learning",),
    "stable_baselines3": ("learning",),
    "torch": ("learning",),
    "safetensors": ("learning",),
    "pyarrow": ("learning", "robot/identification/episodes", "robot/recordings/parquet"),
    "mujoco_warp": ("learning",),
    "warp": ("learning",),
    "rospy": ("ros/transports/ros1",),
    "PyKDL": ("scripts",),
    "rosgraph": ("ros/transports/ros1",),
    "genpy": ("ros/transports/ros1",),
    "rclpy": ("ros/transports/rclpy_node",),
    "cyclonedds": ("ros/transports/ros2",),
    "foxglove": ("ros/transports/foxglove",),
    "moderngl": ("rendering",),
    "mcap": ("recording",),
    "zstandard": ("recording",),
    "rosbags": ("recording/bags", "recording/rosbag1", "ros/transports/ros2", "robot/samples"),
    "apsw": ("recording/bags",),
    "matplotlib": ("plotting", "robot", "tasks"),
    "clarabel": ("robot/identification",),
    "cv2": ("robot/boards", "tasks/vision/images"),
    "imageio_ffmpeg": ("rendering/film",),
    "lxml": ("formats",),
    # Draws the solids in tools/cad.
    "build123d": (),
    "OCP": (),
    "trimesh": ("formats/surfaces", "viewer"),
    "coacd": ("formats/pieces",),
    # Judges of the exports.
    "drake": (),
    "pydrake": ("robot/verification",),
    "pinocchio": ("robot/verification",),
    "yourdfpy": (),
}

# The witnesses against MuJoCo: what they may import beside trocar and the standard library ...
LIBRARIES = {"geometry": {"numpy"}, "kinematics": {"numpy", "scipy"}, "fitting": {"numpy"}}
# ... of which they use nothing that opens files.
FILE_ACCESS = {"io", "os", "pathlib", "shutil", "tempfile", "tomllib", "importlib"}
# Robots and their parts, which the witnesses do not name.
ROBOTS = ("psm", "ecm", "suj", "mtm", "davinci", "da_vinci", "dvrk", "needle_driver")

# Packages with simulation time alone, deterministic and without clients.
TIMELESS = tuple(PACKAGES[: PACKAGES.index("rendering")])
WALL_CLOCKS = {"time", "datetime", "sched"}
NETWORK = {"socket", "socketserver", "http", "asyncio", "selectors", "ssl", "urllib"}


@dataclass(frozen=True)
class Import:
    """One imported name: its line, and whether it is imported inside a function."""

    line: int
    name: str
    deferred: bool = False

    @property
    def library(self) -> str:
        return self.name.split(".")[0]


def imports(source: str, package: str) -> list[Import]:
    """Return every import of a module's source, as absolute names."""

    def names(node: ast.Import | ast.ImportFrom) -> list[str]:
        if isinstance(node, ast.Import):
            return [alias.name for alias in node.names]
        parts = package.split(".")
        base = parts[: len(parts) - node.level + 1] if node.level else []
        return [".".join(filter(None, [*base, node.module, alias.name])) for alias in node.names]

    def walk(node: ast.AST, deferred: bool) -> Iterator[Import]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import | ast.ImportFrom):
                yield from (Import(child.lineno, name, deferred) for name in names(child))
            inside = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            yield from walk(child, deferred or inside)

    return list(walk(ast.parse(source), deferred=False))


SOURCES = {
    path.relative_to(SRC).with_suffix("").as_posix(): path.read_text(encoding="utf-8")
    for path in sorted(SRC.rglob("*.py"))
}
# {"tasks/task": its imports}
IMPORTS = {
    here: imports(source, ".".join(["trocar", *here.split("/")[:-1]]))
    for here, source in SOURCES.items()
}


def lies_in(here: str, folders: tuple[str, ...]) -> bool:
    return any(f"{here}/".startswith(f"{folder}/") for folder in folders)


def against_order(here: str, name: str) -> str:
    """Say why a file may not import a name of trocar, "" where it may."""
    first, *parts = name.split(".")
    if first in OUTSIDE_THE_WHEEL:
        return "trocar is complete without what lies outside the wheel"
    package, *folders = here.split("/")
    if first != "trocar" or not folders or parts == ["__version__"]:
        if first == "trocar" and package not in (*PACKAGES, "__init__", "__main__"):
            return f"{package} is no known package"
        return ""  # the front doors import any package
    if package not in PACKAGES:
        return f"{package} is no known package"
    if not parts or parts[0] not in PACKAGES:
        return "import from the package that owns the name, not from trocar"
    if PACKAGES.index(parts[0]) > PACKAGES.index(package):
        return f"{package} may not import {parts[0]}"
    siblings = package in ISOLATED and parts[0] in ISOLATED and parts[0] != package
    if siblings and (package, parts[0]) not in SIDEWAYS:
        return f"{package} may not import its sibling {parts[0]}"
    return ""


def away_from_home(here: str, found: Import) -> str:
    """Say why a file may not import a library in this place, "" where it may."""
    homes = HOMES.get(found.library)
    if homes is not None:
        return "" if lies_in(here, homes) else f"may only be imported under {homes or 'tests'}"
    if found.deferred and not lies_in(here, ("cli", "__init__", "__main__")):
        return "only subcommands and optional libraries are imported inside functions"
    return ""


def cycle(graph: Mapping[str, set[str]]) -> list[str]:
    """Return nodes that form a cycle, [] where there is none."""
    done: set[str] = set()

    def search(node: str, trail: list[str]) -> list[str]:
        if node in trail:
            return trail[trail.index(node) :]
        if node in done:
            return []
        found = next(filter(None, (search(n, [*trail, node]) for n in sorted(graph[node]))), [])
        done.add(node)
        return found

    return next(filter(None, (search(node, []) for node in sorted(graph))), [])


def module_graph() -> dict[str, set[str]]:
    """Return which module imports which; a package stands for its `__init__`."""
    modules = {
        f"trocar.{here.replace('/', '.')}".removesuffix(".__init__"): here for here in IMPORTS
    }
    graph: dict[str, set[str]] = {}
    for module, here in modules.items():
        graph[module] = set()
        for name in (found.name for found in IMPORTS[here]):
            target = name if name in modules else name.rpartition(".")[0]
            if target in modules and target not in (module, "trocar"):
                graph[module].add(target)
    return graph


def words(source: str) -> Iterator[tuple[int, str]]:
    """Yield every identifier and string of the code; docstrings may name robots."""
    for node in ast.walk(ast.parse(source)):
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


def test_packages_import_only_lower_packages_and_siblings_are_strangers() -> None:
    bad = [
        f"{here}:{found.line}: {found.name}: {why}"
        for here, every in IMPORTS.items()
        for found in every
        if (why := against_order(here, found.name))
    ]
    assert not bad, "\n".join(bad)


def test_no_module_imports_itself_through_others() -> None:
    assert not (found := cycle(module_graph())), " -> ".join(found)


def test_a_heavy_library_is_imported_in_its_home_alone() -> None:
    bad = [
        f"{here}:{found.line}: {found.name}: {why}"
        for here, every in IMPORTS.items()
        for found in every
        if (why := away_from_home(here, found))
    ]
    assert not bad, "\n".join(bad)


def test_the_witnesses_need_numpy_alone_open_no_file_and_name_no_robot() -> None:
    standard = set(sys.stdlib_module_names) - FILE_ACCESS | {"trocar"}
    bad: list[str] = []
    for here, every in IMPORTS.items():
        allowed = LIBRARIES.get(here.split("/")[0])
        if allowed is None:
            continue
        bad += [f"{here}:{i.line}: {i.name}" for i in every if i.library not in allowed | standard]
        bad += [
            f"{here}:{line}: {word}"
            for line, word in words(SOURCES[here])
            if any(robot in word.lower() for robot in ROBOTS)
        ]
    assert not bad, "\n".join(bad)


def test_each_class_name_is_defined_once() -> None:
    found: dict[str, list[str]] = {}
    for here, source in SOURCES.items():
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ClassDef):
                found.setdefault(node.name, []).append(f"{here}:{node.lineno}")
    assert not {name: places for name, places in found.items() if len(places) > 1}


def test_below_rendering_there_is_no_wall_clock_and_no_network() -> None:
    bad = [
        f"{here}:{found.line}: {found.name}"
        for here, every in IMPORTS.items()
        for found in every
        if lies_in(here, TIMELESS) and found.library in WALL_CLOCKS | NETWORK
    ]
    assert not bad, "\n".join(bad)


def test_the_rules_catch_what_they_are_for() -> None:
    for here, name, why in (
        ("geometry/se3", "trocar.kinematics.forward.pose", "may not import kinematics"),
        ("kinematics/loops", "trocar.fitting.fit_hinge", "may not import fitting"),
        ("simulation/world", "trocar.live.loop.Loop", "may not import live"),
        ("tasks/task", "trocar.teleoperation.x", "sibling teleoperation"),
        ("viewer/server", "trocar.teleoperation.x", "may not import teleoperation"),
        ("kinematics/forward", "trocar.load_arm", "package that owns the name"),
        ("modelling/build", "trocar.errors.InputError", "no known package"),
        ("tasks/task", "benchmarks.speed", "outside the wheel"),
    ):
        assert why in against_order(here, name)
    assert not against_order("viewer/server", "trocar.live.loop.Loop")
    assert not against_order("teleoperation/session", "trocar.viewer.Driving")
    assert "may only be" in away_from_home("descriptions/rigs", Import(1, "mujoco.MjModel"))
    assert "under tests" in away_from_home("tasks/task", Import(1, "yourdfpy"))
    assert "inside functions" in away_from_home("tasks/task", Import(1, "math.pi", deferred=True))
    assert cycle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c"]
    assert not cycle({"a": {"b", "c"}, "b": {"c"}, "c": set()})
    source = "from . import rotations\ndef late():\n    from ..errors import InputError\n"
    assert imports(source, "trocar.geometry") == [
        Import(1, "trocar.geometry.rotations"),
        Import(3, "trocar.errors.InputError", deferred=True),
    ]
    typed = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from trocar.cli import main\n"
    assert Import(3, "trocar.cli.main") in imports(typed, "trocar.tasks")
