"""Step responses: one joint of a lone arm steps while the others are held."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.descriptions.records import DynamicsKind, Gains
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import InputError
from trocar.simulation import World

Array = NDArray[np.float64]

#: Source: the usual definitions (Ogata, Modern Control Engineering, 5-3): from 10 to 90 %, and
#: within 2 % of the final value for good.
RISE_FROM, RISE_TO = 0.1, 0.9
SETTLING_BAND = 0.02
#: Ratio of the record, at its end, whose mean is the final value; a response that settles only
#: there has not settled. Source: our own choice.
FINAL_SHARE = 0.1
#: Ratio of the step below which a motion is no response. Source: our own choice.
LEAST_ANSWER = 0.1


@dataclass(frozen=True)
class StepResponse:
    """Measures of a step response; NaN where one does not exist.

    Attributes:
        rise_time_s: from 10 to 90 % of the way that it went [s]
        overshoot: farthest beyond the final value, as a share of that way
        settling_time_s: from the step until it stays within 2 % of the way about the final value
        steady_error: target minus final value [rad or m]
        peak_effort_share: largest effort over the joint's limit, what holds gravity included
    """

    rise_time_s: float
    overshoot: float
    settling_time_s: float
    steady_error: float
    peak_effort_share: float


def step_response(
    time: Array, position: Array, target: float, peak_effort_share: float = float("nan")
) -> StepResponse:
    """Read off a step response.

    Times between two samples are interpolated.

    Args:
        time: since the step, evenly spaced from 0 on, (k,) [s]
        position: of the joint, the first one as the step found it, (k,) [rad or m]
        target: where the step leads [rad or m]
        peak_effort_share: is handed on
    """
    start = position[0]
    final = float(np.mean(position[-max(1, round(FINAL_SHARE * len(position))) :]))
    steady_error = float(target - final)
    if abs(final - start) < LEAST_ANSWER * abs(target - start):
        nothing = float("nan")
        return StepResponse(nothing, 0.0, nothing, steady_error, peak_effort_share)
    way = (position - start) / (final - start)
    return StepResponse(
        _first_time_at(time, way, RISE_TO) - _first_time_at(time, way, RISE_FROM),
        max(0.0, float(way.max()) - 1.0),
        _settling_time(time, way),
        steady_error,
        peak_effort_share,
    )


def _first_time_at(time: Array, way: Array, level: float) -> float:
    """Find the time at which the response first reaches a level."""
    after = int(np.argmax(way >= level))
    return _crossing(time, way, after, level)


def _settling_time(time: Array, way: Array) -> float:
    """Find the time at which the response stays within the band; NaN if it does not settle."""
    outside = np.flatnonzero(np.abs(way - 1.0) > SETTLING_BAND)
    after = int(outside[-1]) + 1
    if after >= len(way) or time[after] > (1.0 - FINAL_SHARE) * time[-1]:
        return float("nan")
    edge = 1.0 + np.copysign(SETTLING_BAND, way[after - 1] - 1.0)
    return _crossing(time, way, after, float(edge))


def _crossing(time: Array, way: Array, after: int, level: float) -> float:
    """Interpolate the time at which the response passes a level, between `after` and before."""
    before = max(after - 1, 0)
    rise = way[after] - way[before]
    share = (level - way[before]) / rise if rise else 0.0
    return float(time[before] + share * (time[after] - time[before]))


Array = NDArray[np.float64]

#: A step is as large as the present P asks half of the effort limit for, so that friction is small
#: beside it and no motor saturates, but at most this share of the joint's range.
#: Source: our own choice.
STEP_EFFORT_SHARE = 0.5
STEP_RANGE_SHARE = 0.05
#: Time to rest at the beginning, and to answer. Source: our own choice; every arm of ours settles
#: in a third of it. [s]
REST_S = 0.5
ANSWER_S = 1.5


@dataclass(frozen=True, eq=False)
class StepTrace:
    """A step that was answered.

    Attributes:
        joint: its name
        time: since the step, (k,) [s]
        position: measured, (k,) [rad or m]
        effort: of the motor, (k,) [N m or N]
        target: where the step led [rad or m]
        response: what is read off it
    """

    joint: str
    time: Array
    position: Array
    effort: Array
    target: float
    response: StepResponse


class StepBench:
    """A lone arm whose joints are stepped one at a time, all others held as by a brake.

    Every step begins afresh, from the arm's pose "home" (a joint that stands at a limit there
    begins two steps away from it), so the same gains always get the same answer.
    """

    def __init__(
        self,
        arm: ArmDescription,
        control: Literal["dvrk", "paper"] = "dvrk",
        friction: Literal["identified", "paper"] = "identified",
        dynamics: DynamicsKind | None = None,
    ) -> None:
        self.arm = arm
        self._world = World(
            lone_arm_rig(arm), control=control, friction=friction, dynamics=dynamics
        )
        (self._name,) = self._world.arms
        #: Joints with a motor, in the arm's order; a gripper has only a spring.
        self.joints = tuple(joint.name for joint in arm.joints if joint.spring is None)
        self._present = {name: self._gains(name) for name in self.joints}

    def present(self, joint: str) -> Gains:
        """Return the gains that a joint has by its description.

        Raises:
            UnknownNameError: no such joint
            InputError: a joint without a motor
        """
        if self.arm.joint(joint).name not in self.joints:
            raise InputError(
                f"{self.arm.name}: {joint} has no motor; allowed: {', '.join(self.joints)}"
            )
        return self._present[joint]

    def step_size(self, joint: str) -> float:
        """Choose the size of the step of a joint, with two digits [rad or m].

        Raises:
            UnknownNameError: no such joint
            InputError: a joint without a motor, or without P, which answers nothing
        """
        described, gains = self.arm.joint(joint), self.present(joint)
        if gains.p <= 0.0:
            raise InputError(f"{self.arm.name}: {joint}: got P 0; allowed for a step: above 0")
        most = STEP_RANGE_SHARE * (described.upper - self._lowest(joint))
        size = min(most, STEP_EFFORT_SHARE * described.effort_max / gains.p)
        return float(f"{size:.2g}")

    def step(self, joint: str, gains: Gains | None = None) -> StepTrace:
        """Step a joint once.

        Args:
            joint: its name
            gains: the description's when omitted

        Raises:
            UnknownNameError: no such joint
            InputError: as for `step_size`
            DivergedError: the simulation left the finite numbers
        """
        size = self.step_size(joint)
        index = self.arm.mechanism.joint_names.index(joint)
        start = self._start(joint, 2.0 * size)
        self._prepare(joint, start, gains or self.present(joint))
        target = start.copy()
        target[index] += size
        arm = self._world.arm(self._name)
        count = round(ANSWER_S / self._world.timestep)
        position, effort = np.zeros(count + 1), np.zeros(count + 1)
        position[0] = arm.joints.positions()[index]
        self._command(joint, target)
        effort[0] = arm.joints.readings()[2][index]
        for row in range(1, count + 1):
            self._world.step()
            q, _, exerted = arm.joints.readings()
            position[row], effort[row] = q[index], exerted[index]
        time = self._world.timestep * np.arange(count + 1, dtype=np.float64)
        share = float(np.abs(effort).max()) / self.arm.joint(joint).effort_max
        answer = step_response(time, position, float(target[index]), share)
        return StepTrace(joint, time, position, effort, float(target[index]), answer)

    def _prepare(self, joint: str, start: Array, gains: Gains) -> None:
        """Put the arm at its start with one joint free, and let it come to rest."""
        world, arm = self._world, self._world.arm(self._name)
        world.reset()
        for name, own in self._present.items():
            arm.joints.set_gains(name, own.p, own.i, own.d)
        arm.joints.set_gains(joint, gains.p, gains.i, gains.d)
        world.set_state(self._name, start)
        others = [name for name in self.joints if name != joint]
        if arm.brakes:
            arm.brakes.release([joint])
        elif others:
            arm.joints.set_mode("set", others)
        self._command(joint, start)
        world.step(round(REST_S / world.timestep))

    def _command(self, joint: str, q: Array) -> None:
        """Command the position of one joint; the others hold."""
        arm = self._world.arm(self._name)
        if joint == "jaw" and arm.jaw is not None:
            arm.jaw.servo_jp(q[-1:])
        else:
            arm.servo_jp(q[: self.arm.own_joints])

    def _start(self, joint: str, room: float) -> Array:
        """Return the pose "home" with room on both sides of a joint, (n,)."""
        start = self._world.rig.poses["start"][self._name].copy()
        index = self.arm.mechanism.joint_names.index(joint)
        upper = self.arm.joint(joint).upper
        start[index] = np.clip(start[index], self._lowest(joint) + room, upper - room)
        return start

    def _lowest(self, joint: str) -> float:
        """Find the lower end of a joint's range: its stop, if that lies inside the limits."""
        described = self.arm.joint(joint)
        stop = described.stop_lower
        return max(described.lower, stop) if math.isfinite(stop) else described.lower

    def _gains(self, joint: str) -> Gains:
        return Gains(*self._world.arm(self._name).joints.gains(joint))
