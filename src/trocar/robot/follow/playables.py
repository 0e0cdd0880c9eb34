"""Recordings as recordings: any moment of them is shown in a world, for `trocar view`."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import RigDescription
from trocar.errors import DivergedError
from trocar.recording import open_recording
from trocar.recording.layout import Layout, joint_values, layout_of, present_row
from trocar.recording.mcap_file import single
from trocar.recording.reader import Recorded
from trocar.robot.follow.reproduce import (
    check_repeatable,
    recorded_world,
    repeat_command,
    step_to,
    version_warnings,
)
from trocar.robot.recordings import ArmMotion
from trocar.simulation import World
from trocar.simulation.journal import Entry, apply_command
from trocar.simulation.world import State

Array = NDArray[np.float64]

#: Shortest time between two saved states [s], and the largest number of these, from which the time
#: of longer recordings follows. Source: our own choice; a state of the full cart has 18 kB
#: (measured).
SAVED_S, MOST_SAVED = 0.5, 600
#: Steps between two looks at the wall clock. Source: our own choice; 2 ms of the full cart.
PIECE = 20
#: Steps of a row of a table of set-points, when omitted. Source: `World.play`.
EVERY = 5
#: Largest number of rows of an arm that are kept of a log; of longer ones every n-th. Source: our
#: own choice: three minutes at 200 Hz, 2 MB.
MOST_ROWS = 36_000


@dataclass(frozen=True)
class _Saved:
    """A state from which the recording goes on.

    Attributes:
        state: of the world
        tools: {arm: tool} mounted then
        entry: the command that comes next
    """

    state: State
    tools: Mapping[str, str]
    entry: int


class RepeatedRecording:
    """A recording of trocar's, repeated: the commands that it holds act in the recorded world.

    States are saved on the way, so that moments of before are soon shown again; they are compared
    with the file's joint positions, and `notes` has the first difference.

    Args:
        file: a recording
        rig: the recorded rig, if it is no longer found under the recorded name or path

    Attributes:
        world: the recorded world, at the beginning of the recording
        name, start_s, end_s, period_s, continues, notes: as of a `Playable`

    Raises:
        LogError: no recording, or one that cannot be repeated; says why
        InputError: another rig than the recorded one
    """

    continues = True

    def __init__(self, file: str | Path, rig: RigDescription | str | Path | None = None) -> None:
        recorded = open_recording(file)
        self.name, self.start_s, self.period_s = recorded.file, recorded.start, recorded.timestep
        self._last = recorded.rows - 1
        self._every = max(round(SAVED_S / self.period_s), -(-recorded.rows // MOST_SAVED))
        self.world = recorded_world(recorded, rig)
        for entry in recorded.past:
            repeat_command(self.world, entry, recorded.file)
        step_to(self.world, int(recorded.about["start_period"]))
        self._entries = [entry for entry in recorded.entries if entry.kind == "command"]
        for entry in self._entries:
            check_repeatable(entry, recorded.file)
        self._positions = dict(self._recorded_positions(recorded))
        self._labels = {
            number: [f"{arm.name}/{joint}" for arm in arms for joint in arm.joints]
            for number, arms in recorded.layouts.items()
        }
        self._scripted = any(prop.script for prop in self.world.rig.objects)
        self._saved: dict[int, _Saved] = {}
        self._row, self._next, self._lost = 0, 0, False
        self._layout: Layout | None = None
        self._warnings = (*version_warnings(recorded), *filter(None, [recorded.problem]))
        self._difference = ""
        self._reached()

    @property
    def end_s(self) -> float:
        """Time of the last moment [s]."""
        return self.start_s + self._last * self.period_s

    @property
    def notes(self) -> tuple[str, ...]:
        """Differences of versions, where the file ends early, the first difference in motion."""
        return (*self._warnings, *filter(None, [self._difference]))

    def nearest(self, time_s: float) -> float:
        """Return the time of the moment nearest to a time [s]."""
        return self.start_s + self._row_at(time_s) * self.period_s

    def forget(self) -> None:
        """Note that the world was moved otherwise."""
        self._lost = True

    def show(self, world: World, moment_s: float, budget_s: float) -> float:  # noqa: ARG002  as of a `Playable`
        """Repeat the recording up to a moment, from the last saved state before it."""
        end = time.perf_counter() + budget_s
        row = self._row_at(moment_s)
        known = 0 if self._scripted else max(one for one in self._saved if one <= row)
        if self._lost or row < self._row or known > self._row:
            self._restore(known)
        while self._row < row and time.perf_counter() < end:
            self._advance(row)
        return self.start_s + self._row * self.period_s

    def _row_at(self, time_s: float) -> int:
        return min(max(round((time_s - self.start_s) / self.period_s), 0), self._last)

    def _advance(self, row: int) -> None:
        """Apply the next command, or step a piece of the way to it."""
        world, before = self.world, self.world.periods
        entry = self._entries[self._next] if self._next < len(self._entries) else None
        most = min(row - self._row, self._every - self._row % self._every)
        try:
            if entry is None or entry.period > before:
                due = most if entry is None else entry.period - before
                world.step(min(due, most, PIECE))
            else:
                done = before - entry.period
                whole = _table_rows(entry) * entry.values.get("every", EVERY)
                played = done < whole and self._repeat(_part(entry, done, most))
                if not played:
                    self._next += 1
                if not whole:
                    self._repeat(entry)
                if entry.name in ("reset", "load"):  # sets the steps back; no row is recorded
                    return
        except DivergedError as error:
            self._row = self._last = min(self._row + max(world.periods - before, 0), self._last)
            self._difference = self._difference or f"it ends there: {error}"
            return
        self._row += world.periods - before
        if self._row % self._every == 0:
            self._reached()

    def _repeat(self, entry: Entry) -> bool:
        """Apply a command; return False when it was rejected, as when it was recorded."""
        try:
            apply_command(self.world, entry)
        except DivergedError:
            raise
        except Exception:  # noqa: BLE001  part of the recording, or the motion differs
            return False
        return True

    def _reached(self) -> None:
        """Save the state, unless it is, and compare it with the file's."""
        row, world = self._row, self.world
        if row in self._saved:
            return
        tools = {name: arm.description.tool or "none" for name, arm in world.arms.items()}
        self._saved[row] = _Saved(world.save(), tools, self._next)
        expected = self._positions.pop(row, None)
        if expected is None or self._difference:
            return
        if self._layout is None or self._layout.model is not world.mj_model:
            self._layout = layout_of(world, 0)
        number, there = expected
        rows = present_row(world, self._layout, row)
        here = single(joint_values(rows))[0, :, 0]
        if here.shape == there.shape and np.array_equal(here, there):
            return
        labels = self._labels[number]
        at = self.start_s + row * self.period_s
        self._difference = f"repeated here, the motion differs from the recorded one at {at:.3f} s"
        if here.shape == there.shape:
            off = np.abs(here.astype(float) - there)
            worst = int(np.argmax(off))
            self._difference += f": by {off[worst]:.3g} rad or m in {labels[worst]}"

    def _restore(self, row: int) -> None:
        """Go back to a saved state, with the tools that were mounted then."""
        world = self.world
        if self._scripted:  # a state lacks what scripts of objects keep
            world.reset()
        saved = self._saved[row]
        for name, tool in saved.tools.items():
            if (world.arm(name).description.tool or "none") != tool:
                world.exchange_tool(name, tool)
        world.load(saved.state)
        self._row, self._next, self._lost = row, saved.entry, False

    def _recorded_positions(self, recorded: Recorded) -> Iterator[tuple[int, tuple[int, Any]]]:
        """Yield the file's joint positions at the rows of saved states, with their layout."""
        for block in recorded.blocks():
            for k in range(-block.first % self._every, len(block.times), self._every):
                yield block.first + k, (block.layout, block.values[0, :, k].copy())


