"""The recorded motion of one arm, in its public joints: pieces, resampling, and what is known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import LogError

Array = NDArray[np.float64]

#: The parts of a row, each of every joint.
QUANTITIES = ("positions", "velocities", "efforts")
#: Longest gap between samples that is interpolated [s, usual steps]: the longer one of both.
#: Source: our own choice.
LONGEST_GAP_S, LONGEST_GAP_STEPS = 1.0, 3.0
#: Largest position beyond a limit [joint ranges], velocity [per s] and effort [N m or N] of a log
#: of an arm. Source: our own choice, ten times those of the arms.
MOST_RANGES_BEYOND = 1.0
MOST_VELOCITY = 300.0
MOST_EFFORT = 1000.0
#: Largest 99th percentile of joint speeds over the arm's limits. Source: our own choice; masters in
#: published logs reach four times the limits of their own trajectories.
FASTEST = 6.0
#: Ratios of recorded velocities to the differences of positions at the right rate. Source: our own
#: choice; real ones are up to 17 % too large.
VELOCITY_RATIOS = (0.6, 1.6)
#: Least correlation of velocities with differences from which a rate is told. Source: our own
#: choice.
ALIKE = 0.8
#: Least motion of a joint over its range whose velocities confirm a rate: at rest they are noise.
#: Source: our own choice, as in identification.
MOVED = 1e-3
#: A jump between rows ends a piece: over the velocity limit, and over the joint's range. Source:
#: our own choice; a lost row is a jump of twice the usual step.
JUMP_SPEEDS, JUMP_RANGE = 20.0, 0.02
#: Farthest that a sample comes after later ones, and is put back [usual steps]. Source: our own
#: choice; a clock that was set goes back farther.
LATE_STEPS = 5.0
#: Largest relative difference of steps in time that counts as even. Source: our own choice.
EVEN_STEPS = 0.01


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """Samples of one arm as they were recorded, in its public joints.

    Attributes:
        file: its path, as given
        label: name of the arm in the file, "" where it has none
        joints: names, n
        times: of the samples, rising within a piece, (k,) [s]
        rows: positions, velocities, efforts, (k, 3, n) [rad or m, per s, N m or N]; zeros stand for
            what was not recorded
        recorded: joints that each of the three was recorded of
        numbers: of the samples in the file, from 1, (k,)
        starts: samples at which a piece begins, the first one is 0
        timed: whether the times are the file's own, not a rate's
        clock: the file's own clock at time 0 [s]
        notes: what was left out or assumed
    """

    file: str
    label: str
    joints: tuple[str, ...]
    times: Array
    rows: Array
    recorded: tuple[frozenset[str], frozenset[str], frozenset[str]]
    numbers: NDArray[np.int64]
    starts: tuple[int, ...] = (0,)
    timed: bool = True
    clock: float = 0.0
    notes: tuple[str, ...] = ()

    @property
    def rate_hz(self) -> float:
        """Usual number of samples a second [Hz]."""
        steps = np.diff(self.times)
        usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
        near = steps[(steps > 0.0) & (np.abs(steps - usual) < 0.5 * usual)]
        return 1.0 / float(near.mean()) if len(near) else 0.0

    @property
    def has_efforts(self) -> bool:
        """Whether any joint has efforts."""
        return bool(self.recorded[2])

    def pieces(self) -> Iterator[ArmMotion]:
        """Yield the pieces, of one start each."""
        for first, last in zip(self.starts, (*self.starts[1:], len(self.times)), strict=True):
            piece = slice(first, last)
            yield replace(
                self,
                times=self.times[piece],
                rows=self.rows[piece],
                numbers=self.numbers[piece],
                starts=(0,),
            )

    def cut_at(self, longest_gap_s: float) -> ArmMotion:
        """Return the motion, cut where two samples are farther apart in time [s]."""
        far = np.flatnonzero(np.diff(self.times) > longest_gap_s) + 1
        return replace(self, starts=tuple(sorted({*self.starts, *far.tolist()})))

    def at_rate(self, rate_hz: float) -> ArmMotion:
        """Return the samples of a motion of one piece at even times, filled in evenly.

        Each has the number of the recorded sample at or after it.

        Args:
            rate_hz: samples a second [Hz]
        """
        span = self.times[-1] - self.times[0]
        # float64 rounds today's seconds to 0.2 us
        count = int(np.floor((span + 1e-6) * rate_hz + 1e-9)) + 1
        steps = np.diff(self.times)
        if count == len(self.times) and np.allclose(steps, 1.0 / rate_hz, rtol=1e-9, atol=0.0):
            return self
        even = self.times[0] + np.arange(count) / rate_hz
        flat = self.rows.reshape(len(self.rows), -1)
        filled = np.zeros((count, flat.shape[1]))
        for k in range(flat.shape[1]):
            filled[:, k] = np.interp(even, self.times, flat[:, k])
        after = np.zeros(count, np.int64)
        after[:] = np.searchsorted(self.times, even - 1e-6)
        return replace(
            self,
            times=even,
            rows=filled.reshape(count, *self.rows.shape[1:]),
            numbers=self.numbers[np.minimum(after, len(self.times) - 1)],
        )

    def understood(self) -> str:
        """Describe the motion in a sentence: "PSM1: 6 joints at 30.0 Hz, no efforts"."""
        positions, velocities, efforts = self.recorded
        words = [f"{len(positions)} joints at {self.rate_hz:.1f} Hz"]
        absent = [joint for joint in self.joints if joint not in positions]
        if absent:
            held = " (at 0)" if len(absent) > 1 else ""
            words.append(f"no {', '.join(absent)}{held}")
        if not velocities:
            words.append("velocities by differences")
        if not efforts:
            words.append("no efforts")
        elif len(efforts) < len(positions):
            words.append(f"efforts of {', '.join(j for j in self.joints if j in efforts)} alone")
        words += self.notes
        if len(self.starts) > 1:
            words.append(f"{len(self.starts)} pieces")
        return f"{self.label or self.file}: {', '.join(words)}"


def checked_motion(motion: ArmMotion, arm: ArmDescription, rate_given: bool) -> ArmMotion:
    """Cut a motion where its time or its joints jump, and fill in velocities.

    Args:
        motion: as it is in the file, of one piece
        arm: the recorded arm
        rate_given: whether the rate was given, by the user or by times in the file

    Raises:
        LogError: fewer than two samples, numbers that this arm cannot have had, or a wrong rate
    """
    if len(motion.times) < 2:
        count = len(motion.times)
        what = "sample" if motion.timed else "row"
        got = f"got {count} {what}{'s' * (count != 1)}" if count else "is empty"
        raise LogError(motion.file, f"{got}; allowed: 2 {what}s or more")
    check_rows(motion.file, motion.numbers, motion.rows, arm)
    motion = _with_velocities(_cut(motion, arm))
    return _with_rate_checked(motion, arm, rate_given)


def check_rows(file: str, numbers: NDArray[np.int64], chunk: Array, arm: ArmDescription) -> None:
    """Check that rows (k, 3, n), of these numbers in the file, are what this arm can have done.

    Raises:
        LogError: they are not; file, row and joint are named
    """
    count = chunk.shape[2]
    lower, upper = arm.mechanism.lower[:count], arm.mechanism.upper[:count]
    beyond = MOST_RANGES_BEYOND * (upper - lower)
    least = np.stack([lower - beyond, np.full(len(lower), -MOST_VELOCITY), 0.0 * lower])
    most = np.stack([upper + beyond, np.full(len(lower), MOST_VELOCITY), 0.0 * lower])
    least[2], most[2] = -MOST_EFFORT, MOST_EFFORT
    bad = (chunk < least) | (chunk > most)
    if bad.any():
        row, quantity, joint = (int(k) for k in np.argwhere(bad)[0])
        raise LogError(
            file,
            f"{QUANTITIES[quantity]}: {arm.joints[joint].name}:"
            f" got {chunk[row, quantity, joint]:.6g};"
            f" allowed: {least[quantity, joint]:.6g} to {most[quantity, joint]:.6g}"
            f" (is this a recording of a {arm.name}?{_other_unit(chunk, arm)})",
            int(numbers[row]),
        )


def _other_unit(chunk: Array, arm: ArmDescription) -> str:
    """Return a hint of the units with which the positions would fit, "" without one."""
    count = chunk.shape[2]
    lower, upper = arm.mechanism.lower[:count], arm.mechanism.upper[:count]
    slides = np.array([joint.kind == "prismatic" for joint in arm.joints[:count]])
    usual = np.median(chunk[:, 0], axis=0)
    span = upper - lower
    for text, turn, slide in (("deg/m", np.pi / 180.0, 1.0), ("deg/mm", np.pi / 180.0, 1e-3),
                              ("rad/mm", 1.0, 1e-3)):  # fmt: skip
        scaled = usual * np.where(slides, slide, turn)
        if ((scaled > lower - 0.2 * span) & (scaled < upper + 0.2 * span)).all():
            return f" the positions would fit in other units: --units {text}"
    return ""


def derivative(values: Array, rate_hz: float) -> Array:
    """Return central differences of five points along the first axis, of two at the ends."""
    found = np.gradient(values, 1.0 / rate_hz, axis=0)
    ahead, further = values[3:-1] - values[1:-3], values[4:] - values[:-4]
    found[2:-2] = (8.0 * ahead - further) * (rate_hz / 12.0)
    return found


def _cut(motion: ArmMotion, arm: ArmDescription) -> ArmMotion:
    """Cut a motion at pauses, at times that go back, and at jumps of the joints."""
    times, rows, numbers = motion.times, motion.rows, motion.numbers
    notes = list(motion.notes)
    order = _in_time(times)
    late = int((np.diff(order) < 0).sum())
    if late:
        times, rows, numbers = times[order], rows[order], numbers[order]
        notes.append(f"{late} samples that came late put in their order")
    steps = np.diff(times)
    again = np.flatnonzero(steps == 0.0) + 1
    if len(again):
        times, rows = np.delete(times, again), np.delete(rows, again, axis=0)
        numbers = np.delete(numbers, again)
        notes.append(f"{len(again)} samples repeat a time and were left out")
        steps = np.diff(times)
    if len(times) < 2:
        raise LogError(motion.file, "got 1 sample; allowed: 2 samples or more")
    usual = float(np.median(steps))
    longest = max(LONGEST_GAP_S, LONGEST_GAP_STEPS * usual if len(steps) > 2 else 0.0)
    lost = int((steps > 1.5 * usual).sum()) if motion.timed else 0
    jumps = _jumps(rows, steps, arm)
    if motion.timed:  # samples stamped in bursts are no jumps
        jumps &= steps > 0.5 * usual
    breaks = (steps < 0.0) | (steps > longest) | jumps
    starts = [0, *(np.flatnonzero(breaks) + 1).tolist()]
    # A piece of a single sample is a stamp that went astray.
    ends = [*starts[1:], len(times)]
    keep = [(a, b) for a, b in zip(starts, ends, strict=True) if b - a > 1]
    if not keep:
        raise LogError(motion.file, f"no two samples follow each other within {longest:.3g} s")
    astray = len(times) - sum(b - a for a, b in keep)
    if astray:
        notes.append(f"{astray} samples of times apart from all others were left out")
        kept = np.concatenate([np.arange(a, b) for a, b in keep])
        times, rows, numbers = times[kept], rows[kept], numbers[kept]
        steps, jumps = np.diff(times), _jumps(rows, np.diff(times), arm)
        ends = np.cumsum([b - a for a, b in keep]).tolist()
        starts = [0]
        for end in ends[:-1]:
            if not 0.0 < steps[end - 1] <= longest or jumps[end - 1]:
                starts.append(end)
    before = np.array(starts[1:], np.int64) - 1
    timely = (steps[before] > 0.0) & (steps[before] <= longest)
    jumped = int((jumps[before] & timely).sum())
    if jumped and motion.timed:
        notes.append(f"{jumped} jumps of the joints")
    paused: list[float] = steps[before[~timely]].tolist()
    lost -= sum(pause > longest for pause in paused)
    if lost > 0:
        notes.append(f"{lost} gaps of lost samples filled in")
    if paused and motion.timed:
        most = max(paused)
        back = sum(pause < 0.0 for pause in paused)
        if most > 0.0:
            notes.append(f"pauses of up to {most:.3g} s")
        if back:
            notes.append(f"the clock goes back {back} times")
    return replace(
        motion, times=times, rows=rows, numbers=numbers, starts=tuple(starts), notes=tuple(notes)
    )


def _in_time(times: Array) -> NDArray[np.int64]:
    """Return the order of samples (k,) in which those that come a few steps late are in place."""
    steps = np.diff(times)
    usual = float(np.median(np.abs(steps)))
    stretch = np.concatenate([[0], np.cumsum(steps < -LATE_STEPS * usual)])
    return np.lexsort((times, stretch)).astype(np.int64)


def _jumps(rows: Array, steps: Array, arm: ArmDescription) -> NDArray[np.bool_]:
    """Find jumps of the joints between rows, farther than the arm moves in a row's time."""
    count = rows.shape[2]
    span = (arm.mechanism.upper - arm.mechanism.lower)[:count]
    fastest = np.array([joint.velocity_max for joint in arm.joints[:count]])
    moved = np.abs(np.diff(rows[:, 0], axis=0))
    jumped = (moved > JUMP_SPEEDS * fastest * steps[:, None]) & (moved > JUMP_RANGE * span)
    found = np.asarray(jumped.any(axis=1), np.bool_)
    again = np.flatnonzero(found[:-1] & found[1:])  # a row astray, not a pause
    found[again], found[again + 1] = False, False
    return found


