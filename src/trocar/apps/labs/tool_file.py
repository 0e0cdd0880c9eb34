"""Instruments from the dVRK's tool files: lengths, limits and coupling.

Source of the format: sawIntuitiveResearchKit share/tool/*.json.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from trocar.apps.labs import documents
from trocar.apps.labs.json_file import Node
from trocar.apps.labs.numbers import read_chain
from trocar.apps.labs.records import Instrument, Row
from trocar.descriptions import names
from trocar.errors import DescriptionError

JOINTS = ("roll", "wrist_pitch", "wrist_yaw", "jaw")
#: alpha and theta of the three rows that an instrument of trocar's has [rad]. Source: the needle
#: driver's file; so have all instruments with a wrist of cables.
ANGLES = ((0.0, 0.0), (-math.pi / 2, -math.pi / 2), (-math.pi / 2, -math.pi / 2))
#: The rotation to Intuitive's convention, which every tool of trocar's ends with.
TIP = [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
#: Lengths that differ by less are the same [m].
SAME_LENGTH = 1e-7


def read_tool_file(root: Node, literal: bool) -> Instrument:
    """Return what a tool's file says.

    Raises:
        DescriptionError: rows or a tip that no tool of trocar's has, or no jaw
    """
    chain = read_chain(root, literal)
    got = tuple((row.alpha, row.theta) for row in chain.rows)
    if chain.convention != "modified" or len(got) != 3 or not np.allclose(got, ANGLES, atol=1e-5):
        raise root.fail(
            "DH",
            f"is a chain of {len(got)} rows that no instrument of trocar's has; allowed: roll,"
            " wrist pitch and wrist yaw as of LARGE_NEEDLE_DRIVER",
        )
    lengths = [(row.a, row.d) for row in chain.rows]
    if any(abs(v) > SAME_LENGTH for v in (lengths[0][0], *lengths[1], lengths[2][1])):
        raise root.fail("DH", f"got A, D of {lengths}; allowed: D of the first, A of the last row")
    tip = root.matrix("tooltip_offset", 4, 4)
    if not np.allclose(tip, TIP, atol=1e-6):
        raise root.fail("tooltip_offset", f"got {tip.tolist()}; allowed: {TIP}")
    jaw = root.node("jaw")
    limits = Row(
        "jaw", "revolute", True, 0.0, 0.0, 0.0, 0.0, jaw.number("qmin"), jaw.number("qmax"),
        jaw.number("ftmax", 0.0),
    )  # fmt: skip
    coupling = root.node("coupling").matrix("ActuatorToJointPosition", 4, 4)
    root.without_use("tool_engage_position", "mass")
    return Instrument(root.file, (*chain.rows, limits), coupling)


def tool_document(tool: str, found: Instrument) -> documents.Document | None:
    """Return a tool with a file's numbers, None where trocar's own has them already.

    Args:
        tool: "NAME:CODE"
        found: what the file says
    """
    known = tool in names("tools")
    like = tool if known else _like(tool)
    document = documents.own_tool(like)
    frames: Mapping[str, documents.Document] = {f["name"]: f for f in document["frame"]}
    changed = documents.set_limits(document, found.rows, found.file)
    roll, _, yaw, _ = found.rows
    for frame, key, length in (("roll", "d", roll.d), ("wrist_yaw", "a", -yaw.a)):
        if abs(documents.limit(frames[frame], key) - length) > SAME_LENGTH:
            documents.without(frames[frame], key)
            frames[frame] |= {f"{key}_m": length, "source": found.file}
            changed = True
    coupling = document["coupling"]
    if not np.allclose(coupling["actuator_to_joint"], found.coupling, atol=1e-9):
        coupling |= {"actuator_to_joint": found.coupling.tolist(), "source": found.file}
        changed = True
    if known and not changed:
        return None
    document["name"] = tool
    document["title"] = f"{tool}, as its file has it; shape and masses of {like}"
    document["source"] = found.file
    _keep_stops(document, found)
    return document


def _like(tool: str) -> str:
    """Return the instrument of trocar's whose shape and masses stand for one that it has not."""
    return f"LARGE_NEEDLE_DRIVER:{'400006' if tool.rpartition(':')[2][:3] == '400' else '420006'}"


def _keep_stops(document: documents.Document, found: Instrument) -> None:
    """Move the jaw's stop inside its limits, where a file has others."""
    jaw, limits = document["joint"][-1], found.rows[-1]
    if limits.lower is None or limits.upper is None:
        raise DescriptionError(found.file, "jaw", "has no qmin and qmax")
    if documents.limit(jaw, "stop_lower") < limits.lower:
        documents.without(jaw, "stop_lower")
        jaw["stop_lower_rad"] = limits.lower
