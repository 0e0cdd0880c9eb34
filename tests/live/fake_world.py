"""A small kinematic stand-in for `trocar.simulation.World`, with the same public names.

Its joints follow their set-points with a lag of 20 ms; nothing here is physics.
"""

from __future__ import annotations

import logging
from types import SimpleNamespace as Namespace

import numpy as np

from trocar.errors import DivergedError, UnknownNameError
from trocar.simulation.records import (
    ArmSnapshot,
    Health,
    JointState,
    Mode,
    ShapeRecord,
    Snapshot,
)

_log = logging.getLogger("trocar")
LAG_S = 0.02
LENGTHS = ("insertion", "lift")


def verbs(*names: str):
    """Mark methods of a class as commands, as the simulation does."""

    def mark(kind: type) -> type:
        for name in names:
            getattr(kind, name).is_command = True
        return kind

    return mark


@verbs("move_jp", "servo_jp", "servo_jf")
class FakeJaw:
    def __init__(self, arm: FakeArm) -> None:
        self._arm = arm

    def move_jp(self, q) -> None:
        self._arm.goal[-1:] = q

    def servo_jp(self, q) -> None:
        self._arm.goal[-1:] = self._arm.setpoint[-1:] = q

    def servo_jf(self, effort) -> None:
        self._arm.effort[-1:] = effort


@verbs(
    "servo_jp",
    "servo_jf",
    "move_jp",
    "move_to",
    "hold",
    "set_mode",
    "set_gains",
    "use_gravity_compensation",
    "release_brakes",
    "lock_brakes",
)
class FakeArm:
    """An arm whose set-points run to their goals at a limited speed."""

    def __init__(self, name: str, kind: str, joints: dict[str, tuple[float, float]], rcm) -> None:
        self.name = name
        self.joints, self.local = self, self  # parts of an Arm, in one
        self.runtime = Namespace(motors=Namespace(welded=False))
        self.names = tuple(joints)
        self.lower = np.array([low for low, _ in joints.values()])
        self.upper = np.array([high for _, high in joints.values()])
        n = len(joints)
        kinds = ["prismatic" if joint in LENGTHS else "revolute" for joint in joints]
        self.description = Namespace(
            mechanism=Namespace(joints=[Namespace(kind=kind) for kind in kinds]),
            inverse_kinematics="",
            tool_frame="",
            tool="",
            type=kind,
        )
        self.effort_limit = np.full(n, 3.316)
        self.has_jaw = "jaw" in joints
        self.jaw = FakeJaw(self) if self.has_jaw else None
        self.gripper = None
        self.poses = {"home": np.clip(np.zeros(n), self.lower, self.upper)}
        self.poses["start"] = np.clip(self.poses["home"] + 0.1, self.lower, self.upper)
        self.remote_centre = rcm
        self.calls: list[tuple] = []
        self.warnings = 0
        self._gains = dict.fromkeys(joints, (100.0, 0.0, 5.0))
        self.gravity_compensation = True
        self.brakes = dict.fromkeys(joints, True) if kind == "SUJ" else {}
        self.restart()

    def restart(self) -> None:
        self.q = self.poses["home"].copy()
        self.goal = self.q.copy()
        self.setpoint = self.q.copy()
        self.effort = np.zeros_like(self.q)
        self.modes: list[Mode] = ["position"] * self.q.size

    def advance(self, dt: float) -> None:
        reach = 0.6 * dt
        self.setpoint += np.clip(self.goal - self.setpoint, -reach, reach)
        pushed = np.array([mode == "effort" for mode in self.modes])
        self.q += np.where(pushed, self.effort * 0.1, (self.setpoint - self.q) / LAG_S) * dt
        self.q = np.clip(self.q, self.lower, self.upper)

    def measured_js(self) -> JointState:
        n = self.q.size - self.has_jaw
        return JointState(
            self.names[:n], self.q[:n].copy(), np.zeros(n), self.effort[:n].copy(), 0.0
        )

    def measured_cp(self) -> Namespace:
        return Namespace(matrix=np.eye(4))

    def servo_jp(self, q, v=None) -> None:  # noqa: ARG002
        self.calls.append(("servo_jp", tuple(q)))
        self.goal[: len(q)] = self.setpoint[: len(q)] = self._inside(q)

    def servo_jf(self, effort) -> None:
        self.calls.append(("servo_jf", tuple(effort)))
        self.effort[: len(effort)] = effort

    def move_jp(self, q) -> None:
        self.calls.append(("move_jp", tuple(q)))
        self.goal[: len(q)] = self._inside(q)

    def move_to(self, name: str) -> None:
        if name not in self.poses:
            raise UnknownNameError("pose", name, self.poses, self.name)
        self.goal[:] = self.poses[name]

    def hold(self) -> None:
        self.goal[:] = self.setpoint

    def set_mode(self, mode, joints=None) -> None:
        for index, joint in enumerate(self.names):
            if joints is None or joint in joints:
                self.modes[index] = mode

    def gains(self, joint):
        return self._gains[joint]

    def set_gains(self, joint, p=None, i=None, d=None) -> None:
        new = (p, i, d)
        old = self._gains[joint]
        p, i, d = (o if n is None else n for n, o in zip(new, old, strict=True))
        self._gains[joint] = (p, i, d)

    def use_gravity_compensation(self, on: bool) -> None:
        self.gravity_compensation = on

    def release_brakes(self, joints=None) -> None:
        self.brakes = dict.fromkeys(joints or self.brakes, False)

    def lock_brakes(self, joints=None) -> None:
        self.brakes = dict.fromkeys(joints or self.brakes, True)

    def _inside(self, q):
        n = len(q)
        clipped = np.clip(q, self.lower[:n], self.upper[:n])
        if not np.array_equal(clipped, q):
            self.warnings += 1
            _log.warning("%s: target clipped to the joint limits", self.name)
        return clipped


