"""The setup joints' file: which column, which links, where each arm hangs."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from trocar.apps.labs import published
from trocar.apps.labs.json_file import Node
from trocar.apps.labs.numbers import read_chain, read_place, read_transform
from trocar.apps.labs.records import Chain, Generation, SetupArm
from trocar.descriptions.records import REFERENCE_ARM

Array = NDArray[np.float64]

#: Whom setup joints can hold. Source: mtsIntuitiveResearchKitSUJ.cpp.
HELD = ("PSM1", "PSM2", "PSM3", "ECM")
#: How many rows of the Classic's move; those that follow are fixed. Source: the same.
CLASSIC_JOINTS = {"ECM": 4, "PSM1": 6, "PSM2": 6, "PSM3": 6}
POTENTIOMETERS = ("primary_offsets", "primary_scales", "secondary_offsets", "secondary_scales")


def read_setup_file(root: Node, kind: str, literal: bool) -> list[SetupArm]:
    """Return the setup joints of every arm.

    Args:
        root: the file
        kind: SUJ_Classic, SUJ_Si or SUJ_Fixed
        literal: take angles as they are printed

    Raises:
        DescriptionError: an arm that nobody holds, or numbers that make no chain
    """
    root.without_use("base_arduino_mac")
    found: list[SetupArm] = []
    for node in root.nodes("arms"):
        name = node.text("name", allowed=HELD)
        if name in [arm.name for arm in found]:
            raise node.fail("name", f"got {name!r} a second time; allowed: each arm once")
        node.without_use("plug_number", "serial_number", "brake_release_current", "arduino_mac")
        node.raw("type")
        arm = _read_fixed(node, name) if kind == "SUJ_Fixed" else None
        found.append(arm or _read_arm(node, name, kind, literal))
    if not found:
        raise root.fail("arms", f"is missing; a list with {', '.join(HELD)} is needed")
    return found


def read_reference_arm(root: Node, kind: str, arms: list[SetupArm], said: list[str]) -> str:
    """Return the arm whose tip frame the poses of the others on setup joints are in.

    Args:
        root: the setup joints' file
        kind: SUJ_Classic, SUJ_Si or SUJ_Fixed
        arms: what the file has
        said: takes what the reader should know

    Raises:
        DescriptionError: it names an arm that the file does not have
    """
    name = root.text(
        "reference_arm", REFERENCE_ARM, dict.fromkeys([REFERENCE_ARM, *(a.name for a in arms)])
    )
    if kind == "SUJ_Fixed" and name != REFERENCE_ARM:
        said.append(
            f"{root.file}: reference_arm is {name!r}; here poses of PSMs on fixed mounts are in the"
            " ECM's frame"
        )
    return name


def own_setup_arms(generation: str) -> list[SetupArm]:
    """Return those that the dVRK publishes; the Classic's chains are trocar's own."""
    return [_own(name, cast(Generation, generation)) for name in HELD]


def _own(name: str, generation: Generation) -> SetupArm:
    if generation == "Classic":
        origin = published.CLASSIC_ORIGIN["ECM" if name == "ECM" else "PSM"]
        return SetupArm(name, "", "Classic", None, np.eye(4), origin, None, None, {})
    known = published.SI[name]
    origin = known.tool_origin
    return SetupArm(name, "", "Si", known.chain, known.column, origin, known.q, None, {})


def _read_fixed(node: Node, name: str) -> SetupArm:
    still = np.eye(4)
    at = read_transform(node, "measured_cp")
    return SetupArm(name, node.file, "Classic", None, still, still, None, at, {})


def _read_arm(node: Node, name: str, kind: str, literal: bool) -> SetupArm:
    generation: Generation = "Si" if kind == "SUJ_Si" else "Classic"
    own = _own(name, generation)
    given = [k for k in ("DH", "world_origin_to_SUJ", "SUJ_tip_to_tool_origin") if k in node]
    if given and len(given) < 3:
        raise node.fail(
            given[0],
            "stands without its fellows; allowed: DH, world_origin_to_SUJ and"
            " SUJ_tip_to_tool_origin together, or none of them (then the dVRK's own are taken)",
        )
    chain, column, origin = own.chain, own.column, own.tool_origin
    if given:
        chain = _with_joints(read_chain(node, literal), name, generation, node)
        column = read_place(node, "world_origin_to_SUJ")
        origin = read_place(node, "SUJ_tip_to_tool_origin")
    q = own.q
    if "simulated_position" in node:
        q = _positions(node, chain, name)
    pots = {key: node.numbers(key) for key in POTENTIOMETERS if key in node}
    return SetupArm(name, node.file, generation, chain, column, origin, q, None, pots)


def _with_joints(chain: Chain, name: str, generation: Generation, node: Node) -> Chain:
    """Return a chain in which just those rows move that have a joint."""
    if generation == "Si":
        return chain
    count = CLASSIC_JOINTS[name]
    if len(chain.rows) < count:
        raise node.fail("DH", f"has {len(chain.rows)} rows; allowed: {count} or more")
    rows = tuple(replace(row, moves=k < count) for k, row in enumerate(chain.rows))
    return replace(chain, rows=rows)


def _positions(node: Node, chain: Chain | None, name: str) -> Array:
    """Return where the joints stand; zeros for rows that do not move may follow."""
    q = node.numbers("simulated_position")
    count = CLASSIC_JOINTS[name] if chain is None else sum(1 for row in chain.rows if row.moves)
    if len(q) < count or q[count:].any():
        raise node.fail(
            "simulated_position", f"got {q.tolist()}; allowed: {count} numbers (and zeros)"
        )
    return q[:count]
