"""Drive a lone simulated arm along a recording of a real one, a piece at a time, and compare."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.calibrated import One, selects_cad
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import InputError, LogError
from trocar.robot.recordings import ArmMotion, ReadSettings, read_arm_motion, recorded_joints
from trocar.robot.standing import standing_arm
from trocar.simulation import World
from trocar.simulation.journal import Entry
from trocar.simulation.setpoint_table import fastest

Array = NDArray[np.float64]
T = TypeVar("T")
ReplayMode = Literal["position", "effort"]

#: Physics steps that are played and stored at once. Source: our own choice; some 2 MB.
PIECE_PERIODS = 2500
#: Largest number of physics steps of a sample. Source: our own choice, 1 Hz at 1 ms.
MOST_PERIODS = 1000
#: Largest relative distance of a sample's time from whole physics steps that is rounded; others are
#: resampled faster. Source: our own choice.
ROUNDED = 0.02
#: Time before a FAULT in which the step that led to it is looked for [s]. Source: our own choice,
#: an arm with the dVRK's gains has settled by then.
BEFORE_FAULT_S = 0.5


@dataclass(frozen=True)
class ReplaySettings:
    """Settings of a replay.

    Attributes:
        mode: "position": the servos follow the recorded motion; "effort": the recorded efforts act
            open loop, gravity compensation off because they contain it
        window_s: in mode "effort" the arm restarts from the recorded state this often [s]
        control, friction: as for `World`
        reading: how to read the recording
        tool: the mounted tool, the arm's default when omitted
        calibration: overlays of the arm, or their paths, or "cad" for the description's masses;
            None: the nominal arm with identified dynamics
        rig, base_rpy: how the arm stands, as for `standing_arm`
    """

    mode: ReplayMode = "position"
    window_s: float = 0.5
    control: Literal["dvrk", "paper"] = "dvrk"
    friction: Literal["identified", "paper"] = "identified"
    reading: ReadSettings = field(default_factory=ReadSettings)
    tool: str | None = None
    calibration: One | Sequence[One] | None = None
    rig: str | Path | None = None
    base_rpy: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class ReplayReport:
    """Comparison of a simulated arm with a recorded one.

    Attributes:
        log: the recording
        arm: the description that was driven
        mode: "position" or "effort"
        understood: what was read, in words
        up: direction against gravity in the arm's reference frame
        rate_hz: rows a second as they were played [Hz]
        pieces: uninterrupted pieces of the recording; the arm is put at the beginning of each
        samples: rows of the recording
        clipped: rows with a position beyond a joint's limit
        tracking_rms: {joint: RMS of simulated minus recorded position} [rad or m]
        effort_rms: {joint: RMS of simulated minus recorded effort} [N m or N]
        effort_relative_rms: {joint: the same divided by the recorded effort's RMS}; None for a
            joint whose recorded effort is zero throughout
    """

    log: str
    arm: str
    mode: ReplayMode
    understood: str
    up: tuple[float, float, float]
    rate_hz: float
    pieces: int
    samples: int
    clipped: int
    tracking_rms: dict[str, float]
    effort_rms: dict[str, float]
    effort_relative_rms: dict[str, float | None]


def replay(
    log: str | Path,
    arm: str | Path | None = "psm",
    settings: ReplaySettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ReplayReport:
    """Replay a recording on a lone simulated arm.

    Between two rows the set-points move evenly, once per physics period. The arm is compared with
    the recording at every row but the first of each piece, which it starts from: positions at that
    time, efforts as the mean since the row before, of both. A pause ends a piece. The gripper of an
    MTM, which has no motor, stays open.

    Args:
        log: as for `read_arm_motion`
        arm: a built-in arm, or the path of a description; with `settings.rig`, an arm of that rig
        settings: the defaults when omitted
        progress: called with (rows done, rows) now and then

    Raises:
        LogError: the recording cannot be used, or the arm cannot follow it; file and row are named
        UnknownNameError, DescriptionError: the arm
        InputError: a setting
        DivergedError: the simulation left the finite numbers
    """
    how = settings or ReplaySettings()
    stand = standing_arm(arm, how.tool, how.rig, how.base_rpy)
    described = stand.arm
    if how.calibration is not None:
        described = load_arm(described.file, described.tool or "none", how.calibration)
    if described.type not in ("PSM", "ECM", "MTM"):
        raise InputError(
            f"{described.name}: got arm type {described.type}; allowed: PSM, ECM or MTM"
        )
    rig = lone_arm_rig(described, stand.turn)
    dynamics = "cad" if selects_cad(how.calibration) else None
    world = World(rig, control=how.control, friction=how.friction, dynamics=dynamics)
    motion = read_arm_motion(log, described, how.reading)
    if how.mode == "effort" and not motion.has_efforts:
        raise LogError(str(log), "contains no efforts; allowed: mode position")
    slowest = 1.0 / (world.timestep * MOST_PERIODS)
    rate = how.reading.rate_hz or max(motion.rate_hz, slowest)
    periods = _periods(rate, world.timestep)
    rate = 1.0 / (periods * world.timestep)
    restart = _restart(how, rate)
    played = [one.at_rate(rate) for one in motion.pieces()]
    played = [one for one in played if len(one.times) > 1]
    total = sum(len(one.times) for one in played)
    if not played:
        raise LogError(str(log), f"lasts less than {1.0 / rate:g} s; allowed: 2 rows or more")
    piece_rows = max(1, PIECE_PERIODS // periods)
    run = _Run(world, described, rig.arms[0].name, how.mode, periods, stand.up)
    for one in played:
        _check_speeds(one, described)
    for one in played:
        run.begin()
        done = 0
        rows = (one.rows[k : k + piece_rows] for k in range(0, len(one.rows), piece_rows))
        for piece, fresh in pieces(rows, restart):
            failed = run.play(piece, fresh)
            if failed is not None:
                raise _fault(one, described, done + failed, run.faults[0].values["text"])
            done += len(piece) - 1
            if progress is not None:
                progress(run.samples, total)
    return run.report(motion, rate)


def pieces(chunks: Iterable[Array], restart: int) -> Iterator[tuple[Array, bool]]:
    """Cut chunks of rows into pieces that begin with the last row of the piece before.

    Args:
        chunks: (k, ...) each
        restart: rows after which a piece begins afresh

    Yields:
        rows (k + 1, ...), and whether the first of them is one to restart from
    """
    done, last = 0, None
    for chunk in chunks:
        rows = chunk if last is None else np.concatenate([last, chunk])
        begin, end = 0, len(rows) - 1
        while begin < end:
            phase = (done + begin) % restart
            stop = min(end, begin + restart - phase)
            yield rows[begin : stop + 1], phase == 0
            begin = stop
        done, last = done + end, rows[-1:]


def between(rows: Array, periods: int) -> Array:
    """Fill in rows evenly: (k + 1, ...) become (k * periods, ...), the first row left out."""
    share = (np.arange(1, periods + 1) / periods).reshape(1, -1, *(1,) * (rows.ndim - 1))
    filled = rows[:-1, None] * (1.0 - share) + rows[1:, None] * share
    return filled.reshape(-1, *rows.shape[1:])


class _Run:
    """A world on its way along a recording, and sums of squares so far."""

    def __init__(
        self,
        world: World,
        arm: ArmDescription,
        name: str,
        mode: ReplayMode,
        periods: int,
        up: Array,
    ) -> None:
        self.world, self.arm, self.name, self.up = world, arm, name, up
        self.mode: ReplayMode = mode
        self.periods = periods
        self.joints = recorded_joints(arm)
        self.samples, self.clipped, self.begun = 0, 0, 0
        self._first = True
        self.faults: list[Entry] = []  # of the arm
        world.listen(self._hear)
        self.sums = np.zeros((3, len(self.joints)))  # of position and effort errors, of efforts
        if mode == "effort":
            world.arm(name).joints.set_mode("effort")
            world.arm(name).joints.use_gravity_compensation(False)

    def begin(self) -> None:
        """Begin a piece of the recording, whose first row is not compared."""
        self.samples, self.begun, self._first = self.samples + 1, self.begun + 1, True

    def play(self, rows: Array, fresh: bool) -> int | None:
        """Play rows (k + 1, 3, n) from the first on, restarting there when `fresh`.

        Returns:
            the row at which the arm went into FAULT, None where it did not
        """
        count = len(self.joints)
        lower, upper = self.arm.mechanism.lower[:count], self.arm.mechanism.upper[:count]
        beyond = (rows[:, 0] < lower) | (rows[:, 0] > upper)
        self.clipped += int(beyond[0 if self._first else 1 :].any(axis=1).sum())
        self._first = False
        targets = rows.copy()
        targets[:, 0] = np.clip(rows[:, 0], lower, upper)
        targets[:, 1][beyond] = 0.0  # a target that is held at a limit does not move
        fine = between(targets, self.periods)
        start, driven = self._whole(targets[:1])[0], self._whole(fine)
        if fresh:
            self.world.set_state(self.name, start[0], start[1])
        q, v, effort = ({self.name: driven[:, k]} for k in range(3))
        began = self.world.time
        played = self.world.play(q, v, effort, every=1)
        if self.faults:
            return 1 + int((self.faults[0].time - began) / self.world.timestep) // self.periods
        position = played.positions[self.name][self.periods - 1 :: self.periods, :count]
        exerted = self._mean(played.efforts[self.name][:, :count])
        recorded = self._mean(fine[:, 2])
        errors = position - rows[1:, 0], exerted - recorded, recorded
        self.sums += [(error**2).sum(axis=0) for error in errors]
        self.samples += len(rows) - 1
        return None

    def _hear(self, entry: Entry) -> None:
        if entry.kind == "event" and entry.name == "error" and entry.source == self.name:
            self.faults.append(entry)

    def _whole(self, rows: Array) -> Array:
        """Return rows of all joints: those that were not recorded stay at their upper limit."""
        whole = np.zeros((*rows.shape[:2], len(self.arm.joints)))
        whole[:, 0] = self.arm.mechanism.upper
        whole[:, :, : rows.shape[2]] = rows
        return whole

    def _mean(self, values: Array) -> Array:
        """Return means over each row's periods: (k * periods, n) become (k, n)."""
        return values.reshape(-1, self.periods, values.shape[1]).mean(axis=1)

    def report(self, motion: ArmMotion, rate_hz: float) -> ReplayReport:
        """Return the figures so far."""
        position, effort, recorded = self.sums.tolist()
        count = self.samples - self.begun
        return ReplayReport(
            log=motion.file,
            arm=self.arm.name,
            mode=self.mode,
            understood=motion.understood(),
            up=(float(self.up[0]), float(self.up[1]), float(self.up[2])),
            rate_hz=rate_hz,
            pieces=self.begun,
            samples=self.samples,
            clipped=self.clipped,
            tracking_rms=self._named(float(np.sqrt(p / count)) for p in position),
            effort_rms=self._named(float(np.sqrt(e / count)) for e in effort),
            effort_relative_rms=self._named(
                float(np.sqrt(e / r)) if r > 0.0 else None
                for e, r in zip(effort, recorded, strict=True)
            ),
        )

    def _named(self, values: Iterable[T]) -> dict[str, T]:
        return dict(zip(self.joints, values, strict=True))


def _check_speeds(motion: ArmMotion, arm: ArmDescription) -> None:
    """Check that a piece, of one rate, is no faster than an arm may be driven.

    Raises:
        LogError: it is; row, time, joint and distance are named
    """
    most = fastest(arm)[: motion.rows.shape[2]]
    ratios = np.abs(motion.rows[:, 1]) / most
    if (ratios > 1.0).any():
        row = int(np.argmax((ratios > 1.0).any(axis=1)))
        k = int(np.argmax(ratios[row]))
        unit = "m" if arm.joints[k].kind == "prismatic" else "rad"
        raise _too_far(
            motion,
            arm,
            max(row - 1, 0),
            row + 2,
            k,
            f"at {ratios[row, k] * most[k]:.3g} {unit}/s; allowed: {most[k]:.3g} {unit}/s",
        )


def _fault(motion: ArmMotion, arm: ArmDescription, row: int, reason: str) -> LogError:
    """Return the error of an arm that went into FAULT at a row of a piece."""
    first = max(row - round(BEFORE_FAULT_S * motion.rate_hz), 0)
    q = motion.rows[:, 0]
    spans = (arm.mechanism.upper - arm.mechanism.lower)[: q.shape[1]]
    steps = np.abs(np.diff(q[first : row + 1], axis=0)).max(axis=0) / spans
    return _too_far(motion, arm, first, row + 1, int(np.argmax(steps)), f"FAULT: {reason}")


def _too_far(
    motion: ArmMotion, arm: ArmDescription, first: int, last: int, joint: int, reason: str
) -> LogError:
    """Return the error of a joint's largest step in rows of a piece, `last` left out."""
    q = motion.rows[first:last, 0, joint]
    row = first + 1 + int(np.argmax(np.abs(np.diff(q))))
    unit = "m" if arm.joints[joint].kind == "prismatic" else "rad"
    moved = motion.rows[row, 0, joint] - motion.rows[row - 1, 0, joint]
    return LogError(
        motion.file,
        f"{arm.joints[joint].name} moves by {moved:.3g} {unit} in"
        f" {motion.times[row] - motion.times[row - 1]:.3g} s, at t = {motion.times[row]:.3f} s, and"
        f" the arm cannot follow: {reason}",
        int(motion.numbers[row]),
    )


def _periods(rate_hz: float, timestep_s: float) -> int:
    """Compute the physics steps of a sample: the nearest whole number, or the one below."""
    periods = 1.0 / (rate_hz * timestep_s) if rate_hz > 0.0 else 0.0
    near = round(periods) if np.isfinite(periods) else 0
    whole = near if abs(periods - near) <= ROUNDED * periods else int(periods)
    if not 0.0 < periods <= MOST_PERIODS * (1.0 + ROUNDED):
        raise InputError(
            f"rate: got {rate_hz:g} Hz; allowed: {1.0 / (timestep_s * MOST_PERIODS):g} Hz or more"
        )
    return max(whole, 1)


def _restart(settings: ReplaySettings, rate_hz: float) -> int:
    """Compute the rows between two restarts from the recording."""
    if settings.mode not in ("position", "effort"):
        raise InputError(f"mode: got {settings.mode!r}; allowed: position, effort")
    least = 1.0 / rate_hz
    if settings.mode != "effort":  # in which nothing restarts
        least = min(least, settings.window_s) if settings.window_s > 0.0 else least
    if not np.isfinite(settings.window_s) or settings.window_s < least * (1.0 - 1e-9):
        raise InputError(f"window: got {settings.window_s!r} s; allowed: {least:g} s or more")
    return round(settings.window_s * rate_hz) if settings.mode == "effort" else sys.maxsize
