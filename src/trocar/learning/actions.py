"""Kinds of actions from -1 to 1, which become the actions of `TipController` period by period."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, UnknownNameError
from trocar.geometry.rotations import (
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
)
from trocar.inputs import shown
from trocar.kinematics.chain_pose import ChainPose, chain_pose
from trocar.learning.observations import scene_centre
from trocar.learning.readings import SceneReadings
from trocar.tasks import Task
from trocar.tasks.controller import GRIP_RAD, PERIOD_S, SPEED_M_S, SPIN_RAD_S

Array = NDArray[np.float64]

#: Durations of an action that are offered. Source: our own choice; 0.2 s is SurRoL's. [s]
ACTION_PERIODS_S = (0.02, 0.1, 0.2)
#: Reach of "tip-setpoint" about the scene's centre, each way. Source: our own choice; the scenes'
#: objects lie within 60 mm of it. [m]
REACH_M = 0.1
#: Velocities of SurRoL's actions: 10 mm and 30 degrees, or 15 of pitch, in a step of 0.2 s.
#: Source: med-air/SurRoL, surrol/tasks/psm_env.py, `_set_action`. [m/s, rad/s, rad/s]
SURROL_M_S, SURROL_YAW_RAD_S, SURROL_PITCH_RAD_S = 0.05, np.radians(150.0), np.radians(75.0)
#: Of an endoscope's roll: 3 degrees in a step of 0.1 s. Source: ecm_env.py there. [rad/s]
SURROL_ROLL_RAD_S = np.radians(30.0)
#: Opening of SurRoL's open jaw. Source: as above. [rad]
SURROL_OPEN_RAD = np.radians(40.0)
#: Factor on ORBIT-Surgical's joint and relative actions. Source: orbit-surgical/orbit-surgical,
#: config/psm/joint_pos_env_cfg.py and ik_rel_env_cfg.py, `scale`. [rad or m]
ORBIT_SCALE = 0.5
#: Openings of its jaw: fingers at 0.5 and 0.07 rad each way. Source: as above,
#: config/needle/joint_pos_env_cfg.py; ours closes with a grip where theirs stops at 0.14 rad. [rad]
ORBIT_OPEN_RAD = 1.0
#: Step of the numerical Jacobian of an endoscope. Source: our own choice. [rad or m]
STEP = 1e-6


@dataclass(frozen=True, eq=False)
class DrivenArm:
    """An arm of the scene, as kinds of actions convert its numbers.

    Attributes:
        name: of the arm
        psm: whether it is a PSM, else an ECM
        jaw: whether actions drive the jaw; it rests where the scene only asks for places of tips
        part: of the actions of `TipController`
        most: largest values of that part, (k,)
        low, high: limits of its joints without the jaw, (j,) [rad or m]
        fastest: their velocities, (j,) [rad/s or m/s]
        start: its joints at the scene's start pose, the jaw last, (j + 1,) [rad or m]
        base: its reference frame in the world, (4, 4)
        chain: returns poses of its tip in that frame
        centre: of the scene, (3,) [m]
    """

    name: str
    psm: bool
    jaw: bool
    part: slice
    most: Array
    low: Array
    high: Array
    fastest: Array
    start: Array
    base: Array
    chain: ChainPose
    centre: Array

    def tips(self, q: Array) -> Array:
        """Return poses of the tip in the world at joint positions (n, all joints), (n, 4, 4)."""
        return self.base @ self.chain(q)


#: Returns an arm's part of the actions of `TipController` (n, k) from its numbers (n, m), each in
#: [-1, 1], the readings, and the time until the action ends [s].
Convert = Callable[[DrivenArm, Array, SceneReadings, float], Array]


class ActionKind:
    """Actions of n worlds, each number from -1 to 1, as a policy chooses them.

    Args:
        name: one of `KINDS`
        task: of the scene
        action_period: duration of an action, one of `ACTION_PERIODS_S` [s]

    Attributes:
        name, action_period: as given
        names: of the numbers, (m,)
        low, high: -1 and 1, (m,)
        periods: of 20 ms in an action
        reads: whether `velocities` looks at the readings of each period; without, those at the
            beginning of the action do

    Raises:
        UnknownNameError: no such kind
        InputError: another period, or a kind that the scene's arms do not have
    """

    def __init__(self, name: str, task: Task, action_period: float) -> None:
        if name not in KINDS:
            raise UnknownNameError("action", name, KINDS, task.scene.name)
        if action_period not in ACTION_PERIODS_S:
            allowed = ", ".join(f"{one:g}" for one in ACTION_PERIODS_S)
            raise InputError(
                f"{task.scene.name}: action_period: got {shown(action_period)}; allowed: {allowed}"
            )
        kind = KINDS[name]
        self.name, self.action_period = name, float(action_period)
        self.periods = round(action_period / PERIOD_S)
        self._label = task.scene.name
        self._arms = _driven_arms(task)
        self._convert = [kind.psm if arm.psm else kind.ecm for arm in self._arms]
        self.reads = not all(convert in WITHOUT_READINGS for convert in self._convert)
        names: list[str] = []
        self._parts: list[slice] = []
        for arm in self._arms:
            own = kind.psm_names if arm.psm else kind.ecm_names
            if not own:
                fit = [k for k, one in KINDS.items() if one.psm_names and one.ecm_names]
                raise InputError(
                    f"{self._label}: action: got {name!r}, which has no numbers for {arm.name};"
                    f" allowed: {', '.join(fit)}"
                )
            if arm.psm and not arm.jaw and name in JAWLESS:
                own = own[:-1]
            self._parts.append(slice(len(names), len(names) + len(own)))
            names += [f"{arm.name}.{one}" for one in own]
        self.names = tuple(names)
        self.high = np.ones(len(names), np.float32)
        self.low = -self.high

    def check(self, action: ArrayLike | Sequence[ArrayLike], n: int | None = None) -> Array:
        """Return the actions of n worlds, clipped to [-1, 1], (n, m).

        Args:
            action: (n, m), or (m,) of a single world
            n: number of worlds; None for a single one

        Raises:
            InputError: another shape or kind of numbers, or one that is not finite; the world is
                named
        """
        try:
            given = np.asarray(action)
        except ValueError:  # rows of different lengths
            given = np.empty(0)
        shape = (len(self.names),) if n is None else (n, len(self.names))
        if given.shape != shape:
            got = given.shape if given.size else shown(action)
            raise InputError(f"{self._label}: action: got the shape {got}; allowed: {shape}")
        if given.dtype.kind not in "fiu":
            raise InputError(
                f"{self._label}: action: got {given.dtype} as dtype; allowed: float32 or float64"
            )
        given = np.atleast_2d(given)
        if not (finite := np.isfinite(given)).all():
            world, column = np.argwhere(~finite)[0].tolist()
            place = f"world {world}: " if len(given) > 1 else ""
            raise InputError(
                f"{self._label}: action: {place}got {given[world, column]} as"
                f" {self.names[column]}; allowed: finite numbers"
            )
        return np.clip(given.astype(np.float64), -1.0, 1.0)

    def velocities(self, action: Array, readings: SceneReadings, period: int) -> Array:
        """Return the actions of `TipController` for one period of 20 ms, (n, k).

        Args:
            action: of `check`, (n, m)
            readings: of the n worlds, at the beginning of the period (see `reads`)
            period: number of it in the action, from 0
        """
        left = PERIOD_S * (self.periods - period)
        return np.concatenate(
            [
                convert(arm, action[:, part], readings, left)
                for arm, part, convert in zip(self._arms, self._parts, self._convert, strict=True)
            ],
            axis=1,
        )


def make_actions(kind: str, task: Task, action_period: float) -> ActionKind:
    """Return a kind of actions of a scene, see `ActionKind` and `KINDS`."""
    return ActionKind(kind, task, action_period)


def _driven_arms(task: Task) -> list[DrivenArm]:
    """Return the arms that the actions of a scene drive."""
    scene, world, centre = task.scene, task.world, scene_centre(task)
    jaw = any(goal.held or not goal.arm for goal in scene.goals)
    found: list[DrivenArm] = []
    at = 0
    for name in task.arms:
        arm = world.arms[name]
        psm, own = arm.description.type == "PSM", arm.description.own_joints
        size = 7 if psm else own
        part = slice(at, at + size)
        at += size
        found.append(
            DrivenArm(
                name,
                psm,
                jaw,
                part,
                task.limits[1][part],
                np.array(arm.joints.lower)[:own],
                np.array(arm.joints.upper)[:own],
                np.array([joint.velocity_max for joint in arm.description.joints[:own]]),
                np.array(scene.rig.poses["start"][name], np.float64),
                world.reference_pose(name),
                chain_pose(arm.description.mechanism),
                centre,
            )
        )
    return found


# ---------------------------------------------------------------------- parts of actions


def _opening(arm: DrivenArm, a: Array) -> Array:
    """Return openings of the jaw: -1 grips, 1 is wide open, (n,) [rad]."""
    return -GRIP_RAD + (a + 1.0) / 2.0 * (arm.most[-1] + GRIP_RAD)


def _binary(arm: DrivenArm, a: Array, opened: float) -> Array:
    """Return openings of a jaw that grips below 0, (n,) [rad]."""
    return np.where(a < 0.0, -GRIP_RAD, min(opened, arm.most[-1]))


def _within(v: Array, most: float) -> Array:
    """Return vectors (n, 3) whose components are within a limit, in their direction."""
    largest = np.abs(v).max(axis=1, keepdims=True)
    return v * np.minimum(1.0, most / np.maximum(largest, most))


def _twist_to(target: Array, goal: Array, seconds: float) -> Array:
    """Return the twists (n, 6) from poses to others (n, 4, 4) in a time, in the world."""
    turn = rotation_vector_from_matrix(goal[:, :3, :3] @ target[:, :3, :3].transpose(0, 2, 1))
    return np.concatenate([goal[:, :3, 3] - target[:, :3, 3], turn], axis=1) / seconds


def _to_pose(target: Array, goal: Array, seconds: float) -> Array:
    """Return the twists (n, 6) towards poses, as fast as the limits of speed and spin allow."""
    twist = _twist_to(target, goal, seconds)
    return np.concatenate([_within(twist[:, :3], SPEED_M_S), _within(twist[:, 3:], SPIN_RAD_S)], 1)


def _by_joints(arm: DrivenArm, readings: SceneReadings, v: Array) -> Array:
    """Return the twists (n, 6) by which a PSM's set-points move at joint velocities for 20 ms.

    The inverse kinematics of `TipController` then finds these very joints, unless the tip would be
    faster than its limits, in which case all joints are slower in proportion.
    """
    q = readings.setpoints[arm.name].copy()
    own = len(arm.low)
    q[:, :own] = np.clip(q[:, :own] + PERIOD_S * v, arm.low, arm.high)
    twist = _twist_to(readings.targets[arm.name], arm.tips(q), PERIOD_S)
    most = np.abs(twist / arm.most[:6]).max(axis=1, keepdims=True)
    return twist / np.maximum(most, 1.0)


def _to_joints(arm: DrivenArm, readings: SceneReadings, goal: Array, seconds: float) -> Array:
    """Return joint velocities (n, j) towards positions (n, j), within their limits."""
    v = (goal - readings.setpoints[arm.name][:, : len(arm.low)]) / seconds
    return np.clip(v, -arm.fastest, arm.fastest)


def _psm_tip(arm: DrivenArm, a: Array, readings: SceneReadings, left: float) -> Array:  # noqa: ARG001
    return np.concatenate([a[:, :6] * arm.most[:6], _opening(arm, a[:, 6:])], axis=1)


def _ecm_joint(arm: DrivenArm, a: Array, readings: SceneReadings, left: float) -> Array:  # noqa: ARG001
    return a * arm.most


def _psm_setpoint(arm: DrivenArm, a: Array, readings: SceneReadings, left: float) -> Array:
    goal = np.tile(np.eye(4), (len(a), 1, 1))
    goal[:, :3, 3] = arm.centre + REACH_M * a[:, :3]
    start = arm.tips(arm.start[None])[0, :3, :3]
    goal[:, :3, :3] = matrix_from_rotation_vector(np.pi * a[:, 3:6]) @ start
    twist = _to_pose(readings.targets[arm.name], goal, left)
    return np.concatenate([twist, _opening(arm, a[:, 6:])], axis=1)


def _ecm_setpoint(arm: DrivenArm, a: Array, readings: SceneReadings, left: float) -> Array:
    goal = arm.low + (a + 1.0) / 2.0 * (arm.high - arm.low)
    return _to_joints(arm, readings, goal, left)


def _psm_joint(arm: DrivenArm, a: Array, readings: SceneReadings, left: float) -> Array:  # noqa: ARG001
    twist = _by_joints(arm, readings, a[:, :6] * arm.fastest)
    return np.concatenate([twist, _opening(arm, a[:, 6:])], axis=1)


def _psm_surrol(arm: DrivenArm, a: Array, readings: SceneReadings, left: float) -> Array:  # noqa: ARG001
    return _surrol(arm, a, 5, SURROL_YAW_RAD_S)


def _psm_surrol_pitch(arm: DrivenArm, a: Array, readings: SceneReadings, left: float) -> Array:  # noqa: ARG001
    return _surrol(arm, a, 4, SURROL_PITCH_RAD_S)


def _surrol(arm: DrivenArm, a: Array, axis: int, spin: float) -> Array:
    """Return SurRoL's actions: way of the tip, rotation about one axis of the world, jaw."""
    found = np.zeros((len(a), 7))
    found[:, :3], found[:, axis] = SURROL_M_S * a[:, :3], spin * a[:, 3]
    found[:, 6] = _binary(arm, a[:, 4], SURROL_OPEN_RAD) if arm.jaw else arm.start[-1]
    return found


