"""Force control of an arm: controllers of its tip, time-outs, the locked gimbal of a master."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.plugins import load_registered
from trocar.errors import InputError, TrocarError
from trocar.kinematics.closed_form import fit_chain
from trocar.kinematics.inverse_gimbal_arm import PLATFORM
from trocar.simulation.control import LARGEST, ArmWorld, JointControl
from trocar.simulation.controllers import (
    CartesianForce,
    CartesianImpedance,
    Controller,
    ControllerError,
    RegisteredController,
    WrenchFrame,
)
from trocar.simulation.journal import command
from trocar.simulation.masters import (
    GIMBAL,
    GimbalLimits,
    PlatformEffort,
    check_orientation,
    orientation_lock,
)
from trocar.simulation.records import Wrench
from trocar.simulation.tip import FRAMES, Tip

Array = NDArray[np.float64]

#: The closed form of masters, whose wrist platform is free and whose gimbal can be locked.
GIMBAL_ARM = "gimbal_arm"


@dataclass(frozen=True)
class Expiry:
    """When an effort or velocity set-point ends, unless another command comes before.

    Attributes:
        verb: that set it
        timeout: given with it [s]
        time: simulation time of the end [s]
    """

    verb: str
    timeout: float
    time: float


@dataclass(frozen=True, eq=False)
class ForceState:
    """Copies of what `ForceControl` keeps, by its attributes' names."""

    controllers: dict[str, Controller]
    orientation: Array | None
    absolute: bool
    effort: Array
    expiry: Expiry | None


