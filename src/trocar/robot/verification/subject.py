"""The arm that is verified, and its joints swung over their ranges with servos and without."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription, JointDescription
from trocar.descriptions.rigs import lone_arm_rig
from trocar.geometry.rotations import matrix_from_rpy
from trocar.geometry.se3 import transform
from trocar.kinematics import forward
from trocar.kinematics.loops import flattenings
from trocar.kinematics.mechanism import Mechanism
from trocar.kinematics.tree import frame_poses
from trocar.simulation import World
from trocar.simulation.trials import SHARE_OF_RANGE, TICK_S, middle_of_range, periods_per_tick

Model = Literal["dvrk", "paper"]


@dataclass(frozen=True, eq=False)
class Subject:
    """An arm under test.

    Attributes:
        name: as the user gave it: a built-in arm or a TOML file
        arm: its description, calibration included
        words: options that choose it on the command line
        nominal: its description without the calibration; None: the arm is nominal itself
    """

    name: str
    arm: ArmDescription
    words: tuple[str, ...] = ()
    nominal: ArmDescription | None = None

    @property
    def calibrated(self) -> bool:
        """Whether a calibration is applied; the paper's figures are of another robot then."""
        return self.arm.overlay is not None

    @property
    def simulated(self) -> bool:
        """Whether its file has masses and gains, which a simulation needs."""
        return bool(self.arm.control) and bool(self.arm.bodies)

    @property
    def place(self) -> str:
        """Name of the arm in its world."""
        return lone_arm_rig(self.arm).arms[0].name

    def world(self, model: Model = "dvrk", tip_load_n: float = 0.0) -> World:
        """Return a world of this arm alone, with the masses that the paper's figures are of.

        Args:
            model: "dvrk": the dVRK's gains and the identified friction; "paper": Table 8's gains
                and the paper's damping; gravity is compensated in both
            tip_load_n: force that turns about the tip [N]
        """
        return World(
            lone_arm_rig(self.arm),
            control=model,
            friction="paper" if model == "paper" else "identified",
            gravity_compensation=True,
            tip_load_n=tip_load_n,
            dynamics="cad",
        )

    def command(self, part: str) -> str:
        """Return the command line that runs one part on this arm again."""
        return shlex.join(["trocar", "verify", "--only", part, *self.words])

    def rest(self) -> np.ndarray:
        """Return the joint positions nearest to zero that the limits allow, (n,)."""
        mechanism = self.arm.mechanism
        return np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)


Array = NDArray[np.float64]
Drive = Literal["servo", "set"]
#: {joint: (from, to)} [rad]
Ranges = Mapping[str, tuple[float, float]]

#: Swings of the second joint per swing of the first. Source: our own choice; a dense net.
SECOND_SWINGS = 5
#: Ratio of a joint's velocity limit that the sweep reaches. Source: our own choice.
SHARE_OF_SPEED = 0.9
#: Ticks of 5 ms per sample. Source: our own choice; 20 Hz.
KEPT = 10
#: Time in which the swings grow to their amplitude [s]. Source: our own choice; in 2 s an ECM would
#: exceed its velocity limits.
RAMP_S = 4.0
#: Pose of the markers on each link, T_link_markers: off its axes, as on a robot.
#: Source: our own choice; no distance and no axis depends on it.
MARKERS = transform(matrix_from_rpy(0.4, -0.3, 0.7), np.array([0.05, 0.03, 0.04]))


@dataclass(frozen=True, eq=False)
class SweepResult:
    """Motion of an arm while yaw and pitch sweep their ranges.

    Attributes:
        drive: "servo": moved by its servos; "set": its joints are where they are told, without
            servo error, while the loops are simulated as ever
        time: (k,) [s]
        commanded, actual: joint positions, (k, n) [rad or m]
        coordinates: of every frame, as the simulation had them, (k, n_frames)
    """

    drive: Drive
    time: Array
    commanded: Array
    actual: Array
    coordinates: Array

    def link_poses(self, mechanism: Mechanism) -> dict[str, Array]:
        """Compute the pose of every frame in the arm's root, {frame: (k, 4, 4)}."""
        found = frame_poses(mechanism, self.coordinates)
        return {frame.name: found[index] for index, frame in enumerate(mechanism.frames)}


def swept_joints(mechanism: Mechanism) -> tuple[int, ...]:
    """Return the joints that a sweep swings: yaw and pitch, else up to two that fold a loop."""
    index = mechanism.joint_index
    if {"yaw", "pitch"} <= index.keys():
        return index["yaw"], index["pitch"]
    return tuple(dict.fromkeys(index[f.joint] for f in flattenings(mechanism)))[:2]