def _with_velocities(motion: ArmMotion) -> ArmMotion:
    """Fill in velocities that were not recorded by differences within each piece."""
    columns = [k for k, joint in enumerate(motion.joints)
               if joint in motion.recorded[0] and joint not in motion.recorded[1]]  # fmt: skip
    if not columns:
        return motion
    rows = motion.rows.copy()
    first = 0
    for piece in motion.pieces():
        steps = np.diff(piece.times)
        q = piece.rows[:, 0][:, columns]
        even = len(q) >= 5 and np.ptp(steps) < EVEN_STEPS * steps.mean()
        found = derivative(q, 1.0 / steps.mean()) if even else np.gradient(q, piece.times, axis=0)
        rows[first : first + len(q), 1, columns] = found
        first += len(q)
    return replace(motion, rows=rows)


def _with_rate_checked(motion: ArmMotion, arm: ArmDescription, given: bool) -> ArmMotion:
    """Compare the rate with recorded velocities, and joint speeds with the arm's limits.

    A rate that was given is doubted in a note; one that was assumed is rejected.
    """
    doubts: list[str] = []
    rate = motion.rate_hz
    moved = np.concatenate([np.gradient(piece.rows[:, 0], piece.times, axis=0)
                            for piece in motion.pieces()])  # fmt: skip
    ratios: list[float] = []
    span = arm.mechanism.upper - arm.mechanism.lower
    for k, joint in enumerate(motion.joints):
        if joint not in motion.recorded[1] or np.ptp(motion.rows[:, 0, k]) < MOVED * span[k]:
            continue
        along, told = moved[:, k], motion.rows[:, 1, k]
        size = float(np.linalg.norm(along) * np.linalg.norm(told))
        if size > 0.0 and float(along @ told) > ALIKE * size:
            ratios.append(float(along @ told) / float(along @ along))
    ratio = float(np.median(ratios)) if ratios else 1.0
    if not VELOCITY_RATIOS[0] < ratio < VELOCITY_RATIOS[1]:
        doubts.append(
            f"velocities are {ratio:.3g} times the differences of positions at {rate:.4g} Hz:"
            f" the rate is perhaps {rate * ratio:.3g} Hz"
        )
    speeds = np.quantile(np.abs(moved), 0.99, axis=0)
    for k, joint in enumerate(motion.joints):
        limit = arm.joints[k].velocity_max
        if speeds[k] > FASTEST * limit and not ratios and not doubts:
            slides = arm.joints[k].kind == "prismatic"
            doubts.append(
                f"{joint} moves at {speeds[k]:.3g} {'m/s' if slides else 'rad/s'} at {rate:.4g} Hz,"
                f" {speeds[k] / limit:.0f} times its limit: a wrong rate or unit?"
            )
    if doubts and not given:
        raise LogError(motion.file, f"{doubts[0]} (--rate)")
    return replace(motion, notes=(*motion.notes, *doubts))