class ForceControl:
    """Controllers that exert efforts at an arm's tip, until the next command: `arm.forces`.

    Args:
        name: of the arm
        tip: its tip
        clock: its world
        fault: called with the reason when a controller fails
        report: called when the operating state may have changed

    Attributes:
        controllers: those that are active, by name; their efforts are added up
        effort: commanded efforts, to which those of controllers are added, (n,) [N m or N]
        orientation: that the gimbal of a master holds, (3, 3) in the frame of `measured_cp`; None
            without a lock
        expiry: end of an effort or velocity set-point, None where it has none
    """

    def __init__(
        self,
        name: str,
        tip: Tip,
        clock: ArmWorld,
        fault: Callable[[str], None],
        report: Callable[[], None],
    ) -> None:
        self._journal, self._source, self._prefix = clock.journal, name, ""
        self._tip, self._clock, self._fault, self._report = tip, clock, fault, report
        self.controllers: dict[str, Controller] = {}
        self.expiry: Expiry | None = None
        self.orientation: Array | None = None
        self._absolute = False

    def fit(self, control: JointControl) -> None:
        """Set the joints of the mounted tool."""
        self._control, self._arm = control, control.motors.arm
        self._own = slice(0, self._arm.own_joints)
        self.effort = np.zeros(self._arm.own_joints)

    # ------------------------------------------------------------------ verbs

    @command
    def servo_cf(
        self, wrench: ArrayLike, frame: WrenchFrame = "body", timeout_s: float | None = None
    ) -> bool:
        """Exert a wrench (force; torque), (6,) [N, N m], until the next command or the time-out.

        Args:
            wrench: what the arm exerts on its surroundings
            frame: "body": at the tip in its axes; "spatial": about the reference frame's origin
            timeout_s: as for `Arm.servo_jf`
        """
        names = ("fx", "fy", "fz", "tx", "ty", "tz")
        components = self._control.rejections.vector(wrench, names, "servo_cf", "forces")
        if components is None:
            return False
        if frame not in FRAMES:
            why = f"got frame {frame!r}; allowed: {', '.join(FRAMES)}"
            self._control.rejections.reject("servo_cf", "frame", why)
            return False
        if not self.may_expire("servo_cf", timeout_s):
            return False
        force = CartesianForce(components, frame, self._absolute)
        return self.expiring(self._run(force, "servo_cf"), "servo_cf", timeout_s)

    @command
    def set_cf_orientation_absolute(self, on: bool) -> None:
        """Take the wrenches of `servo_cf` in the axes of `measured_cp`'s frame, at the tip."""
        self._absolute = bool(on)

    @command
    def servo_ci(self, impedance: CartesianImpedance) -> bool:
        """Be a spring and damper about a pose, until the next command."""
        try:
            if not isinstance(cast(object, impedance), CartesianImpedance):
                raise InputError(f"got {impedance!r}; allowed: a CartesianImpedance")
            impedance.check(LARGEST)
        except InputError as problem:
            self._control.rejections.reject("servo_ci", "values", str(problem))
            return False
        return self._run(impedance, "servo_ci")

    @command
    def use_controller(self, name: str, settings: Mapping[str, Any] | None = None) -> bool:
        """Exert what a controller of an installed package computes, until the next command.

        A controller that raises puts the arm into FAULT.

        Args:
            name: as the package registers it, see docs/extending.md
            settings: keyword arguments of its class

        Raises:
            UnknownNameError: no package registers it; the known names are listed
            InputError: it cannot be made with these settings
        """
        made = load_registered("controllers", str(name))
        try:
            controller: Controller = made(**(settings or {}))
        except Exception as problem:
            what = f"{type(problem).__name__}: {problem}"
            raise InputError(f"controller {name}: got {settings!r}: {what}") from problem
        if not callable(getattr(controller, "act", None)):
            raise InputError(f"controller {name}: got {controller!r}; allowed: with act(now)")
        return self._run(RegisteredController(str(name), controller), "use_controller")

    @property
    def orientation_locked(self) -> bool:
        """Whether the gimbal holds an orientation, or will under the next force command."""
        return self.orientation is not None

    @command
    def lock_orientation(self, R: ArrayLike | None = None) -> bool:
        """Let a master's gimbal hold an orientation while the tip is under force control.

        It does so under `servo_cf` and `servo_ci`, at once or when one of them comes; the first
        three joints stay free. `unlock_orientation`, `free` and every other command end it.

        Args:
            R: (3, 3) or a quaternion wxyz, in the frame of `measured_cp`; as it is when omitted

        Returns:
            whether the command was accepted
        """
        verb = "lock_orientation"
        if not self._control.ready(verb):
            return False
        if self._arm.inverse_kinematics != GIMBAL_ARM:
            self._control.rejections.reject(verb, "", "only masters can")
            return False
        try:
            orientation = self._tip.measured().matrix[:3, :3] if R is None else check_orientation(R)
        except TrocarError as problem:
            self._control.rejections.reject(verb, "", str(problem))
            return False
        self.orientation = orientation.copy()
        if "wrench" in self.controllers:
            self._begin_lock()
        self._control.report("orientation_locked", locked=True)
        return True

    @command
    def unlock_orientation(self) -> bool:
        """Release the gimbal; under force control it floats again."""
        if "lock" in self.controllers:
            del self.controllers["lock"]
            self._control.to_effort(list(range(GIMBAL.start, GIMBAL.stop)), self._own)
        self._forget_lock()
        return True

    # ------------------------------------------------------------------ used by the arm

    @property
    def active(self) -> bool:
        """Whether efforts change from step to step, or a set-point will expire."""
        return bool(self.controllers) or self.expiry is not None

    def begin(self) -> None:
        """Start anew, without commands."""
        self._absolute = False
        self.effort[:] = 0.0

    def idle(self) -> bool:
        """Return whether there is nothing to `end`."""
        return not self.controllers and self.orientation is None and self.expiry is None

    def end(self) -> None:
        """End controllers, time-outs and the lock of the gimbal."""
        self.expiry = None
        self.controllers.clear()
        self._forget_lock()

    def accept(self, accepted: bool) -> bool:
        """End controllers after an effort command that was accepted; return whether it was."""
        if accepted:
            self.end()
            self.effort = self._control.motors.effort[self._own].copy()
            self._report()
        return accepted

    def may_expire(self, verb: str, timeout_s: float | None) -> bool:
        """Return whether a time-out is usable; reject the command when not."""
        number = isinstance(timeout_s, (int, float, np.number)) and not isinstance(timeout_s, bool)
        usable = timeout_s is None or (number and 0.0 < timeout_s <= LARGEST)
        if not usable:
            why = f"got timeout_s {timeout_s!r}; allowed: above 0, or None"
            self._control.rejections.reject(verb, "timeout", why)
        return usable

    def expiring(self, accepted: bool, verb: str, timeout_s: float | None) -> bool:
        """Note when a set-point that was accepted ends; return whether it was."""
        if accepted:
            self.expiry = None
            if timeout_s is not None:
                timeout = float(timeout_s)
                self.expiry = Expiry(verb, timeout, self._clock.time + timeout)
        return accepted

    def apply(self) -> None:
        """Sum the efforts of all controllers and hand them to the motors."""
        now = self._tip.state()
        effort = self.effort.copy()
        for controller in tuple(self.controllers.values()):
            try:
                action = controller.act(now)
            except ControllerError as problem:
                self._fault(str(problem))
                return
            effort += action.effort
            if action.position is not None:
                self._control.steer(action.position, action.velocity, self._own)
        self._control.exert(effort, self._own, "efforts")

    def save(self) -> ForceState:
        """Return copies of everything that is kept here."""
        return ForceState(
            copy.deepcopy(self.controllers),
            None if self.orientation is None else self.orientation.copy(),
            self._absolute,
            self.effort.copy(),
            self.expiry,
        )

    def load(self, saved: ForceState) -> None:
        """Restore everything that `save` returned."""
        self.controllers = copy.deepcopy(saved.controllers)
        self.orientation = None if saved.orientation is None else saved.orientation.copy()
        self._absolute, self.effort = saved.absolute, saved.effort.copy()
        self.expiry = saved.expiry

    # ------------------------------------------------------------------ inside

    def _run(self, controller: Controller, verb: str) -> bool:
        if not self._control.ready(verb):
            return False
        if "wrench" not in self.controllers and not self._tip.deep_enough(verb):
            return False
        # a locked arm is under force control, and the gimbal goes on
        locked = "lock" in self.controllers
        self.effort = np.zeros_like(self.effort)
        if not locked and not self._control.servo_effort(self.effort, self._own, verb):
            return False
        self.expiry = None
        self._tip.commanded("wrench" not in self.controllers)
        self.controllers["wrench"] = controller
        self._begin_master_controllers(controller)
        self.apply()
        self._report()
        return True

    def _begin_master_controllers(self, controller: Controller) -> None:
        """Let a master's platform give way and its gimbal be locked under force control.

        Under a wrench in the reference frame the platform stays, as on the dVRK.
        """
        if self._arm.inverse_kinematics != GIMBAL_ARM:
            return
        self.controllers.pop("platform", None)
        if not (isinstance(controller, CartesianForce) and controller.frame == "spatial"):
            platform = self._arm.joints[PLATFORM]
            self.controllers["platform"] = PlatformEffort(platform.lower, platform.upper)
        if self.orientation is not None and "lock" not in self.controllers:
            self._begin_lock()

    def _begin_lock(self) -> None:
        if self.orientation is None:
            return
        if "lock" not in self.controllers:
            self._control.to_position(list(range(GIMBAL.start, GIMBAL.stop)), self._own)
        joints = self._arm.joints[self._own]
        limits = GimbalLimits(
            np.array([j.lower for j in joints]),
            np.array([j.upper for j in joints]),
            np.array([j.velocity_max for j in joints]),
        )
        self.controllers["lock"] = orientation_lock(
            fit_chain(self._arm.mechanism, GIMBAL_ARM),
            self._tip.base_frame()[0][:3, :3].T @ self.orientation,
            self._control.motors.positions()[self._own],
            limits,
            self._clock.time,
        )

    def _forget_lock(self) -> None:
        if self.orientation is not None:
            self.orientation = None
            self._control.report("orientation_locked", locked=False)


