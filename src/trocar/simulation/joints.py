"""The joints of an arm, the jaw included: limits, readings and settings; brakes of setup joints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, UnknownNameError
from trocar.simulation.control import LARGEST
from trocar.simulation.health import arm_health
from trocar.simulation.journal import command, command_as
from trocar.simulation.motors import MODES
from trocar.simulation.moves import Motion
from trocar.simulation.records import ArmHealth, Mode
from trocar.simulation.runtime import ArmRuntime

Array = NDArray[np.float64]
Share = Literal["both", "velocity", "acceleration"]

SHARES: tuple[Share, ...] = ("both", "velocity", "acceleration")


class ArmJoints:
    """Limits, readings of every joint and settings of the servos: `arm.joints`.

    Args:
        runtime: of the arm
    """

    def __init__(self, runtime: ArmRuntime) -> None:
        self._journal, self._source, self._prefix = runtime.journal, runtime.name, ""
        self._arm = runtime

    # ------------------------------------------------------------------ what they are

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints, the jaw last where there is one."""
        return self._arm.control.joint_names

    @property
    def lower(self) -> Array:
        """Lower limits, (n,) [rad or m]."""
        return self._arm.control.lower

    @property
    def upper(self) -> Array:
        """Upper limits, (n,) [rad or m]."""
        return self._arm.control.upper

    @property
    def effort_limit(self) -> Array:
        """Largest effort of each motor, (n,) [N m or N]."""
        return self._arm.motors.limit.copy()

    @property
    def poses(self) -> dict[str, Array]:
        """{name: q (n,)}: poses that `Arm.move_to` moves to."""
        return self._arm.poses

    # ------------------------------------------------------------------ readings

    def positions(self) -> Array:
        """Return measured positions, (n,) [rad or m]."""
        return self._arm.motors.positions()

    def readings(self) -> tuple[Array, Array, Array]:
        """Return measured (positions, velocities, efforts), (n,) each."""
        q, qd, effort = self._arm.motors.read()
        return q, qd, effort

    def setpoints(self) -> Array:
        """Return the set-points of positions, (n,) [rad or m]."""
        return self._arm.motors.position.copy()

    def frame_coordinates(self) -> Array:
        """Return every frame's own coordinate, with the loops' errors, (n_frames,)."""
        return self._arm.motors.frame_coordinates()

    def health(self) -> ArmHealth:
        """Return the errors of the arm's loops now."""
        return arm_health(self._arm.description, self._arm.motors.frame_coordinates())

    def potentiometers(
        self,
        noise: float = 0.0,
        offset: ArrayLike = 0.0,
        rng: np.random.Generator | None = None,
    ) -> Array:
        """Return the readings of setup joints' potentiometers, (n,) [rad or m].

        Args:
            noise: standard deviation on request [rad or m]
            offset: of each reading, () or (n,) [rad or m]
            rng: generator of the noise, needed when there is some

        Raises:
            InputError: noise that is no number from 0 on or has no generator, a wrong offset
        """
        name, clean = self._source, self.positions()
        shift = np.asarray(offset, dtype=np.float64)
        if shift.shape not in ((), clean.shape):
            raise InputError(
                f"{name}: got offsets of shape {shift.shape}; allowed: () or {clean.shape}"
            )
        if not 0.0 <= noise < np.inf:
            raise InputError(f"{name}: got noise {noise!r}; allowed: 0 or more")
        if noise == 0.0:
            return clean + shift
        if rng is None:
            raise InputError(f"{name}: potentiometer noise needs a random generator")
        return clean + shift + noise * rng.standard_normal(len(clean))

    # ------------------------------------------------------------------ servos

    def mode(self, joint: str) -> Mode:
        """Return a joint's control mode.

        Raises:
            UnknownNameError: no such joint
        """
        return self._arm.motors.mode(_index(self._arm, joint))

    @command
    def set_mode(self, mode: Mode, joints: Sequence[str] | None = None) -> None:
        """Switch joints (all when omitted) to "position", "effort" or "set", from where they are.

        Moves end; joints that change hold where they are, or exert nothing in mode "effort".
        Rejected with a warning while the arm has power but may not move (PAUSED, not homed).

        Raises:
            InputError: no such mode, or an arm that is welded into the model
            UnknownNameError: no such joint
        """
        arm = self._arm
        if mode not in MODES:
            raise InputError(f"{arm.name}: got mode {mode!r}; allowed: {', '.join(MODES)}")
        _check_movable(arm, "change its mode")
        which = _which(arm, joints)
        if arm.control.states.powered and not arm.control.ready("set_mode"):
            return
        arm.forces.end()
        arm.control.under_position(arm.every)
        arm.control.stay(which)
        arm.motors.effort[which] = 0.0
        arm.motors.set_mode(MODES.index(mode), which)

    def gains(self, joint: str) -> tuple[float, float, float]:
        """Return (P, I, D) of a joint.

        Raises:
            UnknownNameError: no such joint
        """
        p, i, d = self._arm.motors.gains[_index(self._arm, joint)]
        return float(p), float(i), float(d)

    @command
    def set_gains(
        self, joint: str, p: float | None = None, i: float | None = None, d: float | None = None
    ) -> None:
        """Change gains of a joint; those omitted stay.

        Raises:
            InputError: a gain that is negative, not finite or larger than 1e6
            UnknownNameError: no such joint
        """
        motors = self._arm.motors
        row = motors.gains[_index(self._arm, joint)].copy()
        for column, value in enumerate((p, i, d)):
            if value is None:
                continue
            if (
                not isinstance(cast(object, value), (int, float, np.number))
                or not 0.0 <= value <= LARGEST
            ):
                raise InputError(
                    f"{self._source}: {joint}: got gain {value!r}; allowed: 0 to {LARGEST:g}"
                )
            row[column] = value
        motors.set_gains(_index(self._arm, joint), row)

    @property
    def gravity_compensation(self) -> bool:
        """Whether gravity compensation is on."""
        return self._arm.motors.gravity_compensated

    @command
    def use_gravity_compensation(self, on: bool) -> None:
        """Switch gravity compensation; setup joints are counterbalanced and always have it.

        Raises:
            InputError: the arm is welded into the model
        """
        _check_movable(self._arm, "switch its gravity compensation")
        self._arm.motors.compensate_gravity(bool(on))

    @property
    def engaged_brakes(self) -> tuple[str, ...]:
        """Joints whose own brakes are engaged; setup joints have `Arm.brakes`."""
        return tuple(n for n, on in zip(self.names, self._arm.motors.engaged, strict=False) if on)

    @property
    def computed_torque(self) -> bool:
        """Whether joints in mode "position" have computed torque."""
        return self._arm.motors.torque_computed

    @command
    def use_computed_torque(self, on: bool) -> None:
        """Switch computed torque: the model's inverse dynamics beside the servos' P and D.

        Joints in mode "position" then follow their set-points without the errors that weight,
        inertia, friction and the other joints' motion cause; a physics step takes longer.

        Raises:
            InputError: the arm is welded into the model
        """
        _check_movable(self._arm, "switch its computed torque")
        self._arm.motors.compute_torque(bool(on))

    # ------------------------------------------------------------------ moves

    @property
    def strict_limits(self) -> bool:
        """Whether targets beyond a limit are rejected; else they are clipped, as on the dVRK."""
        return self._arm.control.strict_limits

    @command
    def use_strict_limits(self, on: bool) -> None:
        """Reject targets beyond a limit, or clip them."""
        self._arm.control.strict_limits = bool(on)

    @property
    def trajectory_ratio(self) -> tuple[float, float]:
        """Ratios of the velocity and acceleration limits that moves keep to, in ]0, 1]."""
        moves = self._arm.control.moves
        return moves.velocity_ratio, moves.acceleration_ratio

    @command
    def move_again(self) -> Motion:
        """Move to the goal of the last move, with the jaw: the robot's answer to one without."""
        run = self._arm
        part, goal = run.control.moves.joints, run.control.moves.target
        return run.begun(run.control.move(goal[part], part, "move_again", beyond=True))

    @command
    def set_trajectory_ratio(self, ratio: float, of: Share = "both") -> None:
        """Slow down moves, also the one under way.

        Args:
            ratio: of the limits, in ]0, 1]
            of: "both", "velocity" or "acceleration"

        Raises:
            InputError: another ratio or limit; one that leaves a move under way no trajectory
        """
        moves, clock = self._arm.control.moves, self._arm.journal
        if of not in SHARES:
            raise InputError(f"{self._source}: got ratio of {of!r}; allowed: {', '.join(SHARES)}")
        if not isinstance(cast(object, ratio), (int, float, np.number)) or not 0.0 < ratio <= 1.0:
            raise InputError(f"{self._source}: got ratio {ratio!r}; allowed: above 0, up to 1")
        before = self.trajectory_ratio
        if of != "acceleration":
            moves.velocity_ratio = float(ratio)
        if of != "velocity":
            moves.acceleration_ratio = float(ratio)
        try:
            moves.plan_again(clock.time)
        except InputError:
            moves.velocity_ratio, moves.acceleration_ratio = before
            raise
        velocity, acceleration = self.trajectory_ratio
        self._arm.control.report("trajectory_ratio", velocity=velocity, acceleration=acceleration)


