"""A lab's configuration as a rig: read, written whole or not at all, compared with its file."""

from __future__ import annotations

import os
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

from trocar.apps.labs.agreement import Agreement, agreement
from trocar.apps.labs.arm_files import Files
from trocar.apps.labs.rig_file import rig_document
from trocar.apps.labs.system_file import Reader
from trocar.descriptions import RigDescription, load_rig
from trocar.descriptions.table import toml_text
from trocar.errors import InputError, UnknownNameError


@dataclass(frozen=True)
class LabOrder:
    """What the user wants.

    Attributes:
        share: folders where files are looked for, too
        tools: {PSM: instrument} in place of the file's
        literal: take angles as they are printed: 1.5708, 0.7853
        force: write over what is there
    """

    share: tuple[Path, ...] = ()
    tools: tuple[tuple[str, str], ...] = ()
    literal: bool = False
    force: bool = False


@dataclass(frozen=True, eq=False)
class Brought:
    """What came of it.

    Attributes:
        rig: as it loads from its file
        files: what was written, the rig first
        said: what was chosen, left out or not found
        idle: entries that have no counterpart in a simulation, "FILE: KEY, ..."
        unknown: entries that nobody knows, "FILE: KEY"
        agreement: how far the rig is from the file
    """

    rig: RigDescription
    files: tuple[str, ...]
    said: tuple[str, ...]
    idle: tuple[str, ...]
    unknown: tuple[str, ...]
    agreement: Agreement


def import_dvrk(system: str | Path, target: str | Path, order: LabOrder | None = None) -> Brought:
    """Turn a dVRK system's configuration into a rig, with files of the arms that differ.

    Args:
        system: system-*.json
        target: RIG.toml
        order: what the user wants

    Raises:
        DescriptionError: a file is broken, missing or contradicts itself: file, key, got, allowed
        InputError: a target that is there already, or cannot be written
    """
    wanted, path, file = order or LabOrder(), Path(system), Path(target).expanduser()
    _check_target(file, wanted.force)
    if not path.is_file():
        raise InputError(f"{system}: there is no such file; a dVRK system-*.json is needed")
    lab = Reader(path, wanted.share, wanted.literal).read()
    psms = [arm.name for arm in lab.arms if arm.type == "PSM"]
    for name, _ in wanted.tools:
        if name not in psms:
            raise UnknownNameError("PSM", name, psms, str(path))
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".import.", dir=file.parent) as place:
        files = Files(Path(place), re.sub(r"[^A-Za-z0-9_]+", "_", file.stem))
        document = rig_document(lab, dict(wanted.tools), files)
        (files.folder / file.name).write_text(toml_text(document), encoding="utf-8")
        gap = agreement(lab, load_rig(files.folder / file.name))
        names = [file.name, *files.names]
        for name in names[1:]:
            _check_target(file.parent / name, wanted.force)
        for name in reversed(names):
            os.replace(files.folder / name, file.parent / name)
    written = tuple(str(file.parent / name) for name in names)
    if files.stand_ins:
        names = ", ".join(dict.fromkeys(files.stand_ins))
        files.said.append(
            f"{names}: masses and shapes are not published; stand-ins, which touch nothing"
        )
    said = tuple(dict.fromkeys((*lab.said, *files.said)))
    return Brought(load_rig(file), written, said, lab.idle, lab.unknown, gap)


def _check_target(file: Path, force: bool) -> None:
    if file.suffix != ".toml":
        raise InputError(f"{file}: a rig's file ends in .toml")
    if file.exists() and not force:
        raise InputError(f"{file}: is there already; --force writes over it")