def _table_rows(entry: Entry) -> int:
    """Return the number of rows of the table that a command plays, 0 for other commands."""
    tables = entry.values.get("positions")
    if entry.name != "play" or not isinstance(tables, Mapping) or not tables:
        return 0
    return min(len(table) for table in cast("Mapping[str, Array]", tables).values())


def _part(entry: Entry, done: int, most: int) -> Entry:
    """Return the part of a table of set-points that comes next: one row, or the rest of one.

    Args:
        entry: the command that plays the table
        done: physics steps of it that were played
        most: physics steps to play
    """
    every: int = entry.values.get("every", EVERY)
    row = done // every
    cut: dict[str, object] = {
        name: {arm: table[row : row + 1] for arm, table in one.items()}
        for name in ("positions", "velocities", "efforts")
        if (one := cast("Mapping[str, Array] | None", entry.values.get(name)))
    }
    steps = min(every - done % every, most)
    return replace(entry, values={**cut, "every": steps, "record": False})


class PlayedLog:
    """Logs of real arms: their joints are put where the log has them.

    Joints that were not recorded stay at their upper limit, as a gripper that is open; positions
    beyond a joint's limit are shown at it.

    Args:
        world: with the arms
        motions: {arm of the world: its motion}

    Attributes:
        world: as given
        name, start_s, end_s, period_s, continues, notes: as of a `Playable`

    """

    continues = False

    def __init__(self, world: World, motions: Mapping[str, ArmMotion]) -> None:
        self.world = world
        first = next(iter(motions.values()))
        self.name = first.file
        self.start_s = float(min(motion.times[0] for motion in motions.values()))
        self.end_s = float(max(motion.times[-1] for motion in motions.values()))
        self._tracks: dict[str, tuple[Array, Array]] = {}
        beyond = 0
        for name, motion in motions.items():
            every = -(-len(motion.times) // MOST_ROWS)
            arm = world.arm(name)
            lower, upper = arm.joints.lower, arm.joints.upper
            places = np.tile(upper, (len(motion.times[::every]), 1))
            recorded = motion.rows[::every, 0]
            places[:, : recorded.shape[1]] = recorded
            inside = np.clip(places, lower, upper)
            beyond += int((inside != places).any(axis=1).sum())
            self._tracks[name] = motion.times[::every], inside
            if arm.description.type == "SUJ":
                arm.brakes.release()
            arm.joints.set_mode("set")
        self._times = np.unique(np.concatenate([times for times, _ in self._tracks.values()]))
        steps = np.diff(self._times)
        self.period_s = float(np.median(steps)) if len(steps) else self.end_s - self.start_s
        clipped = f"{beyond} rows beyond a joint's limit are shown at it"
        self.notes = (
            *(motion.understood() for motion in motions.values()),
            *((clipped,) if beyond else ()),
        )

    def nearest(self, time_s: float) -> float:
        """Return the time of the moment nearest to a time [s]."""
        after = int(np.searchsorted(self._times, time_s))
        near = self._times[max(after - 1, 0) : after + 1]
        return float(near[np.argmin(np.abs(near - time_s))])

    def forget(self) -> None:
        """Note that the world was moved otherwise: every moment is put whole."""

    def show(self, world: World, moment_s: float, budget_s: float) -> float:  # noqa: ARG002  as of a `Playable`
        """Put every arm at its last row until a moment, at its first one before that."""
        for name, (times, places) in self._tracks.items():
            row = max(int(np.searchsorted(times, moment_s, side="right")) - 1, 0)
            world.set_state(name, places[row])
            gripper = world.arm(name).gripper
            if gripper is not None:
                gripper.squeeze_to(float(places[row, -1]))
        return moment_s