def _ecm_surrol(arm: DrivenArm, a: Array, readings: SceneReadings, left: float) -> Array:  # noqa: ARG001
    """Return the velocities of yaw, pitch and insertion that move the tip along its own axes."""
    q = readings.setpoints[arm.name]
    here = arm.chain(q)
    moved = [arm.chain(q + STEP * row)[:, :3, 3] - here[:, :3, 3] for row in np.eye(q.shape[1])[:3]]
    J = np.stack(moved, axis=2) / STEP
    v = here[:, :3, :3] @ (SURROL_M_S * a[:, :, None])
    found = np.zeros((len(a), len(arm.most)))
    found[:, :3] = (np.linalg.pinv(J, rcond=1e-3) @ v)[:, :, 0]
    return found / np.maximum(np.abs(found / arm.most).max(axis=1, keepdims=True), 1.0)


def _ecm_surrol_roll(arm: DrivenArm, a: Array, readings: SceneReadings, left: float) -> Array:  # noqa: ARG001
    found = np.zeros((len(a), len(arm.most)))
    found[:, -1] = min(SURROL_ROLL_RAD_S, arm.most[-1]) * a[:, 0]
    return found


def _psm_orbit_joint(arm: DrivenArm, a: Array, readings: SceneReadings, left: float) -> Array:
    own = len(arm.low)
    goal = np.clip(arm.start[:own] + ORBIT_SCALE * a[:, :own], arm.low, arm.high)
    twist = _by_joints(arm, readings, _to_joints(arm, readings, goal, left))
    return np.concatenate([twist, _orbit_jaw(arm, a[:, own:])], axis=1)


