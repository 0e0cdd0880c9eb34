"""Drive a lone simulated arm along a recording of a real one, a piece at a time, and compare."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.calibrated import One, selects_cad
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import InputError, LogError
from trocar.recording.bags import is_bag
from trocar.robot.logs import Wrist, check_rows, count_rows, read_bag, read_log, recorded_joints
from trocar.robot.standing import standing_arm
from trocar.simulation import World

Array = NDArray[np.float64]
T = TypeVar("T")
ReplayMode = Literal["position", "effort"]

#: Physics steps that are played and stored at once. Source: our own choice; some 2 MB.
PIECE_PERIODS = 2500
#: Largest number of physics steps of a sample. Source: our own choice, 1 Hz at 1 ms.
MOST_PERIODS = 1000


@dataclass(frozen=True)
class ReplaySettings:
    """Settings of a replay.

    Attributes:
        mode: "position": the servos follow the recorded motion; "effort": the recorded efforts act
            open loop, gravity compensation off because they contain it
        window_s: in mode "effort" the arm restarts from the recorded state this often [s]
        rate_hz: of the recording; 1000 divided by a whole number [Hz]
        control, friction: as for `World`
        wrist: as for `read_log`; a bag holds public joints
        topic: of a bag's joint states; its only one that fits when omitted
        tool: the mounted tool, the arm's default when omitted
        calibration: overlays of the arm, or their paths, or "cad" for the description's masses;
            None: the nominal arm with identified dynamics
        rig, base_rpy: how the arm stands, as for `standing_arm`
    """

    mode: ReplayMode = "position"
    window_s: float = 0.5
    rate_hz: float = 200.0
    control: Literal["dvrk", "paper"] = "dvrk"
    friction: Literal["identified", "paper"] = "identified"
    wrist: Wrist = "motor"
    tool: str | None = None
    topic: str | None = None
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
    the recording at every row but the first, which it starts from: positions at that time, efforts
    as the mean since the row before, of both. Memory does not grow with a recording in rows; a bag
    is read as a whole. The gripper of an MTM, which has no motor, stays open.

    Args:
        log: rows of numbers, read twice: first all of it is checked; or a bag
        arm: a built-in arm, or the path of a description; with `settings.rig`, an arm of that rig
        settings: the defaults when omitted
        progress: called with (rows done, rows) now and then

    Raises:
        LogError: the recording cannot be used; file and row are named
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
    periods, restart = _periods(how, world.timestep), _restart(how)
    piece_rows = max(1, PIECE_PERIODS // periods)
    if is_bag(log):
        table = _bag_rows(log, described, how)
        total = len(table)
        rows = (table[k : k + piece_rows] for k in range(0, total, piece_rows))
    else:
        total = count_rows(log, described, how.wrist)
        rows = read_log(log, described, how.wrist, piece_rows)
    run = _Run(world, described, rig.arms[0].name, how.mode, periods)
    for piece, fresh in pieces(rows, restart):
        run.play(piece, fresh)
        if progress is not None:
            progress(run.samples, total)
    return run.report(str(log))


def _bag_rows(log: str | Path, arm: ArmDescription, how: ReplaySettings) -> Array:
    """Read a bag at even times, (k, 3, n), and check it.

    Raises:
        LogError: it cannot be used
    """
    rows, has_efforts = read_bag(log, arm, how.rate_hz, how.topic)
    if how.mode == "effort" and not has_efforts:
        raise LogError(str(log), "contains no efforts; allowed: mode position")
    if len(rows) < 2:
        lasted = f"lasts less than {1.0 / how.rate_hz:g} s"
        raise LogError(str(log), f"{lasted}; allowed: 2 rows or more")
    check_rows(str(log), 1, rows, arm)
    return rows


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
        self, world: World, arm: ArmDescription, name: str, mode: ReplayMode, periods: int
    ) -> None:
        self.world, self.arm, self.name = world, arm, name
        self.mode: ReplayMode = mode
        self.periods = periods
        self.joints = recorded_joints(arm)
        self.samples, self.clipped = 1, 0
        self.sums = np.zeros((3, len(self.joints)))  # of position and effort errors, of efforts
        if mode == "effort":
            world.arm(name).joints.set_mode("effort")
            world.arm(name).joints.use_gravity_compensation(False)

    def play(self, rows: Array, fresh: bool) -> None:
        """Play rows (k + 1, 3, n) from the first on, restarting there when `fresh`."""
        count = len(self.joints)
        lower, upper = self.arm.mechanism.lower[:count], self.arm.mechanism.upper[:count]
        beyond = (rows[:, 0] < lower) | (rows[:, 0] > upper)
        self.clipped += int(beyond[1 if self.samples > 1 else 0 :].any(axis=1).sum())
        targets = rows.copy()
        targets[:, 0] = np.clip(rows[:, 0], lower, upper)
        targets[:, 1][beyond] = 0.0  # a target that is held at a limit does not move
        fine = between(targets, self.periods)
        start, driven = self._whole(targets[:1])[0], self._whole(fine)
        if fresh:
            self.world.set_state(self.name, start[0], start[1])
        q, v, effort = ({self.name: driven[:, k]} for k in range(3))
        played = self.world.play(q, v, effort, every=1)
        position = played.positions[self.name][self.periods - 1 :: self.periods, :count]
        exerted = self._mean(played.efforts[self.name][:, :count])
        recorded = self._mean(fine[:, 2])
        errors = position - rows[1:, 0], exerted - recorded, recorded
        self.sums += [(error**2).sum(axis=0) for error in errors]
        self.samples += len(rows) - 1

    def _whole(self, rows: Array) -> Array:
        """Return rows of all joints: those that were not recorded stay at their upper limit."""
        whole = np.zeros((*rows.shape[:2], len(self.arm.joints)))
        whole[:, 0] = self.arm.mechanism.upper
        whole[:, :, : rows.shape[2]] = rows
        return whole

    def _mean(self, values: Array) -> Array:
        """Return means over each row's periods: (k * periods, n) become (k, n)."""
        return values.reshape(-1, self.periods, values.shape[1]).mean(axis=1)

    def report(self, log: str) -> ReplayReport:
        """Return the figures so far."""
        position, effort, recorded = self.sums.tolist()
        count = self.samples - 1
        return ReplayReport(
            log=log,
            arm=self.arm.name,
            mode=self.mode,
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


def _periods(settings: ReplaySettings, timestep_s: float) -> int:
    """Compute the physics steps of a sample."""
    periods = 1.0 / (settings.rate_hz * timestep_s) if settings.rate_hz > 0.0 else 0.0
    whole = round(periods) if np.isfinite(periods) else 0
    if not 1 <= whole <= MOST_PERIODS or abs(periods - whole) > 1e-9 * whole:
        raise InputError(
            f"rate: got {settings.rate_hz!r} Hz; allowed: {1.0 / timestep_s:g} Hz divided by a"
            f" whole number up to {MOST_PERIODS}, e.g. 200"
        )
    return whole


def _restart(settings: ReplaySettings) -> int:
    """Compute the rows between two restarts from the recording."""
    if settings.mode not in ("position", "effort"):
        raise InputError(f"mode: got {settings.mode!r}; allowed: position, effort")
    least = 1.0 / settings.rate_hz
    if not np.isfinite(settings.window_s) or settings.window_s < least * (1.0 - 1e-9):
        raise InputError(f"window: got {settings.window_s!r} s; allowed: {least:g} s or more")
    return round(settings.window_s * settings.rate_hz) if settings.mode == "effort" else sys.maxsize
