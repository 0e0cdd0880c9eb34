"""The operating state of an arm: its verbs, homing, faults."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from trocar.simulation.control import ArmWorld, JointControl
from trocar.simulation.forces import ForceControl
from trocar.simulation.journal import command
from trocar.simulation.moves import Motion
from trocar.simulation.operating_state import (
    RELEASE_S,
    STATE,
    STATE_COMMANDS,
    Desired,
    Homing,
    OperatingState,
    State,
)

Array = NDArray[np.float64]
log = logging.getLogger("trocar")

#: Copies of a homing under way: goal, goal of the set-points' move, whether that is over and there.
HomingState = tuple[Array, Array, bool, bool]


class ArmStateMachine:
    """The verbs of an arm's operating state, and what ends its motion.

    Args:
        name: of the arm
        forces: its force control
        clock: its world

    Attributes:
        homing: under way, None without one
        reported: state, whether homed and whether busy, as the journal has them
    """

    def __init__(self, name: str, forces: ForceControl, clock: ArmWorld) -> None:
        self._journal, self._source, self._prefix = clock.journal, name, ""
        self._forces, self._clock = forces, clock
        self.homing: Homing | None = None
        self.reported: tuple[State, bool, bool] | None = None

    def fit(self, control: JointControl, poses: dict[str, Array]) -> None:
        """Set the joints of the mounted tool, and the arm's named poses {name: q (n,)}."""
        self._control, self._poses, self._states = control, poses, control.states
        control.ended = self.report
        self._own = slice(0, control.motors.arm.own_joints)

    # ------------------------------------------------------------------ verbs

    @command
    def state_command(self, name: str) -> bool:
        """Execute "enable", "disable", "home", "unhome", "pause" or "resume".

        Returns:
            whether it was accepted
        """
        if name not in STATE_COMMANDS:
            why = f"got {name!r}; allowed: {', '.join(STATE_COMMANDS)}"
            self._control.rejections.reject("state_command", "name", why)
            return False
        if name == "home":
            motion = self.home()
            return not motion.done or motion.goal_reached
        return bool(getattr(self, name)())

    @command
    def enable(self) -> bool:
        """Switch the motors of a DISABLED arm on; it holds its position until it is homed.

        Brakes that it has stay engaged until then.
        A fault is left by `disable`, as on the robot: `enable` changes nothing there.
        """
        if not self._may("enable"):
            return False
        if self._states.phase == "DISABLED":
            self._settle()
            self._control.motors.switch(True)
            self._control.motors.follow()
            self._states.enter("ENABLED")
            if self._of_setup_joints:
                self._states.enter("HOMED", known=True)
        self._report_desired("ENABLED")
        if self._states.phase == "FAULT":
            self._control.rejections.warn(
                "enable fault", "enable: the arm stays in FAULT; disable it first"
            )
        return True

    @command
    def disable(self) -> bool:
        """End everything and switch the motors off; the arm is held in its position.

        Its brakes are engaged, where its joints have some; a larger force moves it against them.
        """
        self._switch_off()
        self._states.enter("DISABLED")
        self._report_desired("DISABLED")
        return True

    @command
    def pause(self) -> bool:
        """End moves and hold; no command moves the arm until `resume`."""
        if not self._may("pause"):
            return False
        states = self._states
        if self._of_setup_joints:
            return True
        if states.phase != "PAUSED":  # the robot forgets what it paused when it is paused twice
            states.resumes = states.phase, states.desired
            self.stop()
        states.enter("PAUSED")
        self._report_desired("PAUSED")
        return True

    @command
    def resume(self) -> bool:
        """Go on after `pause`: accept commands, or begin the homing again that it ended."""
        if not self._may("resume"):
            return False
        phase, desired = self._states.resumes
        if phase == "HOMING":
            self._go_home()
        else:
            self._states.enter(phase)
        self._report_desired(desired)
        return True

    @command
    def home(self) -> Motion:
        """Bring an arm that was enabled to its home pose; the jaw stays.

        The motion is over when the joints are measured there; if they are not within two seconds,
        the arm is in FAULT. An arm that is home already stays as it is, moving or not; so does one
        that was unhomed, which has to be disabled and enabled first.
        """
        control, states = self._control, self._states
        if not self._may("home"):
            return control.rejected(self._own)
        if self._of_setup_joints:
            states.enter("HOMED", known=True)
            self.report()
            return self._over(control.motors.position[self._own])
        if states.phase == "HOMED" and not states.known:
            control.rejections.warn(
                "home unhomed",
                "home: an arm that was unhomed is not homed again; disable and enable it first",
            )
            motion = control.rejected(self._own)
        elif states.phase == "HOMED":
            motion = self._over(control.motors.position[self._own])
        else:
            motion = self._go_home() if self.homing is None else self.homing.motion
        self._report_desired("HOMED")
        return motion

    @command
    def unhome(self) -> bool:
        """Forget that the arm was homed; a move under way goes on, and none is accepted after.

        On its way home an arm is in FAULT then, as the robot.
        """
        self._states.forget()
        if self._states.phase == "HOMING":
            self.fault("unhomed on its way home")
        self.report()
        return True

    # ------------------------------------------------------------------ used by the arm

    @property
    def busy(self) -> bool:
        """Whether a move is under way; homing is one."""
        return self._control.moves.profile is not None or self.homing is not None

    def operating_state(self) -> OperatingState:
        """Return the state as CRTK has it."""
        now = self._states
        state = STATE[now.phase]
        return OperatingState(state, now.homed, self.busy, self._clock.time, now.phase)

    def report(self) -> None:
        """Enter the operating state into the journal, when it changed."""
        states = self._states
        now = STATE[states.phase], states.homed, self.busy
        if now != self.reported:
            self.reported = now
            self._control.report("operating_state", state=now[0], is_homed=now[1], is_busy=now[2])

    def fault(self, reason: str) -> None:
        """Switch the motors off after a fault."""
        self._switch_off()
        self._states.enter("FAULT")
        log.error("%s: FAULT: %s", self._source, reason)
        self._control.rejections.last = f"FAULT: {reason}"
        self._control.report("error", text=reason)
        self._report_desired("FAULT")

    def stop(self, part: slice | None = None) -> None:
        """End what some joints (all when omitted) do; they stay at the set-points.

        Joints that were under effort control stay where they are measured.
        """
        control = self._control
        part = slice(0, len(control.joint_names)) if part is None else part
        self.abandon_homing()
        self._forces.end()
        control.under_position(part)
        control.moves.end(part)
        control.motors.velocity[part] = 0.0
        control.motors.follow()
        count: int = part.stop - part.start
        control.exert(np.zeros(count), part, "hold")
        self.report()

    def abandon_homing(self) -> None:
        """End a homing under way, its goal not reached."""
        homing, self.homing = self.homing, None
        if homing is not None:
            homing.motion.finish(False)
            self._states.enter("ENABLED")

    def watch(self) -> None:
        """Look whether a homing under way has ended, and how."""
        homing = self.homing
        if homing is None:
            return
        motors, profile = self._control.motors, self._control.moves.profile
        if np.count_nonzero(motors.engaged):
            if profile is not None and self._clock.time < profile.start - 1e-9:
                return
            motors.release()
        measured = motors.positions()[self._own]
        outcome = homing.look(measured, self._clock.time)
        if outcome == "home":
            self.homing = None
            self._states.enter("HOMED")
            homing.motion.finish(True)
        elif outcome == "late":
            names = np.array(self._control.joint_names[self._own])[homing.far(measured)]
            self.fault(f"homing: {', '.join(names)} did not arrive")

    def save(self) -> HomingState | None:
        """Return copies of a homing under way, None without one."""
        if self.homing is None:
            return None
        way = self.homing.way
        return self.homing.motion.goal.copy(), way.goal.copy(), way.done, way.goal_reached

    def load(self, saved: HomingState | None, motions: list[Motion]) -> None:
        """Restore what `save` returned.

        Args:
            saved: as returned
            motions: handles of the moves under way, of which a homing's is the first
        """
        if saved is not None:
            goal, way_goal, done, reached = saved
            way = motions[0] if motions and not done else self._over(way_goal, reached)
            motion = Motion(goal.copy(), self._clock.wait)
            self.homing = Homing(motion, way, self._slides())

    # ------------------------------------------------------------------ inside

    @property
    def _of_setup_joints(self) -> bool:
        """Whether they are setup joints: homed where they are, and without a pause.

        Source: SAW, mtsIntuitiveResearchKitSUJ.cpp:1201.
        """
        return self._control.motors.arm.type == "SUJ"

    def _go_home(self) -> Motion:
        """Begin a homing; return its handle."""
        control, motors = self._control, self._control.motors
        own = motors.position[self._own]
        self.stop()
        self._states.enter("HOMING", known=True)
        moves = "home" in self._poses and not motors.welded
        if moves:
            part = control.moves.joints
            goal = self._poses["home"][part]
            begin = self._clock.time + RELEASE_S * bool(np.count_nonzero(motors.engaged))
            way = control.moves.begin(goal, part, begin, silent=True)
        else:
            way = self._over(own)
        motion = Motion(way.goal[self._own].copy(), self._clock.wait)
        self.homing = Homing(motion, way, self._slides())
        return motion

    def _report_desired(self, state: Desired) -> None:
        """Enter the desired state into the journal, and the operating state where it changed."""
        self._states.desired = state
        if not self._of_setup_joints:
            self._control.report("desired_state", state=state)
        self.report()

    def _slides(self) -> NDArray[np.bool_]:
        return np.array([j.kind == "prismatic" for j in self._control.motors.arm.joints[self._own]])

    def _may(self, verb: str) -> bool:
        why = self._states.why_not(verb)
        if why:
            self._control.rejections.reject(verb, "state", why)
        return not why

    def _over(self, q: Array, reached: bool = True) -> Motion:
        """Return the handle of a move that is over."""
        motion = Motion(q.copy(), self._clock.wait)
        motion.finish(reached)
        return motion

    def _settle(self) -> None:
        """Put the set-points where the joints are measured."""
        motors = self._control.motors
        if not motors.welded:
            self._control.stay(list(range(len(self._control.joint_names))))
            motors.effort[:] = 0.0

    def _switch_off(self) -> None:
        if not self._states.powered:
            return
        control = self._control
        self.abandon_homing()
        self._forces.end()
        control.under_position(slice(0, len(control.joint_names)))
        self._settle()
        control.motors.switch(False)
        control.motors.follow()
