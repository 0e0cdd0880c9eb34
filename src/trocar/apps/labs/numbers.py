"""Angles, poses and kinematic chains out of the dVRK's files."""

from __future__ import annotations

import math
from typing import Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from trocar.apps.labs.json_file import Node
from trocar.apps.labs.records import Chain, Convention, Row
from trocar.descriptions import ArmDescription
from trocar.geometry.dh import modified_dh, standard_dh
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import transform
from trocar.kinematics.forward import pose

Array = NDArray[np.float64]

#: The dVRK's files print angles with four decimals or more: 1.5708, 0.7853, -1.2217. What is this
#: near to a whole multiple of 5 degrees stands for it [rad].
ROUNDED = 1.01e-4
STEP = math.radians(5.0)
#: How far a rotation of a file may be from one: 0.866 for cos 30 deg. Source: our own choice.
SKEW = 1e-3
#: What cisst takes for a joint's kind. Source: cisstRobot robJoint.cpp.
KINDS = {"revolute": "revolute", "hinge": "revolute", "prismatic": "prismatic"}
KINDS["slider"] = "prismatic"
#: What ends trocar's own chain of a PSM and of an ECM is turned by this about the shaft from the
#: last row of the dVRK's: as a tool's frames begin (psm.toml), and by the tooltip rotation of an
#: ECM (ecm.toml). [rad]
ROW_TURN = -np.pi / 2.0


def angle(value: float, literal: bool) -> float:
    """Return an angle as it is meant: 1.5708 is 90 degrees; as it stands where `literal`."""
    near = STEP * round(value / STEP)
    return near if not literal and abs(near - value) <= ROUNDED else value


def read_chain(node: Node, literal: bool) -> Chain:
    """Return the rows under "DH".

    Raises:
        DescriptionError: no rows, another convention or kind, a number that is none
    """
    dh = node.node("DH")
    rows = dh.nodes("joints") or dh.nodes("links")
    if not rows:
        raise dh.fail("joints", "is missing; a list of rows is needed (or links)")
    found = [_convention(dh if "convention" in dh else row) for row in rows]
    if len(set(found)) > 1:
        raise rows[1].fail("convention", f"got {', '.join(found)}; allowed: the same in all rows")
    for row in rows:
        row.raw("convention")
    return Chain(cast(Convention, found[0]), tuple(_row(row, literal) for row in rows))


def _convention(node: Node) -> str:
    return node.text("convention", allowed=get_args(Convention))


def _row(row: Node, literal: bool) -> Row:
    told = row.text("type", "revolute").lower()
    if told not in KINDS:
        raise row.fail("type", f"got {told!r}; allowed: {', '.join(KINDS)}")
    kind = cast(Literal["revolute", "prismatic"], KINDS[told])
    mode = row.text("mode", "active").lower()
    if mode not in ("active", "passive"):
        raise row.fail("mode", f"got {mode!r}; allowed: active, passive")
    offset = row.number("offset", 0.0)
    theta, d = angle(row.number("theta", 0.0), literal), row.number("D", 0.0)
    if kind == "revolute":
        theta += angle(offset, literal)
    else:
        d += offset
    lower, upper = _limit(row, "qmin"), _limit(row, "qmax")
    if lower is not None and upper is not None and not lower < upper:
        raise row.fail("qmin", f"got {lower:g}; allowed: less than qmax, {upper:g}")
    # Masses in a kinematic file are those of gravity compensation, which trocar has from the arm.
    row.without_use("mass", "cx", "cy", "cz", "Ixx", "Iyy", "Izz")
    row.without_use(*(f"{axis}{k}" for axis in "xyz" for k in "123"))
    return Row(
        row.text("name", ""),
        kind,
        mode == "active",
        row.number("A", 0.0),
        angle(row.number("alpha", 0.0), literal),
        d,
        theta,
        lower,
        upper,
        _limit(row, "ftmax"),
    )


def _limit(row: Node, key: str) -> float | None:
    return row.number(key) if key in row else None


def chain_tip(chain: Chain, q: Array) -> Array:
    """Return the pose of the last row's frame in the base, (4, 4).

    Args:
        chain: rows
        q: of the rows that move, (n,) [rad or m]
    """
    T, values = np.eye(4), iter(q.tolist())
    for row in chain.rows:
        moved = next(values) if row.moves else 0.0
        turn = moved if row.kind == "revolute" else 0.0
        slide = moved if row.kind == "prismatic" else 0.0
        place = modified_dh if chain.convention == "modified" else standard_dh
        T = T @ place(row.a, row.alpha, row.d + slide, row.theta + turn)
    return T


def last_row(arm: ArmDescription, q: Array) -> Array:
    """Return the pose of what is the last row of an arm's own chain in the dVRK, (4, 4).

    Args:
        arm: trocar's, with or without an instrument
        q: of all of its joints, (n,) [rad or m]
    """
    T = pose(arm.mechanism, q, "insertion" if arm.type == "PSM" else None)
    turn = 0.0 if arm.type == "MTM" else -ROW_TURN
    return T @ transform(rotation_z(turn), np.zeros(3))


def read_transform(node: Node, key: str) -> Array:
    """Return a (4, 4) matrix that must be a pose.

    Raises:
        DescriptionError: it is none
    """
    T = node.matrix(key, 4, 4)
    if not np.allclose(T[3], [0.0, 0.0, 0.0, 1.0], atol=1e-9):
        raise node.fail(key, f"got {T[3].tolist()} as the last row; allowed: [0, 0, 0, 1]")
    return transform(_rotation(node, key, T[:3, :3]), T[:3, 3])


def read_place(node: Node, key: str) -> Array:
    """Return a pose that is given as "Translation" and "Rotation", (4, 4)."""
    place = node.node(key)
    at = place.numbers("Translation")
    if at.shape != (3,):
        raise place.fail("Translation", f"got {at.tolist()}; allowed: 3 numbers")
    return transform(_rotation(place, "Rotation", place.matrix("Rotation", 3, 3)), at)


def _rotation(node: Node, key: str, R: Array) -> Array:
    """Return the rotation next to a matrix that was printed with few decimals."""
    U, sizes, V = np.linalg.svd(R)
    if np.abs(sizes - 1.0).max() > SKEW or np.linalg.det(R) < 0.0:
        raise node.fail(
            key,
            f"got {R.tolist()}, whose determinant is {np.linalg.det(R):.4g}; allowed: a rotation"
            f" (rows at right angles, of length 1 within {SKEW:g}, right-handed)",
        )
    return U @ V
