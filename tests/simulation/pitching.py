"""The sweep of the pitch in which the loops of an arm hold."""

from __future__ import annotations

import numpy as np

from trocar.simulation import World

#: Number of the joint.
PITCH = 1


def whole_pitch(world: World, name: str, seconds: float) -> np.ndarray:
    """Set-points and their rates that take the pitch over its whole range and back, every 1 ms."""
    arm = world.rig.arm(name).arm
    lower, upper = arm.mechanism.lower, arm.mechanism.upper
    time = world.timestep * np.arange(round(seconds / world.timestep))
    q = np.tile(np.clip(np.zeros(len(lower)), lower, upper), (len(time), 1))
    q[:, 2] = 0.12
    v = np.zeros_like(q)
    middle, half = 0.5 * (lower + upper)[PITCH], 0.5 * (upper - lower)[PITCH]
    omega = 2.0 * np.pi / seconds
    q[:, PITCH] = middle - half * np.cos(omega * time)
    v[:, PITCH] = half * omega * np.sin(omega * time)
    return np.stack([q, v])
