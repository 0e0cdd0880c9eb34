"""Carry a running world over to another model, when a tool is exchanged.

A new tool has other bodies and perhaps other joints, so the physics needs another model. What the
old one held of every joint and servo that is still there is carried over by name, bit for bit.
"""

from __future__ import annotations

import logging

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.mounting import carried_over, joints_without_tool
from trocar.descriptions.records import ArmDescription
from trocar.modeling import naming
from trocar.simulation.motors import Motors
from trocar.simulation.servos import Servos

Array = NDArray[np.float64]
Index = NDArray[np.intp]
log = logging.getLogger("trocar")

#: The tool's joint that stays as well. Source: the dVRK engages a new instrument with its wrist
#: straight and its jaw shut, wherever its roll is.
ROLL = "roll"
#: Coordinates and rates of a joint of each kind.
CARRIED = (
    "setpoint",
    "modes",
    "gains",
    "limit",
    "locked",
    "powered",
    "balanced",
    "computed",
    "commanded",
    "holding",
    "before",
    "engaged",
)
WIDTHS = {
    int(mujoco.mjtJoint.mjJNT_FREE): (7, 6),
    int(mujoco.mjtJoint.mjJNT_BALL): (4, 3),
    int(mujoco.mjtJoint.mjJNT_SLIDE): (1, 1),
    int(mujoco.mjtJoint.mjJNT_HINGE): (1, 1),
}


def engaged(q: Array, old: ArmDescription, new: ArmDescription) -> Array:
    """Return joints of an arm with its new tool, (n_new,), from those with the old, (n_old,)."""
    kept = np.isin(old.mechanism.joint_names, [*joints_without_tool(old), ROLL])
    return carried_over(np.where(kept, q, 0.0), old, new)


def warn_of_clipped(
    name: str, before: Array, old: ArmDescription, after: Array, new: ArmDescription
) -> None:
    """Log which joints' set-points the new tool's limits clip."""
    for joint in (*joints_without_tool(old), ROLL):
        here, there = (arm.mechanism.joint_index.get(joint) for arm in (old, new))
        if here is not None and there is not None and before[here] != after[there]:
            log.warning(
                "%s: %s clipped from %.6g to %.6g, the limit of %s",
                *(name, joint, before[here], after[there], new.tool or "the bare arm"),
            )


def keep_settings(old: Motors, new: Motors) -> None:
    """Keep power and compensation, and modes and gains of the arm's own joints."""
    before = old.arm.mechanism.joint_index
    for joint in joints_without_tool(new.arm):
        here, there = new.arm.mechanism.joint_index[joint], before[joint]
        new.gains[here], new.modes[here] = old.gains[there], old.modes[there]
    new.compensate_gravity(old.gravity_compensated)
    new.compute_torque(old.torque_computed)
    if old.powered != new.powered:
        new.switch(old.powered)
    for joint in joints_without_tool(new.arm):
        new.engaged[new.arm.mechanism.joint_index[joint]] = old.engaged[before[joint]]


Physics = tuple[mujoco.MjModel, mujoco.MjData, Servos]


def carry(old: Physics, new: Physics, name: str) -> None:
    """Copy time, joints, servos and the solver's memory of everything but the arm `name`."""
    (model, data, servos), (grown, fresh, inputs) = old, new
    fresh.time = data.time
    qpos, dof = _joint_maps(model, grown, name)
    fresh.qpos[qpos[1]] = data.qpos[qpos[0]]
    for field in ("qvel", "qacc_warmstart", "qfrc_applied"):
        getattr(fresh, field)[dof[1]] = getattr(data, field)[dof[0]]
    for body in range(1, model.nbody):
        if naming.owner(called := model.body(body).name) != name:
            fresh.xfrc_applied[grown.body(called).id] = data.xfrc_applied[body]
    here, there = _actuator_map(model, grown, name)
    for field in CARRIED:
        getattr(inputs, field)[there] = getattr(servos, field)[here]
    observations = inputs.observations()
    observations[:, there] = servos.observations()[:, here]
    inputs.begin_observing(observations)
    act = model.actuator_actadr[here], grown.actuator_actadr[there]
    fresh.act[act[1]] = data.act[act[0]]


def _joint_maps(
    old: mujoco.MjModel, new: mujoco.MjModel, without: str
) -> tuple[tuple[Index, Index], tuple[Index, Index]]:
    """Return (from, to) of coordinates and of rates, of all joints but one arm's."""
    qpos: tuple[list[int], list[int]] = ([], [])
    dof: tuple[list[int], list[int]] = ([], [])
    for k in range(old.njnt):
        joint = old.joint(k).name
        if naming.owner(joint) == without:
            continue
        found = new.joint(joint).id
        wide, free = WIDTHS[int(old.jnt_type[k])]
        for model, index, side in ((old, k, 0), (new, found, 1)):
            qpos[side].extend(int(model.jnt_qposadr[index]) + i for i in range(wide))
            dof[side].extend(int(model.jnt_dofadr[index]) + i for i in range(free))
    return _pair(qpos), _pair(dof)


def _actuator_map(old: mujoco.MjModel, new: mujoco.MjModel, without: str) -> tuple[Index, Index]:
    names = [old.actuator(k).name for k in np.flatnonzero(old.actuator_ctrlnum)]
    here = [k for k, actuator in enumerate(names) if naming.owner(actuator) != without]
    return _pair((here, [new.actuator(names[k]).id for k in here]))


def _pair(both: tuple[list[int], list[int]]) -> tuple[Index, Index]:
    return np.array(both[0], dtype=np.intp), np.array(both[1], dtype=np.intp)