def exact(subject: Subject, motion: SweepResult) -> SweepResult:
    """Return a sweep with its loops closed as the kinematics closes them."""
    found = forward.coordinates(subject.arm.mechanism, motion.actual)
    return replace(motion, coordinates=found)


def sweep(subject: Subject, drive: Drive, ranges: Ranges | None = None) -> SweepResult:
    """Sweep joints; all other joints rest in the middle of their ranges.

    Args:
        subject: whose
        drive: how they are moved
        ranges: of the joints that are swept; 95 % of what they may when omitted
    """
    world = subject.world()
    time, q, v = _net(subject, ranges or {})
    name = subject.place
    world.set_state(name, q[0])
    kept = slice(KEPT - 1, None, KEPT)
    if drive == "servo":
        played = world.play({name: q}, {name: v}, every=periods_per_tick(world))
        actual, coordinates = played.positions[name][kept], played.coordinates[name][kept]
    else:
        actual, coordinates = _set(world, name, q[kept], v[kept])
    return SweepResult(drive, time[kept], q[kept], actual, coordinates)


class Sweeps:
    """Sweeps of an arm over its whole ranges that several experiments share.

    Args:
        subject: whose
        watch: called before a sweep is simulated
    """

    def __init__(self, subject: Subject, watch: Callable[[str], None]) -> None:
        self.subject = subject
        self.watch = watch
        self._done: dict[Drive, SweepResult] = {}

    def sweep(self, drive: Drive) -> SweepResult:
        """Simulate a sweep, or give the one that was simulated before."""
        if drive not in self._done:
            errors = "servos" if drive == "servo" else "no servo error"
            self.watch(f"{self.subject.name}: a sweep, {errors}")
            self._done[drive] = sweep(self.subject, drive)
        return self._done[drive]


def _set(world: World, name: str, q: Array, v: Array) -> tuple[Array, Array]:
    """Put the joints to each row, let the loops settle for a tick, and look."""
    arm, own = world.arm(name), world.rig.arm(name).arm.own_joints
    arm.joints.set_mode("set")
    every = periods_per_tick(world)
    actual: list[Array] = []
    coordinates: list[Array] = []
    for place, speed in zip(q[:, :own], v[:, :own], strict=True):
        arm.servo_jp(place, speed)
        world.step(every)
        actual.append(arm.joints.positions())
        coordinates.append(arm.joints.frame_coordinates())
    return np.array(actual), np.array(coordinates)


def measured_ranges(subject: Subject) -> Ranges:
    """Read the ranges of yaw and pitch in the tracks of a calibrated arm.

    Returns:
        {joint: (from, to) [rad]}, within the joints' limits; empty where the overlay has none
    """
    overlay = subject.arm.overlay
    measured: dict[str, Any] = {} if overlay is None else overlay.measured.get("rcm", {})
    swept: dict[str, tuple[float, float]] = measured.get("sweep_rad", {})
    found: dict[str, tuple[float, float]] = {}
    for joint in subject.arm.joints:
        if joint.name in swept:
            low, high = (float(np.clip(v, joint.lower, joint.upper)) for v in swept[joint.name])
            found[joint.name] = (low, high)
    return found if len(found) == len(swept) else {}


def _net(subject: Subject, ranges: Ranges) -> tuple[Array, Array, Array]:
    """Return times (k,), positions and velocities (k, n) of a sweep that begins at rest."""
    arm = subject.arm
    swung = swept_joints(arm.mechanism)
    joints = [arm.joints[index] for index in swung]
    spans = [_span(joint, ranges) for joint in joints]
    swings = [0.5 * (high - low) for low, high in spans]
    speed = SHARE_OF_SPEED * min(j.velocity_max for j in joints)
    times = (1, SECOND_SWINGS)[-len(swung) :]
    duration = max(20.0, 2.0 * np.pi * times[-1] * swings[-1] / speed)
    time = TICK_S * np.arange(round(duration / TICK_S), dtype=np.float64)
    share = np.clip(time / RAMP_S, 0.0, 1.0)
    ramp = share**2 * (3.0 - 2.0 * share)
    q = np.tile(middle_of_range(arm), (len(time), 1))
    for index, (low, high), swing, often in zip(swung, spans, swings, times, strict=True):
        q[:, index] = 0.5 * (low + high)
        q[:, index] += swing * ramp * np.sin(2.0 * np.pi * often * time / duration)
    return np.asarray(time), q, np.asarray(np.gradient(q, TICK_S, axis=0), dtype=np.float64)


def _span(joint: JointDescription, ranges: Ranges) -> tuple[float, float]:
    """Choose the ends of the sweep of a joint."""
    if joint.name in ranges:
        return ranges[joint.name]
    middle = 0.5 * (joint.lower + joint.upper)
    swing = 0.5 * SHARE_OF_RANGE * (joint.upper - joint.lower)
    return middle - swing, middle + swing
