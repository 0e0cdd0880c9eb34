"""What a recorded row holds: which numbers of the physics state are which joint of which arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigArm, RigDescription
from trocar.simulation.drives import Drives
from trocar.simulation.objects import SceneObject
from trocar.simulation.servos import INPUTS
from trocar.simulation.state_view import StateView

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: What a row copies of the physics state.
STATE = ("qpos", "qvel", "act")
#: Where x, y, z and the quaternion xyzw are behind the first coordinate of a free joint.
POSE_ORDER = np.array([0, 1, 2, 4, 5, 6, 3])
#: What is kept of every joint in every physics period, in this order.
QUANTITIES = ("position", "velocity", "effort", "setpoint")


@dataclass(frozen=True)
class ArmColumns:
    """Which columns are an arm's.

    Attributes:
        name, type: "PSM1", "PSM"
        joints: names, the jaw last where there is one
        kinds: "revolute" or "prismatic" of each
        jaw: whether the last one is a jaw
        first: column of the first joint
    """

    name: str
    type: str
    joints: tuple[str, ...]
    kinds: tuple[str, ...]
    jaw: bool
    first: int

    @property
    def columns(self) -> slice:
        """The arm's columns."""
        return slice(self.first, self.first + len(self.joints))

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {
            "name": self.name,
            "type": self.type,
            "joints": list(self.joints),
            "kinds": list(self.kinds),
            "jaw": self.jaw,
            "first": self.first,
        }


def arm_columns(values: Mapping[str, Any]) -> ArmColumns:
    """Return columns from plain values, the inverse of `ArmColumns.as_dict`."""
    return ArmColumns(
        str(values["name"]),
        str(values["type"]),
        tuple(values["joints"]),
        tuple(values["kinds"]),
        bool(values["jaw"]),
        int(values["first"]),
    )


@dataclass(frozen=True, eq=False)
class Inputs:
    """What the servos were told, kept where it may have changed only.

    Attributes:
        first: rows from which on each set holds, rising, the first 0 where there are rows, (j,)
        ctrl: `ctrl` from there on, (j, nu)
    """

    first: Index
    ctrl: Array

    def of_each(self, rows: int) -> Array:
        """Return the servos' inputs in each of so many rows, (rows, nu / 3, 3)."""
        lasting = np.diff(self.first, append=rows)
        return np.repeat(self.ctrl, lasting, axis=0).reshape(rows, -1, INPUTS)


@dataclass(frozen=True, eq=False)
class Layout:
    """How rows of the physics state become joints, (n_joints,) over all arms.

    Attributes:
        arms: whose columns are which
        rest: positions of joints that are welded into the model, else 0, (n_joints,)
        weights: position = rest + sum over terms of weight times a coordinate, (terms, n_joints)
        qpos, qvel: which coordinate and which rate that is, (terms, n_joints)
        live: columns of joints that have a servo, (s,)
        servos, act: ids of those servos and of their integrals, (s,)
        parts: where qpos, qvel and act are in a row
        size: numbers of a row
        objects: names of what can be moved
        places: columns in qpos of each one's position and quaternion xyzw, (objects, 7)
    """

    arms: tuple[ArmColumns, ...]
    rest: Array
    weights: Array
    qpos: Index
    qvel: Index
    live: Index
    servos: Index
    act: Index
    parts: Mapping[str, slice]
    size: int
    objects: tuple[str, ...]
    places: Index

    @property
    def joints(self) -> int:
        """Number of joints over all arms."""
        return len(self.rest)


