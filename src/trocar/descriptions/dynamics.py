"""Identified dynamics of a robot: its bodies, and friction, springs and cables of its joints."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.frames import pin_name
from trocar.descriptions.overlay_records import (
    POSITIVE,
    TERMS,
    BodyDynamics,
    Drivetrain,
    Dynamics,
    FilterSettings,
)
from trocar.descriptions.records import ArmDescription, Body, Friction
from trocar.descriptions.table import Table
from trocar.errors import InputError, UnknownNameError

Array = NDArray[np.float64]

#: Joints that not every instrument has; drivetrains along one that is not there exert nothing.
INSTRUMENT = ("roll", "wrist_pitch", "wrist_yaw", "jaw")


def apply_dynamics(arm: ArmDescription, dynamics: Dynamics, where: str) -> ArmDescription:
    """Return an arm with identified bodies, friction and rotors.

    What a hinge of any format has is set here: rotor, viscous friction, and dry friction of
    Coulomb's kind with the stop elements' force when all slip. Tools keep their own. The simulation
    has all terms of all drivetrains in place of these: see `modeling.drives`.

    Args:
        arm: the description, with its tool
        dynamics: what was identified
        where: the file, for messages

    Raises:
        UnknownNameError: a frame or joint that the arm does not have
    """
    own = [b.frame for b in arm.bodies if b.part == arm.name]
    for frame in dynamics.bodies:
        if frame not in own:
            raise UnknownNameError("body", frame, own, where)
    for train in dynamics.drivetrains.values():
        for joint in train.along:
            if joint not in (*arm.mechanism.joint_index, *INSTRUMENT):
                raise UnknownNameError("joint", joint, arm.mechanism.joint_names, where)
    left = dict(dynamics.bodies)
    bodies: list[Body] = []
    for body in arm.bodies:
        if body.part != arm.name or body.frame not in dynamics.bodies:
            bodies.append(body)
            continue
        new = left.pop(body.frame, BodyDynamics(0.0, np.zeros(3), np.zeros((3, 3))))
        bodies.append(
            replace(
                body,
                mass=new.mass,
                com=new.com,
                inertia=new.inertia,
                inertia_from="source",
                source=f"identified: {where}",
            )
        )
    kept = _kept_by_tool(arm)
    pins = {pin_name(closure.name) for closure in arm.mechanism.closures}
    friction = {k: v for k, v in arm.friction.get("identified", {}).items() if k in kept}
    rotor = {k: v for k, v in arm.rotor.items() if k in kept | pins}
    for name, train in dynamics.drivetrains.items():
        if name in kept or not _moves(arm, name, train):
            continue
        friction[name] = Friction(train.dry_friction, train.one("viscous"))
        if "rotor" in train.terms:
            frame, weight = _hinge(arm, name)
            rotor[frame] = train.one("rotor") * weight**2
    return replace(
        arm,
        bodies=tuple(bodies),
        friction={**arm.friction, "identified": friction},
        rotor=rotor,
        block_sources={**arm.block_sources, "friction identified": f"identified: {where}"},
    )


def _kept_by_tool(arm: ArmDescription) -> set[str]:
    """Return the joints and frames of the tool, and those that the arm's logs do not move."""
    if not arm.tool:
        return (
            {arm.joints[-1].name, *(f for f, _ in arm.joints[-1].drive)}
            if (arm.has_gripper)
            else set()
        )
    base = arm.mechanism.frame_index[arm.tool_frame]
    frames = {f.name for f in arm.mechanism.frames if base in arm.mechanism.chain(f.name)[:-1]}
    return frames | {j.name for j in arm.joints if j.drive[0][0] in frames}


def _moves(arm: ArmDescription, name: str, train: Drivetrain) -> bool:
    """Return whether a drivetrain is along the joint or frame that has its name."""
    mechanism = arm.mechanism
    if name in mechanism.joint_index:
        return dict(train.along) == {name: 1.0}
    if name not in mechanism.frame_index:
        return False
    return dict(train.along) == dict(mechanism.frame(name).couplings)


def _hinge(arm: ArmDescription, name: str) -> tuple[str, float]:
    """Return the frame that a joint's motor moves and q / coordinate; of a frame, itself and 1."""
    if name in arm.mechanism.joint_index:
        return arm.joint(name).drive[0]
    return name, 1.0


