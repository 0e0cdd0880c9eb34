"""Velocities of tips become set-points of joints: limits, lag, inverse kinematics, jaws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError, SingularError, UnreachableError
from trocar.geometry.rotations import rotation_rows
from trocar.geometry.se3 import inverse, translation
from trocar.kinematics.inverse import ChainEnds, chain_ends, nearest_solution
from trocar.simulation import World
from trocar.simulation.arm import Arm
from trocar.simulation.rig_readings import RigReadings

Array = NDArray[np.float64]
#: Set-points and their velocities of arms in plain numbers, {arm: (q, v)}.
Row = dict[str, tuple[list[float], list[float]]]

#: Duration of an action. Source: our own choice, 50 Hz. [s]
PERIOD_S = 0.02
#: Physics steps between the set-points of an action, which lie on straight lines between its ends.
#: Source: our own choice.
EVERY = 10
#: Largest speeds of a tip, of its rotation and of the jaw. Source: our own choice; instruments move
#: at up to 0.1 m/s in peg transfers (`trocar score`). [m/s, rad/s, rad/s]
SPEED_M_S, SPIN_RAD_S, JAW_RAD_S = 0.2, 4.0, 5.0
#: Closing of a grip beyond the measured opening of the jaw. Source: the servo (6 N m/rad) then
#: exerts its 0.16 N m ten times over, and the tracking tolerance of 0.6 rad is not reached. [rad]
GRIP_RAD = 0.3
#: Largest lead of set-points over measured joints, as a ratio of the tracking tolerance, beyond
#: which an arm goes into FAULT, as when it presses on the table. Source: our own choice.
LAG = 0.5
#: Ratio of its greatest velocity that a joint gets which would be too fast. Source: our own choice;
#: joints do not move in proportion to the tip.
SLOWED = 0.95
#: Reason of an arm that stays, until `TipController.stalls` finds the joints that are in the way.
OUT_OF_REACH = "pose out of reach"
#: Margin of an endoscope's velocities below its limits, as a ratio. Source: our own choice,
#: rounding.
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class _Driven:
    """An arm that actions drive.

    Attributes:
        arm: of the world
        part: of an action
        own: number of its joints without the jaw
        travels, leads: of a PSM's joints without the jaw: most motion in a period, and most lead
            over the measured joints, n each [rad or m]
        T_arm_world: the world in the frame of an arm that stands in it, which never moves; None of
            an arm on another one
        description: of the arm with the tool that it had when this was made
        psm: whether it is a PSM
        ends: of a PSM's chain in closed form; None of an ECM
    """

    arm: Arm
    part: slice
    own: int
    travels: tuple[float, ...]
    leads: tuple[float, ...]
    T_arm_world: Array | None
    description: ArmDescription
    psm: bool
    ends: ChainEnds | None


class TipController:
    """Turns actions into set-points of arms, and commands these.

    An action has seven numbers for each PSM: velocity of the tip and its angular velocity in axes
    of the world [m/s, rad/s], opening of the jaw, grip below 0 [rad]; and four for an ECM, the
    velocities of its joints [rad/s, m/s]. Values beyond `limits` are clipped.

    Args:
        world: with the arms; `begin` before the first action
        arms: names of the driven PSMs and ECMs, in the order of an action
        label: of error messages

    Attributes:
        world, arms: as given
        readings: readings of the world and these arms, shared with referee and observation
        limits: least and largest values of an action, (n,) each
        stalled: time for which each arm stayed though an action moves it, {arm: time} [s]
        bases: pose of the world as a PSM's kinematics report it in the world of actions and
            observations, {arm: (4, 4)}, by the robots' errors of registration; without an entry the
            two are one
        registration: the same, corrected by images of the tips, see `correct`
    """

    def __init__(self, world: World, arms: Sequence[str], label: str) -> None:
        self.world, self.arms, self._label = world, tuple(arms), label
        self.readings = RigReadings(world, self.arms)
        standing = {place.name for place in world.rig.arms if not place.on}
        self._driven: dict[str, _Driven] = {}
        low: list[float] = []
        high: list[float] = []
        for name in self.arms:
            begin, arm = len(high), world.arms[name]
            described = arm.description
            joints, psm = described.joints, described.type == "PSM"
            if psm:
                joints = joints[:-1]
                high += [SPEED_M_S] * 3 + [SPIN_RAD_S] * 3 + [float(arm.joints.upper[-1])]
                low += [-SPEED_M_S] * 3 + [-SPIN_RAD_S] * 3 + [-GRIP_RAD]
            else:
                fastest = [(1.0 - ROUNDING) * joint.velocity_max for joint in joints]
                high += fastest
                low += [-value for value in fastest]
            self._driven[name] = _Driven(
                arm,
                slice(begin, len(high)),
                described.own_joints,
                tuple(joint.velocity_max * PERIOD_S for joint in joints),
                tuple(LAG * joint.tracking_tolerance for joint in joints),
                inverse(world.reference_pose(name)) if name in standing else None,
                described,
                psm,
                chain_ends(described.mechanism, described.inverse_kinematics) if psm else None,
            )
        self.limits: tuple[Array, Array] = np.array(low), np.array(high)
        self._bounds = list(zip(low, high, strict=True))
        rows = round(PERIOD_S / (EVERY * world.timestep))
        #: Ratio of the way that the set-points of each row have gone.
        self._ratios = [row / rows for row in range(1, rows + 1)]
        #: Set-points of each arm; a list is never written to.
        self._joints: dict[str, list[float]] = {}
        self._targets: dict[str, Array] = {}
        self.stalled: dict[str, float] = {}
        self._stalls: dict[str, str] = {}
        #: Poses in an arm's own frame that no joints reached, and the joints before them.
        self._unreached: dict[str, tuple[Array, list[float]]] = {}
        self.bases: dict[str, Array] = {}
        self.registration: dict[str, Array] = {}

    def begin(self) -> None:
        """Hold the arms where they are, with nothing counted."""
        self.register()
        self.resume()
        self.stalled = dict.fromkeys(self.arms, 0.0)
        self._stalls.clear()
        self._unreached.clear()

    def resume(self) -> None:
        """Hold the arms where they are, as after other commands."""
        for name, driven in self._driven.items():
            self._joints[name] = driven.arm.joints.setpoints().tolist()
            if driven.psm:
                self._targets[name] = driven.arm.measured_cp("world").matrix

    def setpoints(self, action: ArrayLike) -> list[Row]:
        """Compute the set-points of an action, one row for every `EVERY` physics steps.

        After the first row, rows lack arms that rest, and jaws that do.

        Args:
            action: see the class

        Raises:
            InputError: another shape, or numbers that are not finite; nothing changes
        """
        bounds = self._bounds
        try:
            given = np.asarray(action, np.float64)
        except (TypeError, ValueError, OverflowError):
            given = np.full(1, np.nan)
        numbers: list[float] = given.tolist()
        if given.shape != (len(bounds),) or not (
            isfinite(sum(numbers)) or np.isfinite(given).all()  # the first is quick
        ):
            raise InputError(
                f"{self._label}: got the action {action!r}; allowed: {len(bounds)} finite numbers"
            )
        values: list[float] = []
        for number, (low, high) in zip(numbers, bounds):  # noqa: B905  as many, and often
            values.append(low if number < low else high if number > high else number)
        self.readings.renew()
        rows: list[Row] = []
        while len(rows) < len(self._ratios):
            rows.append({})
        for name, driven in self._driven.items():
            before = self._joints[name]
            after = self._joints[name] = self._next(name, driven, values[driven.part])
            change: list[float] = []
            v: list[float] = []
            for one, other in zip(before, after):  # noqa: B905  loops: comprehensions are calls
                change.append(other - one)
                v.append((other - one) / PERIOD_S)
            size = len(v)
            for row, ratio in zip(rows, self._ratios):  # noqa: B905  quick
                q: list[float] = []
                for one, way in zip(before, change):  # noqa: B905  quick
                    q.append(one + ratio * way)
                row[name] = (q, v) if size == len(v) else (q[:size], v[:size])
                if after == before:
                    break
                if after[driven.own :] == before[driven.own :]:
                    size = driven.own
        return rows

    def drive(self, row: Row) -> None:
        """Command the arms' servos with a row of `setpoints`."""
        for name, (q, v) in row.items():
            driven = self._driven[name]
            arm, own = driven.arm, driven.own
            if arm.runtime.control.stream(q, v):
                continue
            arm.servo_jp(q[:own], v[:own])
            jaw = arm.jaw if len(q) > own else None
            if jaw is not None:
                jaw.servo_jp(q[own:], v[own:])

    def register(self) -> None:
        """Set `bases`: a reset draws errors of the camera's reported pose, which PSMs stand in."""
        errors = self.world.servos.errors
        self.bases.clear()
        self.registration.clear()
        if errors is None or not errors.registration:
            return
        scopes = [one for one in self.world.cameras().values() if one.kind == "endoscope"]
        T = scopes[0].T_world_camera if scopes else np.eye(4)
        for arm, reported in errors.registration.items():
            if arm in self._driven:
                self.bases[arm] = self.registration[arm] = T @ reported @ inverse(T)

    def correct(self, arm: str, way: Array) -> None:
        """Move a PSM's measured tip and set-point by a way, (3,) [m], until the next reset."""
        base = self.bases.get(arm)
        moved = translation(way)
        self.registration[arm] = moved if base is None else moved @ base

    # ------------------------------------------------------------------ looking

    def tip(self, arm: str) -> Array:
        """Return the measured pose of a tip in the world, (4, 4)."""
        return self.registered(arm, self.world.arms[arm].measured_cp("world").matrix)

    def target(self, arm: str) -> Array:
        """Return the set-point of a PSM's tip in the world, (4, 4)."""
        return self.registered(arm, self._targets[arm].copy())

    def farthest(self, arm: str, T: Array) -> float:
        """Return the largest change of a joint from its set-point to a pose of the tip.

        Args:
            arm: a PSM
            T: in the world, (4, 4)

        Returns:
            [rad or m]; infinite out of reach
        """
        near, driven = self._joints[arm][:-1], self._driven[arm]
        try:
            after = self._inverse(driven, T, near)
        except (UnreachableError, SingularError):
            return np.inf
        return max((abs(a - b) for a, b in zip(after, near, strict=False)), default=np.inf)

    def reaches(self, arm: str, T: Array) -> bool:
        """Return whether a PSM's tip reaches a pose in the world from its set-points, (4, 4)."""
        driven = self._driven[arm]
        near = driven.arm.joints.setpoints()[:-1].tolist()
        try:
            return bool(self._inverse(driven, T, near))
        except (UnreachableError, SingularError):
            return False

    def stays(self, arm: str) -> bool:
        """Return whether an arm stays now though an action moves it."""
        return bool(self._stalls.get(arm))

    def stalls(self) -> dict[str, str]:
        """Find the reason for which each arm stayed in the last action; "" where it did not.

        Poses out of reach are explained here, with the tool of that action: it takes longer than a
        solution.

        Returns:
            {arm: reason}
        """
        for name, (local, near) in self._unreached.items():
            run, described = self._driven[name].arm.runtime, self._driven[name].description
            start = np.array(near)
            try:
                if run.description is described:
                    run.tip.local_inverse_kinematics(local, start)  # remembers what it refused
                else:
                    structure = described.inverse_kinematics
                    nearest_solution(described.mechanism, structure, local, start)
            except (UnreachableError, SingularError) as problem:
                self._stalls[name] = str(problem)
        self._unreached.clear()
        return dict(self._stalls)

    def idle(self) -> dict[str, Array]:
        """Return each arm's part of the action that holds it, {arm: (7,) or (4,)}."""
        found: dict[str, Array] = {}
        for name, driven in self._driven.items():
            found[name] = np.zeros(driven.part.stop - driven.part.start)
            if name in self._targets:
                found[name][-1] = self._joints[name][-1]
        return found

    # ------------------------------------------------------------------ inside

    def _next(self, name: str, driven: _Driven, values: list[float]) -> list[float]:
        """Return an arm's set-points after an action, those before where it cannot go on."""
        run, before = driven.arm.runtime, self._joints[name]
        if not driven.psm:
            after = np.array(before) + np.array(values) * PERIOD_S
            return np.clip(after, run.control.lower, run.control.upper).tolist()
        q, measured, reason = before.copy(), self.readings.joints[name].tolist(), ""
        jaw = q[-1]
        self._unreached.pop(name, None)
        if any(values[:6]):
            reason = self._onward(name, driven, q, measured, values[:6])
            self.stalled[name] += PERIOD_S if reason else 0.0
        self._stalls[name] = reason
        opening = values[6]
        if opening < 0.0:
            opening = max(opening, measured[-1] - GRIP_RAD)
        fastest = JAW_RAD_S * PERIOD_S
        q[-1] = jaw + min(max(opening - jaw, -fastest), fastest)
        return q

    def _onward(
        self, name: str, driven: _Driven, q: list[float], measured: list[float], twist: list[float]
    ) -> str:
        """Move a PSM's set-points on by a period, as fast as its joints may; return why they stay.

        In plain numbers, which take half the time of arrays of six.

        Args:
            name, driven: of the PSM
            q: its set-points, which are written, n
            measured: its joints, n
            twist: of the tip, six
        """
        joints, reason, now = driven.description.joints, "", q[:-1]
        T, target = self.registration.get(name), self._targets[name]
        for _ in range(2):
            goal = target.copy() if T is None else T @ target
            x, y, z, a, b, c = twist
            goal[0, 3] = goal.item(0, 3) + x * PERIOD_S  # += takes twice as long
            goal[1, 3] = goal.item(1, 3) + y * PERIOD_S
            goal[2, 3] = goal.item(2, 3) + z * PERIOD_S
            if a or b or c:
                turn = np.array(rotation_rows(a * PERIOD_S, b * PERIOD_S, c * PERIOD_S))
                goal[:3, :3] = turn.dot(goal[:3, :3])
            try:
                after = self._inverse(driven, goal, now)
            except (UnreachableError, SingularError) as problem:
                return str(problem)
            if not after:
                self._unreached[name] = self._arm_from_world(driven).dot(goal), now
                return OUT_OF_REACH
            worst, fastest = 0.0, 0
            for k, most in enumerate(driven.travels):
                haste = abs(after[k] - now[k]) / most
                if haste > worst:
                    worst, fastest = haste, k
            if worst <= 1.0:
                break
            twist = [one * (SLOWED / worst) for one in twist]
            reason = f"{joints[fastest].name} would move too fast"
        else:
            return reason
        for k, most in enumerate(driven.leads):
            if (lead := abs(after[k] - measured[k])) > most and lead > abs(now[k] - measured[k]):
                return f"{joints[k].name} is held back"
        self._targets[name], q[:-1] = goal if T is None else inverse(T) @ goal, after
        return ""

    def registered(self, arm: str, tip: Array) -> Array:
        """Return a measured pose of a tip as this world's actions and observations have it."""
        T = self.registration.get(arm)
        return tip if T is None else T @ tip

    def _arm_from_world(self, driven: _Driven) -> Array:
        """Return the pose of the world of actions in a PSM's own frame, (4, 4)."""
        own, name = driven.T_arm_world, driven.arm.name
        if own is None:
            own = inverse(self.world.reference_pose(name))
        registration = self.registration.get(name)
        return own if registration is None else own @ inverse(registration)

    def _inverse(self, driven: _Driven, T: Array, near: list[float]) -> Sequence[float]:
        """Find a PSM's joints nearest to others, n, with the tip at a pose in the world.

        Returns:
            n joints; () out of reach, for reasons that `stalls` finds

        Raises:
            UnreachableError, SingularError: out of reach, for this reason
        """
        own, run, ends = driven.T_arm_world, driven.arm.runtime, driven.ends
        if own is None or self.registration:
            own = self._arm_from_world(driven)
        local = own.dot(T)
        if ends is not None and ends.nearest is not None and run.description is driven.description:
            found = ends.nearest(ends.before.dot(local).dot(ends.after), ends.limits, near)
            if found is not None:
                return found
        solved: list[float] = run.tip.local_inverse_kinematics(local, np.array(near)).tolist()
        return solved
