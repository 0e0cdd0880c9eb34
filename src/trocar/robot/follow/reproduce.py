"""Repeat a recording of a simulated world: same commands, and the same motion to the last bit."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trocar import __version__
from trocar.descriptions import RigDescription, load_rig
from trocar.errors import DivergedError, LogError
from trocar.recording import Recorded, open_recording
from trocar.recording.entries import Unknown
from trocar.recording.layout import QUANTITIES, Rows, joint_values
from trocar.recording.mcap_file import digest, single
from trocar.recording.metadata import rig_fingerprint, versions
from trocar.recording.recorder import Entries, StateSampler
from trocar.simulation import World
from trocar.simulation.journal import Entry, apply_command

#: Periods between two calls of `progress`. Source: our own choice.
PIECE_PERIODS = 1000


@dataclass(frozen=True)
class Difference:
    """First difference of a repeated motion from the recorded one.

    Attributes:
        time: simulated time of the first block that differs [s]
        joint: with the largest difference of all, "ARM/joint"
        quantity: "position", "velocity", "effort" or "setpoint"
        largest: that difference [rad or m, per s, N m or N]
    """

    time: float
    joint: str
    quantity: str
    largest: float


@dataclass(frozen=True)
class RepeatReport:
    """Result of repeating a recording.

    Attributes:
        file, rig: what was repeated
        simulated_s: length of the recording [s]
        periods: physics periods that were compared
        commands: how many were repeated
        identical: whether every period's state is the recorded one to the last bit
        digest: fingerprint of all recorded states
        difference: where and how far the motion differs; None when identical
        warnings: versions that differ from those of the recording, and may explain a difference
        problem: why the file ends early, "" where it is whole
    """

    file: str
    rig: str
    simulated_s: float
    periods: int
    commands: int
    identical: bool
    digest: str
    difference: Difference | None
    warnings: tuple[str, ...]
    problem: str


def repeat(
    file: str | Path,
    rig: RigDescription | str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RepeatReport:
    """Build the recorded world again, repeat its commands, and compare every period's state.

    Args:
        file: a recording (`trocar.recording.record`, `trocar sim --record`)
        rig: the recorded rig, if it is no longer found under the recorded name or path
        progress: called with (periods done, periods) now and then

    Raises:
        LogError: no recording, or one that cannot be repeated; says why
        InputError: another rig than the recorded one
    """
    recorded = open_recording(file)
    world = recorded_world(recorded, rig)
    for entry in recorded.past:
        repeat_command(world, entry, str(file))
    step_to(world, int(recorded.about["start_period"]))
    comparison = _Comparison(recorded)
    sampler = StateSampler(world, comparison.take)
    commands = 0
    try:
        for entry in recorded.entries:
            if entry.kind == "command":
                repeat_command(world, entry, str(file))
                commands += 1
                if progress is not None:
                    progress(min(sampler.count, recorded.rows), recorded.rows)
        while sampler.count < recorded.rows:
            world.step(min(PIECE_PERIODS, recorded.rows - sampler.count))
            if progress is not None:
                progress(sampler.count, recorded.rows)
    except DivergedError:
        pass  # as it did when it was recorded, or the comparison finds a difference
    finally:
        sampler.stop()
    return comparison.report(commands)


def recorded_world(recorded: Recorded, rig: RigDescription | str | Path | None) -> World:
    """Build the world that was recorded.

    Raises:
        LogError: the recording cannot be repeated, or is of another rig
    """
    about, file = recorded.about, recorded.file
    if about["repeatable"] != "yes":
        raise LogError(file, f"cannot be repeated: {about['repeatable']}")
    source = rig if rig is not None else about["rig_source"]
    if isinstance(source, str) and not source:
        raise LogError(
            file,
            f"its rig {about['rig']!r} was built in Python, not read from a file; pass it:"
            " repeat(file, rig=...)",
        )
    arguments = recorded.arguments()
    arguments.setdefault("dynamics", "cad")  # the only ones before they were an argument
    strange = set(arguments) - set(inspect.signature(World.__init__).parameters)
    if strange:
        raise LogError(
            file,
            f"trocar {about['trocar']} recorded world options {', '.join(sorted(strange))} that"
            f" trocar {__version__} lacks",
        )
    given = isinstance(source, RigDescription)
    described = source if given else load_rig(source)
    # another rig may lack an arm, or carry its own overlay: the comparison below says so
    open_to = {p.name for p in described.arms if not given or p.arm.overlay is None}
    overlays = {arm: known for arm, known in recorded.overlays().items() if arm in open_to}
    world = World(described, calibration=overlays or None, **arguments)
    found = rig_fingerprint(world.rig)
    if found != about["rig_fingerprint"]:
        raise LogError(
            file,
            f"is a recording of rig {about['rig']!r} with the description"
            f" {about['rig_fingerprint'][:12]} (trocar {about['trocar']}); here rig"
            f" {world.rig.name!r} has {found[:12]}: its motion cannot be repeated",
        )
    return world


def repeat_command(world: World, entry: Entry, file: str) -> None:
    """Step to a command and apply it; errors of the command are part of the recording."""
    check_repeatable(entry, file)
    step_to(world, entry.period)
    with contextlib.suppress(Exception):  # it was raised then, too, or the motion differs
        apply_command(world, entry)


def version_warnings(recorded: Recorded) -> tuple[str, ...]:
    """List the versions that differ from those of the recording, and may explain a difference."""
    now = versions()
    return tuple(
        f"recorded with {name} {value}, repeated with {now[name]}"
        for name, value in recorded.about.items()
        if name in now and now[name] != value
    )


def check_repeatable(entry: Entry, file: str) -> None:
    """Check that the arguments of a command could be recorded.

    Raises:
        LogError: they could not
    """
    unknown = [f"{k} = {v}" for k, v in entry.values.items() if isinstance(v, Unknown)]
    if unknown:
        raise LogError(
            file,
            f"cannot be repeated: the command {entry.source} {entry.name} at {entry.time:g} s"
            f" has arguments that cannot be recorded: {', '.join(unknown)}",
        )


def step_to(world: World, period: int) -> None:
    """Step to a command; where it diverges just before, it did so when it was recorded."""
    if world.periods < period:
        try:
            world.step(period - world.periods)
        except DivergedError:
            if world.periods < period:
                raise


class _Comparison:
    """Compares blocks of the repeated motion with the recorded ones."""

    def __init__(self, recorded: Recorded) -> None:
        self.recorded, self.periods = recorded, 0
        self.differs_from: float | None = None
        self.worst: tuple[float, str, str] = (0.0, "", "")
        self._digest = hashlib.blake2b(digest_size=16)
        self._blocks = iter(recorded.blocks())

    def take(self, block: Rows, _entries: Entries) -> None:
        """Compare a block with the recorded one of the same rows."""
        expected = next(self._blocks, None) if len(block.states) else None
        if expected is None:
            return
        count = len(expected.times)
        self._digest.update(expected.digest.encode())
        self.periods += count
        same = block.first == expected.first and len(block.states) >= count
        if same and digest(block.states[:count]) == expected.digest:
            return
        if self.differs_from is None:
            self.differs_from = float(expected.times[0])
        count = min(count, len(block.states))
        values = single(joint_values(block))[:, :, :count]
        if values.shape[:2] != expected.values.shape[:2]:
            self.worst = (np.inf, "the number of joints", "")
            return
        off = np.abs(values.astype(float) - expected.values[:, :, :count])
        if off.size and not np.nanmax(off) <= self.worst[0]:
            quantity, joint, _ = np.unravel_index(int(np.nanargmax(off)), off.shape)
            names = [f"{a.name}/{j}" for a in block.layout.arms for j in a.joints]
            self.worst = (float(np.nanmax(off)), names[int(joint)], QUANTITIES[int(quantity)])
        elif not self.worst[1] and block.layout.objects:
            self.worst = (0.0, "no joint: the objects alone differ", "state")

    def report(self, commands: int) -> RepeatReport:
        """Return the result."""
        recorded = self.recorded
        same = self.differs_from is None and self.periods == recorded.rows
        largest, joint, quantity = self.worst
        began = recorded.end if self.differs_from is None else self.differs_from
        return RepeatReport(
            file=recorded.file,
            rig=recorded.about["rig"],
            simulated_s=recorded.end - recorded.start,
            periods=self.periods,
            commands=commands,
            identical=same,
            digest=self._digest.hexdigest(),
            difference=None if same else Difference(began, joint, quantity, largest),
            warnings=version_warnings(recorded),
            problem=recorded.problem,
        )