def _psm_orbit_absolute(arm: DrivenArm, a: Array, readings: SceneReadings, left: float) -> Array:
    goal = np.tile(np.eye(4), (len(a), 1, 1))
    goal[:, :3, 3] = arm.base[:3, 3] + a[:, :3]
    turn = np.where(np.abs(a[:, 3:7]).max(axis=1, keepdims=True) < 1e-6, [1, 0, 0, 0], a[:, 3:7])
    goal[:, :3, :3] = matrix_from_quaternion(turn)
    twist = _to_pose(readings.targets[arm.name], goal, left)
    return np.concatenate([twist, _orbit_jaw(arm, a[:, 7:])], axis=1)


def _psm_orbit_relative(arm: DrivenArm, a: Array, readings: SceneReadings, left: float) -> Array:  # noqa: ARG001
    way = ORBIT_SCALE * a[:, :6] / PERIOD_S
    parts = _within(way[:, :3], SPEED_M_S), _within(way[:, 3:], SPIN_RAD_S)
    return np.concatenate([*parts, _orbit_jaw(arm, a[:, 6:])], axis=1)


def _orbit_jaw(arm: DrivenArm, a: Array) -> Array:
    """Return openings of the jaw from its number (n, 1), or from none (n, 0), (n, 1) [rad]."""
    return _binary(arm, a, ORBIT_OPEN_RAD) if a.size else np.full((len(a), 1), arm.start[-1])