def layout_of(
    state: StateView,
    rig: RigDescription,
    drives: Mapping[str, Drives],
    welded: Mapping[str, Array],
    objects: Mapping[str, SceneObject],
) -> Layout:
    """Return the layout of copies of a state; `welded` has the positions of arms without hinges."""
    arms: list[ArmColumns] = []
    first = 0
    for rig_arm in rig.arms:
        columns = _columns(rig_arm, drives[rig_arm.name], first)
        arms.append(columns)
        first += len(columns.joints)
    terms = max(_terms(d) for d in drives.values())
    weights, rest = np.zeros((terms, first)), np.zeros(first)
    qpos, qvel = np.zeros((2, terms, first), np.intp)
    live: list[int] = []
    servos: list[int] = []
    act: list[int] = []
    for columns in arms:
        d = drives[columns.name]
        if d.welded:
            rest[columns.columns] = welded[columns.name]
            continue
        for joint, row in enumerate(d.binding.drive):
            for term, hinge in enumerate(np.flatnonzero(row)):
                weights[term, columns.first + joint] = row[hinge]
                qpos[term, columns.first + joint] = d.binding.qpos[hinge]
                qvel[term, columns.first + joint] = d.binding.dof[hinge]
        live += range(columns.columns.start, columns.columns.stop)
        servos += d.binding.actuators.tolist()
        act += d.binding.act.tolist()
    return Layout(
        tuple(arms),
        rest,
        weights,
        qpos,
        qvel,
        np.array(live, np.intp),
        np.array(servos, np.intp),
        np.array(act, np.intp),
        state.parts,
        len(state.values),
        tuple(objects),
        np.array([one.place for one in objects.values()], np.intp).reshape(-1, 1) + POSE_ORDER,
    )


def quantities(
    layout: Layout, rows: Array, told: Inputs, laws: Sequence[tuple[int, Array]]
) -> Array:
    """Return positions, velocities, efforts and set-points of every joint.

    Args:
        layout: of the rows
        rows: samples of the state, (k, size)
        told: what the servos were told meanwhile
        laws: (first row, P, I, D and effort limit as they act from there on (s, 4)), rows rising

    Returns:
        (4, n_joints, k) [rad or m, per s, N m or N, rad or m]
    """
    qpos, qvel, act = (rows[:, layout.parts[name]] for name in STATE)
    found = np.zeros((len(QUANTITIES), layout.joints, len(rows)))
    found[0] = layout.rest[:, None]
    for weight, place, rate in zip(layout.weights, layout.qpos, layout.qvel, strict=True):
        # By hand: a matrix product would wake the threads of the algebra library, which then spin.
        found[0] += weight[:, None] * qpos.T[place]
        found[1] += weight[:, None] * qvel.T[rate]
    live, integrals = _run(layout.live), act[:, _run(layout.act)]
    inputs = told.of_each(len(rows))[:, _run(layout.servos)]
    found[3] = layout.rest[:, None]
    found[3, live] = inputs[:, :, 0].T
    position, velocity = found[0, live], found[1, live]
    ends = [first for first, _ in laws[1:]] + [len(rows)]
    for (first, law), end in zip(laws, ends, strict=True):
        part = slice(first, end)
        p, i, d, limit = law.T[:, :, None]
        wanted = inputs[part].transpose(2, 1, 0)
        effort = p * (wanted[0] - position[:, part]) + i * integrals[part].T
        effort += d * (wanted[1] - velocity[:, part]) + wanted[2]
        found[2, live, part] = np.clip(effort, -limit, limit)
    return found


def _run(index: Index) -> Index | slice:
    """Return indices as a slice where they follow one another: no copy, and no lock held for it."""
    if len(index) and (np.diff(index) == 1).all():
        return slice(int(index[0]), int(index[-1]) + 1)
    return index


def _terms(drives: Drives) -> int:
    """Return how many hinges a joint's position is summed from at most."""
    return 1 if drives.welded else max(1, int(drives.binding.driven.sum(axis=1).max()))


def _columns(rig_arm: RigArm, drives: Drives, first: int) -> ArmColumns:
    arm = rig_arm.arm
    return ArmColumns(
        rig_arm.name,
        arm.type,
        arm.mechanism.joint_names,
        tuple(joint.kind for joint in drives.arm.joints),
        arm.has_jaw,
        first,
    )