class Brakes(Mapping[str, bool]):
    """{joint: whether its brake is locked}; empty for arms without brakes: `arm.brakes`.

    Args:
        runtime: of the arm
    """

    def __init__(self, runtime: ArmRuntime) -> None:
        self._journal, self._source, self._prefix = runtime.journal, runtime.name, ""
        self._arm = runtime

    def __getitem__(self, joint: str) -> bool:
        """Return whether a joint's brake is locked."""
        if not self._arm.motors.brakes:
            raise KeyError(joint)
        return bool(self._arm.motors.locked[self._arm.control.joint_names.index(joint)])

    def __iter__(self) -> Iterator[str]:
        """Iterate over the joints that have brakes."""
        return iter(self._arm.control.joint_names if self._arm.motors.brakes else ())

    def __len__(self) -> int:
        """Return the number of brakes."""
        return len(self._arm.control.joint_names) if self._arm.motors.brakes else 0

    def __repr__(self) -> str:
        return f"<Brakes of {self._source!r}: {dict(self)}>"

    @command_as("release_brakes")
    def release(self, joints: Sequence[str] | None = None) -> None:
        """Release brakes (all when omitted); the joints then follow their servos from here.

        Raises:
            InputError: an arm without brakes, or one that is welded into the model
            UnknownNameError: no such joint
        """
        self._set(False, joints)

    @command_as("lock_brakes")
    def lock(self, joints: Sequence[str] | None = None) -> None:
        """Lock brakes (all when omitted) in the present position of the joints.

        Raises:
            InputError: an arm without brakes, or one that is welded into the model
            UnknownNameError: no such joint
        """
        self._set(True, joints)

    def _set(self, locked: bool, joints: Sequence[str] | None) -> None:
        arm = self._arm
        if not arm.motors.brakes:
            raise InputError(f"{arm.name}: has no brakes; only setup joints do")
        _check_movable(arm, "release its brakes")
        which = _which(arm, joints)
        arm.control.stay(which)
        arm.motors.set_brakes(locked, which)
        arm.motors.follow()


def _check_movable(arm: ArmRuntime, wish: str) -> None:
    if arm.motors.welded:
        raise InputError(
            f"{arm.name}: is welded into the model; build the world without that to {wish}"
        )


def _which(arm: ArmRuntime, joints: Iterable[str] | None) -> list[int]:
    """Return the indices of joints that have a motor, all of them when omitted."""
    names, described = arm.control.joint_names, arm.description
    motors = names[: described.own_joints] if described.has_gripper else names
    which = [_index(arm, name) for name in (motors if joints is None else joints)]
    if any(k >= len(motors) for k in which):
        raise InputError(f"{arm.name}: {names[-1]} has no motor; squeeze it")
    return which


def _index(arm: ArmRuntime, joint: str) -> int:
    names = arm.control.joint_names
    if joint not in names:
        raise UnknownNameError("joint", joint, names, arm.name)
    return names.index(joint)
