"""Uploaded files: imported beside the simulation, previewed, and placed in the rig's file."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_arm, load_rig
from trocar.descriptions.table import toml_text
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.geometry.se3 import transform
from trocar.simulation import World
from trocar.simulation.records import ShapeRecord

Floats = NDArray[np.float64]

MOST_BYTES = 50_000_000
"""Largest uploaded file. Source: our own choice: a binary STL of a million triangles."""

MESHES, ROBOTS, SYSTEMS = (".stl", ".obj"), (".urdf", ".xml", ".mjcf"), (".json",)
"""Endings of files that may be uploaded: meshes, robots (URDF, MJCF), configurations of a dVRK."""

PATIENCE_S = 180.0
"""Time after which an import is given up [s]. Source: our own choice; splitting a mesh of 100 000
triangles into convex pieces takes a minute."""

RIG = "rig.toml"


@dataclass(frozen=True, eq=False)
class Understood:
    """An uploaded file as it was understood.

    Attributes:
        name: of the prop or arm; of a rig, the file's
        kind: "prop", "arm" or "rig"
        file: the description that was written
        lines: size, mass, joints and warnings, for people
        bodies: (T_placed_body (4, 4), shapes) of each body of a prop or arm
    """

    name: str
    kind: str
    file: Path
    lines: tuple[str, ...]
    bodies: tuple[tuple[Floats, tuple[ShapeRecord, ...]], ...] = ()


@cache
def _workplace() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="trocar_uploads_")


def folder() -> Path:
    """Return the folder of uploads, which is removed as the program ends."""
    return Path(_workplace().name)


def understand(
    name: str, content: bytes, *, unit: str = "", hull: bool = False, taken: Sequence[str] = ()
) -> Understood:
    """Import an uploaded file, as `trocar import` and `trocar import-dvrk` do, in another process.

    Files that were uploaded before stand beside it, so that a robot finds its meshes, and a
    dVRK's system its arms, when they are uploaded first.

    Args:
        name: of the file; its ending decides
        content: of the file
        unit: of a mesh's numbers; "": the file's own, else metres
        hull: collide as convex hulls
        taken: names of arms and props of the rig; the new one is numbered where it has one of them

    Raises:
        InputError: the file is empty, too large, of another kind, or the importer's error
    """
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", Path(name).name).lstrip(".")
    suffix = Path(plain).suffix.lower()
    allowed = (*MESHES, *ROBOTS, *SYSTEMS)
    if suffix not in allowed:
        raise InputError(f"{name}: unknown ending {suffix!r}; allowed: {', '.join(allowed)}")
    if not content:
        raise InputError(f"{name}: is empty")
    check_size(name, len(content))
    given = folder() / "given"
    given.mkdir(exist_ok=True)
    file = given / plain
    file.write_bytes(content)
    out = Path(tempfile.mkdtemp(prefix="import_", dir=folder()))
    if suffix in SYSTEMS:
        found = _imported(name, ["import-dvrk", file, "-o", out / RIG, "--share", given])
        arms = ", ".join(arm["name"] for arm in found["arms"])
        notes = [*found["said"], *found["warnings"]]
        return Understood(file.stem, "rig", out / RIG, (f"a rig with {arms}", *notes))
    more = ["--unit", unit] if unit and suffix in MESHES else []
    more += ["--hull"] if hull else []
    found = _imported(name, ["import", file, "-o", out / "import", *more])
    written = Path(found["file"])
    own = _free_name(found["name"], taken)
    home = (out / "import").rename(out / own)
    described = home / written.name
    size = " x ".join(f"{1e3 * edge:.4g}" for edge in found["size"])
    joints = f", joints {', '.join(found['joints'])}" if found["joints"] else ""
    kind, links = "an arm" if found["kind"] == "arm" else "an object", found["links"]
    lines = (
        f"{kind}, {links} link{'s' * (links != 1)}{joints}",
        f"{size} mm, {found['mass']:.4g} kg, {found['triangles']} triangles,"
        f" {found['pieces']} collision shapes",
        *found["warnings"],
    )
    seen = Understood(own, found["kind"], described, lines)
    return Understood(own, found["kind"], described, lines, _bodies(seen))


def check_size(name: str, size: int) -> None:
    """Reject a file of more than `MOST_BYTES`.

    Raises:
        InputError: its size and the bound
    """
    if size > MOST_BYTES:
        raise InputError(
            f"{name}: got {1e-6 * size:.1f} MB; allowed: up to {1e-6 * MOST_BYTES:g} MB"
        )


def placed_rig(rig: str | Path, thing: Understood, pose: Floats, *, movable: bool) -> Path:
    """Write the file of a rig with a thing in it, in the form of `trocar sim --rig`.

    Args:
        rig: file of the rig, or of a scene, whose rig it has with its props
        thing: a prop or an arm; a rig is returned as it is
        pose: T_world_thing, (4, 4)
        movable: whether a prop is an object that can be moved

    Returns:
        the file, in a folder of its own together with the thing's

    Raises:
        InputError: the rig has no file, or the thing is an arm and the file a scene
        DescriptionError: the rig with the thing in it cannot be read
    """
    if thing.kind == "rig":
        return thing.file
    if not str(rig):
        raise InputError("the rig was built in Python, so no file can have the thing in it")
    source = Path(rig)
    document = _absolute(tomllib.loads(source.read_text(encoding="utf-8")), source.parent)
    row: dict[str, Any] = {
        "name": thing.name,
        "description": f"{thing.name}/{thing.file.name}",
        "xyz_m": pose[:3, 3],
        "rotation": pose[:3, :3],
    }
    if thing.kind == "prop":
        document["prop"] = [*document.get("prop", ()), {**row, "movable": movable}]
    elif "task" in document:
        raise InputError(f"{source.name} is a scene, which takes objects; load its rig first")
    else:
        document["arm"] = [*document.get("arm", ()), row]
        lower, upper = _limits(thing.file)
        start = next(one for one in document["pose"] if one["name"] == "start")
        start["q_rad_m"][thing.name] = np.clip(np.zeros(len(lower)), lower, upper)
    document["name"] = f"{document['name']}_{thing.name}"
    file = thing.file.parents[1] / RIG
    file.write_text(toml_text(document), encoding="utf-8")
    load_rig(file)
    return file


def archive(file: Path) -> bytes:
    """Return a ZIP of a rig's file and what stands beside it."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as files:
        for one in sorted(file.parent.rglob("*")):
            if one.is_file():
                files.write(one, one.relative_to(file.parent))
    return packed.getvalue()


