"""One master that moves an instrument: MTM -> PSM."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.teleops import TeleopDescription
from trocar.geometry.rotations import angle_between
from trocar.geometry.se3 import transform
from trocar.teleoperation.component import ALIGNING, ENABLED, SETTING, TeleopComponent
from trocar.teleoperation.force_feedback import ForceFeedback
from trocar.teleoperation.masters import Master, MasterReading
from trocar.teleoperation.slave import Slave, base_in_view
from trocar.teleoperation.virtual_fixtures import Fixtures

if TYPE_CHECKING:
    from trocar.simulation import World

Array = NDArray[np.float64]

#: Time between two readings of the tool's orientation while the master aligns with it. Source: our
#: own choice, as the tool rarely turns then (the dVRK: each period). [s]
ALIGN_S = 0.05
#: Gripper and jaw have met. Source: SAW mtsIntuitiveResearchKit.h, ToleranceBackFromClutch. [rad]
MET = math.radians(2.0)
CLUTCH = {True: "pressed", False: "released"}
#: Part of the sum of both thresholds that is enough of gripper and roll together. Source: SAW
#: mtsTeleOperationPSM.cpp, TransitionAligningMTM.
BOTH = 0.8


@dataclass
class JawFollower:
    """Let the jaw follow the gripper, slowly until they have met.

    A ghost of the gripper goes after it, beginning where the jaw is. The gripper at `gripper_max`
    opens the jaw to its upper limit. Source: SAW mtsTeleOperationPSM.cpp, RunJawGripperTeleop,
    UpdateGripperToJawConfiguration.

    Args:
        description: openings and speeds
        lower, upper: limits of the jaw [rad]
        jaw: the jaw's set-point [rad]
    """

    description: TeleopDescription
    lower: float
    upper: float
    jaw: float

    def __post_init__(self) -> None:
        """Begin at the jaw."""
        self.ghost = self._gripper(self.jaw)
        self._met = False

    def follow(self, gripper: float, period_s: float) -> float:
        """Return the jaw's opening after a period [rad]."""
        self._met = self._met or abs(gripper - self.ghost) < MET
        rates = self.description.jaw_rate, self.description.jaw_rate_after_clutch
        most = rates[0 if self._met else 1] * period_s
        ghost = self.ghost + min(max(gripper - self.ghost, -most), most)
        opening = (ghost - self.description.gripper_zero) / self._ratio
        self.jaw = min(max(opening, self.lower), self.upper)
        self.ghost = ghost if self.jaw == opening else self._gripper(self.jaw)  # no windup
        return self.jaw

    @property
    def _ratio(self) -> float:
        return (self.description.gripper_max - self.description.gripper_zero) / self.upper

    def _gripper(self, jaw: float) -> float:
        return self.description.gripper_zero + jaw * self._ratio


class HandDetector:
    """Detect a hand at the master by how far gripper and roll went to and fro.

    Source: SAW mtsTeleOperationPSM.cpp, TransitionAligningMTM.

    Args:
        gripper, roll: range that is enough, or BOTH of their sum; 0 of either: a hand is there at
            once [rad]

    Attributes:
        present: whether a hand is there
    """

    def __init__(self, gripper: float, roll: float) -> None:
        self._enough = (gripper, roll)
        self.present = False
        self.restart()

    def restart(self) -> None:
        """Forget how far both went."""
        self._lowest, self._highest = [math.inf] * 2, [-math.inf] * 2

    def update(self, gripper: float | None, offset: Array | None) -> bool:
        """Return whether a hand is there.

        Args:
            gripper: its opening, None without one [rad]
            offset: rotation from the handle to its goal, while that is small, (3, 3)
        """
        if min(self._enough) <= 0.0:
            self.present = True
        roll = None if offset is None else math.atan2(offset[1, 0], offset[0, 0])
        for index, value in enumerate((gripper, roll)):
            if value is None:
                continue
            self._lowest[index] = min(self._lowest[index], value)
            self._highest[index] = max(self._highest[index], value)
        ranges = [high - low for low, high in zip(self._lowest, self._highest, strict=True)]
        enough = any(range_ >= least for range_, least in zip(ranges, self._enough, strict=True))
        self.present = self.present or enough or sum(ranges) > BOTH * sum(self._enough)
        return self.present