@dataclass(frozen=True, eq=False)
class _Kind:
    """A kind of actions.

    Attributes:
        psm_names, ecm_names: of the numbers of a PSM and of an ECM; empty: it has none
        psm, ecm: convert these
    """

    psm_names: tuple[str, ...]
    ecm_names: tuple[str, ...]
    psm: Convert
    ecm: Convert


_XYZ, _TURN = ("x", "y", "z"), ("about_x", "about_y", "about_z")
_PSM_JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
_ECM_JOINTS = ("yaw", "pitch", "insertion", "roll")

#: Kinds of actions, of each arm. "jaw" is the opening, -1 a grip and 1 wide open; "shut" grips
#: below 0 and opens else. Set-points are approached on straight lines, at the end of the action or
#: as fast as the limits of `TipController` allow.
#:
#: - "tip": velocity of the tip and angular velocity in axes of the world, as ratios of the limits
#:   (0.2 m/s, 4 rad/s); jaw. An ECM: velocities of its joints as ratios of the largest ones.
#: - "tip-setpoint": position about the scene's centre over 0.1 m, rotation vector from the
#:   orientation at the start pose over pi, in axes of the world; jaw. An ECM: positions of its
#:   joints, -1 and 1 at their limits.
#: - "joint": velocities of the joints as ratios of the largest ones, all slower where the tip would
#:   exceed its limits; jaw. An ECM as with "tip".
#: - "surrol": way of the tip in axes of the world, 10 mm in 0.2 s; rotation about the world's z, 30
#:   degrees in 0.2 s; shut, ignored where the scene only asks for places of tips. An ECM: way of
#:   the tip in its own axes, 10 mm in 0.2 s. "surrol-pitch" rotates about y, by 15 degrees.
#:   "surrol-roll" only rolls an ECM, 3 degrees in 0.1 s.
#: - "orbit-joint": joint positions, offset from the start pose over 0.5 rad or m; shut.
#:   "orbit-ik-abs": position from the remote centre in axes of the world [m], quaternion wxyz;
#:   shut. "orbit-ik-rel": way [m] and rotation vector [rad] over 0.5 in 20 ms, which the limits of
#:   speed cut; shut. Where the scene only asks for places of tips, they lack "shut".
KINDS = {
    "tip": _Kind((*_XYZ, *_TURN, "jaw"), _ECM_JOINTS, _psm_tip, _ecm_joint),
    "tip-setpoint": _Kind((*_XYZ, *_TURN, "jaw"), _ECM_JOINTS, _psm_setpoint, _ecm_setpoint),
    "joint": _Kind((*_PSM_JOINTS, "jaw"), _ECM_JOINTS, _psm_joint, _ecm_joint),
    "surrol": _Kind((*_XYZ, "yaw", "shut"), _XYZ, _psm_surrol, _ecm_surrol),
    "surrol-pitch": _Kind((*_XYZ, "pitch", "shut"), _XYZ, _psm_surrol_pitch, _ecm_surrol),
    "surrol-roll": _Kind((), ("roll",), _psm_surrol, _ecm_surrol_roll),
    "orbit-joint": _Kind((*_PSM_JOINTS, "shut"), (), _psm_orbit_joint, _ecm_joint),
    "orbit-ik-abs": _Kind(
        (*_XYZ, "qw", "qx", "qy", "qz", "shut"), (), _psm_orbit_absolute, _ecm_joint
    ),
    "orbit-ik-rel": _Kind((*_XYZ, *_TURN, "shut"), (), _psm_orbit_relative, _ecm_joint),
}
#: Conversions that do not look at readings.
WITHOUT_READINGS = (
    _psm_tip,
    _ecm_joint,
    _psm_surrol,
    _psm_surrol_pitch,
    _ecm_surrol_roll,
    _psm_orbit_relative,
)
#: Kinds that lack the jaw where the scene only asks for places of tips. Source: ORBIT-Surgical's
#: reach has no gripper action.
JAWLESS = frozenset({"orbit-joint", "orbit-ik-abs", "orbit-ik-rel"})
