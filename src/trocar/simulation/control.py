"""Joint commands of an arm, for any part of its joints: checked, clipped, handed to the motors."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, RejectedError
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.frames import Frames
from trocar.simulation.journal import MOST_COMMANDS, MOST_NUMBERS, Journal
from trocar.simulation.motors import Motors
from trocar.simulation.moves import Drift, Motion, Moves, Profile
from trocar.simulation.operating_state import States
from trocar.simulation.rate_limit import RateLimit, Remembered, burst, suffix
from trocar.simulation.records import JointState
from trocar.simulation.servos import EFFORT, POSITION

Array = NDArray[np.float64]

#: A command moves a joint whose brake is locked when its target is farther than this from the
#: set-point. Source: our own choice; below it a reading that is sent back. [rad or m]
BRAKE_SLACK = 1e-4
#: A number farther from zero is a mistake. Source: our own choice, far beyond every joint, effort
#: and gain of the robots, and far below what arithmetic cannot hold.
LARGEST = 1e6

#: Time between two warnings of a streamed command of a kind. Source: our own choice, so that single
#: commands are all warned of; the robot warns of commands of any kind each 2 s, SAW
#: mtsIntuitiveResearchKitArm.cpp:1679. [s]
REJECTION_PERIOD_S = 0.5

log = logging.getLogger("trocar")
OnReject = Literal["warn", "raise"]


class ArmWorld(Protocol):
    """A `World` as its arms use it, declared here because world.py imports the arms."""

    @property
    def journal(self) -> Journal:
        """Receives commands and events."""
        ...

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        ...

    @property
    def frames(self) -> Frames:
        """Poses of the rig's frames."""
        ...

    @property
    def reference_arm(self) -> str:
        """Arm on setup joints whose tip frame the poses of the others are in."""
        ...

    @property
    def on_reject(self) -> OnReject:
        """Whether rejected commands warn or raise."""
        ...

    @property
    def strict_limits(self) -> bool:
        """Whether arms begin with strict limits."""
        ...

    def cameras(self) -> dict[str, CameraRecord]:
        """Return every camera of the rig, by name, with its present pose."""
        ...

    def base_pose(self, name: str) -> tuple[Array, str]:
        """Return the pose of an arm's reference frame in the frame of its public poses."""
        ...

    def wait(self, motion: Motion, timeout_s: float | None) -> bool:
        """Wait for a move."""
        ...

    def exchange_tool(self, name: str, tool: str) -> None:
        """Mount another tool on an arm."""
        ...


class Rejections:
    """Checks an arm's commands; counts and reports those that it rejects or clips.

    Args:
        arm: its name
        world: where it is

    Attributes:
        count: number of rejected and clipped commands
        last: the last reason
    """

    def __init__(self, arm: str, world: ArmWorld) -> None:
        self.count = 0
        self.last = ""
        self._arm, self._world, self._journal = arm, world, world.journal
        self._limit = RateLimit(REJECTION_PERIOD_S)

    def reject(self, verb: str, kind: str, why: str, event: str = "warning") -> None:
        """Count a rejected command, and warn of it or raise as the world's `on_reject` has it.

        Args:
            verb: of the command
            kind: of the reason; a warning of a streamed command of a kind comes once in a while
            why: reason
            event: "warning" or "error", as the robot's software reports it

        Raises:
            RejectedError: `on_reject` is "raise"
        """
        if self._world.on_reject == "raise":
            self.count += 1
            self.last = f"{verb}: {why}"
            raise RejectedError(self._arm, verb, why)
        self.warn(f"{verb} {kind}", f"{verb}: {why}", event)

    def warn(self, kind: str, reason: str, event: str = "warning") -> None:
        """Count a clipped command and warn of it; of streamed ones of a kind once in a while."""
        self.count += 1
        self.last = reason
        left_out = self._limit.due(kind, self._world.time, burst(kind))
        if left_out is None:
            return
        text = reason + suffix(left_out)
        log.warning("%s: %s", self._arm, text)
        self._journal.event(self._arm, event, text=text)

    def forget(self) -> None:
        """Warn of every kind anew: time starts again."""
        self._limit.forget()

    def save(self) -> tuple[int, str, Remembered]:
        """Return copies of the counts and the times of warnings."""
        return self.count, self.last, self._limit.save()

    def load(self, saved: tuple[int, str, Remembered]) -> None:
        """Restore what `save` returned."""
        self.count, self.last = saved[:2]
        self._limit.load(saved[2])

    def vector(
        self, values: ArrayLike, names: tuple[str, ...], verb: str, what: str
    ) -> Array | None:
        """Return one finite number per name, (n,), or reject the command and return None."""
        allowed = f"{len(names)} numbers for {', '.join(names)}"
        try:
            array = np.asarray(values)
        except (TypeError, ValueError, OverflowError):  # rows of unequal length
            array = np.asarray(None)
        if array.shape != (len(names),):
            got = f"of shape {array.shape}" if array.dtype.kind in "iuf" else "that are no numbers"
            self.reject(verb, f"{what} shape", f"got {what} {got}; allowed: {allowed}")
            return None
        if array.dtype.kind not in "iuf":
            why = f"got {what} {array.tolist()!r}; allowed: {allowed}"
            self.reject(verb, f"{what} type", why)
            return None
        if not (np.abs(array) <= LARGEST).all():  # NaN is not either
            why = (
                f"got {what} {array.tolist()}; allowed: finite numbers, magnitude up to {LARGEST:g}"
            )
            self.reject(verb, f"{what} finite", why)
            return None
        return array.astype(np.float64)


