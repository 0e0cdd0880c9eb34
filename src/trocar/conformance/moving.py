"""Checks with small, slow moves, which stop at the first thing that was not commanded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import radians, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.conformance.expectations import (
    BRIDGE,
    CARTESIAN_TABLE,
    CRTK,
    JAW_TABLE,
    MOVES_TABLE,
    STATES_TABLE,
)
from trocar.conformance.observation import (
    ArmObserver,
    Arrival,
    numbers,
    pose,
    pose_error,
    stamps,
    twist,
)
from trocar.conformance.report import CheckResult, check, skipped
from trocar.errors import InputError, TrocarError
from trocar.geometry.rotations import rotation_vector_from_matrix
from trocar.ros.message_builders import pose as pose_message

Array = NDArray[np.float64]

# Sizes and times. Source: our own choice: a tip moves by a few millimetres, slower than by hand.
STEP_RAD, STEP_M, STEP_UNKNOWN = radians(2.0), 0.002, 0.002
#: Ratio of the velocity and acceleration limits that moves are made with, and slower ones.
RATIO, SLOW, SLOWEST = 0.2, 0.05, 0.02
#: A joint that is farther than this from where it began stops everything, in steps.
LEASH = 2.0
#: Silence of measured_js that stops everything [s]: loaded computers paused for half of it.
SILENCE_S = 1.0
#: Longest time of a move, of a change of state, of homing; a pause after commands [s].
MOVE_S, CHANGE_S, HOME_S, SETTLE_S = 8.0, 2.0, 60.0, 0.3
CONNECT_S, LOOK_S = 1.5, 0.005
#: Set-points of a stream: how many, period [s].
STREAM, STREAM_S = 20, 0.02
#: Set-points: equal [rad or m]; moving.
SAME, MOVED = 1e-4, 1e-7
#: Measured beside commanded positions after a move: as a share of a step; of the tip [m].
TRACKED, TIP_M = 1.0, 0.003
#: Peak speed beside that of a profile of constant acceleration; the ratio of two peaks at ratios
#: of 4 to 1: 2 where acceleration limits a move, 4 where the speed does.
PEAK, PEAKS = (0.75, 1.1), (1.7, 4.4)
#: Streams that no check of moves reads.
UNREAD = (
    "gravity_compensation/setpoint_js", "local/setpoint_cp", "body/measured_cf",
    "spatial/measured_cf", "body/jacobian", "spatial/jacobian",
)  # fmt: skip
#: Time from a command to the first set-point that follows it [s].
LATENCY_S = 0.1
#: Poses of set-points: 0.2 mm and 2 mrad. Integrals of velocities: share of the way, and offset.
PLACE_M, TURN_RAD, SHARE, OFFSET = 2e-4, 2e-3, 0.4, 2e-4
#: Insertion below which the wrist of a PSM or ECM is near its cannula [m].
CANNULA_M = 0.07
GROUP = "Moves"


class StoppedError(TrocarError):
    """Something happened that was not commanded."""


@dataclass(frozen=True)
class ObservedMove:
    """A move as its messages describe it.

    Attributes:
        reached: values of goal_reached
        busy: values of is_busy, in order
        setpoints: while it lasted (k, n) [rad or m]
        peaks: largest set-point speeds (n,) [rad/s or m/s], None without velocities
        latency: from the command to the first set-point that follows it, NaN without one [s]
        start, goal, end: set-points (n,) before it, commanded and after it
        measured: positions after it (n,)
    """

    reached: list[bool]
    busy: list[bool]
    setpoints: Array
    peaks: Array | None
    latency: float
    start: Array
    goal: Array
    end: Array
    measured: Array


class MotionChecks:
    """Commands an arm and checks what follows.

    Args:
        watch: observes the arm
        home: enable and home it first
        nan: send a set-point that is not a number at the end
    """

    def __init__(self, watch: ArmObserver, home: bool = False, nan: bool = False) -> None:
        self._watch, self._home, self._nan = watch, home, nan
        self._client = watch.client
        self._allowed: tuple[str, ...] = ("ENABLED",)
        self._start = np.zeros(0)
        self._guarded = False
        self._ratios: dict[str, float] = {}

    def ready(self) -> Iterator[CheckResult]:
        """Advertise the commands; enable and home the arm if it may be; check that it can be moved.

        Raises:
            InputError: it is not enabled, not homed, or busy
        """
        watch = self._watch
        for key, kind in watch.expected.commands.items():
            if watch.has_command(key):
                self._client.advertise(f"{watch.arm}/{key}", kind)
        self._client.sleep(CONNECT_S)
        if self._home:
            yield from self._homing()
        if watch.state != "ENABLED" or not watch.flag("is_homed") or watch.flag("is_busy"):
            words = "homed" if watch.flag("is_homed") else "not homed"
            busy = ", busy" if watch.flag("is_busy") else ""
            raise InputError(
                f"--move: {watch.arm} is {watch.state or 'without operating_state'}, {words}{busy};"
                " allowed: ENABLED and homed, at rest (--home enables and homes it)"
            )
        for key in ("measured_js", "setpoint_js"):
            if watch.last(key) is None:
                raise InputError(f"--move: {watch.arm} publishes no {key}")

    def run(self, progress: Callable[[str], None]) -> list[CheckResult]:
        """Make every move that the arm has commands for, and return to where it began."""
        name, results = "nothing happens that was not commanded", list[CheckResult]()
        steps: list[tuple[str, Callable[[], Iterator[CheckResult]]]] = [
            ("set_ratio", self._set_ratio),
            ("move_jp of each joint", self._move_joints),
            ("move_jr", self._move_relative),
            ("hold", self._hold),
            ("servo_jp", self._servo_joints),
            ("servo_jr", self._servo_relative),
            ("move_cp and servo_cp", self._cartesian),
            (self._watch.expected.part or "jaw", self._jaw),
            ("pause and resume", self._pause),
            ("unusable commands", self._unusable),
            ("goal_reached for late subscribers", self._late),
            ("the way back", self._return),
            ("numbers that are none", self._not_numbers),
        ]
        try:
            self._watch.close(*UNREAD)
            self._start, self._guarded = self._setpoint(), True
            for title, step in steps:
                progress(title)
                results += step()
        except StoppedError as stop:
            results.append(check(GROUP, name, False, f"stopped: {stop}", source=CRTK))
            if self._watch.has_command("hold") and self._watch.state == "ENABLED":
                self._watch.publish("hold", {})
        else:
            results.append(check(GROUP, name, True, source=CRTK))
        finally:
            self._restore_ratio()
        return results

    # ------------------------------------------------------------------ guard

    def _wait(self, until: Callable[[], bool], limit_s: float) -> bool:
        """Wait until something holds; return whether it does in time.

        Raises:
            StoppedError: something happened that was not commanded
        """
        end = self._client.now() + limit_s
        while not until():
            if self._client.now() >= end:
                return False
            self._client.sleep(LOOK_S)
            self._guard()
        return True

    def _pass(self, seconds: float) -> None:
        self._wait(lambda: False, seconds)

    def _guard(self) -> None:
        watch = self._watch
        if not self._guarded:
            return
        if watch.state not in self._allowed:
            error = watch.last("error")
            reason = f" ({error.message['data']})" if error is not None else ""
            raise StoppedError(f"{watch.arm} is {watch.state}{reason}")
        newest = watch.last("measured_js")
        if newest is None or self._client.now() - newest.time > SILENCE_S:
            raise StoppedError(f"no measured_js for {SILENCE_S:g} s")
        q = numbers(newest.message, "position")
        if q.shape != self._start.shape or not np.isfinite(q).all():
            raise StoppedError(f"measured_js has positions {q.tolist()}")
        off = np.abs(q - self._start) / self._steps()
        worst = int(np.argmax(off))
        if off[worst] > LEASH:
            raise StoppedError(
                f"{self._names()[worst]} is at {q[worst]:.4g}, it began at"
                f" {self._start[worst]:.4g}; allowed: {LEASH * self._steps()[worst]:.2g} from there"
            )

    # ------------------------------------------------------------------ readings

    def _names(self) -> list[str]:
        newest = self._watch.last("measured_js")
        return [] if newest is None else [str(name) for name in newest.message["name"]]

    def _steps(self) -> Array:
        """Return the size of a small move of each joint, (n,) [rad or m]."""
        known = self._watch.expected.joints
        if self._watch.expected.kind == "CRTK":
            return np.full(len(self._start), STEP_UNKNOWN)
        return np.array(
            [
                STEP_M if known and known[k] == "insertion" else STEP_RAD
                for k in range(len(self._start))
            ]
        )

    def _towards(self) -> Array:
        """Return the direction of a move of each joint away from the nearer end, (n,)."""
        middle = self._watch.expected.middle
        centre = np.array(middle) if middle else np.zeros(len(self._start))
        return np.where(self._start > centre, -1.0, 1.0)

    def _setpoint(self, key: str = "setpoint_js") -> Array:
        q = self._watch.positions(key)
        if q is None or not np.isfinite(q).all():
            raise StoppedError(f"{key} has positions {None if q is None else q.tolist()}")
        return q

    def _pose(self, key: str) -> Array:
        newest = self._watch.last(key)
        return np.full((4, 4), np.nan) if newest is None else pose(newest.message["pose"])

    def _goals(self, since: float) -> list[bool]:
        return [bool(row.message["data"]) for row in self._watch.since(since, "goal_reached")]

    # ------------------------------------------------------------------ commands

    def _joint_command(self, key: str, values: Array) -> float:
        """Send positions; return when [s]."""
        begin = self._client.now()
        self._watch.publish(key, {"position": values})
        return begin

    def _move(
        self, key: str, values: Array, goal: Array, stream: str = "setpoint_js"
    ) -> ObservedMove:
        """Make a move of the joints that `stream` has, and wait for its end.

        Args:
            key: command
            values: its positions
            goal: set-points after it (n,)
            stream: topic of the set-points
        """
        start = self._setpoint(stream)
        begin = self._joint_command(key, values)
        self._wait(lambda: bool(self._goals(begin)), MOVE_S)
        # On a loaded computer, messages of streams arrive later than events.
        self._wait(
            lambda: (
                bool(np.abs(self._setpoint(stream) - goal).max() <= SAME)
                and not self._watch.flag("is_busy")
            ),
            CHANGE_S,
        )
        self._pass(SETTLE_S)
        rows = self._watch.since(begin, stream)
        setpoints = np.array([numbers(row.message, "position") for row in rows])
        speeds = [numbers(row.message, "velocity") for row in rows]
        peaks = np.abs(speeds).max(axis=0) if rows and len(speeds[0]) else None
        follows = [row.time for row in rows if self._differs(row, start)]
        measured = self._watch.positions(stream.replace("setpoint", "measured"))
        states = self._watch.since(begin, "operating_state")
        return ObservedMove(
            reached=self._goals(begin),
            busy=[bool(row.message["is_busy"]) for row in states],
            setpoints=setpoints,
            peaks=peaks,
            latency=follows[0] - begin if follows else float("nan"),
            start=start,
            goal=goal,
            end=self._setpoint(stream),
            measured=np.zeros(0) if measured is None else measured,
        )

    @staticmethod
    def _differs(row: Arrival, start: Array) -> bool:
        q = numbers(row.message, "position")
        return q.shape == start.shape and bool(np.abs(q - start).max() > MOVED)

    def _goal(self, joint: int, share: float = 1.0) -> Array:
        goal = self._start.copy()
        goal[joint] += share * self._towards()[joint] * self._steps()[joint]
        return goal

    def _back(self) -> None:
        """Move to where the arm began, without a check."""
        if np.abs(self._setpoint() - self._start).max() > SAME:
            self._move("move_jp", self._start, self._start)

    # ------------------------------------------------------------------ checks

    def _homing(self) -> Iterator[CheckResult]:
        watch, group = self._watch, "States"
        if watch.state == "DISABLED":
            watch.publish("state_command", {"string": "enable"})
            met = self._wait(lambda: watch.state == "ENABLED", HOME_S)
            yield check(group, "enable leads to ENABLED", met, watch.state, "ENABLED", STATES_TABLE)
        if not watch.flag("is_homed"):
            watch.publish("state_command", {"string": "home"})
            self._wait(lambda: watch.flag("is_homed") and not watch.flag("is_busy"), HOME_S)
            met = watch.state == "ENABLED" and watch.flag("is_homed")
            text = f"{watch.state}, homed {watch.flag('is_homed')}"
            yield check(group, "home leads to homed", met, text, "ENABLED, homed", STATES_TABLE)
        self._pass(SETTLE_S)

    def _set_ratio(self) -> Iterator[CheckResult]:
        name = "set_ratio is published as ratio, ratio_v and ratio_a"
        if not self._watch.has_command("trajectory_j/set_ratio"):
            yield skipped(GROUP, name, "no set_ratio: moves are as fast as the arm's", MOVES_TABLE)
            return
        for key in ("trajectory_j/ratio_v", "trajectory_j/ratio_a"):
            newest = self._watch.last(key)
            self._ratios[key] = 1.0 if newest is None else float(newest.message["data"])
        found = self._use_ratio(RATIO)
        met = all(value == RATIO for value in found)
        text = ", ".join("none" if value is None else f"{value:g}" for value in found)
        yield check(GROUP, name, met, text, f"{RATIO:g}", MOVES_TABLE)

    def _use_ratio(self, ratio: float) -> list[float | None]:
        """Set the ratio of moves; return what was published."""
        keys = ("trajectory_j/ratio", "trajectory_j/ratio_v", "trajectory_j/ratio_a")
        begin = self._client.now()
        self._watch.publish("trajectory_j/set_ratio", {"data": ratio})

        def found() -> list[float | None]:
            rows = [self._watch.since(begin, key) for key in keys]
            return [float(r[-1].message["data"]) if r else None for r in rows]

        self._wait(lambda: None not in found(), CHANGE_S)
        return found()

    def _restore_ratio(self) -> None:
        for key, ratio in self._ratios.items():
            self._watch.publish(key.replace("ratio_", "set_ratio_"), {"data": ratio})
        self._client.sleep(SETTLE_S)  # a node that ends at once loses its last messages

    def _move_joints(self) -> Iterator[CheckResult]:
        if not self._watch.has_command("move_jp"):
            yield skipped(GROUP, "move_jp", "no such command", CRTK)
            return
        names, moves, joints = self._names(), list[ObservedMove](), list[int]()
        velocities: list[CheckResult] = []
        for joint in range(len(self._start)):
            begin = self._client.now() - LOOK_S
            goal = self._goal(joint)
            moves.append(self._move("move_jp", goal, goal))
            if joint == 0:
                velocities = list(self._velocities(begin, self._client.now()))
            moves.append(self._move("move_jp", self._start, self._start))
            joints += [joint, joint]
        yield from self._judge("move_jp", moves, names)
        yield self._judge_others(moves, joints)
        yield self._judge_peaks(moves, joints)
        yield self._judge_latency([move.latency for move in moves])
        yield from velocities
        yield self._judge_ratio(moves[0])

    def _judge(
        self, key: str, moves: Sequence[ObservedMove], names: Sequence[str], source: str = CRTK
    ) -> Iterator[CheckResult]:
        """Check the events, set-points and positions of moves."""
        wrong = [f"{move.reached}" for move in moves if move.reached != [True]]
        text = f"{', '.join(wrong)}" or f"{len(moves)} moves"
        yield check(
            GROUP, f"{key}: goal_reached is true, once for each move", not wrong, text, "[True]",
            MOVES_TABLE,
        )  # fmt: skip
        lazy = sum(not any(move.busy) or move.busy[-1] for move in moves)
        text = f"not of {lazy} of {len(moves)} moves" if lazy else f"{len(moves)} moves"
        yield check(
            GROUP, f"{key}: is_busy while it lasts, not after", not lazy, text, source=MOVES_TABLE
        )
        errors = [np.abs(move.end - move.goal) for move in moves]
        yield self._judge_ends(f"{key}: set-points end at the goal", errors, names, SAME, source)
        errors = [
            np.abs(move.measured - move.goal)
            if move.measured.shape == move.goal.shape
            else np.full(len(move.goal), np.inf)
            for move in moves
        ]
        shares = [e / self._steps() if len(e) == len(self._start) else e / STEP_RAD for e in errors]
        yield self._judge_ends(
            f"{key}: measured positions end there, too [steps of 2 deg, 2 mm]", shares, names,
            TRACKED, source,
        )  # fmt: skip

    def _judge_ends(
        self, name: str, errors: Sequence[Array], names: Sequence[str], most: float, source: str
    ) -> CheckResult:
        worst = np.max(errors, axis=0)
        joint = int(np.argmax(worst))
        text = f"{names[joint]}: {worst[joint]:.2g}"
        return check(GROUP, name, bool(worst[joint] <= most), text, f"<= {most:g}", source)

    def _judge_others(self, moves: Sequence[ObservedMove], joints: Sequence[int]) -> CheckResult:
        most = 0.0
        for move, joint in zip(moves, joints, strict=True):
            others = np.delete(move.setpoints - move.start, joint, axis=1)
            most = max(most, float(np.abs(others).max(initial=0.0)))
        name = "move_jp: set-points of other joints stay"
        return check(GROUP, name, most <= SAME, f"{most:.2g}", f"<= {SAME:g} rad, m", MOVES_TABLE)

    def _judge_peaks(self, moves: Sequence[ObservedMove], joints: Sequence[int]) -> CheckResult:
        name = f"move_jp: peak speeds at a ratio of {RATIO:g}, of the profile's"
        rates = self._watch.expected.acceleration
        if not rates or not self._ratios or any(move.peaks is None for move in moves):
            return skipped(GROUP, name, "accelerations or velocities are unknown", MOVES_TABLE)
        shares: list[float] = []
        for move, joint in zip(moves, joints, strict=True):
            way = abs(float(move.goal[joint] - move.start[joint]))
            peak = sqrt(rates[joint] * RATIO * way)
            shares.append(float(move.peaks[joint]) / peak if move.peaks is not None else 0.0)
        text = f"{min(shares):.2f} to {max(shares):.2f}"
        met = min(shares) >= PEAK[0] and max(shares) <= PEAK[1]
        return check(GROUP, name, met, text, f"{PEAK[0]:g} to {PEAK[1]:g}", MOVES_TABLE)

    def _judge_latency(self, latencies: Sequence[float]) -> CheckResult:
        middle = float(np.median(latencies)) if not np.isnan(latencies).any() else float("nan")
        text = f"median {1e3 * middle:.0f} ms, {1e3 * max(latencies):.0f} ms at most"
        name = "set-points follow a command"
        return check(
            GROUP, name, middle <= LATENCY_S, text, f"median <= {1e3 * LATENCY_S:g} ms", CRTK
        )

    def _judge_ratio(self, usual: ObservedMove) -> CheckResult:
        name = f"a quarter of the ratio ({SLOW:g}) makes moves half as fast, or slower"
        if not self._ratios or usual.peaks is None:
            return skipped(GROUP, name, "no set_ratio, or no velocities", MOVES_TABLE)
        self._use_ratio(SLOW)
        goal = self._goal(0)
        slow = self._move("move_jp", goal, goal)
        self._use_ratio(RATIO)
        self._back()
        ratio = float(usual.peaks[0] / slow.peaks[0]) if slow.peaks is not None else 0.0
        met = PEAKS[0] <= ratio <= PEAKS[1]
        return check(GROUP, name, met, f"{ratio:.2f}", f"{PEAKS[0]:g} to {PEAKS[1]:g}", MOVES_TABLE)

    def _velocities(self, begin: float, end: float) -> Iterator[CheckResult]:
        """Check that velocities of the tip add up to its way between two times [s]."""
        for key, placed, local in (
            ("measured_cv", "measured_cp", False),
            ("local/measured_cv", "local/measured_cp", True),
        ):
            axes = "axes of the tool" if local else "axes of its frame"
            name = f"{key} adds up to the way of {placed}, in {axes}"
            rows = [row for row in self._watch.since(begin, key) if row.time <= end]
            poses = [row for row in self._watch.since(begin, placed) if row.time <= end]
            if len(rows) < 3 or len(poses) < 3:
                yield skipped(GROUP, name, f"no {key} or {placed}", CARTESIAN_TABLE)
                continue
            yield self._integral(name, rows, poses, local)

    @staticmethod
    def _integral(
        name: str, rows: Sequence[Arrival], poses: Sequence[Arrival], local: bool
    ) -> CheckResult:
        T, at, times = (
            [pose(row.message["pose"]) for row in poses],
            stamps(poses),
            stamps(rows),
        )
        way = T[-1][:3, 3] - T[0][:3, 3]
        turn = rotation_vector_from_matrix(T[-1][:3, :3] @ T[0][:3, :3].T)
        speeds = np.array([twist(row.message["twist"]) for row in rows])
        times, order = np.unique(times, return_index=True)
        speeds = speeds[order]
        if local:
            for k, time in enumerate(times):
                R = T[int(np.argmin(np.abs(at - time)))][:3, :3]
                speeds[k] = np.concatenate([R @ speeds[k, :3], R @ speeds[k, 3:]])
        added = 0.5 * (speeds[1:] + speeds[:-1]).T @ np.diff(times)
        off = float(np.linalg.norm(added[:3] - way))
        twisted = float(np.linalg.norm(added[3:] - turn))
        most = [SHARE * float(np.linalg.norm(v)) + OFFSET for v in (way, turn)]
        text = f"{1e3 * off:.2g} mm, {1e3 * twisted:.2g} mrad off"
        allowed = f"<= {1e3 * most[0]:.2g} mm, {1e3 * most[1]:.2g} mrad"
        met = off <= most[0] and twisted <= most[1]
        return check(GROUP, name, met, text, allowed, CARTESIAN_TABLE)

    def _move_relative(self) -> Iterator[CheckResult]:
        if not self._watch.has_command("move_jr"):
            yield skipped(GROUP, "move_jr", "no such command", CRTK)
            return
        way = self._goal(0, 0.5) - self._start
        moves = [
            self._move("move_jr", way, self._start + way),
            self._move("move_jr", -way, self._start),
        ]
        yield from self._judge("move_jr", moves, self._names())

    def _hold(self) -> Iterator[CheckResult]:
        name = "hold ends a move: set-points stay, goal_reached is false"
        if not (self._watch.has_command("hold") and self._watch.has_command("move_jp")):
            yield skipped(GROUP, name, "no hold or move_jp", MOVES_TABLE)
            return
        if not self._ratios:
            yield skipped(GROUP, name, "no set_ratio: a small move is over too soon", MOVES_TABLE)
            return
        self._use_ratio(SLOWEST)
        begin = self._joint_command("move_jp", self._goal(0))
        half = 0.3 * self._steps()[0]
        self._wait(lambda: bool(abs(self._setpoint()[0] - self._start[0]) > half), MOVE_S)
        self._watch.publish("hold", {})
        self._wait(lambda: bool(self._goals(begin)), CHANGE_S)
        self._pass(SETTLE_S)
        held = self._setpoint()
        self._pass(SETTLE_S)
        crept = float(np.abs(self._setpoint() - held).max())
        reached = self._goals(begin)
        self._use_ratio(RATIO)
        text = f"{reached}, {crept:.2g} later"
        met = reached == [False] and crept <= SAME and not self._watch.flag("is_busy")
        yield check(GROUP, name, met, text, f"[False], <= {SAME:g}", MOVES_TABLE)
        self._back()

    def _stream(self, key: str, goals: Sequence[Array], stream: str) -> Array:
        """Send set-points one after the other; return the last one published afterwards.

        Those of servo_jr are steps.
        """
        before = self._setpoint(stream)
        for goal in goals:
            self._joint_command(key, goal)
            self._pass(STREAM_S)
        end = before + goals[-1] if key == "servo_jr" else goals[-1]
        self._wait(lambda: bool(np.abs(self._setpoint(stream) - end).max() <= SAME), CHANGE_S)
        self._pass(SETTLE_S)
        return self._setpoint(stream)

    def _servo_joints(self) -> Iterator[CheckResult]:
        if not self._watch.has_command("servo_jp"):
            yield skipped(GROUP, "servo_jp", "no such command", CRTK)
            return
        begin = self._client.now()
        shares = np.arange(1, STREAM + 1) / STREAM
        goals = [self._goal(0, 0.5 * share) for share in shares]
        end = self._stream("servo_jp", goals, "setpoint_js")
        off = float(np.abs(end - goals[-1]).max())
        name = "servo_jp: set-points are those that were sent"
        yield check(GROUP, name, off <= SAME, f"{off:.2g}", f"<= {SAME:g} rad, m", CRTK)
        self._pass(2.0 * SETTLE_S)
        crept = float(np.abs(self._setpoint() - end).max())
        name = "servo_jp: the last set-point is held"
        yield check(GROUP, name, crept <= SAME, f"{crept:.2g}", f"<= {SAME:g} rad, m", CRTK)
        self._stream("servo_jp", [*goals[-2::-1], self._start], "setpoint_js")
        events = self._goals(begin)
        name = "servo_jp: no goal_reached"
        yield check(GROUP, name, not events, f"{events}", "[]", MOVES_TABLE)

    def _servo_relative(self) -> Iterator[CheckResult]:
        name = "servo_jr is added to the set-points"
        if not self._watch.has_command("servo_jr"):
            yield skipped(GROUP, name, "no such command", MOVES_TABLE)
            return
        before, way = self._setpoint(), self._goal(0, 0.05) - self._start
        end = self._stream("servo_jr", [way], "setpoint_js")
        off = float(np.abs(end - before - way).max())
        self._stream("servo_jr", [-way], "setpoint_js")
        yield check(GROUP, name, off <= SAME, f"{off:.2g}", f"<= {SAME:g} rad, m", MOVES_TABLE)
        self._back()

    def _cartesian(self) -> Iterator[CheckResult]:
        poses = self._poses()
        reason = ""
        known = self._watch.expected.joints
        if "insertion" in known and self._start[known.index("insertion")] < CANNULA_M:
            reason = f"the insertion is below {CANNULA_M:g} m, near the cannula"
        elif not poses:
            reason = "no setpoint_cp, or no goal: no forward_kinematics"
        for key in ("move_cp", "servo_cp"):
            if reason or not self._watch.has_command(key):
                yield skipped(GROUP, key, reason or "no such command", CARTESIAN_TABLE)
                continue
            yield from self._place(key, poses)
            self._back()

    def _poses(self) -> list[Array]:
        """Return poses on a small way, (4, 4) each, as forward_kinematics has them; [] unknown."""
        if self._watch.last("setpoint_cp") is None:
            return []
        way, poses = 0.5 * self._towards() * self._steps(), list[Array]()
        try:
            for share in np.arange(1, STREAM + 1) / STREAM:
                reply = self._watch.call("forward_kinematics", {"jp": self._start + share * way})
                if not reply["result"]:
                    return []
                poses.append(pose(reply["cp"]))
                self._guard()
        except StoppedError:
            raise
        except TrocarError:
            return []
        return poses

    def _place(self, key: str, poses: Sequence[Array]) -> Iterator[CheckResult]:
        """Check a small way, as a move or in steps."""
        goal = poses[-1]
        begin = self._client.now()
        if key == "move_cp":
            self._watch.publish(key, {"pose": pose_message(goal)})
            self._wait(lambda: bool(self._goals(begin)), MOVE_S)
        else:
            for step in poses:
                self._watch.publish(key, {"pose": pose_message(step)})
                self._pass(STREAM_S)
        self._wait(lambda: pose_error(self._pose("setpoint_cp"), goal)[0] <= PLACE_M, CHANGE_S)
        self._pass(SETTLE_S)
        off, turn = pose_error(self._pose("setpoint_cp"), goal)
        text = f"{1e3 * off:.2g} mm, {1e3 * turn:.2g} mrad off"
        allowed = f"<= {1e3 * PLACE_M:g} mm, {1e3 * TURN_RAD:g} mrad"
        name = f"{key}: setpoint_cp ends at the goal"
        met = off <= PLACE_M and turn <= TURN_RAD
        yield check(GROUP, name, met, text, allowed, CARTESIAN_TABLE)
        off, _ = pose_error(self._pose("measured_cp"), goal)
        name, most = f"{key}: measured_cp ends there, too", TIP_M
        yield check(
            GROUP,
            name,
            off <= most,
            f"{1e3 * off:.2g} mm",
            f"<= {1e3 * most:g} mm",
            CARTESIAN_TABLE,
        )
        events, wanted = self._goals(begin), [True] if key == "move_cp" else []
        name = f"{key}: goal_reached"
        yield check(GROUP, name, events == wanted, f"{events}", f"{wanted}", CARTESIAN_TABLE)

    def _jaw(self) -> Iterator[CheckResult]:
        key, stream = "jaw/move_jp", "jaw/setpoint_js"
        if self._watch.expected.part != "jaw":
            return
        if not self._watch.has_command(key) or self._watch.positions(stream) is None:
            yield skipped(GROUP, "jaw", f"no {key} or {stream}", JAW_TABLE)
            return
        start, before = self._setpoint(stream), self._setpoint()
        goal = start + (STEP_RAD if start[0] < 0.5 else -STEP_RAD)
        moves = [self._move(key, q, q, stream) for q in (goal, start)]
        yield from self._judge(key, moves, ["jaw"], JAW_TABLE)
        if self._watch.has_command("jaw/servo_jp"):
            shares = np.arange(1, STREAM + 1) / STREAM
            goals = [start + share * (goal - start) for share in shares]
            end = self._stream("jaw/servo_jp", goals, stream)
            off = float(np.abs(end - goal).max())
            name = "jaw/servo_jp: the set-point is the one that was sent"
            yield check(GROUP, name, off <= SAME, f"{off:.2g}", f"<= {SAME:g} rad", JAW_TABLE)
            self._stream("jaw/servo_jp", [*goals[-2::-1], start], stream)
        off = float(np.abs(self._setpoint() - before).max())
        name = "commands of the jaw leave the arm where it is"
        yield check(GROUP, name, off <= SAME, f"{off:.2g}", f"<= {SAME:g} rad, m", JAW_TABLE)

    def _pause(self) -> Iterator[CheckResult]:
        watch, group = self._watch, "States"
        if not watch.has_command("state_command"):
            yield skipped(group, "pause leads to PAUSED", "no state_command", STATES_TABLE)
            return
        before, self._allowed = self._setpoint(), ("ENABLED", "PAUSED")
        watch.publish("state_command", {"string": "pause"})
        paused = self._wait(lambda: watch.state == "PAUSED", CHANGE_S)
        self._pass(SETTLE_S)
        text = f"{watch.state}, homed {watch.flag('is_homed')}"
        met = paused and watch.flag("is_homed")
        yield check(group, "pause leads to PAUSED, homed", met, text, source=STATES_TABLE)
        yield self._desired("PAUSED", ("PAUSED",))
        if paused and watch.has_command("move_jp"):
            begin = self._joint_command("move_jp", self._goal(0))
            self._pass(2.0 * SETTLE_S)
            moved = float(np.abs(self._setpoint() - before).max())
            text = f"{moved:.2g}, goal_reached {self._goals(begin)}"
            met = moved <= SAME and True not in self._goals(begin)
            yield check(group, "a move in PAUSED is not made", met, text, source=STATES_TABLE)
        watch.publish("state_command", {"string": "resume"})
        self._wait(lambda: watch.state == "ENABLED", CHANGE_S)
        self._pass(SETTLE_S)
        self._allowed = ("ENABLED",)
        text = f"{watch.state}, homed {watch.flag('is_homed')}"
        met = watch.state == "ENABLED" and watch.flag("is_homed")
        yield check(group, "resume leads to ENABLED, homed", met, text, source=STATES_TABLE)
        yield self._desired("ENABLED", ("HOMED", "ENABLED"))
        self._guard()

    def _desired(self, state: str, allowed: tuple[str, ...]) -> CheckResult:
        name, newest = f"desired_state in {state}", self._watch.last("desired_state")
        if newest is None:
            return skipped("States", name, "not published", STATES_TABLE)
        text = str(newest.message["data"])
        known = " or ".join(allowed)
        return check("States", name, text in allowed, text, known, STATES_TABLE)

    def _unusable(self) -> Iterator[CheckResult]:
        watch = self._watch
        if watch.has_command("state_command"):
            begin, before = self._client.now(), watch.state
            watch.publish("state_command", {"string": "trocar_conform"})
            self._pass(2.0 * SETTLE_S)
            warned = len(watch.since(begin, "warning"))
            text = f"{watch.state}, {warned} warnings"
            name = "an unknown state_command changes nothing, with a warning"
            met = watch.state == before and (warned > 0 or "warning" not in watch.subscribed)
            yield check("States", name, met, text, source=STATES_TABLE)
        if watch.has_command("servo_jp") and len(self._start) > 1:
            before = self._setpoint()
            self._joint_command("servo_jp", self._goal(0)[:-1])
            self._pass(2.0 * SETTLE_S)
            moved = float(np.abs(self._setpoint() - before).max())
            name = "servo_jp with too few positions changes nothing"
            yield check(GROUP, name, moved <= SAME, f"{moved:.2g}", f"<= {SAME:g}", MOVES_TABLE)

    def _late(self) -> Iterator[CheckResult]:
        watch, name = self._watch, "goal_reached of the last move comes at once"
        if "goal_reached" not in watch.subscribed or watch.last("goal_reached") is None:
            yield skipped("Late subscribers", name, "no goal_reached", BRIDGE)
            return
        got: list[Any] = []
        topic, kind = f"{watch.arm}/goal_reached", watch.expected.events["goal_reached"]
        end = self._client.subscribe(topic, kind, got.append)
        self._wait(lambda: bool(got), CHANGE_S)
        end()
        text = str(bool(got[0]["data"])) if got else "no message"
        yield check("Late subscribers", name, bool(got), text, source=BRIDGE)

    def _return(self) -> Iterator[CheckResult]:
        if self._watch.has_command("move_jp"):
            self._back()
        off = float(np.abs(self._setpoint() - self._start).max())
        name = "set-points are where they began"
        yield check(GROUP, name, off <= SAME, f"{off:.2g}", f"<= {SAME:g} rad, m", CRTK)

    def _not_numbers(self) -> Iterator[CheckResult]:
        name = "servo_jp with NaN moves nothing, or ends in DISABLED or FAULT"
        if not self._nan:
            yield skipped(GROUP, name, "only with --nan: a dVRK disables itself", MOVES_TABLE)
            return
        self._guarded = False  # an arm may disable itself
        before = self._watch.positions("measured_js")
        self._joint_command("servo_jp", np.full(len(self._start), np.nan))
        self._client.sleep(4.0 * SETTLE_S)
        after = self._watch.positions("measured_js")
        moved = float("inf")
        if before is not None and after is not None and before.shape == after.shape:
            moved = float(np.abs(after - before).max())
        off = self._watch.state in ("DISABLED", "FAULT")
        met = off or moved <= 0.1 * float(self._steps().min())
        yield check(GROUP, name, met, f"{moved:.2g}, {self._watch.state}", source=MOVES_TABLE)