class PsmTeleoperation(TeleopComponent):
    """An instrument that does what a hand does, smaller.

    Attributes:
        rotation_locked, translation_locked: what does not follow
        align: whether the master turns as the tool is turned, before it moves it
        offset: rotation from the handle to the tip as the surgeon sees both, (3, 3)
        fixtures: virtual fixtures of the instrument, None without any
        feedback: force feedback to the hand, None without any
        carried: returns whether the page or a recording moves the handle, so that no force can
        wrench: of a client on the hand while the tool follows, in axes of the handle, (6,)
            [N, N m], None without any
    """

    #: Both spellings are accepted: the topic that publishes the setting is called align_mtm.
    commands: Mapping[str, str] = {
        **TeleopComponent.commands,
        "align_MTM": ALIGNING,
        "align_mtm": ALIGNING,
    }

    def __init__(
        self, world: World, description: TeleopDescription, masters: Sequence[Master]
    ) -> None:
        super().__init__(world, description, masters)
        self.rotation_locked = description.rotation_locked
        self.translation_locked = description.translation_locked
        self.align = description.align
        self.offset = np.eye(3)
        self.fixtures: Fixtures | None = None
        self.feedback: ForceFeedback | None = None
        self.carried: Callable[[], bool] = lambda: False
        self.wrench: Array | None = None
        self._T_world_view = np.eye(4)
        self._carried_since = False  # then the arm holds the handle
        self._hand = HandDetector(description.gripper_threshold, description.roll_threshold)
        self._after_pause = False
        self._slave: Slave | None = None
        self._aligned_at = -np.inf
        self._reason = ""

    # ------------------------------------------------------------------ commands

    def press_clutch(self, pressed: bool) -> None:
        """Press or release the clutch; outside of following that is published alone."""
        if self.desired != ENABLED or self.current != ENABLED:
            if pressed:
                self.publish("following", False)
            self.publish("status", f"{self.name}: console clutch {CLUTCH[pressed]}")
        super().press_clutch(pressed)

    def lock_rotation(self, on: bool) -> None:
        """Keep the instrument's orientation, or turn it with the hand again."""
        self.rotation_locked = on
        self.publish("rotation_locked", on)
        if self.current == ENABLED:
            if on:
                self._engage_anew()
                self.masters[0].release(self.world, locked=True)
            else:  # the handle was turned in between
                self._align_anew()

    def lock_translation(self, on: bool) -> None:
        """Keep the instrument's place, or move it with the hand again."""
        self.translation_locked = on
        self.publish("translation_locked", on)
        self._engage_anew()

    def set_align(self, on: bool) -> None:
        """Turn the master as the tool is turned before it moves it, or do not."""
        self.align = on
        self.publish("align_mtm", on)
        if self.current == ENABLED:
            self._align_anew()

    def exert(self, wrench: Array) -> None:
        """Exert a wrench on the hand, in axes of the handle, (6,) [N, N m], while the tool follows.

        It ends with following, as on the dVRK; outside of following it has no effect.
        """
        if self.following:
            self.wrench = wrench

    def goal(self, T: Array) -> Array:
        """Return the tip's pose for the handle at T, as the surgeon sees both, (4, 4)."""
        p = self._to[:3, 3]
        if not self.translation_locked:
            p = p + self.scale * (T[:3, 3] - self._from[:3, 3])
        return transform(self._to[:3, :3] if self.rotation_locked else T[:3, :3] @ self.offset, p)

    # ------------------------------------------------------------------ states

    def _align(self, readings: Sequence[MasterReading]) -> None:
        reading, master = readings[0], self.masters[0]
        if self._slave is None or self.world.time - self._aligned_at >= ALIGN_S:
            self._aligned_at = self.world.time
            self._slave = self._new_slave()
            if self.align and not self.clutched:
                tolerance = self.description.orientation_tolerance
                self._reason = master.align(self.world, self._slave.T[:3, :3], tolerance)
                return  # the reading was taken before it began to move
        if self.desired == ALIGNING:
            return
        self.offset = reading.T[:3, :3].T @ self._slave.T[:3, :3]
        error = float(angle_between(np.eye(3), self.offset)) if self.align else 0.0
        near = error <= self.description.orientation_tolerance
        gripper = None if self.description.ignore_jaw else reading.gripper
        rolled = self.offset if near and not reading.turning else None
        present = self._hand.update(gripper, rolled) or reading.present
        if near and present:
            self._hand.present = True
            if not reading.turning:
                self._enable(readings)
        elif self._report_due():
            hint = f"unable to align {master.name}: {np.degrees(error):.1f} deg off"
            if self._reason:
                hint += f" ({self._reason})"
            self.report("warning", "pinch or twist the gripper a bit" if near else hint)

    def _new_slave(self) -> Slave:
        name = self.description.slave
        return Slave(self.world, name, base_in_view(self.world, name))

    def _engage(self, readings: Sequence[MasterReading]) -> None:
        self._slave = self._new_slave()
        self._from, self._to = readings[0].T, self._slave.T
        self.offset = self._from[:3, :3].T @ self._to[:3, :3]
        self._reason, self._jaw = "", None
        self._T_world_view = self.world.reference_pose(self._slave.name) @ self._slave.T_base_view
        self._carried_since = False
        if self.feedback is not None:
            self.feedback.restart(self._T_world_view[:3, :3], self.scale)
        arm = self.world.arm(self.description.slave)
        if not self.description.ignore_jaw and arm.jaw is not None:
            limits = float(arm.joints.lower[-1]), float(arm.joints.upper[-1])
            self._jaw = JawFollower(self.description, *limits, float(arm.joints.setpoints()[-1]))
            self.masters[0].match_gripper(self._jaw.ghost)

    def _follow(self, readings: Sequence[MasterReading], period_s: float) -> None:
        reading = readings[0]
        if self._slave is None:
            return
        goal, wrench, gripper = self.goal(reading.T), self.wrench, reading.gripper
        if self.feedback is not None:
            goal, gripper, wrench = self._felt(self.feedback, reading, goal, period_s)
        if self.fixtures is not None:
            goal, wrench = self._guided(self.fixtures, reading, goal, wrench)
        if wrench is not None:
            self.masters[0].exert(self.world, wrench)
        reason = self._slave.follow(goal, period_s)
        if reason:
            self.masters[0].step_back()
            if reason != self._reason or self._report_due():
                self._reason, self._reported = reason, self.world.time
                self.report("warning", f"{self.description.slave} cannot follow: {reason}")
        jaw = self.world.arm(self.description.slave).jaw
        if self._jaw is not None and jaw is not None and gripper is not None:
            jaw.servo_jp([self._jaw.follow(gripper, period_s)])

    def _felt(
        self, feedback: ForceFeedback, reading: MasterReading, goal: Array, period_s: float
    ) -> tuple[Array, float | None, Array | None]:
        """Return goal and gripper that arrive at the instrument, and the wrench on the hand."""
        slave, T, gripper = self._slave, reading.T, reading.gripper
        if slave is None:
            return goal, gripper, self.wrench
        arrived = feedback.arriving(np.append(goal.ravel(), 0.0 if gripper is None else gripper))
        wrench = self.wrench
        if not self.translation_locked:
            force = feedback.on_hand(T[:3, 3], goal[:3, 3], slave.measured[:3, 3], period_s)
            self._carried_since = self._carried_since or self.carried()
            if not self._carried_since:
                wrench = np.zeros(6) if wrench is None else wrench.copy()
                wrench[:3] += T[:3, :3].T @ force
        gripper = None if gripper is None else float(arrived[-1])
        return arrived[:-1].reshape(4, 4), gripper, wrench

    def _guided(
        self, fixtures: Fixtures, reading: MasterReading, goal: Array, wrench: Array | None
    ) -> tuple[Array, Array | None]:
        """Return the goal that filters leave, and the wrench with that of fixtures on the hand."""
        slave, T = self.description.slave, self._T_world_view
        p = T[:3, :3] @ goal[:3, 3] + T[:3, 3]
        if fixtures.acts_on(slave, "force"):
            wrench = np.zeros(6) if wrench is None else wrench.copy()
            if not self.translation_locked:
                force = T[:3, :3].T @ fixtures.force(slave, p, self.scale)
                wrench[:3] += reading.T[:3, :3].T @ force
        goal = transform(goal[:3, :3], T[:3, :3].T @ (fixtures.filtered(slave, p) - T[:3, 3]))
        return goal, wrench

    def _release_masters(self, *, clutch: bool) -> None:
        locked = self.rotation_locked or (clutch and self.align)
        self.masters[0].release(self.world, locked=locked)

    def _set_following(self, on: bool) -> None:
        self.wrench = None
        super()._set_following(on)

    def _after_clutch(self) -> None:
        self._after_pause = True  # the hand was there already

    def _enter(self, state: str) -> None:
        if state == SETTING:
            self._slave = None
        if state == ALIGNING:
            self._aligned_at = -np.inf
            self.publish("scale", self.scale)
            self._hand.restart()
            self._hand.present = self._hand.present and self._after_pause
            self._after_pause = False
        super()._enter(state)

    def _align_anew(self) -> None:
        """Pass through DISABLED, as on the dVRK; the hand is there already."""
        self._after_pause = True
        self._stop()

    def _engage_anew(self) -> None:
        if self.following:
            self._engage(self._read())
