"""Wrist platform and gimbal of a master whose tip is under force control.

The wrist platform turns so that the wrist yaw comes back to its middle. That exerts no force on the
hand, because all four gimbal axes meet in the tip. The gimbal may hold an orientation while the
first three joints stay free.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError
from trocar.geometry.rotations import check_rotation, matrix_from_quaternion
from trocar.kinematics.closed_form import Fit
from trocar.kinematics.inverse_gimbal_arm import PLATFORM, gimbal_branches
from trocar.simulation.controllers import Action, TipState

Array = NDArray[np.float64]

#: The joints of the gimbal, which hold an orientation.
GIMBAL = slice(3, 7)
PITCH, YAW = 4, 5
#: Source: SAW mtsIntuitiveResearchKit.h, MTMPlatform: Gain (PGain 1, DGain 0.1), EffortMax.
PLATFORM_P, PLATFORM_D = 0.5 * 1.0, 0.5 * 0.1  # [N m/rad, N m s/rad]
PLATFORM_EFFORT_MAX = 0.4  # [N m]
#: The platform's goal is at most this far ahead. Source: SAW mtsIntuitiveResearchKitMTM.cpp,
#: control_servo_cf_preload. [rad]
PLATFORM_STEP = 0.05 * np.pi
#: Time constant with which the platform of a locked gimbal yields. Source: our own choice (the
#: dVRK's numerical inverse kinematics begins where this ends). [s]
PLATFORM_TIME_S = 0.2
#: Reject quaternions whose norm differs from 1 by more. Source: our own choice.
UNIT_TOLERANCE = 1e-3


def platform_advance(q: Array) -> float:
    """Compute the platform's distance from a wrist yaw of 0, to first order [rad].

    The projection of the roll axis on the platform is turned by the wrist yaw; it counts as far
    as the roll axis lies in the platform's plane.

    Source: SAW mtsIntuitiveResearchKitMTM.cpp, control_servo_cf_preload.

    Args:
        q: joint positions, (7,) [rad]
    """
    ahead = float(q[YAW]) * math.cos(q[PITCH])
    return min(max(ahead, -PLATFORM_STEP), PLATFORM_STEP)


@dataclass(frozen=True, eq=False)
class PlatformEffort:
    """The effort of the wrist platform that brings the wrist yaw back to its middle.

    Attributes:
        lower, upper: the platform's limits, which its goal keeps to [rad]
    """

    lower: float
    upper: float

    def act(self, now: TipState) -> Action:
        """Return the effort where the arm is now."""
        effort = np.zeros(len(now.q))
        effort[PLATFORM] = self.effort(now.q, now.qd)
        return Action(effort)

    def effort(self, q: Array, qd: Array) -> float:
        """Return P (goal - q4) - D v4, within the largest effort [N m]."""
        platform = float(q[PLATFORM])
        goal = min(max(platform + platform_advance(q), self.lower), self.upper)
        effort = PLATFORM_P * (goal - platform) - PLATFORM_D * float(qd[PLATFORM])
        return min(max(effort, -PLATFORM_EFFORT_MAX), PLATFORM_EFFORT_MAX)


@dataclass(frozen=True, eq=False)
class GimbalLimits:
    """Limits of the set-points of a locked gimbal, (7,) each [rad, rad/s]."""

    lower: Array
    upper: Array
    speed: Array


@dataclass(eq=False)
class OrientationLock:
    """Set-points of the gimbal that hold an orientation, wherever the first three joints go.

    Its platform gives way as under `PlatformEffort`. `orientation_lock` makes it.

    Attributes:
        orientation: of the tip, in the frames of the closed form, (3, 3)
        setpoints: the last ones, (7,) [rad]; written to
        limits: of the joints
        time: simulation time of these set-points [s]
    """

    orientation: Array
    setpoints: Array
    limits: GimbalLimits
    time: float

    def act(self, now: TipState) -> Action:
        """Return the gimbal's set-points for the next step."""
        elapsed = now.time - self.time
        self.time += elapsed
        goal = self._goal(now.q[:3], elapsed)
        most = self.limits.speed * elapsed
        step = np.clip(goal - self.setpoints, -most, most)
        self.setpoints += step
        position, velocity = np.full(7, np.nan), np.zeros(7)
        position[GIMBAL] = self.setpoints[GIMBAL]
        if elapsed > 0.0:
            velocity[GIMBAL] = step[GIMBAL] / elapsed
        return Action(np.zeros(7), position, velocity)

    def _goal(self, arm: Array, elapsed: float) -> Array:
        """Return the joints that have the orientation, nearest to the last set-points, (7,)."""
        last, limits = self.setpoints, self.limits
        on = last[PLATFORM] + platform_advance(last) * min(elapsed / PLATFORM_TIME_S, 1.0)
        platform = min(max(on, limits.lower[PLATFORM]), limits.upper[PLATFORM])
        found, _ = gimbal_branches(self.orientation, arm[None], np.array([[platform]]))
        found -= 2.0 * np.pi * np.round((found - last) / (2.0 * np.pi))
        found[:, :3] = arm
        nearest = found[np.abs(found - last)[:, GIMBAL].max(axis=1).argmin()]
        return np.clip(nearest, limits.lower, limits.upper)


def orientation_lock(
    fit: Fit, R: Array, q: Array, limits: GimbalLimits, time: float
) -> OrientationLock:
    """Return set-points that hold an orientation, from where the arm is.

    Args:
        fit: the arm's closed form
        R: orientation of the tip in the arm's reference frame, (3, 3)
        q: joint positions now, (7,) [rad]
        limits: of the joints
        time: simulation time [s]
    """
    orientation = fit.chain.base[:3, :3].T @ R @ fit.tip[:3, :3].T
    return OrientationLock(orientation, q.copy(), limits, time)


def check_orientation(value: ArrayLike) -> Array:
    """Return an orientation that is given as a rotation matrix or a quaternion wxyz, (3, 3).

    Raises:
        InputError: neither of both
    """
    try:
        given = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        given = np.zeros(0)
    if given.shape == (3, 3):
        return check_rotation(given, "orientation")
    if given.shape == (4,) and abs(math.hypot(*given) - 1.0) < UNIT_TOLERANCE:
        return matrix_from_quaternion(given / np.linalg.norm(given))
    raise InputError(
        f"orientation: got {value!r}; allowed: a rotation matrix (3, 3), or a unit quaternion wxyz"
    )
