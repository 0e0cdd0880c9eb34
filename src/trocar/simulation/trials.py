"""What trials on a world share: their tick, their worst loops, how well they were tracked."""

from __future__ import annotations

import numpy as np

from trocar.errors import InputError
from trocar.simulation.health import arm_health
from trocar.simulation.records import Recording
from trocar.simulation.timing import begin_trajectory
from trocar.simulation.trajectories import RAMP_S, TestTrajectory, amplitudes
from trocar.simulation.world import World

#: Targets are written and samples taken this often. Source: our own choice. [s]
TICK_S = 0.005


def periods_per_tick(world: World) -> int:
    """Return how many physics periods 5 ms have.

    Raises:
        InputError: the tick is no whole multiple of the physics period
    """
    every = round(TICK_S / world.timestep)
    if every < 1 or abs(every * world.timestep - TICK_S) > 1e-9:
        raise InputError(
            f"timestep: got {world.timestep:g} s; allowed: what divides {TICK_S:g} s evenly"
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