@dataclass(frozen=True, eq=False)
class ControlState:
    """State of a `JointControl`; profiles are never written after they are made.

    The names of its fields are in pickled states and in recordings.
    """

    profile: Profile | None
    motions: tuple[tuple[Array, slice], ...]
    target: Array
    tracking: bool
    silent: bool
    ratios: tuple[float, float]
    strict_limits: bool
    lent: frozenset[int]
    taken: frozenset[int]
    refusals: tuple[int, str, Remembered]
    drift: Drift | None
    cartesian: bool = False


class JointControl:
    """Commands and readings of an arm's joints, for the arm without its jaw and for the jaw.

    A position command switches joints back to mode "position" that an effort command had switched
    to "effort"; a joint that was put into mode "effort" on purpose stays there.

    Attributes:
        motors: set-points, modes, gains and brakes
        moves: what is under way
        rejections: checks commands, and counts the rejected and clipped ones
        states: the operating state
        strict_limits: whether targets beyond limits are rejected instead of clipped
    """

    def __init__(
        self, name: str, motors: Motors, clock: ArmWorld, before: JointControl | None = None
    ) -> None:
        """Control motors; `before` is what controlled those of the tool that was mounted before."""
        arm = motors.arm
        self._name, self._clock, self.motors = name, clock, motors
        self._journal, self._own = clock.journal, arm.own_joints
        #: `Journal.revision` without streamed set-points when all joints followed their servos.
        self._following = -1
        #: Whether nothing but position commands acts on the joints.
        self.exclusive: Callable[[], bool] = lambda: True
        self.joint_names = arm.mechanism.joint_names
        self.lower, self.upper = arm.mechanism.lower, arm.mechanism.upper
        fastest = [joint.velocity_max for joint in arm.joints]
        #: Lower and upper limit and largest velocity of each joint, in plain numbers.
        self._limits = list(zip(self.lower.tolist(), self.upper.tolist(), fastest, strict=True))
        #: Joints that an effort command switched to mode "effort"; those of them that a controller
        #: switched back.
        self.switched: set[int] = set()
        self.restored: set[int] = set()
        self.moves = Moves(
            motors.position,
            motors.velocity,
            (
                np.array([j.velocity_max for j in arm.joints]),
                np.array([j.acceleration_max for j in arm.joints]),
            ),
            (self.lower, self.upper),
            (slice(0, arm.own_joints + arm.has_jaw), slice(0, arm.own_joints)),
            clock.wait,
            self._over,
        )
        self.states = before.states if before else States()
        self.strict_limits = before.strict_limits if before else clock.strict_limits
        self.rejections = before.rejections if before else Rejections(name, clock)
        #: Called when a trajectory has ended.
        self.ended: Callable[[], None] = lambda: None
        if before:
            self.moves.velocity_ratio = before.moves.velocity_ratio
            self.moves.acceleration_ratio = before.moves.acceleration_ratio

    def begin(self) -> None:
        """Forget what was set and is under way; motors are put back by the world."""
        self.moves.end(slice(0, len(self.joint_names)))
        self.moves.velocity_ratio = self.moves.acceleration_ratio = 1.0
        self.strict_limits = self._clock.strict_limits
        self.keep_modes()

    def save(self) -> ControlState:
        """Return copies of everything that is kept here."""
        moves = self.moves
        return ControlState(
            moves.profile,
            tuple((motion.goal.copy(), part) for motion, part in moves.motions),
            moves.target.copy(),
            moves.tracking,
            moves.silent,
            (moves.velocity_ratio, moves.acceleration_ratio),
            self.strict_limits,
            frozenset(self.switched),
            frozenset(self.restored),
            self.rejections.save(),
            moves.drift,
            moves.cartesian,
        )

    def load(self, saved: ControlState) -> list[Motion]:
        """Restore everything that `save` returned; return new handles of the moves under way."""
        moves = self.moves
        moves.end(slice(0, len(self.joint_names)))
        handles = [moves.motion(goal.copy()) for goal, _ in saved.motions]
        parts = (part for _, part in saved.motions)
        moves.motions = list(zip(handles, parts, strict=True))
        moves.profile, moves.target = saved.profile, saved.target.copy()
        moves.tracking, moves.silent = saved.tracking, saved.silent
        moves.drift, moves.cartesian = saved.drift, saved.cartesian
        moves.velocity_ratio, moves.acceleration_ratio = saved.ratios
        self.strict_limits = saved.strict_limits
        self.switched, self.restored = set(saved.lent), set(saved.taken)
        self.rejections.load(saved.refusals)
        return handles

    def reattach(self, motors: Motors) -> None:
        """Go on with motors in a model that was compiled anew; moves go on."""
        self.motors = motors
        self.moves.reattach(motors.position, motors.velocity)

    # ------------------------------------------------------------------ readings

    def measured(self, part: slice) -> JointState:
        """Return measured values of some joints."""
        q, v, effort = self.motors.read()[:, part]
        return JointState(self.joint_names[part], q, v, effort, self._clock.time)

    def setpoint(self, part: slice) -> JointState:
        """Return set-points of some joints."""
        m = self.motors
        q, v, effort = (values[part].copy() for values in (m.position, m.velocity, m.effort))
        return JointState(self.joint_names[part], q, v, effort, self._clock.time)

    # ------------------------------------------------------------------ commands

    def servo(self, q: ArrayLike, v: ArrayLike | None, part: slice, verb: str) -> bool:
        """Set positions (and velocities) of some joints now; return whether it was accepted."""
        if self._quick(q, v, part):
            return True
        names = self.joint_names[part]
        target = self.rejections.vector(q, names, verb, "positions")
        speed = self.rejections.vector(
            np.zeros(len(names)) if v is None else v, names, verb, "velocities"
        )
        if target is None or speed is None or self._immobile(part, verb):
            return False
        allowed = self._allowed(target, part, verb)
        if allowed is None:
            return False
        inside, moves = allowed
        self._take_position(part)
        self.motors.position[part] = inside
        if v is not None:
            speed = self._slowed(speed, part, verb)
        self.motors.velocity[part] = np.where(moves, speed, 0.0)
        self.motors.follow()
        return True

    def stream(self, q: list[float], v: list[float]) -> bool:
        """Set positions and velocities of joints now, the jaw's behind them if given, n each.

        As `Arm.servo_jp` and then `Jaw.servo_jp` do, where every joint simply follows its servo and
        the journal has no listeners; else nothing changes, and these two do it or say why not.
        Whether joints follow is looked up again only after commands and events.

        Args:
            q, v: positions and velocities in plain numbers [rad or m, per s]

        Returns:
            whether it is done
        """
        journal = self._journal
        if journal.listeners or journal.inside:
            return False
        m, moves, part = self.motors, self.moves, slice(0, len(q))
        revision = journal.revision - journal.streamed
        if revision != self._following:
            if not (self.exclusive() and self._quick(q, v, part)):
                return False
            self._following = revision if len(q) == len(self._limits) else -1
        else:
            for place, speed, (low, high, most) in zip(q, v, self._limits):  # noqa: B905  quick
                if not (low <= place <= high and -most <= speed <= most):  # NaN is neither
                    return False
            m.position[part], m.velocity[part] = q, v
            moves.tracking = moves.cartesian = False
        journal.revision += 1
        journal.streamed += 1
        past = journal.past
        if not past.incomplete:
            row = (journal.period, journal.time, self._name, q.copy(), v.copy(), self._own)
            past.rows.append(row)
            past.commands += 1 + (len(q) > self._own)
            past.numbers += 2 * len(q)
            if past.commands > MOST_COMMANDS or past.numbers > MOST_NUMBERS:
                past.forget_many()
        return True

    def _quick(self, q: ArrayLike, v: ArrayLike | None, part: slice) -> bool:
        """Do as `servo` where these joints simply follow their servos, in few calls.

        Returns:
            whether it is done; else nothing changes
        """
        m, moves = self.motors, self.moves
        if moves.profile or moves.drift or self.switched or self.restored:
            return False
        if m.brakes or m.welded or np.count_nonzero(m.modes[part]) or not self.states.ready:
            return False
        limits = self._limits[part]
        try:
            places: Any = q.tolist() if isinstance(q, np.ndarray) else list(q)  # type: ignore[arg-type]
            speeds: Any = places if v is None else v
            speeds = speeds.tolist() if isinstance(speeds, np.ndarray) else list(speeds)
            if not len(places) == len(speeds) == len(limits):
                return False
            for place, speed, (low, high, most) in zip(places, speeds, limits):  # noqa: B905  quick
                if type(place) is not float or not low <= place <= high:  # NaN is neither
                    return False
                if v is not None and (type(speed) is not float or not -most <= speed <= most):
                    return False
        except TypeError:
            return False
        m.position[part] = q
        m.velocity[part] = 0.0 if v is None else v
        moves.tracking = False
        if not part.start:
            moves.cartesian = False
        return True

    def servo_velocity(self, v: ArrayLike, part: slice, verb: str) -> bool:
        """Let set-points go on at velocities until the next command; return whether accepted."""
        requested = self.rejections.vector(v, self.joint_names[part], verb, "velocities")
        if requested is None or self._immobile(part, verb):
            return False
        inside = self._slowed(requested, part, verb)
        self._take_position(part)
        self.motors.velocity[part] = 0.0
        speed = np.where(self.motors.locked[part], 0.0, inside)
        if speed.any():
            limits = self.lower[part], self.upper[part]
            self.moves.drift = Drift(part, self.setpoints(part), speed, *limits, self._clock.time)
        return True

    def servo_relative(self, dq: ArrayLike, part: slice, verb: str) -> bool:
        """Add to the set-points of some joints; return whether it was accepted."""
        change = self.rejections.vector(dq, self.joint_names[part], verb, "positions")
        return change is not None and self.servo(self.setpoints(part) + change, None, part, verb)

    def servo_effort(self, effort: ArrayLike, part: slice, verb: str) -> bool:
        """Set efforts; return whether it was accepted.

        Joints that are in mode "effort" get theirs; where none is, all of them are put there
        until the next position command.
        """
        requested = self.rejections.vector(effort, self.joint_names[part], verb, "efforts")
        if requested is None or not self.ready(verb):
            return False
        if self.motors.welded or self.motors.locked[part].all():
            return not self._immobile(part, verb)
        self.under_effort(part)
        self.exert(requested, part, verb)
        return True

    def exert(self, effort: Array, part: slice, verb: str) -> None:
        """Hand efforts to the motors, within their limits; joints under position ignore theirs."""
        requested = np.where(self.motors.modes[part] == EFFORT, effort, 0.0)
        limit = self.motors.limit[part]
        if (np.abs(requested) > limit).any():
            self.rejections.warn(f"{verb} limit", f"{verb}: effort clipped to the limits")
        every = self.motors.effort.copy()
        every[part] = np.clip(requested, -limit, limit)
        self.motors.command_effort(every)

    def move(
        self,
        q: ArrayLike,
        part: slice,
        verb: str,
        *,
        beyond: bool = False,
        jaw: float | None = None,
    ) -> Motion:
        """Move some joints to a goal within velocity and acceleration limits.

        Args:
            q: goal, (n,) [rad or m]
            part: which joints
            verb: of the command
            beyond: let the trajectory go on beyond a limit, while set-points wait there, as the
                robot's does for goals of the jaw and of relative moves; else the goal is clipped
            jaw: another goal of the jaw, which goes along [rad]
        """
        target = self.rejections.vector(q, self.joint_names[part], verb, "positions")
        if target is None or self._immobile(part, verb):
            return self.rejected(part)
        allowed = self._allowed(target, part, verb)
        if allowed is None:
            return self.rejected(part)
        goal, moves = allowed
        if beyond:
            goal = np.where(moves, target, goal)
        self.under_position(self._together(part))
        self._warn_of_jaw(part, verb, jaw)
        try:
            return self.moves.begin(goal, part, self._clock.time, jaw=jaw)
        except InputError as problem:
            self.rejections.reject(verb, "plan", str(problem))
            return self.rejected(part)

    def move_relative(self, dq: ArrayLike, part: slice, verb: str) -> Motion:
        """Move on from the goal that some joints have, or from their set-points.

        Where none moves, a relative move of the arm adds the jaw's set-point to the goal of the
        jaw's last move. Source: SAW, mtsIntuitiveResearchKitArm.cpp:2157: to the goal of the last
        trajectory, whose first joints are those of the command, it adds the set-points of all.
        """
        change = self.rejections.vector(dq, self.joint_names[part], verb, "positions")
        if change is None:
            return self.rejected(part)
        moves = self.moves
        goal = self.setpoints(part) if self.switched else moves.goal(part)
        jaw = moves.joints.stop - 1
        added = None
        if moves.profile is None and part.stop == jaw:
            added = float(moves.target[jaw] + self.motors.position[jaw])
        return self.move(goal + change, part, verb, beyond=True, jaw=added)

    def rejected(self, part: slice) -> Motion:
        """Return a motion that is over and reached nothing, for the last reason."""
        motion = self.moves.motion(self.motors.position[part].copy())
        motion.reason = self.rejections.last
        motion.finish(False)
        return motion

    def stay(self, which: Sequence[int]) -> None:
        """End every move; the given joints' set-points are where they are measured."""
        here = self._here()
        self.moves.end(slice(0, len(here)))
        self.motors.position[which] = here[which]
        self.motors.velocity[:] = 0.0

    def put(self, q: Array) -> None:
        """End every move; set-points rest at q, (n,), without effort."""
        self.moves.rest(q)
        self.motors.position[:] = q
        self.motors.velocity[:] = 0.0
        self.motors.effort[:] = 0.0

    # ------------------------------------------------------------------ effort and back

    def under_effort(self, part: slice) -> None:
        """Put joints into mode "effort", unless some were put there on purpose."""
        modes = self.motors.modes
        if self.restored:
            self.to_effort(sorted(self.restored), part)
        if (modes[part] == EFFORT).any():
            return
        free = (modes[part] == POSITION) & ~self.motors.locked[part]
        self.to_effort((part.start + np.flatnonzero(free)).tolist(), part)

    def under_position(self, part: slice) -> None:
        """Switch joints back that `under_effort` had put into mode "effort", where they are."""
        if self.switched:
            which = sorted(self.switched & set(range(part.start, part.stop)))
            if which:
                self.to_position(which, part)
        self.restored.clear()

    def keep_modes(self) -> None:
        """Forget which joints were switched: their modes are now the caller's choice."""
        self.switched.clear()
        self.restored.clear()

    def setpoints(self, part: slice) -> Array:
        """Return the set-points; of joints under effort control the measured positions, (n,)."""
        setpoints = self.motors.position.copy()
        if self.switched:
            switched = sorted(self.switched)
            setpoints[switched] = self.motors.positions()[switched]
        return setpoints[part]

    def to_position(self, which: Sequence[int], part: slice) -> None:
        """Put some joints of a part under position control, from where they are."""
        self._rest_here(which, part)
        self.motors.set_mode(POSITION, which)
        self.restored |= self.switched & set(which)
        self.switched -= set(which)

    def to_effort(self, which: Sequence[int], part: slice) -> None:
        """Put some joints of a part under effort control until the next position command."""
        self._rest_here(which, part)
        self.motors.set_mode(EFFORT, which)
        self.switched |= set(which)
        self.restored -= set(which)

    def steer(self, q: Array, v: Array | None, part: slice) -> None:
        """Set the set-points of joints under position control inside their limits; NaN: leave."""
        inside, given = np.clip(q, self.lower[part], self.upper[part]), np.isfinite(q)
        self.motors.position[part] = np.where(given, inside, self.motors.position[part])
        if v is not None:
            self.motors.velocity[part] = np.where(given, v, self.motors.velocity[part])
        self.motors.follow()

    # ------------------------------------------------------------------ state

    def ready(self, verb: str) -> bool:
        """Return whether the operating state lets the arm move; reject the command when not."""
        why = self.states.why_not_ready()
        if why:
            self.rejections.reject(verb, why, why)
        return not why

    def report(self, event: str, **values: object) -> None:
        """Enter an event of this arm into the journal."""
        self._clock.journal.event(self._name, event, **values)

    # ------------------------------------------------------------------ inside

    def _over(self, reached: bool) -> None:
        if self.motors.arm.type != "SUJ":  # SAW: setup joints have no such event
            self.report("goal_reached", reached=reached)
        self.ended()

    def _warn_of_jaw(self, part: slice, verb: str, other: float | None) -> None:
        """Warn of a jaw that a move of the arm takes along, to its last goal or another."""
        moves, jaw = self.moves, self.moves.joints.stop - 1
        if moves.profile is not None or part.stop != jaw:
            return
        goal, now = moves.target[jaw] if other is None else other, self.motors.position[jaw]
        goal = np.clip(goal, self.lower[jaw], self.upper[jaw])
        if abs(goal - now) > 1e-3:
            self.rejections.warn(
                f"{verb} jaw",
                f"{verb}: the jaw moves from {now:.3f} to {goal:.3f} rad, as on the robot; move_jp"
                " takes it to the goal of its last move, move_jr adds that to where it is",
            )

    def _take_position(self, part: slice) -> None:
        """Put joints under position control, and end a trajectory, the others at rest."""
        self.under_position(self._together(part))
        self.moves.end(part)

    def _together(self, part: slice) -> slice:
        """Return the joints that a command to some of them puts under position control."""
        moved = self.moves.joints
        return moved if part.start < moved.stop and part.stop > moved.start else part

    def _here(self) -> Array:
        """Return the measured positions, clipped to the limits, (n,)."""
        return np.clip(self.motors.positions(), self.lower, self.upper)

    def _rest_here(self, which: Sequence[int], part: slice) -> None:
        """End the moves of a part; some joints' set-points are where they are, without effort."""
        here, m = self._here(), self.motors
        self.moves.end(part)
        m.position[which], m.velocity[which], m.effort[which] = here[which], 0.0, 0.0

    def _immobile(self, part: slice, verb: str) -> bool:
        """Reject a command and return True when no joint could follow."""
        if not self.ready(verb):
            return True
        m = self.motors
        chosen = [k for k in range(part.start, part.stop) if k not in self.switched]
        if m.welded:
            why = "it is welded into the model"
        elif m.locked[part].all():
            why = "the brakes are locked; release them first"
        elif chosen and (m.modes[chosen] == EFFORT).all():
            why = 'every joint is in mode "effort"; nothing moves'
        else:
            return False
        self.rejections.reject(verb, "stuck", why)
        return True

    def _slowed(self, speed: Array, part: slice, verb: str) -> Array:
        """Return velocities inside the joints' limits; warn where they were beyond."""
        most = self.moves.velocity_max[part]
        inside = np.clip(speed, -most, most)
        if (inside != speed).any():
            names = zip(self.joint_names[part], inside != speed, strict=True)
            beyond = ", ".join(name for name, clipped in names if clipped)
            self.rejections.warn(
                f"{verb} {beyond} speed", f"{verb}: {beyond}: velocity clipped to the limit"
            )
        return inside

    def _allowed(
        self, target: Array, part: slice, verb: str
    ) -> tuple[Array, NDArray[np.bool_]] | None:
        """Return the target inside the limits, locked joints left alone, and which may move.

        None when it is beyond and limits are strict.
        """
        names = self.joint_names[part]
        inside = np.clip(target, self.lower[part], self.upper[part])
        if (inside != target).any():
            beyond = ", ".join(n for n, c in zip(names, inside != target, strict=True) if c)
            if self.strict_limits:
                why = f"{beyond} beyond the limit; nothing moves"
                self.rejections.reject(verb, f"{beyond} strict", why)
                return None
            self.rejections.warn(
                f"{verb} {beyond} clipped", f"{verb}: {beyond} clipped to the limit"
            )
        locked, setpoint = self.motors.locked[part], self.motors.position[part]
        held = locked & (np.abs(inside - setpoint) > BRAKE_SLACK)
        if held.any():
            which = ", ".join(n for n, c in zip(names, held, strict=True) if c)
            self.rejections.warn(
                f"{verb} {which} held", f"{verb}: {which} stays: its brake is locked"
            )
        return np.where(locked, setpoint, inside), ~locked