def _imported(name: str, words: Sequence[str | Path]) -> Mapping[str, Any]:
    """Run an import; return its report.

    Raises:
        InputError: its error, or that it took too long
    """
    command = [sys.executable, "-m", "trocar", *map(str, words), "--json"]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=PATIENCE_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise InputError(f"{name}: not imported within {PATIENCE_S:g} s") from error
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["the importer ended"])[-1]
        text = last.removeprefix("trocar: error: ").replace(f"{folder() / 'given'}/", "")
        raise InputError(text if name in text else f"{name}: {text}")
    return json.loads(done.stdout)


def _bodies(thing: Understood) -> tuple[tuple[Floats, tuple[ShapeRecord, ...]], ...]:
    """Return the bodies of a thing that stands at the origin, beside one PSM."""
    file = placed_rig(load_rig("psm").file, thing, np.eye(4), movable=True)
    world = World(file)
    now = world.snapshot()
    found: dict[int, list[ShapeRecord]] = {}
    for shape in world.shapes():
        if shape.arm == thing.name or (
            shape.arm is None and shape.name.startswith(f"{thing.name}/")
        ):
            found.setdefault(shape.body, []).append(shape)
    return tuple(
        (transform(matrix_from_quaternion(now.quaternions[body]), now.positions[body]), tuple(own))
        for body, own in found.items()
    )


def _limits(file: Path) -> tuple[Floats, Floats]:
    mechanism = load_arm(file).mechanism
    return mechanism.lower, mechanism.upper


def _absolute(value: Any, beside: Path) -> Any:
    """Return a document whose paths to files beside it are absolute."""
    if isinstance(value, dict):
        return {key: _absolute(one, beside) for key, one in value.items()}  # pyright: ignore[reportUnknownVariableType]  a document of TOML
    if isinstance(value, list):
        return [_absolute(one, beside) for one in value]  # pyright: ignore[reportUnknownVariableType]  the same
    if isinstance(value, str) and value.endswith((".toml", ".py")) and (beside / value).is_file():
        return str((beside / value).resolve())
    return value


def _free_name(name: str, taken: Sequence[str]) -> str:
    """Return a name, with a number where it is taken."""
    used = {one.lower() for one in taken}
    number, found = 1, name
    while found.lower() in used:
        number += 1
        found = f"{name}_{number}"
    return found
