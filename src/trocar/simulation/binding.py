"""Where an arm's joints are in a compiled model: names resolved to indices once."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigArm
from trocar.modeling import naming

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Binding:
    """Indices of an arm in a model.

    Attributes:
        hinges: frame indices of the arm's hinges, (h,)
        qpos, dof: addresses of the hinges, (h,)
        drive: q = drive @ qpos[hinges], (n, h)
        share: generalised force on q = share @ force on hinges, (n, h); loops as parallelograms
        driven: which hinges each joint's motor turns, (n, h) bool
        actuators, act: ids of servos and of their integral states, (n,)
        frame_bodies: {frame: body id} of frames that are bodies
    """

    hinges: Index
    qpos: Index
    dof: Index
    drive: Array
    share: Array
    driven: NDArray[np.bool_]
    actuators: Index
    act: Index
    frame_bodies: dict[str, int]


def carrier(rig_arm: RigArm, binding: Binding, frame: str) -> tuple[int, Array]:
    """Return the body that carries a frame, and T_body_frame (4, 4)."""
    mechanism = rig_arm.arm.mechanism
    found = mechanism.frame(frame)
    at = np.eye(4)
    while found.name not in binding.frame_bodies and found.parent is not None:
        at = found.before @ found.after @ at
        found = mechanism.frame(found.parent)
    return binding.frame_bodies[found.name], at


def bind(model: mujoco.MjModel, rig_arm: RigArm) -> Binding:
    """Resolve an arm's names in a model; a locked arm has no hinges."""
    arm, mechanism = rig_arm.arm, rig_arm.arm.mechanism
    joints = {model.joint(i).name: i for i in range(model.njnt)}
    hinges: list[int] = []
    ids: list[int] = []
    for index, frame in enumerate(mechanism.frames):
        found = joints.get(naming.scoped(rig_arm.name, frame.name))
        if found is not None:
            hinges.append(index)
            ids.append(found)
    column = {mechanism.frames[h].name: k for k, h in enumerate(hinges)}
    live = arm.joints if hinges else ()
    drive = np.zeros((len(live), len(hinges)))
    for row, joint in enumerate(live):
        for frame, weight in joint.drive:
            drive[row, column[frame]] = weight
    actuators = [model.actuator(naming.scoped(rig_arm.name, j.name)).id for j in live]
    bodies: dict[str, int] = {}
    for frame in mechanism.frames:
        body = mujoco.mj_name2id(
            model, mujoco.mjtObj.mjOBJ_BODY, naming.scoped(rig_arm.name, frame.name)
        )
        if body >= 0:
            bodies[frame.name] = body
    return Binding(
        hinges=np.array(hinges, dtype=np.intp),
        qpos=np.array([model.jnt_qposadr[i] for i in ids], dtype=np.intp),
        dof=np.array([model.jnt_dofadr[i] for i in ids], dtype=np.intp),
        drive=drive,
        share=mechanism.ratios[hinges].T.copy() if hinges else np.zeros((0, 0)),
        driven=drive != 0.0,
        actuators=np.array(actuators, dtype=np.intp),
        act=np.array([model.actuator_actadr[a] for a in actuators], dtype=np.intp),
        frame_bodies=bodies,
    )
