"""Grip of a jaw: slip of a needle that is carried about, and the load at which it lets go."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import cast

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.inertial import STANDARD_GRAVITY
from trocar.geometry.se3 import inverse, transform
from trocar.robot.verification.figures import Figure
from trocar.simulation import World
from trocar.simulation.jaw import Jaw

Array = NDArray[np.float64]

#: Bounds. Source: the project's own goals.
SLIP_M, TURN_DEG, PULL_N, PULL_M, LOOSE_M, SHARE = 5e-6, 0.01, 5.0, 2e-5, 2e-3, 0.05
#: Half a circle of wire: its radius and the wire's, and into how many capsules it is cut [mm].
RADIUS, WIRE, PIECES = 10.0, 0.5, 12
#: Distance of the wire beyond the jaw's pivot [m].
REACH_M = 0.0085
#: The motion that the needle is carried through: amplitudes and frequencies of the joints
#: [rad or m, Hz].
SWING = np.array([0.1, 0.1, 0.012, 0.35, 0.2, 0.2])
HERTZ = np.array([0.30, 0.40, 0.50, 0.35, 0.45, 0.55])
CARRIED_S = 60.0
#: Loads grow from nothing to this in this time, and slip is motion beyond this in the jaw.
#: [N, N m, s, m, rad]
MOST_N, MOST_NM, RAMP_S, SLIPPED_M, SLIPPED_RAD = 60.0, 0.4, 2.0, 2e-4, 0.04
#: Directions of forces and torques in the jaw: along the wire and across the pads, along the pads'
#: normal, out of the jaw; and a force with torques [N, mN m].
FORCES = {
    "along the wire": (1.0, 0.0, 0.0),
    "out of the jaw": (0.0, 0.0, 1.0),
    "into the jaw": (0.0, 0.0, -1.0),
    "between": (1.0, 0.0, 1.0),
}
TORQUES = {
    "about the wire": (1.0, 0.0, 0.0),
    "about the pads' normal": (0.0, 1.0, 0.0),
    "about the jaw": (0.0, 0.0, 1.0),
    "about wire and normal": (1.0, 1.0, 0.0),
    "about wire and jaw": (1.0, 0.0, 1.0),
    "about normal and jaw": (0.0, 1.0, 1.0),
    "about normal and jaw, the other way": (0.0, 1.0, -1.0),
    "about all": (1.0, 1.0, 1.0),
    "mostly about normal and jaw": (0.3, 1.0, 1.0),
    "mostly about normal and jaw, the other way": (-0.3, 1.0, 1.0),
    "mostly about the normal": (0.3, 1.0, 0.0),
    "mostly about the jaw": (0.3, 0.0, 1.0),
}
BOTH = {
    "along the wire, with 2 mN m about the jaw for each N": ((1.0, 0.0, 0.0), (0.0, 0.0, 2e-3)),
    "out of the jaw, with 2 mN m about the normal": ((0.0, 0.0, 1.0), (0.0, 2e-3, 0.0)),
    "out of the jaw, with 2 mN m about the jaw": ((0.0, 0.0, 1.0), (0.0, 0.0, 2e-3)),
}

RIG = """
schema = 1
name = "grip"
source = "our own choice"
grasp = "{grasp}"
dynamics = "cad"
[[arm]]
name = "PSM1"
description = "psm"
tool = "LARGE_NEEDLE_DRIVER:400006"
place = "rcm"
xyz_m = [0, 0, 0.3]
[[pose]]
name = "start"
[pose.q_rad_m]
PSM1 = [0.2, 0.1, 0.14, 0, 0, 0, 0.5]
[[prop]]
name = "needle"
movable = true
mass_g = 0.25
xyz_m = [0, 0, 0.05]
shape = [{shapes}]
"""


def rig_text(grasp: str) -> str:
    """Return a rig of a PSM and a needle; the needle's circle is about its own z."""
    at = [
        [RADIUS * np.cos(angle), RADIUS * np.sin(angle), 0.0]
        for angle in np.linspace(0.0, np.pi, PIECES + 1)
    ]
    shapes = ", ".join(
        f'{{ kind = "capsule", from_mm = {one}, to_mm = {two}, radius_mm = {WIRE} }}'
        for one, two in zip(np.round(at, 6).tolist(), np.round(at[1:], 6).tolist(), strict=False)
    )
    return RIG.format(grasp=grasp, shapes=shapes)


