"""The meaning of recorded rows: joints, tips and objects from copies of the physics state."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import quaternion_from_matrix
from trocar.geometry.se3 import inverse
from trocar.modeling import naming
from trocar.modeling.joints import INPUTS
from trocar.simulation import World
from trocar.simulation.objects import ObjectKinematics

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Parts of the physics state in a row, in MuJoCo's order.
STATE = int(
    mujoco.mjtState.mjSTATE_TIME
    | mujoco.mjtState.mjSTATE_QPOS
    | mujoco.mjtState.mjSTATE_QVEL
    | mujoco.mjtState.mjSTATE_ACT
    | mujoco.mjtState.mjSTATE_CTRL
)
#: x, y, z and the quaternion xyzw, from position and quaternion wxyz.
POSE_ORDER = np.array([0, 1, 2, 4, 5, 6, 3])
#: The values of each joint that a recording keeps, in this order.
QUANTITIES = ("position", "velocity", "effort", "setpoint")


@dataclass(frozen=True)
class ArmColumns:
    """The columns of one arm.

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


@dataclass(frozen=True, eq=False)
class Layout:
    """The map from rows of the state to joints, (n_joints,) over all arms; made by `layout_of`.

    Attributes:
        number: counts the layouts of a recording from 0
        model: the model that the rows are states of
        arms: columns of each arm
        rest: positions of joints that are welded into the model, else 0, (n_joints,)
        drive, rate: q = rest + drive @ qpos, qd = rate @ qvel, (n_joints, nq) and (n_joints, nv)
        live: joints that have a servo, (s,)
        servos, integrals: columns in a row of their three inputs, (3, s), and of their integrals
        objects: names of the movable props
        kinematics: poses of the movable props from their coordinates
        frame_ids: the frame of each arm's tip pose, (a,)
        sites: at the tips, then where they are seen from, (2 a,)
        before: poses of these in the frames, (a, 4, 4)
    """

    number: int
    model: mujoco.MjModel
    arms: tuple[ArmColumns, ...]
    rest: Array
    drive: Array
    rate: Array
    live: Index
    servos: Index
    integrals: Index
    objects: tuple[str, ...]
    kinematics: ObjectKinematics
    frame_ids: tuple[str, ...]
    sites: Index
    before: Array


@dataclass(frozen=True, eq=False)
class Rows:
    """Consecutive states of a world, one per physics step.

    Attributes:
        layout: the meaning of a row
        gains: P, I, D and effort limit of each live servo, as they acted, (s, 4)
        first: number of the first row since the recording began
        states: time and the rest of `STATE`, (k, size)
    """

    layout: Layout
    gains: Array
    first: int
    states: Array


def joint_values(rows: Rows) -> Array:
    """Return `QUANTITIES` of every joint, (4, n_joints, k) [rad or m, per s, N m or N]."""
    layout, nq, nv = rows.layout, rows.layout.model.nq, rows.layout.model.nv
    found = np.zeros((len(QUANTITIES), len(layout.rest), len(rows.states)))
    # Not @: it would wake the threads of the algebra library, which then spin.
    qpos, qvel = rows.states[:, 1 : 1 + nq], rows.states[:, 1 + nq : 1 + nq + nv]
    found[0] = layout.rest[:, None] + np.einsum("jq,kq->jk", layout.drive, qpos)
    found[1] = np.einsum("jv,kv->jk", layout.rate, qvel)
    found[3] = layout.rest[:, None]
    p, i, d, limit = rows.gains.T[:, :, None]
    goal, rate, fed_forward = rows.states.T[layout.servos]
    effort = p * (goal - found[0, layout.live]) + i * rows.states.T[layout.integrals]
    effort += d * (rate - found[1, layout.live]) + fed_forward
    found[2, layout.live] = np.clip(effort, -limit, limit)
    found[3, layout.live] = goal
    return found


def tip_poses(layout: Layout, scratch: mujoco.MjData, states: Array) -> Array:
    """Return position and quaternion xyzw of every arm's tip as `Arm.measured_cp`, (k, a, 7) [m].

    Args:
        layout: of the states
        scratch: of the layout's model; overwritten
        states: (k, size)
    """
    at = np.zeros((len(states), len(layout.sites), 4, 4))
    at[:, :, 3, 3] = 1.0
    for row, state in enumerate(states):
        scratch.qpos[:] = state[1 : 1 + layout.model.nq]
        mujoco.mj_kinematics(layout.model, scratch)
        at[row, :, :3, 3] = scratch.site_xpos[layout.sites]
        at[row, :, :3, :3] = scratch.site_xmat[layout.sites].reshape(-1, 3, 3)
    count = len(layout.frame_ids)
    tips = layout.before @ inverse(at[:, count:]) @ at[:, :count]
    quaternions = quaternion_from_matrix(tips[..., :3, :3])
    return np.concatenate([tips[..., :3, 3], np.roll(quaternions, -1, axis=-1)], axis=-1)


def object_poses(layout: Layout, states: Array) -> Array:
    """Return position and quaternion xyzw of every movable prop in the world, (k, objects, 7) [m].

    Args:
        layout: of the states
        states: (k, size)
    """
    return layout.kinematics.poses(states[:, 1 : 1 + layout.model.nq])[..., POSE_ORDER]


def layout_of(world: World, number: int) -> Layout:
    """Return the layout of a world's rows as its model and base frames are now."""
    model, table = world.mj_model, world.joints
    act = 1 + model.nq + model.nv
    arms: list[ArmColumns] = []
    first = 0
    for rig_arm in world.rig.arms:
        arm = rig_arm.arm
        names, kinds = arm.mechanism.joint_names, tuple(joint.kind for joint in arm.joints)
        arms.append(ArmColumns(rig_arm.name, arm.type, names, kinds, arm.has_jaw, first))
        first += len(names)
    rest, drive, rate = np.zeros(first), np.zeros((first, model.nq)), np.zeros((first, model.nv))
    live: list[int] = []
    for arm in arms:
        if world.arm(arm.name).runtime.motors.welded:
            rest[arm.columns] = world.arm(arm.name).joints.positions()
            continue
        rows = table.arms[arm.name].rows
        drive[arm.columns], rate[arm.columns] = table.drive[rows], table.rate[rows]
        live += range(arm.columns.start, arm.columns.stop)
    servos = np.arange(len(table))
    views = [arm.runtime.tip.view() for arm in world.arms.values()]
    tips = [model.site(naming.frame_site(name, "tip")).id for name in world.arms]
    return Layout(
        number,
        model,
        tuple(arms),
        rest,
        drive,
        rate,
        np.array(live, np.intp),
        act + model.na + INPUTS * servos + np.arange(INPUTS)[:, None],
        act + servos,
        tuple(world.objects),
        ObjectKinematics(world.rig, model),
        tuple(frame for _, _, frame in views),
        np.array([*tips, *(site for site, _, _ in views)], np.intp),
        np.stack([before for _, before, _ in views]),
    )


def effective_gains(world: World) -> Array:
    """Return P, I, D and effort limit of every live servo as they act now, (s, 4)."""
    gains, limit = world.servos.effective
    return np.column_stack([gains, limit])


def present_row(world: World, layout: Layout, number: int) -> Rows:
    """Return the present state of a world as one row.

    Args:
        world: at rest or in motion
        layout: of the world
        number: of the row since the recording began
    """
    states = np.empty((1, mujoco.mj_stateSize(layout.model, STATE)))
    mujoco.mj_getState(world.mj_model, world.mj_data, states[0], STATE)
    return Rows(layout, effective_gains(world), number, states)
