"""An arm of a lab as an arm of trocar's: the built-in one, or a file that differs from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.labs import documents
from trocar.apps.labs.numbers import ROW_TURN, chain_tip, last_row
from trocar.apps.labs.records import Chain, LabArm
from trocar.apps.labs.stand_ins import arm_bodies
from trocar.apps.labs.tool_file import tool_document
from trocar.descriptions import ArmDescription, names
from trocar.descriptions.table import toml_text
from trocar.errors import DescriptionError
from trocar.geometry.se3 import pose_difference

Array = NDArray[np.float64]

#: Chains that differ by less are the same [m, rad]: 1.5708 for 90 degrees makes 4e-6.
SAME_CHAIN = 3e-5
#: Gains of an Si where no file has them. Source: share/pid/sawControllersPID-{PSM,ECM}-Si.json.
SI_GAINS = {
    "PSM": {"yaw": (600.0, 0.0, 30.0), "pitch": (600.0, 0.0, 30.0), "insertion": (6e3, 0.0, 200.0)},
    "ECM": {
        "yaw": (600.0, 0.0, 30.0),
        "pitch": (600.0, 0.0, 30.0),
        "insertion": (15e3, 0.0, 500.0),
        "roll": (100.0, 0.0, 3.0),
    },
}


@dataclass
class Files:
    """The files that an import writes beside the rig.

    Attributes:
        folder: where they are built
        stem: what their names begin with
        names: those that were written
        said: what the reader should know
        stand_ins: arms whose masses and shapes are not known
    """

    folder: Path
    stem: str
    names: list[str] = field(default_factory=list[str])
    said: list[str] = field(default_factory=list[str])
    stand_ins: list[str] = field(default_factory=list[str])

    def write(self, name: str, document: documents.Document) -> str:
        """Write a document, and return its name as a rig beside it calls it."""
        file = f"{self.stem}_{name}.toml"
        (self.folder / file).write_text(toml_text(document), encoding="utf-8")
        self.names.append(file)
        return file


def arm_entry(arm: LabArm, tool: str, files: Files) -> dict[str, Any]:
    """Return `description` and `tool` of an arm; writes the files that they name.

    Raises:
        DescriptionError: a chain that no arm of trocar's can have
    """
    own = _own_name(arm)
    document, changed = documents.own_arm(own), False
    known = documents.known(own, "none" if arm.type == "PSM" else None)
    source = f"{Path(arm.file).name}, imported"
    rows = () if arm.chain is None else arm.chain.rows
    if arm.chain is not None and not _same_chain(arm.chain, known):
        document, known = _other_chain(arm, own, source)
        changed = True
        files.said.append(f"{arm.name}: its chain is not {own}'s, so it has no loops")
    changed |= documents.set_limits(document, rows, source)
    if "body" not in document:
        _add_bodies(document, known, arm)
        changed = True
        files.stand_ins.append(arm.name)
    gains = arm.gains or {}
    changed |= documents.set_gains(document, gains, source)
    entry: dict[str, Any] = {"description": own}
    if changed:
        document["title"] = f"{document.get('title', own)}; as {arm.name} of the lab has it"
        entry["description"] = files.write(arm.name.lower(), document)
    if arm.type == "PSM":
        entry["tool"] = _tool_entry(arm, tool or document["default_tool"], files)
    return entry


def _tool_entry(arm: LabArm, tool: str, files: Files) -> str:
    """Return the name of the instrument, or the file of one that differs from trocar's."""
    asked_for = tool != arm.tool
    found = None if asked_for else arm.instrument
    document = None if found is None else tool_document(tool, found)
    if document is not None and tool not in names("tools"):
        files.said.append(f"{arm.name}: {tool}: shape and masses are a needle driver's")
    if found is None and not asked_for and tool not in names("tools"):
        raise DescriptionError(
            arm.file,
            "tool",
            f"got {tool!r}, and its file tool/{tool.replace(':', '_')}.json is not here; allowed:"
            f" {', '.join(names('tools'))} (--tool {arm.name}=TOOL takes one of these, or a tool's"
            " own TOML file, in its place)",
        )
    changed = document is not None
    document = document or documents.own_tool(tool)
    changed |= documents.set_gains(document, arm.gains or {}, f"{Path(arm.file).name}, imported")
    if changed:
        return files.write(f"{arm.name.lower()}_tool", document)
    return str(Path(tool).resolve()) if tool.endswith(".toml") else tool


def _own_name(arm: LabArm) -> str:
    """Return the arm of trocar's that this one is, by its kind, generation and side."""
    if arm.type == "MTM":
        return "mtml" if "MTML" in arm.name.upper() or "mtml" in arm.file.lower() else "mtmr"
    return arm.type.lower() + ("_si" if arm.generation == "Si" else "")


def _same_chain(chain: Chain, known: ArmDescription) -> bool:
    moving = sum(1 for row in chain.rows if row.moves)
    if moving != known.own_joints:
        return False
    rng = np.random.default_rng(0)
    lower, upper = known.mechanism.lower, known.mechanism.upper
    return all(
        max(
            float(np.max(d))
            for d in pose_difference(chain_tip(chain, q[:moving]), last_row(known, q))
        )
        < SAME_CHAIN
        for q in rng.uniform(lower, upper, (8, len(lower)))
    )


def _other_chain(arm: LabArm, own: str, source: str) -> tuple[documents.Document, ArmDescription]:
    """Return the document of a PSM or ECM with another chain, and trocar's serial one like it."""
    chain = arm.chain
    names = ("yaw", "pitch", "insertion", "roll")[: 4 if arm.type == "ECM" else 3]
    kinds = ("revolute", "revolute", "prismatic", "revolute")[: len(names)]
    got = () if chain is None else tuple(row.kind for row in chain.rows)
    if arm.type == "MTM" or chain is None or chain.convention != "modified" or got != kinds:
        raise DescriptionError(
            arm.file,
            "kinematic",
            f"is a chain that trocar's {own} cannot have (got {', '.join(got)}); allowed: that of"
            f" {own}, or for a PSM or ECM one of {', '.join(kinds)} in the modified convention",
        )
    serial = f"{arm.type.lower()}_si"
    document = documents.own_arm(serial)
    document["name"], document["generation"] = f"{own}_lab", arm.generation
    for name, row in zip(names, chain.rows, strict=True):
        frame = next(f for f in document["frame"] if f["name"] == name)
        turn = ROW_TURN if arm.type == "PSM" and name == "insertion" else 0.0
        documents.set_row(frame, row, turn)
        frame["source"] = source
    return document, documents.known(serial, "none" if arm.type == "PSM" else None)


def _add_bodies(document: documents.Document, known: ArmDescription, arm: LabArm) -> None:
    """Give a serial arm bodies and gains, so that it can be simulated."""
    document["body"] = arm_bodies(known.mechanism, arm.type == "ECM")
    document["control"] = {
        "dvrk": {
            "source": "share/pid of the dVRK for the Si",
            "pid": {joint: list(pid) for joint, pid in SI_GAINS[arm.type].items()},
        }
    }
    document["missing"] = [
        {"what": "masses, inertias, shapes, friction", "why": "not published; stand-ins"}
    ]