class Grip:
    """A needle in the jaw of a PSM, at the middle of its arc, its circle about the jaw.

    Args:
        grasp: "friction+stick", "friction" or "attach"; or a file as `rig_text` returns
    """

    def __init__(self, grasp: str | Path) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "grip.toml"
            if isinstance(grasp, Path):
                file = grasp
            else:
                file.write_text(rig_text(grasp), encoding="utf-8")
            self.world = world = World(file)
        self.arm, needle = world.arm("PSM1"), world.object("needle")
        middle = 1e-3 * RADIUS * np.cos(0.5 * np.pi / PIECES)  # of a capsule, which lies across
        turn = np.pi * (0.5 - 0.5 / PIECES)
        wire = transform(_turned(turn), middle * np.array([np.cos(turn), np.sin(turn), 0.0]))
        # radial is the pads' normal, tangent across them
        wire[:3, :3] = wire[:3, :3] @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        needle.set_cp(self.jaw() @ transform(np.eye(3), [0.0, 0.0, REACH_M]) @ inverse(wire))
        needle.servo_cf([0.0, 0.0, needle.mass * STANDARD_GRAVITY, 0.0, 0.0, 0.0])
        cast(Jaw, self.arm.jaw).close().wait(timeout_s=1.0)
        world.step(200)
        needle.servo_cf(np.zeros(6))
        world.step(50)
        self._shadow = mujoco.MjData(world.mj_model)
        self.start = self.needle_in_finger()

    def jaw(self) -> Array:
        """Return the pose of the jaw in the world."""
        return self.world.reference_pose("PSM1") @ self.arm.local.measured_cp().matrix

    def needle_in_finger(self) -> Array:
        """Return the needle's pose in the left finger, (4, 4)."""
        world, shadow = self.world, self._shadow
        shadow.qpos[:] = world.mj_data.qpos
        mujoco.mj_kinematics(world.mj_model, shadow)
        finger, needle = (
            transform(shadow.body(name).xmat.reshape(3, 3), shadow.body(name).xpos)
            for name in ("PSM1/finger_left", "needle")
        )
        return inverse(finger) @ needle

    def slip(self) -> tuple[float, float]:
        """Return the displacement of the needle since it was held, at the wire [m, rad]."""
        moved = inverse(self.start) @ self.needle_in_finger()
        wire = np.array([0.0, 1e-3 * RADIUS, 0.0])
        far = np.linalg.norm(moved[:3, :3] @ wire + moved[:3, 3] - wire)
        turn = moved[:3, :3]
        axis = [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        return float(far), float(np.arctan2(0.5 * np.linalg.norm(axis), 0.5 * (turn.trace() - 1)))

    def carry(self, time_s: float) -> tuple[float, float]:
        """Swing the arm, and return the largest slip [m, rad]."""
        start = self.arm.setpoint_js().position.copy()
        worst = np.zeros(2)
        for k in range(round(time_s / 0.005)):
            t = 0.005 * k
            self.arm.servo_jp(start + min(1.0, t) * SWING * np.sin(2 * np.pi * HERTZ * t))
            self.world.step(5)
            if k % 20 == 0:
                worst = np.maximum(worst, self.slip())
        return float(worst[0]), float(worst[1])

    def load(self, force: Array, torque: Array) -> None:
        """Load the grip: on the needle, and against it on the body that carries the fingers.

        Args:
            force: at the wire between the pads, in the jaw's axes, (3,) [N]
            torque: (3,) [N m]
        """
        model, data, jaw = self.world.mj_model, self.world.mj_data, self.jaw()
        at = jaw[:3, 3] + REACH_M * jaw[:3, 2]
        push, twist = jaw[:3, :3] @ force, jaw[:3, :3] @ torque
        for name, sign in (("needle", 1.0), ("PSM1/wrist_yaw", -1.0)):
            body = model.body(name).id
            turn = twist + np.cross(at - data.xipos[body], push)
            data.xfrc_applied[body] = sign * np.concatenate([push, turn])

    def lets_go(self, force: Array, torque: Array) -> float:
        """Return the load at which it slips, growing along a direction [N or N m]."""
        most = MOST_N if np.any(force) else MOST_NM
        steps = round(RAMP_S / self.world.timestep)
        for step in range(0, steps, 5):
            size = most * step / steps
            self.load(size * force, size * torque)
            self.world.step(5)
            far, turned = self.slip()
            if far > SLIPPED_M or turned > SLIPPED_RAD:
                return size
        return float("inf")


def _turned(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def grip() -> list[Figure]:
    """Measure how a needle is held."""
    held = Grip("friction+stick")
    far, turned = held.carry(CARRIED_S)
    found = [
        Figure("slip of a needle in 60 s of motion", far * 1e6, "um", SLIP_M * 1e6),
        Figure("turn of it", np.degrees(turned), "deg", TURN_DEG),
    ]
    pulled = Grip("friction+stick")
    pulled.load(PULL_N * np.array([0.0, 0.0, 1.0]), np.zeros(3))
    pulled.world.step(1000)
    found.append(
        Figure("slip under 5 N out of the jaw", pulled.slip()[0] * 1e3, "mm", PULL_M * 1e3)
    )
    found.append(
        Figure(
            "slip in 60 s by friction alone",
            Grip("friction").carry(CARRIED_S)[0] * 1e3,
            "mm",
            LOOSE_M * 1e3,
        )
    )
    nothing = np.zeros(3)
    loads = {name: (_unit(axis), nothing) for name, axis in FORCES.items()}
    loads |= {name: (nothing, _unit(axis)) for name, axis in TORQUES.items()}
    loads |= {name: (np.array(force), np.array(torque)) for name, (force, torque) in BOTH.items()}
    for name, load in loads.items():
        stick, friction = (Grip(kind).lets_go(*load) for kind in ("friction+stick", "friction"))
        unit, per = ("mN m", 1e3) if name in TORQUES else ("N", 1.0)
        found.append(Figure(f"{name}: lets go at", stick * per, unit))
        found.append(
            Figure(f"{name}: against friction alone", abs(stick / friction - 1), "", SHARE)
        )
    return found


def _unit(axis: tuple[float, float, float]) -> Array:
    return np.array(axis) / np.linalg.norm(axis)