class TipForces:
    """Wrenches and Jacobian of an arm's tip in one of two frames: `arm.body`, `arm.spatial`.

    Args:
        forces, tip: of the arm
        frame: "body": at the tip in its axes; "spatial": about the reference frame's origin in its
            axes
    """

    def __init__(self, forces: ForceControl, tip: Tip, frame: WrenchFrame) -> None:
        self._forces, self._tip = forces, tip
        self._frame: WrenchFrame = frame

    def servo_cf(self, wrench: ArrayLike, timeout_s: float | None = None) -> bool:
        """Exert a wrench (force; torque), (6,) [N, N m], until the next command or the time-out.

        Args:
            wrench: what the arm exerts on its surroundings
            timeout_s: as for `Arm.servo_jf`

        Returns:
            whether the command was accepted
        """
        if timeout_s is None:
            return self._forces.servo_cf(wrench, self._frame)
        return self._forces.servo_cf(wrench, self._frame, timeout_s)

    def measured_cf(self) -> Wrench:
        """Return the wrench that the motors exert at the tip, what carries the links not counted.

        The least-squares solution of tau = J^T w: exact for six joints, the smallest for fewer.
        """
        return self._tip.wrench(self._frame)

    def jacobian(self) -> Array:
        """Return J with (linear; angular) = J @ qd where the arm is, jaw left out, (6, n)."""
        return self._tip.jacobian(self._frame)
