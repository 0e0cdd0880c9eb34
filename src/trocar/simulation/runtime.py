"""The parts behind an arm's verbs, as its world steps, saves and mounts tools on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigArm
from trocar.simulation.control import ArmWorld, ControlState, JointControl
from trocar.simulation.controllers import Controller
from trocar.simulation.forces import Expiry, ForceControl, ForceState
from trocar.simulation.jaw import Gripper, Jaw
from trocar.simulation.journal import command
from trocar.simulation.motors import Motors
from trocar.simulation.moves import Motion
from trocar.simulation.operating_state import STATE, Desired, Phase, State
from trocar.simulation.records import ArmSample, ArmSnapshot, ArmStatus
from trocar.simulation.servos import EFFORT
from trocar.simulation.states import ArmStateMachine, HomingState
from trocar.simulation.tip import Tip

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ArmState:
    """State of an arm beside the physics and the servos, as `ArmRuntime.save` returns it.

    The names of its fields are in pickled states and in recordings.
    """

    phase: Phase
    desired: Desired
    known: bool
    homed: bool
    resumes: tuple[Phase, Desired]
    told: tuple[State, bool, bool] | None
    control: ControlState
    laws: dict[str, Controller]
    lock: Array | None
    absolute: bool
    push: Array
    base: tuple[Array, str] | None
    homing: HomingState | None
    gripper: tuple[bool, int, float | None] | None
    expiry: Expiry | None = None


class ArmRuntime:
    """Joint control, force control, operating state and tip of one arm: `arm.runtime`.

    For its world and for readings of all joints at once; users have `Arm`.

    Attributes:
        name: "PSM1", ...
        journal: receives its commands and events
        description: the arm with its tool
        poses: {name: q (n,)}
        motors: set-points, modes, gains and brakes of its joints
        control: joint commands for any part of its joints
        tip, forces, states: its tip, force control and operating state
        own, every: its joints without the jaw, and with it
        jaw: the jaw's own verbs, None without one
        gripper: a master's gripper, None without one
    """

    def __init__(self, rig_arm: RigArm, motors: Motors, clock: ArmWorld) -> None:
        self.name = self._source = rig_arm.name
        self.journal = self._journal = clock.journal
        self._prefix, self._clock = "", clock
        self._status: ArmStatus | None = None
        self._status_revision = -1
        self.tip = Tip(self.name, clock)
        self.forces = ForceControl(
            self.name,
            self.tip,
            clock,
            self._fault,
            self._report,
        )
        self.states = ArmStateMachine(self.name, self.forces, clock)
        #: The one jaw that is ever handed out; `jaw` is None while a tool has none.
        self._jaw = Jaw(self.name, self.journal, self.states.report)
        self._fit(rig_arm, motors, None)

    def _fit(self, rig_arm: RigArm, motors: Motors, before: JointControl | None) -> None:
        """Set what the mounted tool determines."""
        arm = self.description = rig_arm.arm
        self.poses = dict(arm.poses)
        self.motors = motors
        self.control = JointControl(self.name, motors, self._clock, before)
        self.control.exclusive = self.forces.idle
        count = len(arm.mechanism.joint_names)
        self.own, self.every = slice(0, arm.own_joints), slice(0, count)
        self.tip.fit(self.control)
        self.forces.fit(self.control)
        self.states.fit(self.control, self.poses)
        self._jaw.fit(self.control if arm.has_jaw else None)
        self.jaw = self._jaw if arm.has_jaw else None
        now = lambda: self._clock.time  # noqa: E731
        self.gripper = (
            Gripper(self.name, self.control, self.journal, now) if arm.has_gripper else None
        )

    def _fault(self, reason: str) -> None:
        self.states.fault(reason)

    def _report(self) -> None:
        self.states.report()

    # ------------------------------------------------------------------ commands

    @command
    def set_tool_type(self, name: str) -> None:
        """Mount another tool; see the world's `exchange_tool` for what becomes of the arm.

        Raises:
            UnknownNameError, InputError, DescriptionError: as `exchange_tool` does
        """
        self._clock.exchange_tool(self.name, name)

    def ended(self, accepted: bool) -> bool:
        """End controllers after a position command that was accepted; return whether it was."""
        if accepted:
            forces = self.forces  # as `idle`, in place: this runs with every servo command
            if forces.controllers or forces.orientation is not None or forces.expiry is not None:
                forces.end()
        return accepted

    def begun(self, motion: Motion) -> Motion:
        """End controllers after a move that was accepted; return the move."""
        self.ended(not motion.done)
        self.states.report()
        return motion

    # ------------------------------------------------------------------ time

    @property
    def active(self) -> bool:
        """Whether set-points or efforts change from step to step."""
        moves, forces = self.control.moves, self.forces
        return (
            moves.profile is not None
            or bool(forces.controllers)
            or moves.drift is not None
            or forces.expiry is not None
            or self.states.homing is not None
        )

    def follow(self, time: float) -> None:
        """Advance the set-points of moves to a time, and renew the efforts of controllers."""
        forces, expiry = self.forces, self.forces.expiry
        if expiry is not None and self._clock.time >= expiry.time - 1e-9:
            self.states.stop(self.own)  # the jaw goes on
            self.control.rejections.warn(
                f"{expiry.verb} timeout",
                f"{expiry.verb}: no set-point for {expiry.timeout:g} s; the arm holds where it is",
            )
        self.control.moves.follow(time)
        self.motors.follow()
        if forces.controllers:
            forces.apply()
        if self.states.homing is not None:
            self.states.watch()
        self.states.report()

    def start_at(self, q: Array) -> None:
        """Forget every command; set-points rest at joint positions, (n,)."""
        self.forces.end()
        self.control.rejections.forget()
        self.control.put(q)

    def begin(self, q: Array, ready: bool) -> None:
        """Start anew with set-points at rest, (n,): ENABLED and homed, or DISABLED.

        The world puts motors and physics back.
        """
        self.states.abandon_homing()
        self.tip.placed, self.states.reported = None, None
        self.forces.begin()
        self.control.begin()
        if self.gripper is not None:
            self.gripper.forget()
        self.control.states.begin(ready)
        self.start_at(q)

    def save(self) -> ArmState:
        """Return copies of everything that the arm keeps beside the physics and the servos."""
        states, forces, placed = self.control.states, self.forces.save(), self.tip.placed
        gripper = self.gripper
        return ArmState(
            states.phase,
            states.desired,
            states.known,
            states.homed,
            states.resumes,
            self.states.reported,
            self.control.save(),
            forces.controllers,
            forces.orientation,
            forces.absolute,
            forces.effort,
            None if placed is None else (placed[0].copy(), placed[1]),
            self.states.save(),
            None if gripper is None else (gripper.closed, gripper.pinches, gripper.since),
            forces.expiry,
        )

    def load(self, saved: ArmState) -> None:
        """Restore everything that `save` returned; handles of moves until now are over."""
        self.states.abandon_homing()
        states = self.control.states
        states.phase, states.desired, states.resumes = saved.phase, saved.desired, saved.resumes
        states.known, states.homed = saved.known, saved.homed
        states.ready = saved.phase == "HOMED" and saved.known
        motions = self.control.load(saved.control)
        self.forces.load(
            ForceState(saved.laws, saved.lock, saved.absolute, saved.push, saved.expiry)
        )
        self.tip.placed = None if saved.base is None else (saved.base[0].copy(), saved.base[1])
        self.states.load(saved.homing, motions)
        if self.gripper is not None and saved.gripper is not None:
            self.gripper.closed, self.gripper.pinches, self.gripper.since = saved.gripper
        self.states.reported = saved.told

    # ------------------------------------------------------------------ tools and models

    def reattach(self, motors: Motors) -> None:
        """Go on in a model that was compiled anew, with everything as it was."""
        self.motors = motors
        self.control.reattach(motors)

    def refit(self, rig_arm: RigArm, motors: Motors, q: Array, setpoint: Array) -> None:
        """Mount another tool with its motors; settings stay.

        The arm is at rest at joint positions q; its set-points are others, (n,) each.
        """
        self._fit(rig_arm, motors, self.control)
        motors.place(q, np.zeros(len(q)))
        motors.command(setpoint, np.zeros(len(q)))
        self.control.moves.rest(setpoint)
        motors.apply()
        self.states.report()

    # ------------------------------------------------------------------ samples

    def snapshot(self, remote_centre: Array | None, read: Array | None = None) -> ArmSnapshot:
        """Return a frozen copy of everything about this arm.

        Args:
            remote_centre: in the world, (3,) [m]
            read: positions, velocities and efforts (3, n), where they were read already
        """
        motors, control, states = self.motors, self.control, self.control.states
        q, qd, effort = motors.read() if read is None else read
        setpoint = motors.position.copy()
        if self.gripper is not None and motors.modes[-1] == EFFORT:
            setpoint[-1] = q[-1]  # nothing holds its levers
        modes, locked = motors.labels()
        return ArmSnapshot(
            control.joint_names,
            q,
            qd,
            effort,
            setpoint,
            modes,
            locked,
            control.moves.profile is not None,
            remote_centre,
            control.rejections.count,
            control.rejections.last,
            STATE[states.phase],
            states.homed,
            self.description.tool,
        )

    def status(self) -> ArmStatus:
        """Return the part that only commands and events change; the same object until then."""
        revision = self.journal.revision
        if self._status is None or self._status_revision != revision:
            motors, moves, states = self.motors, self.control.moves, self.control.states
            self._status_revision = revision
            self._status = ArmStatus(
                not motors.welded and motors.gravity_compensated,
                STATE[states.phase],
                states.homed,
                self.states.busy,
                states.phase,
                states.desired,
                self.tip.placed,
                self.description.tool,
                (moves.velocity_ratio, moves.acceleration_ratio),
                self.gripper is not None and self.gripper.closed,
                self.forces.orientation_locked,
                motors.brakes and np.count_nonzero(motors.locked) == len(motors.locked),
            )
        return self._status

    def sample(self, joints: Array | None = None) -> ArmSample:
        """Return copies of what every reading of this arm is computed from.

        Args:
            joints: of `ArmSample`, if they have been copied already, (7, n)
        """
        if joints is None:
            motors = self.motors
            setpoint = motors.position, motors.velocity, motors.effort
            joints = np.array([*motors.read(), motors.load(), *setpoint])
        return ArmSample(self.status(), joints)
