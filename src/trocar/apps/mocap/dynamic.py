"""The sweep as the simulation makes it: dynamics, servos, friction."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.lone_arm import lone_arm_rig
from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError
from trocar.simulation import World

Array = NDArray[np.float64]

#: Played in pieces of so many periods, for the sake of whoever watches. Source: our own choice.
PIECE = 1000
#: The arm settles at its home before the cameras begin. Source: our own choice. [s]
SETTLE_S = 1.0


def simulated_positions(
    arm: ArmDescription,
    times: Array,
    told: Callable[[Array], Array],
    progress: Callable[[int, int], None] | None = None,
) -> Array:
    """Return where the joints were at given times, (n, n_joints) [rad or m].

    A sample is the state at the end of the physics period that is nearest: all joints of a sample
    are of one moment.

    Args:
        arm: simulated alone, with the dVRK's gains
        times: increasing, from 0 on, (n,) [s]
        told: set-points of given times
        progress: is told (done, all) periods

    Raises:
        InputError: the sweep is faster than a joint may move, or leaves its limits
        DivergedError: the simulation left the finite numbers
    """
    world = World(lone_arm_rig(arm))
    (name,) = world.arms
    period = world.timestep
    count = round(float(times[-1]) / period) + 1
    ends = period * np.arange(count, dtype=np.float64)
    goal = told(ends)
    speed = np.asarray(np.gradient(goal, period, axis=0), dtype=np.float64)
    _check(arm, goal, speed)
    world.set_state(name, goal[0])
    world.play({name: np.tile(goal[:1], (round(SETTLE_S / period), 1))}, every=1, record=False)
    found: list[Array] = []
    for begin in range(0, count, PIECE):
        piece = slice(begin, begin + PIECE)
        run = world.play({name: goal[piece]}, {name: speed[piece]}, every=1)
        found.append(run.positions[name])
        if progress is not None:
            progress(min(begin + PIECE, count), count)
    return np.concatenate(found)[np.rint(times / period).astype(int)]


def _check(arm: ArmDescription, goal: Array, speed: Array) -> None:
    for index, joint in enumerate(arm.joints):
        fastest = float(np.abs(speed[:, index]).max())
        if fastest > joint.velocity_max:
            raise InputError(
                f"{arm.name}: {joint.name} would be swept at {fastest:.3g} rad/s; allowed:"
                f" {joint.velocity_max:.3g} rad/s; give the sweep a longer duration"
            )
        low, high = float(goal[:, index].min()), float(goal[:, index].max())
        if low < joint.lower or high > joint.upper:
            raise InputError(
                f"{arm.name}: {joint.name} would be swept from {low:.3g} to {high:.3g}; allowed:"
                f" {joint.lower:.3g} to {joint.upper:.3g}"
            )
