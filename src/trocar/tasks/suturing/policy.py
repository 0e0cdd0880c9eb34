"""Policy of two arms that make stitches: motions with force limits, looks at results, retries."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry.rotations import (
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    rotation_z,
)
from trocar.geometry.se3 import exp_twist, inverse, log_transform, transform
from trocar.simulation.tissue.tissues import SoftTissue
from trocar.tasks.controller import PERIOD_S
from trocar.tasks.motions import UP, Hand, Motion, together
from trocar.tasks.suturing.planning import (
    ABOVE_M,
    LEAST,
    Plan,
    Stitch,
    TipWorkspace,
    needle_on_circle,
)
from trocar.tasks.suturing.pull import LAST_PULLS, PULLS, STEP_M, Pull
from trocar.tasks.task import Task

Array = NDArray[np.float64]

#: Speeds of the needle about its circle: in, and out. Source: our own choice; Frick 2001 found no
#: effect of 1 to 10 mm/s on forces. [rad/s]
DRIVE_RAD_S, OUT_RAD_S = np.radians(25.0), np.radians(45.0)
#: Speeds of the pull: slack, and under tension. Source: our own choice. [m/s]
PULL_M_S, TIGHT_M_S = 0.04, 0.006
#: Tension at which a stitch is tight, that at which the pull slows down, and speed of its last part
#: by the tension that is missing, so that it ends below 2 N. Source: Horeman 2013 measured 3 +- 1.2
#: N while surgeons pulled; 2 N closes the wound. [N, m/s/N, m/s]
TIGHT_N, SLOW_N, GAIN, SLOWEST_M_S = 1.96, 0.5, 6e-3, 6e-4
#: Distance of a tip from its set-point at which something blocks a pull. Source: measured: 0.4 mm
#: at 2 N of tension, 3 mm as soon as a forearm meets the endoscope's. [m]
BLOCKED_M = 5e-3
#: Way back from there before the arm pulls another way. Source: measured: after 20 mm the forearm
#: of an Si still meets the endoscope's. [m]
BACK_M = 0.04
#: Largest tilt of a needle out of the jaw's plane: beyond it the needle is put down and picked
#: again, as one with which the arm would not reach the whole arc. Source: our own choice. [deg]
TILT_DEG = 35.0
#: Tries of each step. Source: our own choice.
TRIES = 4
#: Time in which pads come near to a needle, and in which a jaw that grips has taken hold of it.
#: Source: our own choice. [s]
NEAR_S, CLOSE_S = 0.12, 0.4
#: Openings of jaws: about a needle that lies, about one that the other arm holds, where pads come
#: near to the wire, and with all force. Source: our own choice; wider ones press the tissue. [rad]
AROUND, BESIDE, ALMOST, GRIP = 0.6, 0.4, 0.16, -0.349
#: Speed with which pads come to the wire. Source: measured: two arms that hold one needle then
#: force each other by less. [rad/s]
GENTLE_RAD_S = 0.5
#: Height above the surface before a stitch. Source: our own choice. [m]
CLEAR_M = 0.006
#: Looks at a needle in the jaws whose mean is taken, at one that was missed, and at where the next
#: stitch is to go. Source: our own choice.
LOOKS = 3
#: Part of the way within which a needle beside its circle is brought onto it. Source: our own
#: choice. [rad]
ONTO_RAD = np.radians(20.0)
#: Angle past the surface at which a tip without a puncture has missed. Source: our own choice.
#: [rad]
MISSED_RAD = np.radians(25.0)


class StitchError(TrocarError):
    """A stitch that could not be made, with the reason."""


@dataclass
class PerceptionNoise:
    """Errors of perception: uniform ones up to these, normal ones of a needle's pose in the jaws.

    Attributes:
        place, turn: of a needle that lies [m, rad]
        held, held_turn: of a needle in the jaws, along and about each axis [m, rad]
        wound: of each point that is seen of the wound, normal [m]
    """

    place: float = 1e-3
    turn: float = float(np.radians(5.0))
    held: float = 2e-4
    held_turn: float = float(np.radians(0.5))
    wound: float = 2.5e-4

    def scaled(self, factor: float) -> PerceptionNoise:
        """Return errors larger by a factor; of the wound, too."""
        values = (self.place, self.turn, self.held, self.held_turn, self.wound)
        return PerceptionNoise(*(factor * value for value in values))


class Operation(Protocol):
    """The episode that a policy works in."""

    tissue: SoftTissue
    noise: PerceptionNoise
    noise_rng: np.random.Generator

    @property
    def plan(self) -> Plan:
        """Its stitches."""
        ...

    def make_plan(self) -> Plan:
        """Plan the stitches from the seen wound and needle."""
        ...

    def announce(self, text: str) -> None:
        """Publish the step that is executed."""
        ...


class NeedleHand(Hand):
    """An instrument that holds a needle.

    Args:
        task: the episode
        arm: name of a PSM
        reach: of it
    """

    def __init__(self, task: Task, arm: str, reach: TipWorkspace) -> None:
        super().__init__(task, arm)
        self.reach = reach

    @property
    def holds(self) -> bool:
        """Whether its jaw holds the needle."""
        grasp = self.task.world.grasps()[self.arm]
        return grasp.object != "" and grasp.load != 0.0  # 0 while it only presses

    def follow(self, poses: Iterator[Array]) -> Motion:
        """Bring the tip through poses in the world, one each period.

        Raises:
            StitchError: it stays behind: a limit, a singular pose, or something in the way
        """
        behind = 0
        for T in poses:
            now = self.task.controller.target(self.arm)
            change = rotation_vector_from_matrix(T[:3, :3] @ now[:3, :3].T)
            way = T[:3, 3] - now[:3, 3]
            far = float(np.linalg.norm(way)) > 0.006 or float(np.linalg.norm(change)) > 0.15
            behind = behind + 1 if far else 0
            if behind > 10:
                raise StitchError(f"{self.arm} does not follow its path")
            yield np.concatenate([way / PERIOD_S, change / PERIOD_S, [self.jaw]])

    def to_joints(self, q: Array, speed: float = 1.2) -> Motion:
        """Go to joint positions, (n,), along a line between joints."""
        start = self.task.world.arms[self.arm].joints.setpoints()[: len(q)]
        scale = np.array([1.0, 1.0, 10.0, 0.6, 1.0, 1.0])  # m are 10 rad, a roll turns faster
        time = 1.5 * float(np.abs((q - start) * scale).max()) / speed
        count = max(1, int(np.ceil(time / PERIOD_S)))
        smooth = (np.arange(1, count + 1) / count) ** 2 * (
            3.0 - 2.0 * np.arange(1, count + 1) / count
        )
        yield from self.follow(self.reach.pose(start + s * (q - start)) for s in smooth)

    def line(self, goal: Array, speed: float = 0.05) -> Motion:
        """Go straight to a pose in the world (4, 4), and settle."""
        yield from self.go(goal, speed)
        now = self.task.controller.target(self.arm)
        if np.linalg.norm(goal[:3, 3] - now[:3, 3]) > 1e-3:
            at = np.round(1e3 * goal[:3, 3], 1)
            raise StitchError(f"{self.arm} does not reach {at} mm{self.reach.why_not(goal)}")

    def lag(self) -> float:
        """Return the distance of the measured tip from its set-point [m]."""
        controller = self.task.controller
        now, goal = controller.tip(self.arm), controller.target(self.arm)
        return float(np.linalg.norm(goal[:3, 3] - now[:3, 3]))

    def give_way(self) -> Motion:
        """Bring the set-point half of the way to the measured tip, for a period."""
        now, goal = (
            self.task.controller.target(self.arm),
            self.task.controller.tip(self.arm),
        )
        change = rotation_vector_from_matrix(goal[:3, :3] @ now[:3, :3].T)
        way = np.concatenate([goal[:3, 3] - now[:3, 3], change])
        yield np.append(0.5 * way / PERIOD_S, self.jaw)

    def back(self, way: float, speed: float = 0.08) -> Motion:
        """Withdraw along the jaw [m]."""
        yield from self.shift(-way * self.task.controller.target(self.arm)[:3, 2], speed)


class Sewing:
    """The policy of one episode.

    Args:
        task: the episode
        operation: the same, with its tissue and noise
    """

    def __init__(self, task: Task, operation: Operation) -> None:
        self.task, self.op = task, operation
        self.needle = operation.plan.needle
        names = [name for name, arm in task.world.arms.items() if arm.description.type == "PSM"]
        self.hands = {
            name: NeedleHand(task, name, TipWorkspace(task.world, name)) for name in names
        }

    def run(self) -> Iterator[Array]:
        """Yield the actions of all stitches."""
        held = yield from self._pick()
        stitches = self.op.plan.stitches
        for number, planned in enumerate(stitches):
            self.op.announce(f"stitch {number + 1}: approach")
            stitch = self._aimed(number, planned) if number else planned
            held = yield from self._drive(number, stitch, held)
            held = yield from self._regrasp(stitch, held)
            yield from self._pull_through(number, stitch, held)
            self.op.tissue.lock(number)
            if number + 1 < len(stitches):
                self.op.announce("hand back")
                held = yield from self._hand_back(stitches[number + 1], held)
        self.op.announce("done")

    def rest(self, time: float) -> Iterator[Array]:
        """Stay where everything is [s]."""
        return self._one(hand := next(iter(self.hands.values())), hand.wait(time))

    # ------------------------------------------------------------------ parts of a stitch

    def _pick(self) -> Generator[Array, None, Array]:
        """Pick the needle up, again where that fails; return how it is held."""
        for attempt in range(TRIES):
            self.op.announce("pick" if attempt == 0 else f"pick again ({attempt + 1})")
            sights = [self._see()]
            for _ in range(LOOKS - 1 if attempt else 0):
                yield from self.rest(PERIOD_S)
                sights.append(self._see())
            seen = _mean(sights)
            if seen[2, 2] * self.op.plan.stitches[0].grips[0].along > 0.0:
                self.op.announce("the needle lies on its other side: plan again")
                self.op.make_plan()
            stitch = self.op.plan.stitches[0]
            hand, grip = self.hands[stitch.driver], stitch.grips[0]
            held = grip.pose(self.needle)
            start = self._start_joints(stitch, held)
            if start is None:
                raise StitchError(f"{hand.arm} does not reach the stitch")
            above, there = _raised(seen @ held, ABOVE_M), seen @ held
            hand.jaw = AROUND
            solutions = hand.reach.all(above)
            if not len(solutions):
                raise StitchError(
                    f"{hand.arm} does not reach the needle{hand.reach.why_not(above)}"
                )
            roll = np.abs(solutions - start)[:, [0, 1, 3, 4, 5]].max(axis=1)
            yield from self._one(hand, hand.to_joints(solutions[int(np.argmin(roll))]))
            yield from self._one(hand, hand.line(there, 0.04))
            yield from self._close(hand)
            yield from self._one(hand, hand.line(above))
            if hand.holds:
                now = self._held(hand)
                tilt = np.degrees(np.arccos(np.clip(now[2, 2] * grip.along, -1.0, 1.0)))
                start = self._start_joints(stitch, now) if tilt < TILT_DEG else None
                if start is not None:
                    yield from self._one(hand, hand.to_joints(start, 1.5))
                    return now
                self.op.announce(f"needle tilted by {tilt:.0f} deg in the jaws: put it down")
                yield from self._one(hand, hand.line(there))
            else:
                self.op.announce("missed the needle")
            yield from self._one(hand, hand.open(AROUND))
            yield from self._one(hand, hand.line(above))
            yield from self._one(hand, hand.wait(0.5))
        raise StitchError(f"the needle was not picked in {TRIES} tries")

    def _aimed(self, number: int, stitch: Stitch) -> Stitch:
        """Return a stitch through its punctures as seen now: tight ones move the wound."""
        rng, error = self.op.noise_rng, self.op.noise.wound / np.sqrt(LOOKS)
        seen = self.op.tissue.read().points[number, [0, 3]] + error * rng.normal(size=(2, 3))
        planned = stitch.points[[0, 3]] @ stitch.wound[:3, :3].T + stitch.wound[:3, 3]
        (x, y, _), (u, v, _) = np.diff(planned, axis=0)[0], np.diff(seen, axis=0)[0]
        turn = rotation_z(float(np.arctan2(x * v - y * u, x * u + y * v)))
        shift = (seen.mean(axis=0) - turn @ planned.mean(axis=0)) * [1.0, 1.0, 0.0]
        return replace(stitch, wound=transform(turn, shift) @ stitch.wound)

    def _drive(self, number: int, stitch: Stitch, held: Array) -> Generator[Array, None, Array]:
        """Bring the needle to the wound and through both sides; return the tip's pose in it."""
        hand, tissue = self.hands[stitch.driver], self.op.tissue
        begin = stitch.needle_pose(self.needle, stitch.start)
        yield from self._one(hand, hand.line(_raised(begin @ held, CLEAR_M)))
        held = yield from self._look_again(hand, held)
        yield from self._one(hand, hand.line(begin @ held, 0.02))
        yield from self._one(hand, hand.wait(0.1))
        self.op.announce(f"stitch {number + 1}: drive")

        def late(angle: float) -> bool:
            if tissue.astray:
                raise StitchError(f"stitch {number + 1}: the tip went in beside the plan")
            return not tissue.passed[number, 0] and angle > stitch.surface + MISSED_RAD

        yield from self._arc(hand, stitch, held, (stitch.start, stitch.out), DRIVE_RAD_S, late)
        yield from self._one(hand, hand.wait(0.1))
        if not tissue.passed[number].all():
            reached = int(tissue.passed[number].sum())
            raise StitchError(f"stitch {number + 1}: the tip passed {reached} of 4 points")
        return held

    def _regrasp(self, stitch: Stitch, held: Array) -> Generator[Array, None, Array]:
        """Let the other arm take the needle by its tip; return the tip's pose in it."""
        self.op.announce("the other arm takes the needle")
        grip = stitch.grips[1].pose(self.needle)
        angles = np.arange(stitch.out, stitch.end, np.radians(4.0))
        way = [stitch.needle_pose(self.needle, angle) @ grip for angle in angles]
        return (yield from self._take(stitch, 1, held, way))

    def _take(
        self, stitch: Stitch, row: int, given: Array, then: list[Array]
    ) -> Generator[Array, None, Array]:
        """Let an arm take the needle with one of the stitch's grips, the other let go of it.

        Args:
            stitch: whose grips
            row: 0: of the driver, 1: of the taker
            given: pose of the other arm's tip in the needle now
            then: poses that the taker's tip shall go through afterwards
        """
        taker, giver = (stitch.driver, stitch.taker)[:: 1 - 2 * row]
        give, take = self.hands[giver], self.hands[taker]
        grip = stitch.grips[row].pose(self.needle)
        goal = self._pose(give, given) @ grip
        for _ in range(TRIES):
            yield from self._one(take, take.open(BESIDE))
            yield from self._approach(take, [goal, *then])
            yield from self._one(take, take.line(goal, 0.03 if row else 0.05))  # in the air
            if row:  # tissue holds the needle, too: pads that close on it alone do not twist it
                yield from self._near(take)
                yield from self._one(give, give.open(BESIDE))
                yield from self._close(take)
                seen = self._pose(take, self._held(take))
            else:
                yield from self._close(take, give)
                seen = self._pose(give, given)
            if take.holds:
                break
            self.op.announce(f"{taker} missed the needle")
            yield from self._one(take, take.open(BESIDE))
            yield from self._one(take, take.back(ABOVE_M))
            goal = seen @ grip
        else:
            raise StitchError(f"{taker} did not take the needle in {TRIES} tries")
        if not row:
            yield from self._one(give, give.open(BESIDE))
        held = self._held(take)
        yield from self._one(give, give.back(0.015))
        yield from self._one(give, give.shift(0.02 * UP))
        return (yield from self._look_again(take, held))

    def _pull_through(self, number: int, stitch: Stitch, held: Array) -> Iterator[Array]:
        """Turn the needle out and pull the thread until the stitch is tight."""
        hand, tissue = self.hands[stitch.taker], self.op.tissue
        self.op.announce(f"stitch {number + 1}: pull the needle out")
        now = stitch.angle_of(self.needle, self._pose(hand, held))
        yield from self._arc(hand, stitch, held, (now, stitch.end), OUT_RAD_S, lambda _: False)
        if not tissue.left[number].all():
            raise StitchError(f"stitch {number + 1}: the needle is not out")
        self.op.announce(f"stitch {number + 1}: pull the thread")
        blocked: list[Pull] = []
        while (pull := self._best_pull(stitch, held, blocked)) is not None:
            yield from self._one(hand, hand.follow(self._pull(hand, pull)))
            if hand.lag() < BLOCKED_M:
                break
            blocked.append(pull)
            self.op.announce(f"stitch {number + 1}: something is in the way: pull another way")
            while hand.lag() > 0.1 * BLOCKED_M:
                yield from self._one(hand, hand.give_way())
            if len(blocked) > 1:  # from here no way leads on
                yield from self._one(hand, hand.shift(-BACK_M * blocked[0].way))
        if tissue.tension() < 0.8 * TIGHT_N:
            raise StitchError(f"stitch {number + 1}: the thread is not tight")
        yield from self._one(hand, hand.wait(0.3))

    def _best_pull(self, stitch: Stitch, held: Array, blocked: list[Pull]) -> Pull | None:
        """Return the first pull that stays away from limits, else the one that stays farthest.

        Args:
            stitch: after which the thread is pulled
            held: pose of the tip in the needle's frame, (4, 4)
            blocked: pulls before, with something in their way

        Returns:
            None: something is in the way in all directions

        Raises:
            StitchError: there is no way in reach; says which joint is in the way, and by how much
        """
        reach, tissue = self.hands[stitch.taker].reach, self.op.tissue.tissue
        start, q = self.task.controller.target(stitch.taker), reach.arm.joints.setpoints()[:-1]
        best: tuple[float, Pull] | None = None
        far, why = -np.inf, ""
        for directions in (PULLS, LAST_PULLS):
            for pull in stitch.pulls(reach, tissue, start, held, directions):
                if any(np.allclose(pull.way, other.way) for other in blocked):
                    continue
                if blocked:
                    pull = pull.continuing(blocked[0])
                poses = pull.poses()
                room = reach.through(q, poses)[0]
                if room >= LEAST:
                    return pull
                if room < 0.0:
                    count = reach.count(q, poses)
                    if count > far:
                        after = f" {1e3 * STEP_M * count:.0f} of {1e3 * pull.length:.0f} mm"
                        far, why = count, after + reach.why_not(poses[count])
                elif best is None or room > best[0]:
                    best = room, pull
            if best is not None:
                return best[1]
        if why:
            raise StitchError(f"{stitch.taker} does not reach the end of the pull, after{why}")
        return None

    def _pull(self, hand: NeedleHand, pull: Pull) -> Iterator[Array]:
        """Yield poses along a pull until the thread is tight or something blocks it."""
        tension, pulled = 0.0, 0.0
        while tension < TIGHT_N and pulled < pull.length and hand.lag() < BLOCKED_M:
            speed = max(SLOWEST_M_S, min(TIGHT_M_S, GAIN * (TIGHT_N - tension)))
            pulled += (PULL_M_S if tension < SLOW_N else speed) * PERIOD_S
            yield pull.pose(pulled)
            tension = self.op.tissue.tension()

    def _hand_back(self, stitch: Stitch, held: Array) -> Generator[Array, None, Array]:
        """Turn the needle on in the air and give it back; return the driver's pose in it."""
        give = self.hands[stitch.taker]
        begin = self.task.controller.target(give.arm) @ inverse(held)
        start = stitch.start + np.radians(4.0)
        goal = stitch.needle_pose(self.needle, start)
        goal[2, 3] += 0.018
        angle = stitch.angle_of(self.needle, begin)
        turn = (start - angle) % (2.0 * np.pi)
        x, count = float(stitch.points[0, 0]), 105
        swage = angle - self.needle.arc
        flat = needle_on_circle(stitch.wound, x, stitch.height, stitch.side, swage)
        beside = rotation_vector_from_matrix(flat[:3, :3].T @ begin[:3, :3])

        def way() -> Iterator[Array]:
            for k in range(1, count + 1):
                s = k / count
                s = s * s * (3.0 - 2.0 * s)
                swage = angle + s * turn - self.needle.arc
                T = needle_on_circle(stitch.wound, x, stitch.height, stitch.side, swage)
                T[:3, :3] = T[:3, :3] @ matrix_from_rotation_vector((1.0 - s) * beside)
                T[:3, 3] = begin[:3, 3] + s * (goal[:3, 3] - begin[:3, 3])
                T[2, 3] += 0.01 * np.sin(np.pi * s)
                yield T @ held

        yield from self._one(give, give.follow(way()))
        yield from self._one(give, give.wait(0.1))
        grip = stitch.grips[0].pose(self.needle)
        angles = np.arange(stitch.start, stitch.out, np.radians(4.0))
        then = [stitch.needle_pose(self.needle, angle) @ grip for angle in angles]
        return (yield from self._take(stitch, 0, held, [_raised(then[0], CLEAR_M), *then]))

    # ------------------------------------------------------------------ inside

    def _one(self, hand: Hand, motion: Motion) -> Iterator[Array]:
        return together(self.task, **{hand.arm: motion})

    def _near(self, hand: NeedleHand) -> Iterator[Array]:
        """Bring the pads of a jaw near to the needle between them."""
        hand.jaw = ALMOST
        yield from self._one(hand, hand.wait(NEAR_S))

    def _close(self, hand: NeedleHand, *others: NeedleHand) -> Iterator[Array]:
        """Close a jaw until it holds the needle.

        Its arm, and others that hold the needle, yield to forces on them.
        """
        yield from self._near(hand)
        gently = np.arange(ALMOST, 0.0, -GENTLE_RAD_S * PERIOD_S).tolist()
        for hand.jaw in [*gently, *[GRIP] * round(CLOSE_S / PERIOD_S)]:
            yield from together(self.task, **{one.arm: one.give_way() for one in (hand, *others)})
            if hand.holds and hand.jaw < 0.0:
                return

    def _arc(
        self,
        hand: NeedleHand,
        stitch: Stitch,
        held: Array,
        angles: tuple[float, float],
        rate: float,
        stop: Callable[[float], bool],
    ) -> Iterator[Array]:
        """Turn the needle about the stitch's circle, onto which it is brought on the way."""

        def way() -> Iterator[Array]:
            angle, last = angles
            first = stitch.needle_pose(self.needle, angle) @ held
            beside = log_transform(inverse(first) @ self.task.controller.target(hand.arm))
            while angle < last:
                angle = min(last, angle + rate * PERIOD_S)
                left = max(0.0, 1.0 - (angle - angles[0]) / ONTO_RAD)
                yield stitch.needle_pose(self.needle, angle) @ held @ exp_twist(left * beside)
                if stop(angle):
                    raise StitchError("the tip did not puncture where it was expected")

        yield from self._one(hand, hand.follow(way()))

    def _approach(self, hand: NeedleHand, poses: list[Array]) -> Iterator[Array]:
        """Go in front of the first of poses, along the jaw, with most room for all of them.

        Raises:
            StitchError: there is no way
        """
        before = poses[0].copy()
        before[:3, 3] -= ABOVE_M * poses[0][:3, 2]
        found = hand.reach.along([before, *poses])
        if found is None:
            raise StitchError(f"{hand.arm} does not reach the needle and what is to come")
        yield from self._one(hand, hand.to_joints(found[2], 1.5))

    def _start_joints(self, stitch: Stitch, held: Array) -> Array | None:
        """Return the driver's joints above the wound, on the best way along the arc; None: none."""
        hand = self.hands[stitch.driver]
        angles = np.arange(stitch.start, stitch.out, np.radians(4.0))
        poses = [stitch.needle_pose(self.needle, angle) @ held for angle in angles]
        found = hand.reach.along([_raised(poses[0], ABOVE_M), *poses])
        return None if found is None or found[0] < LEAST else found[2]

    def _pose(self, hand: Hand, held: Array) -> Array:
        """Return the needle's pose in the world from that of a hand's tip in it, (4, 4)."""
        return self.task.controller.tip(hand.arm) @ inverse(held)

    def _see(self) -> Array:
        """Return the seen pose of the lying needle."""
        rng, noise = self.op.noise_rng, self.op.noise
        T = self.task.object_pose(self.op.tissue.tissue.needle)
        T[:2, 3] += noise.place * rng.uniform(-1.0, 1.0, 2)
        turn = matrix_from_rotation_vector(noise.turn * rng.uniform(-1.0, 1.0) * UP)
        return transform(turn @ T[:3, :3], T[:3, 3])

    def _look_again(self, hand: NeedleHand, held: Array) -> Generator[Array, None, Array]:
        """Look at a needle in the jaws a few times; return the mean pose of the tip in it."""
        looks = [held]
        for _ in range(LOOKS - 1):
            yield from self._one(hand, hand.wait(PERIOD_S))
            looks.append(self._held(hand))
        return _mean(looks)

    def _held(self, hand: NeedleHand) -> Array:
        """Return the pose of a hand's tip in the needle's frame as it is measured, (4, 4)."""
        rng, noise = self.op.noise_rng, self.op.noise
        needle = self.task.object_pose(self.op.tissue.tissue.needle)
        held = inverse(needle) @ self.task.controller.tip(hand.arm)
        turn = matrix_from_rotation_vector(noise.held_turn * rng.normal(size=3))
        return transform(turn, noise.held * rng.normal(size=3)) @ held


def _mean(poses: list[Array]) -> Array:
    """Return the mean of poses that are near to each other, (4, 4)."""
    apart = np.array([log_transform(inverse(poses[0]) @ one) for one in poses])
    return poses[0] @ exp_twist(apart.mean(axis=0))


def _raised(T: Array, height: float) -> Array:
    """Return a pose moved upwards."""
    found = T.copy()
    found[2, 3] += height
    return found
