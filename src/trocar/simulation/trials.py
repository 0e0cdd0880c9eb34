"""Trials on rigs and arms: the closed-loop paper's test trajectory, loop health, tracking."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription, RigDescription
from trocar.errors import InputError
from trocar.kinematics import forward
from trocar.modeling import naming
from trocar.modeling.build import build, lone_rig
from trocar.simulation import World
from trocar.simulation.health import arm_health
from trocar.simulation.records import Recording

Array = NDArray[np.float64]

#: Set-points are written and samples taken this often. Source: our own choice. [s]
TICK_S = 0.005
#: Source: closed-loop paper 4.3 (0.1 Hz, 1 rad, 0.1 m); our own choice (middle of the range,
#: insertion 0.12 m, ramp of 1 s, 0.95 of half the range).
FREQUENCY_HZ = 0.1
AMPLITUDE_RAD = 1.0
AMPLITUDE_M = 0.1
SHARE_OF_RANGE = 0.95
INSERTION_MIDDLE_M = 0.12
RAMP_S = 1.0
MOVED = ("PSM", "ECM", "MTM")


@dataclass(frozen=True, eq=False)
class TestTrajectory:
    """Set-points of every moved arm.

    Attributes:
        period: time between rows [s]
        start: {arm: q (n,)}: where the arms stand at time 0
        positions, velocities: {arm: (k, n)}: what is written, valid for one period each
        expected: {arm: (k, n)}: where the arm should be when its period is over
    """

    __test__ = False  # not a pytest class

    period: float
    start: dict[str, Array]
    positions: dict[str, Array]
    velocities: dict[str, Array]
    expected: dict[str, Array]


def paper_sine(
    rig: RigDescription, duration_s: float, period_s: float, begin_s: float = 0.0
) -> TestTrajectory:
    """Return the paper's sine for every arm of a rig but its setup joints.

    A row is held for one period, so it is the set-point of the period's middle: held set-points
    then lag by nothing on average.

    Args:
        rig: the rig; where its arms would meet, its `test_share` scales the amplitude
        duration_s: length [s]
        period_s: time between rows [s]
        begin_s: where on the sine the first row is, for one that is played in pieces [s]

    Raises:
        InputError: the rig has no arm that moves, or the duration is no positive number
    """
    if not np.isfinite(duration_s) or duration_s <= 0.0:
        raise InputError(f"duration: got {duration_s!r}; allowed: above 0 s")
    arms = {a.name: a.arm for a in rig.arms if a.arm.type in MOVED}
    if not arms:
        raise InputError(
            f"rig {rig.name}: has no PSM, ECM or MTM to drive along the test trajectory"
        )
    count = max(1, round(duration_s / period_s))
    begin = begin_s + period_s * np.arange(count, dtype=np.float64)
    middles = {
        name: rig.poses["test"][name] if rig.test_share < 1.0 else middle_of_range(arm)
        for name, arm in arms.items()
    }
    swings = {name: rig.test_share * amplitudes(arm) for name, arm in arms.items()}
    wave, slope = _ramped_sine(np.asarray(begin + 0.5 * period_s))
    after, _ = _ramped_sine(np.asarray(begin + period_s))
    return TestTrajectory(
        period_s,
        middles,
        {name: middles[name] + np.outer(wave, swings[name]) for name in arms},
        {name: np.outer(slope, swings[name]) for name in arms},
        {name: middles[name] + np.outer(after, swings[name]) for name in arms},
    )


def middle_of_range(arm: ArmDescription) -> Array:
    """Return the middle of each joint's range, the insertion at 0.12 m, the jaw shut, (n,).

    A gripper is where its spring has it.
    """
    middle = np.array([0.5 * (j.lower + j.upper) for j in arm.joints])
    for index, joint in enumerate(arm.joints):
        if joint.name == "insertion" and arm.type == "PSM":
            middle[index] = INSERTION_MIDDLE_M
        if joint.name == "jaw":
            middle[index] = 0.0
        if joint.spring is not None:
            middle[index] = np.clip(joint.spring.rest, joint.lower, joint.upper)
    return middle


def random_positions(arm: ArmDescription, seed: int, count: int) -> Array:
    """Return joint positions all over the ranges, jaws from shut on, (count, n)."""
    lower, upper = arm.mechanism.lower, arm.mechanism.upper
    q = np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))
    if arm.has_jaw:
        q[:, -1] = np.abs(q[:, -1])
    return q


def amplitudes(arm: ArmDescription) -> Array:
    """Return the amplitude of each joint, none for a jaw or a gripper, (n,) [rad or m]."""
    found: list[float] = []
    for index, joint in enumerate(arm.joints):
        most = AMPLITUDE_RAD if joint.kind == "revolute" else AMPLITUDE_M
        half = 0.5 * (joint.upper - joint.lower)
        found.append(min(most, SHARE_OF_RANGE * half) if index < arm.own_joints else 0.0)
    return np.array(found)


def _ramped_sine(time: Array) -> tuple[Array, Array]:
    """Return a sine that grows in over the ramp, and its derivative, (k,) each."""
    share = np.clip(time / RAMP_S, 0.0, 1.0)
    ramp = share**2 * (3.0 - 2.0 * share)
    growth = np.where(time < RAMP_S, 6.0 * share * (1.0 - share) / RAMP_S, 0.0)
    omega = 2.0 * np.pi * FREQUENCY_HZ
    wave = np.sin(omega * time)
    return ramp * wave, growth * wave + ramp * omega * np.cos(omega * time)


def begin_trajectory(world: World, trajectory: TestTrajectory) -> None:
    """Reset a world and put its arms where a trajectory begins."""
    world.reset()
    for name, q in trajectory.start.items():
        world.set_state(name, q)


def periods_per_tick(world: World) -> int:
    """Return the number of physics periods in 5 ms.

    Raises:
        InputError: the tick is no whole multiple of the physics period
    """
    every = round(TICK_S / world.timestep)
    if every < 1 or abs(every * world.timestep - TICK_S) > 1e-9:
        raise InputError(
            f"timestep: got {world.timestep:g} s; allowed: {TICK_S:g} s divided by a whole number"
        )
    return every


def loop_health(world: World, trajectory: TestTrajectory, every: int) -> tuple[float, float, bool]:
    """Play a trajectory, sample every physics period, and return the worst of all arms.

    Returns:
        (loop gap [m], remote-centre error [m], whether every loop kept its branch)
    """
    begin_trajectory(world, trajectory)
    gap, rcm, branch = 0.0, 0.0, True
    rows = len(next(iter(trajectory.positions.values())))
    for begin in range(0, rows, 400):  # two seconds at a time: memory does not grow with the run
        part = slice(begin, begin + 400)
        played = world.play(
            {name: np.repeat(q[part], every, axis=0) for name, q in trajectory.positions.items()},
            {name: np.repeat(v[part], every, axis=0) for name, v in trajectory.velocities.items()},
            every=1,
        )
        for name in trajectory.positions:
            found = arm_health(world.rig.arm(name).arm, played.coordinates[name])
            gap, rcm = max(gap, found.loop_gap_m), max(rcm, found.rcm_error_m)
            branch &= found.branch_ok
    return gap, rcm, branch


def tracking_rms(
    world: World, trajectory: TestTrajectory, recording: Recording
) -> dict[str, dict[str, float]]:
    """Return the RMS of measured minus commanded after the first second, {arm: {joint: ..}}.

    A run of a second or less counts whole.
    """
    counted = recording.time > RAMP_S
    if not counted.any():
        counted[:] = True
    found: dict[str, dict[str, float]] = {}
    for name, expected in trajectory.expected.items():
        error = (recording.positions[name] - expected)[counted]
        rms = np.sqrt(np.mean(error**2, axis=0))
        joints = world.rig.arm(name).arm.mechanism.joint_names
        found[name] = dict(zip(joints, rms.tolist(), strict=True))
    return found


def whole_pitch(sine: TestTrajectory, world: World) -> TestTrajectory:
    """Return the trajectory with the pitch stretched to its whole range."""
    for name, middle in sine.start.items():
        arm = world.rig.arm(name).arm
        pitch = arm.mechanism.joint_index["pitch"]
        half = 0.5 * (arm.joints[pitch].upper - arm.joints[pitch].lower)
        stretch = half / amplitudes(arm)[pitch]
        for table in (sine.positions[name], sine.expected[name]):
            table[:, pitch] = middle[pitch] + stretch * (table[:, pitch] - middle[pitch])
        sine.velocities[name][:, pitch] *= stretch
    return sine


def compiled_poses(arm: ArmDescription, q: Array) -> dict[str, Array]:
    """Return the pose of every frame that is a body of the compiled model.

    The hinges stand where the kinematics has them; where the frames are is MuJoCo's doing.

    Args:
        arm: the arm, alone in the model, its root at the origin
        q: joint positions, (k, n) [rad or m]

    Returns:
        {frame: poses in the arm's root, (k, 4, 4)}

    Raises:
        InputError: no masses are known, so that there is no model
    """
    model = build(lone_rig(arm)).mj
    data = mujoco.MjData(model)
    moving = [
        (index, model.joint(naming.scoped("arm", frame.name)).qposadr[0])
        for index, frame in enumerate(arm.mechanism.frames)
        if frame.motion != "fixed"
    ]
    bodies = {
        frame: mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, naming.scoped("arm", frame))
        for frame in arm.mechanism.frame_names
    }
    found = {
        frame: np.tile(np.eye(4), (len(q), 1, 1)) for frame, body in bodies.items() if body > 0
    }
    for row, coordinate in enumerate(forward.coordinates(arm.mechanism, q)):
        for index, address in moving:
            data.qpos[address] = coordinate[index]
        mujoco.mj_kinematics(model, data)
        for frame, poses in found.items():
            poses[row, :3, 3] = data.xpos[bodies[frame]]
            poses[row, :3, :3] = data.xmat[bodies[frame]].reshape(3, 3)
    return found