PSM = {
    "yaw": (-1.5994, 1.5994),
    "pitch": (-0.9425, 0.9425),
    "insertion": (0.0, 0.24),
    "roll": (-4.5, 4.5),
    "jaw": (-0.698, 1.396),
}
SUJ = {"lift": (-0.38, 0.84), "swing": (-1.5, 1.5)}


@verbs("reset")
class FakeWorld:
    """One column, and an arm of three bodies for each PSM."""

    def __init__(self, *, timestep_s: float = 0.001, fail_at: float | None = None) -> None:
        self.timestep = timestep_s
        self.time = 0.0
        self.steps = 0
        self.fail_at = fail_at
        centres = {"PSM1": (0.15, -0.25, 0.9), "PSM2": (-0.15, -0.25, 0.9)}
        self.arms = {name: FakeArm(name, "PSM", PSM, np.array(p)) for name, p in centres.items()}
        self.objects = {}
        self.tissues = {}
        self.parts = {}
        self.rig = Namespace(name="fake", title="A fake", poses={"start": dict.fromkeys(centres)})
        self.arms["SUJ1"] = FakeArm("SUJ1", "SUJ", SUJ, None)

    @property
    def periods(self) -> int:
        return self.steps

    def arm(self, name: str) -> FakeArm:
        if name not in self.arms:
            raise UnknownNameError("arm", name, self.arms)
        return self.arms[name]

    def step(self, n: int = 1) -> None:
        for _ in range(n):
            for arm in self.arms.values():
                arm.advance(self.timestep)
            self.steps += 1
            self.time = self.steps * self.timestep
            if self.fail_at is not None and self.time > self.fail_at:
                raise DivergedError(self.time, "PSM1/yaw", 0.3)

    def reset(self, seed=None, pose: str = "start") -> None:  # noqa: ARG002
        self.time, self.steps = 0.0, 0
        for arm in self.arms.values():
            arm.restart()

    def reference_pose(self, name: str) -> np.ndarray:
        return _at(*self.arms[name].remote_centre)

    def health(self) -> Health:
        return Health(4e-8, 7e-7, True, 0.36, {})

    def save(self) -> Namespace:
        return Namespace(time=self.time)

    def shapes(self) -> tuple[ShapeRecord, ...]:
        grey, dark, steel = (0.8, 0.8, 0.82, 1.0), (0.15, 0.15, 0.17, 1.0), (0.7, 0.72, 0.75, 1.0)
        column = _shape(0, "column", "box", (0.2, 0.15, 0.75), _at(0, 0.35, 0.75), grey, None)
        found = [column]
        for index, name in enumerate(("PSM1", "PSM2")):
            body = 1 + 3 * index
            found += [
                _shape(body, "yaw", "capsule", (0.05, 0.2), _at(0, 0.2, 0.1), grey, name),
                _shape(body, "hub", "cylinder", (0.07, 0.06), _at(0, 0.35, 0.1), dark, name),
                _shape(
                    body + 1, "carriage", "box", (0.03, 0.03, 0.12), _at(0, 0, 0.25), dark, name
                ),
                _shape(body + 2, "shaft", "cylinder", (0.0042, 0.2), _at(0, 0, 0), steel, name),
                _shape(body + 2, "wrist", "sphere", (0.006,), _at(0, 0, -0.2), steel, name),
            ]
        return tuple(found)

    def snapshot(self, *, arms: bool = True) -> Snapshot:
        positions, quaternions = [np.zeros(3)], [np.array([1.0, 0, 0, 0])]
        for name in ("PSM1", "PSM2"):
            yaw, pitch, insertion = self.arms[name].q[:3]
            turn = _product(_about(1, yaw), _about(0, pitch))
            for depth in (0.0, 0.1 - 0.2 * insertion, 0.15 - insertion):
                positions.append(self.arms[name].remote_centre + _matrix(turn) @ [0, 0, depth])
                quaternions.append(turn)
        told = {name: self._arm_snapshot(arm) for name, arm in self.arms.items() if arms}
        return Snapshot(self.time, np.array(positions), np.array(quaternions), told)

    def _arm_snapshot(self, arm: FakeArm) -> ArmSnapshot:
        return ArmSnapshot(
            joint_names=arm.names,
            q=arm.q.copy(),
            qd=np.zeros_like(arm.q),
            effort=arm.effort.copy(),
            setpoint=arm.setpoint.copy(),
            modes=tuple(arm.modes),
            busy=bool(np.any(arm.goal != arm.setpoint)),
            locked=tuple(arm.brakes.get(joint, False) for joint in arm.names),
            remote_centre=arm.remote_centre,
            warnings=arm.warnings,
            last_warning="",
        )


def _at(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def _about(axis: int, angle: float) -> np.ndarray:
    quaternion = np.zeros(4)
    quaternion[0], quaternion[1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
    return quaternion


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    vector = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.array([a[0] * b[0] - a[1:] @ b[1:], *vector])


def _matrix(q: np.ndarray) -> np.ndarray:
    x, y, z = np.eye(3)
    turned = [v + 2 * np.cross(q[1:], np.cross(q[1:], v) + q[0] * v) for v in (x, y, z)]
    return np.array(turned).T


def _shape(body, name, kind, size, pose, rgba, arm) -> ShapeRecord:
    return ShapeRecord(
        body=body,
        name=name,
        kind=kind,
        size=np.array(size),
        pose=pose,
        rgba=rgba,
        gloss=0.4,
        metal=0.0,
        rounding=0.0,
        arm=arm,
        frame=name,
        collide=True,
    )
