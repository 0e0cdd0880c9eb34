"""Verbs of an arm's tip: poses to go to, wrenches to exert, springs to be."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.geometry.se3 import transform
from trocar.kinematics.chain_pose import chain_pose
from trocar.simulation.controllers import CartesianForce, CartesianImpedance, Law, WrenchFrame
from trocar.simulation.journal import command
from trocar.simulation.motion import Motion
from trocar.simulation.readings import FRAMES, Readings

Array = NDArray[np.float64]

#: Cartesian commands need the first wrist joint this far past the remote centre. Source:
#: mtsIntuitiveResearchKit.h, SafeDistanceFromRCM. [m]
SAFE_DEPTH_M = 0.045


class TipVerbs(Readings):
    """The part of an arm that moves its tip."""

    type: str
    _laws: dict[str, Law]
    _push: Array
    _absolute: bool

    def _ended(self, accepted: bool) -> bool:
        """End laws after a position command that was accepted; `Arm` does."""
        raise NotImplementedError

    def _begun(self, motion: Motion) -> Motion:
        """End laws after a move that began; `Arm` does."""
        raise NotImplementedError

    def _begin_master_laws(self, law: Law) -> None:
        """Add what a master does under force control; `Locking` does."""
        raise NotImplementedError

    @command
    def servo_cp(self, T: ArrayLike) -> bool:
        """Bring the tip to a pose (4, 4) in the frame of `measured_cp` now."""
        q = self._solved(T, "servo_cp")
        return q is not None and self._ended(self._verbs.servo(q, None, self._own, "servo_cp"))

    @command
    def servo_cr(self, T: ArrayLike) -> bool:
        """Move the tip from its set-point by a translation and a rotation, (4, 4), now.

        Both in axes of the frame of `measured_cp`: p + dp, dR @ R.
        """
        change = np.asarray(T, dtype=np.float64)
        told = self.setpoint_cp().T
        if change.shape == (4, 4):
            told = transform(change[:3, :3] @ told[:3, :3], told[:3, 3] + change[:3, 3])
        else:
            told = change
        q = self._solved(told, "servo_cr")
        return q is not None and self._ended(self._verbs.servo(q, None, self._own, "servo_cr"))

    @command
    def move_cp(self, T: ArrayLike) -> Motion:
        """Move to a pose (4, 4) in the frame of `measured_cp`: solved once, then joint by joint."""
        q = self._solved(T, "move_cp")
        if q is None:
            return self._verbs.refused(self._own)
        return self._begun(self._verbs.move(q, self._own, "move_cp"))

    @command
    def servo_cf(self, wrench: ArrayLike, frame: WrenchFrame = "body") -> bool:
        """Exert a wrench (force; torque), (6,) [N, N m], that persists until the next command.

        Args:
            wrench: what the arm exerts on its surroundings
            frame: "body": at the tip in its axes; "spatial": about the reference frame's origin
        """
        names = ("fx", "fy", "fz", "tx", "ty", "tz")
        wanted = self._verbs.refusals.vector(wrench, names, "servo_cf", "forces")
        if wanted is None:
            return False
        if frame not in FRAMES:
            self._verbs.refusals.warn(
                "servo_cf frame", f"servo_cf: got frame {frame!r}; allowed: {', '.join(FRAMES)}"
            )
            return False
        return self._follow_law(CartesianForce(wanted, frame, self._absolute), "servo_cf")

    @command
    def set_cf_orientation_absolute(self, on: bool) -> None:
        """Take the wrenches of `servo_cf` in the axes of `measured_cp`'s frame, at the tip."""
        self._absolute = bool(on)

    @command
    def servo_ci(self, impedance: CartesianImpedance) -> bool:
        """Be a spring and damper about a pose, until the next command."""
        return self._follow_law(impedance, "servo_ci")

    # ------------------------------------------------------------------ inside

    def _solved(self, T: ArrayLike, verb: str) -> Array | None:
        """Return the joints of a pose, when Cartesian commands are allowed now."""
        if not self._verbs.ready(verb) or not self._deep_enough(verb):
            return None
        return self._nearest(T, verb)

    def _deep_enough(self, verb: str) -> bool:
        """Warn and return False while an instrument's wrist is too near its remote centre."""
        mechanism = self.description.mechanism
        if self.type != "PSM" or "wrist_pitch" not in mechanism.frame_index:
            return True
        q = self.positions()
        wrist = chain_pose(mechanism, "wrist_pitch")(q)[:3, 3]
        depth = float(chain_pose(mechanism, "roll")(q)[:3, 2] @ wrist)
        if depth >= SAFE_DEPTH_M:
            return True
        self._verbs.refusals.warn(
            f"{verb} depth",
            f"{verb}: the wrist is {1e3 * depth:.1f} mm past the remote centre; allowed from "
            f"{1e3 * SAFE_DEPTH_M:.0f} mm on; insert the instrument first",
        )
        return False

    def _follow_law(self, law: Law, verb: str) -> bool:
        if not self._verbs.ready(verb) or not self._deep_enough(verb):
            return False
        locked = "lock" in self._laws  # then it is under force control, and the gimbal goes on
        self._push = np.zeros_like(self._push)
        if not locked and not self._verbs.servo_effort(self._push, self._own, verb):
            return False
        self._laws["wrench"] = law
        self._begin_master_laws(law)
        self._obey()
        self.tell_state()
        return True

    def _obey(self) -> None:
        """Add up the efforts of all laws and hand them to the motors."""
        now = self._tip_state()
        effort = self._push.copy()
        for law in self._laws.values():
            action = law.act(now)
            effort += action.effort
            if action.position is not None:
                self._verbs.steer(action.position, action.velocity, self._own)
        self._verbs.exert(effort, self._own, "efforts")