def read_dynamics(table: Table) -> Dynamics | None:
    """Return the dynamics of an overlay's file, None if it has none.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    if "bodies" not in table and "drivetrains" not in table:
        return None
    bodies, found = table.named("bodies", _read_body), table.named("drivetrains", _read_drivetrain)
    return Dynamics(bodies, found, _read_filters(table.optional_table("filters")))


def dynamics_document(dynamics: Dynamics) -> dict[str, Any]:
    """Return dynamics as the tables of an overlay's file."""
    return {
        "filters": {
            "rate_hz": dynamics.filters.rate_hz,
            "cutoff_hz": dynamics.filters.cutoff_hz,
            "order": dynamics.filters.order,
            "acceleration_cutoff_hz": dict(dynamics.filters.acceleration_cutoff_hz) or None,
            "differentiated": list(dynamics.filters.differentiated) or None,
        },
        "bodies": {
            name: {
                "mass_kg": body.mass,
                "mass_sigma_kg": body.mass_sigma,
                "com_m": body.com,
                "com_sigma_m": body.com_sigma,
                "inertia_kgm2": six(body.inertia),
                "inertia_sigma_kgm2": None
                if body.inertia_sigma is None
                else six(body.inertia_sigma),
            }
            for name, body in dynamics.bodies.items()
        },
        "drivetrains": {
            name: {
                "along": dict(train.along),
                "stop_limits": list(train.stop_limits) or None,
                "cable_range": list(train.cable_range) if "cable" in train.terms else None,
                **{term: list(values) for term, values in train.terms.items()},
                "sigma": {term: list(values) for term, values in train.sigma.items()} or None,
            }
            for name, train in dynamics.drivetrains.items()
        },
    }


def six(matrix: Array) -> Array:
    """Return xx, yy, zz, xy, xz, yz of a symmetric matrix, (6,)."""
    return np.array([matrix[i, j] for i, j in _SIX])


_SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def _full(values: Array) -> Array:
    matrix = np.zeros((3, 3))
    for (i, j), value in zip(_SIX, values, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix


def _read_body(row: Table) -> BodyDynamics:
    inertia = _full(row.numbers("inertia_kgm2", 6))
    sigma = _full(row.numbers("inertia_sigma_kgm2", 6)) if "inertia_sigma_kgm2" in row else None
    found = row.record(BodyDynamics, inertia=inertia, inertia_sigma=sigma)
    if not found.mass > 0.0:
        raise row.fail("mass_kg", f"got {found.mass:g}; allowed: more than 0")
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    if np.linalg.eigvalsh(second).min() < -1e-9 * np.trace(inertia):
        raise row.fail(
            "inertia_kgm2", f"got {six(inertia).tolist()}; allowed: the inertia of a possible body"
        )
    return found


def _read_drivetrain(row: Table) -> Drivetrain:
    weights = row.table("along")
    along = {joint: weights.number(joint) for joint in weights.entries()}
    if not along:
        raise row.fail("along", "is empty; allowed: { JOINT = WEIGHT, ... }")
    limits = row.numbers("stop_limits", default=[])
    if (limits <= 0.0).any():
        raise row.fail("stop_limits", f"got {limits.tolist()}; allowed: more than 0")
    span = row.numbers("cable_range", 2, [0.0, 0.0])
    if "cable" in row and not span[0] < span[1]:
        raise row.fail("cable_range", f"got {span.tolist()}; allowed: [LOWER, UPPER]")
    terms: dict[str, tuple[float, ...]] = {}
    for term, count in TERMS.items():
        if term not in row:
            continue
        size = len(limits) if term == "stops" else count or None
        values = row.numbers(term, size)
        if term in POSITIVE and (values < 0.0).any():
            raise row.fail(term, f"got {values.tolist()}; allowed: 0 or more")
        terms[term] = tuple(values.tolist())
    if len(limits) and "stops" not in terms:
        raise row.fail("stops", f"is missing; allowed: {len(limits)} numbers, as stop_limits has")
    spread = row.optional_table("sigma")
    sigma = {
        term: tuple(spread.numbers(term, len(terms.get(term, ()))).tolist())
        for term in spread.entries()
    }
    return Drivetrain(along, terms, sigma, tuple(limits.tolist()), (span[0], span[1]))


def _read_filters(row: Table) -> FilterSettings:
    found = row.record(FilterSettings)
    row.done()
    if not (found.rate_hz > 0.0 and found.cutoff_hz > 0.0 and 1 <= found.order <= 12):
        raise InputError(
            f"{row.file}: filters: got rate_hz {found.rate_hz:g}, cutoff_hz {found.cutoff_hz:g},"
            f" order {found.order}; allowed: more than 0, order 1 to 12"
        )
    return found
