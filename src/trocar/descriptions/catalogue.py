"""Find descriptions by name among those that come with the package, or by path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from trocar.descriptions.arms import ToolDescription, read_arm, read_tool
from trocar.descriptions.calibrated import Calibration, One, calibrated, calibrated_rig
from trocar.descriptions.generation import on_si
from trocar.descriptions.plugins import registered, registered_file
from trocar.descriptions.records import ArmDescription, RigDescription
from trocar.descriptions.rigs import read_rig
from trocar.descriptions.scenes import Scene, is_scene, read_scene
from trocar.descriptions.settings import changed
from trocar.descriptions.table import Table, read_table
from trocar.descriptions.tool_versions import GEARED, tool_of_version
from trocar.errors import DescriptionError, TrocarError, UnknownNameError
from trocar.inputs import is_file

Shelf = Literal["arms", "tools", "rigs", "cameras", "scenes"]

DATA = Path(__file__).parent / "data"


def names(shelf: Shelf) -> tuple[str, ...]:
    """Return the sorted names of built-in arms, tools, rigs and the like, then registered ones.

    Raises:
        InputError: two installed packages register one name
    """
    found = sorted(path.stem for path in (DATA / shelf).glob("*.toml"))
    named = [_tool_name(stem) if shelf == "tools" else stem for stem in found]
    others = () if shelf == "cameras" else registered(shelf)
    return (*named, *(name for name in sorted(others) if name not in named))


def load_arm(
    name: str | Path, tool: str | Path | None = None, calibration: One | Sequence[One] | None = None
) -> ArmDescription:
    """Load an arm with its tool.

    Args:
        name: a built-in arm ("psm"), or the path of a TOML file
        tool: a built-in tool ("LARGE_NEEDLE_DRIVER:400006"), a path, "none" for a bare arm;
            the arm's own default when omitted
        calibration: an overlay or the path of one; None: the nominal arm

    Raises:
        UnknownNameError: no such arm or tool; the known ones are listed
        DescriptionError: the file is broken; file, key, got and allowed are named
        InputError: the overlay is for another arm
    """
    files = [find("arms", name), *(() if tool in (None, "", "none") else (find("tools", tool),))]
    read = _shipped_arm if all(file.is_relative_to(DATA) for file in files) else _read_arm
    return calibrated(read(files[0], None if tool is None else str(tool)), calibration)


def _read_arm(path: Path, tool: str | None) -> ArmDescription:
    table = _open("arms", path)
    mounted = table.text("default_tool", "") if tool is None else tool
    return read_arm(table, None if mounted in ("", "none") else load_tool(mounted))


@lru_cache(maxsize=64)
def _shipped_arm(path: Path, tool: str | None) -> ArmDescription:
    """Read an arm of the package once: its files stay as they are, and so does what follows.

    Reading it and searching its loops for singularities took half of the time of a new World.
    """
    return _read_arm(path, tool)


def load_mechanism(
    name: str | Path, tool: str | Path = "none", calibration: One | Sequence[One] | None = None
) -> ArmDescription:
    """Load an arm with its tool as `load_arm` does, but without their bodies.

    What draws these bodies needs it.
    """
    mounted = None if tool == "none" else read_tool(_bodiless("tools", tool))
    return calibrated(read_arm(_bodiless("arms", name), mounted), calibration)


def load_tool(name: str | Path) -> ToolDescription:
    """Load a tool by its name or path."""
    return read_tool(_open("tools", find("tools", name)))


def document(shelf: Literal["arms", "tools"], name: str | Path) -> dict[str, Any]:
    """Return the entries of an arm's or a tool's file, on those of its base."""
    return _open(shelf, find(shelf, name)).document()


def load_rig(name: str | Path, calibration: Calibration | None = None) -> RigDescription:
    """Load a rig by its name or path; paths inside it are relative to its folder.

    Args:
        name: a built-in rig ("psm"), or the path of a TOML file; of a scene, its rig with its props
        calibration: an overlay (or its path) for every arm of its kind, {arm of the rig: overlay},
            or a list of overlays and texts "ARM=FILE"; arms without one are nominal

    Raises:
        UnknownNameError: no such rig, or an arm that it does not have
        DescriptionError: a file is broken
        InputError: an overlay for none of the arms
    """
    path = find("rigs", name)
    table = read_table(path)
    if is_scene(table):
        return calibrated_rig(read_scene(table, load_rig).rig, calibration)
    loaded: dict[tuple[str, str | None], ArmDescription] = {}

    def beside(entry: str) -> str:
        return str(path.parent / entry) if entry.endswith(".toml") else entry

    def load(arm: str, tool: str | None) -> ArmDescription:
        if (arm, tool) not in loaded:
            loaded[arm, tool] = load_arm(beside(arm), tool if tool is None else beside(tool))
        return loaded[arm, tool]

    return calibrated_rig(read_rig(table, load), calibration)


def load_scene(name: str | Path, settings: Mapping[str, Any] | None = None) -> Scene:
    """Load a scene by its name or path; paths inside it are relative to its folder.

    Args:
        name: a built-in or registered scene ("peg-board"), or the path of a TOML file
        settings: values of keys in place of the file's, {dotted path: value}, see
            `settings.changed`

    Raises:
        UnknownNameError: no such scene, or no such rig; the known ones are listed
        DescriptionError: the file is broken; file, key, got and allowed are named
        InputError: a setting's path leads nowhere; the known parts are listed
    """
    table = read_table(find("scenes", name))
    scene = read_scene(changed(table, settings) if settings else table, load_rig)
    return replace(scene, rig=on_si(scene.rig, load_arm)) if scene.generation == "Si" else scene


def _open(shelf: Shelf, path: Path, above: tuple[Path, ...] = ()) -> Table:
    """Return the table of a file, on that of its base.

    Args:
        shelf: where a base that is not a path is looked up
        path: of the file
        above: files that have this one as their base

    Raises:
        DescriptionError: the file or its base is broken, or there is no such base
    """
    table = read_table(path)
    if "base" not in table:
        return table
    name = table.text("base")
    try:
        base = find(shelf, path.parent / name if name.endswith(".toml") else name)
    except TrocarError as problem:
        raise table.fail("base", str(problem)) from problem
    if base in (path, *above):
        raise table.fail("base", f"got {name!r}; allowed: a file that is not based on this one")
    # Two descriptions of one name could not be distinguished.
    return table.without("base").on(_open(shelf, base, (path, *above)).without("name"))


def _bodiless(shelf: Shelf, name: str | Path) -> Table:
    return _open(shelf, find(shelf, name)).without("body", "counterweight")


def find(shelf: Shelf, name: str | Path) -> Path:
    """Return the file of a description: a built-in or registered name, or a path.

    Raises:
        UnknownNameError: no such name; the known ones are listed
        DescriptionError: there is no such file
    """
    text = tool_of_version(str(name)) if shelf == "tools" else str(name)
    if text.endswith(".toml") or isinstance(name, Path):
        path = Path(name).expanduser().resolve()
        if not is_file(path):
            raise DescriptionError(str(name), "", "there is no such file")
        return path
    path = DATA / shelf / f"{text.replace(':', '_')}.toml"
    if shelf != "cameras" and not is_file(path) and text in registered(shelf):
        return registered_file(shelf, text)
    if text not in names(shelf) or not is_file(path):
        more = _why_not(text) if shelf == "tools" else ""
        raise UnknownNameError(shelf[:-1], text, names(shelf), more=more)
    return path


def _why_not(instrument: str) -> str:
    """Return the reason why an instrument of the dVRK is not built in, "" for an unknown one."""
    for group in read_table(DATA / "instruments.toml").tables("group"):
        if instrument.removesuffix(GEARED) in group.texts("names"):
            return f"{instrument}: {group.text('why')}; docs/how-to/design-a-tool.md says how"
    return ""


def _tool_name(stem: str) -> str:
    model = stem.removesuffix(GEARED)
    head, _, code = model.rpartition("_")
    return f"{head}:{code}{stem[len(model) :]}" if head else stem
