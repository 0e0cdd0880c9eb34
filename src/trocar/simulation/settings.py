"""How an arm is driven: modes, gains, limits of moves, brakes, compensation, base frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, UnknownNameError
from trocar.geometry.se3 import check_transform
from trocar.simulation.drives import Drives
from trocar.simulation.journal import Journal, command
from trocar.simulation.motion import RATIO_MIN
from trocar.simulation.records import Mode
from trocar.simulation.verbs import Verbs

Array = NDArray[np.float64]
MODES: tuple[Mode, ...] = ("position", "effort", "set")
Share = Literal["both", "velocity", "acceleration"]
SHARES: tuple[Share, ...] = ("both", "velocity", "acceleration")


class Settings:
    """The part of an arm that is set rather than moved; `Arm` adds the verbs of motion."""

    name: str
    joint_names: tuple[str, ...]
    _journal: Journal
    _source: str
    _prefix: str
    _verbs: Verbs
    _drives: Drives
    _base: tuple[Array, str] | None

    # ------------------------------------------------------------------ servos

    def mode(self, joint: str) -> Mode:
        """Return a joint's control mode."""
        return self._drives.modes[self._index(joint)]

    @command
    def set_mode(self, mode: Mode, joints: Sequence[str] | None = None) -> None:
        """Switch joints (all when omitted) to "position", "effort" or "set", from where they are.

        Moves end; joints that change hold where they are, or exert nothing in mode "effort".
        Refused with a warning while the arm has power but may not move (PAUSED, not homed).

        Raises:
            InputError: no such mode, or an arm that is welded into the model
            UnknownNameError: no such joint
        """
        if mode not in MODES:
            raise InputError(f"{self.name}: got mode {mode!r}; allowed: {', '.join(MODES)}")
        self._check_movable("change its mode")
        which = self._which(joints)
        if self._verbs.states.powered and not self._verbs.ready("set_mode"):
            return
        self._end_laws()
        self._verbs.under_position(slice(0, len(self.joint_names)))
        self._verbs.stay(which)
        self._verbs.setpoints.effort[which] = 0.0
        self._drives.set_mode(mode, which, self._verbs.setpoints.position)

    def gains(self, joint: str) -> tuple[float, float, float]:
        """Return (P, I, D) of a joint."""
        p, i, d = self._drives.gains[self._index(joint)]
        return float(p), float(i), float(d)

    @command
    def set_gains(
        self, joint: str, p: float | None = None, i: float | None = None, d: float | None = None
    ) -> None:
        """Change gains of a joint; those omitted stay.

        Raises:
            InputError: a gain that is negative or not finite
            UnknownNameError: no such joint
        """
        row = self._drives.gains[self._index(joint)].copy()
        for column, value in enumerate((p, i, d)):
            if value is None:
                continue
            if not isinstance(value, (int, float, np.number)) or not 0.0 <= value < np.inf:
                raise InputError(f"{self.name}: {joint}: got gain {value!r}; allowed: 0 or more")
            row[column] = value
        self._drives.gains[self._index(joint)] = row
        self._drives.apply()

    @property
    def gravity_compensation(self) -> bool:
        """Whether gravity compensation is on."""
        return self._drives.gravity_compensated

    @command
    def use_gravity_compensation(self, on: bool) -> None:
        """Switch gravity compensation; setup joints are counterbalanced and always have it."""
        self._drives.compensate_gravity(on)

    # ------------------------------------------------------------------ moves

    @property
    def strict_limits(self) -> bool:
        """Whether targets beyond a limit are refused; else they are clipped, as on the dVRK."""
        return self._verbs.strict_limits

    @command
    def use_strict_limits(self, on: bool) -> None:
        """Refuse targets beyond a limit, or clip them."""
        self._verbs.strict_limits = bool(on)

    @property
    def trajectory_ratio(self) -> tuple[float, float]:
        """Shares of the velocity and acceleration limits that moves keep to, RATIO_MIN to 1."""
        return self._verbs.setpoints.velocity_ratio, self._verbs.setpoints.acceleration_ratio

    @command
    def set_trajectory_ratio(self, ratio: float, of: Share = "both") -> None:
        """Slow down the moves that begin from now on.

        Args:
            ratio: share of the limits, RATIO_MIN to 1
            of: "both", "velocity" or "acceleration"

        Raises:
            InputError: another ratio or limit
        """
        if of not in SHARES:
            raise InputError(f"{self.name}: got ratio of {of!r}; allowed: {', '.join(SHARES)}")
        if not isinstance(ratio, (int, float, np.number)) or not RATIO_MIN <= ratio <= 1.0:
            raise InputError(f"{self.name}: got ratio {ratio!r}; allowed: {RATIO_MIN:g} to 1")
        if of != "acceleration":
            self._verbs.setpoints.velocity_ratio = float(ratio)
        if of != "velocity":
            self._verbs.setpoints.acceleration_ratio = float(ratio)
        velocity, acceleration = self.trajectory_ratio
        self._verbs.tell("trajectory_ratio", velocity=velocity, acceleration=acceleration)

    @command
    def set_base_frame(self, T: ArrayLike | None, frame_id: str = "") -> None:
        """Say where the arm's reference frame stands in the frame of `measured_cp`.

        Args:
            T: (4, 4); None: where the rig has it, by the measured joints of what carries it
            frame_id: name of the frame that T is in; "<ARM>_base" when omitted

        Raises:
            InputError: T is no pose
        """
        if T is None:
            self._base = None
            return
        base = check_transform(T)
        if base.shape != (4, 4):
            raise InputError(f"{self.name}: got a pose of shape {base.shape}; allowed: (4, 4)")
        self._base = base.copy(), frame_id or f"{self.name}_base"

    # ------------------------------------------------------------------ brakes of setup joints

    @property
    def brakes(self) -> dict[str, bool]:
        """{joint: whether its brake is locked}; empty for arms without brakes."""
        if not self._drives.brakes:
            return {}
        return {
            name: bool(v) for name, v in zip(self.joint_names, self._drives.locked, strict=True)
        }

    @command
    def release_brakes(self, joints: Sequence[str] | None = None) -> None:
        """Release brakes (all when omitted); the joints then follow their servos from here.

        Raises:
            InputError: an arm without brakes, or one that is welded into the model
            UnknownNameError: no such joint
        """
        self._set_brakes(False, joints)

    @command
    def lock_brakes(self, joints: Sequence[str] | None = None) -> None:
        """Lock brakes (all when omitted) where the joints are.

        Raises:
            InputError: an arm without brakes, or one that is welded into the model
            UnknownNameError: no such joint
        """
        self._set_brakes(True, joints)

    def potentiometers(
        self,
        noise: float = 0.0,
        offset: ArrayLike = 0.0,
        rng: np.random.Generator | None = None,
    ) -> Array:
        """Return what the setup joints' potentiometers read, (n,) [rad or m].

        Args:
            noise: standard deviation on request [rad or m]
            offset: of each reading, () or (n,) [rad or m]
            rng: generator of the noise, needed when there is some

        Raises:
            InputError: noise that is no number from 0 on or has no generator, a wrong offset
        """
        clean = self._verbs.positions()
        shift = np.asarray(offset, dtype=np.float64)
        if shift.shape not in ((), clean.shape):
            raise InputError(
                f"{self.name}: got offsets of shape {shift.shape}; allowed: () or {clean.shape}"
            )
        if not 0.0 <= noise < np.inf:
            raise InputError(f"{self.name}: got noise {noise!r}; allowed: 0 or more")
        if noise == 0.0:
            return clean + shift
        if rng is None:
            raise InputError(f"{self.name}: potentiometer noise needs a random generator")
        return clean + shift + noise * rng.standard_normal(len(clean))

    # ------------------------------------------------------------------ inside

    def _end_laws(self) -> None:
        """End periodic laws; `Arm` knows which there are."""
        raise NotImplementedError

    def _set_brakes(self, locked: bool, joints: Sequence[str] | None) -> None:
        if not self._drives.brakes:
            raise InputError(f"{self.name}: has no brakes; only setup joints do")
        self._check_movable("release its brakes")
        which = self._which(joints)
        self._verbs.stay(which)
        self._drives.set_brakes(locked, which)
        self._verbs.write()

    def _check_movable(self, wish: str) -> None:
        if self._drives.welded:
            raise InputError(
                f"{self.name}: is welded into the model; build the world with"
                f' setup_joints="braked" to {wish}'
            )

    def _which(self, joints: Iterable[str] | None) -> list[int]:
        arm = self._drives.arm
        motors = self.joint_names[: arm.own_joints] if arm.has_gripper else self.joint_names
        which = [self._index(name) for name in (motors if joints is None else joints)]
        if any(k >= len(motors) for k in which):
            raise InputError(f"{self.name}: {self.joint_names[-1]} has no motor; squeeze it")
        return which

    def _index(self, joint: str) -> int:
        if joint not in self.joint_names:
            raise UnknownNameError("joint", joint, self.joint_names, self.name)
        return self.joint_names.index(joint)
