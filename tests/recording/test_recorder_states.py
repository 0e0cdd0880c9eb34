"""Whatever is done to a world, what is read from its recording is what it did."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import (
    RuleBasedStateMachine,
    precondition,
    rule,
    run_state_machine_as_test,
)
from numpy.typing import NDArray

from trocar.errors import LogError
from trocar.recording import Recorder, open_recording, record
from trocar.simulation import World
from trocar.simulation.journal import Entry
from trocar.simulation.world import State

mcap_reader = pytest.importorskip("mcap.reader")
Array = NDArray[np.float64]

TOOLS = ("LARGE_NEEDLE_DRIVER:400006", "PROGRASP_FORCEPS:400093")
#: Steps that a program may lose when it is killed [s]. Source: docs/recording.md, Failures.
LOST_S = 1.0


class RecorderMachine(RuleBasedStateMachine):
    """A world with a witness of its own, and a recorder that comes and goes."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="trocar-"))
        self.world = World("psm")
        self.arm = self.world.arm("PSM1")
        self.recorder: Recorder | None = None
        self.states: list[State] = []
        self.files = 0
        self.rows: list[tuple[tuple[str, ...], Array]] = []
        self.entries: list[tuple[str, str]] = []
        self.world.observe(self.note)
        self.world.listen(self.hear)
        self.start()

    def teardown(self) -> None:
        """End the recording, and check it once more."""
        if self.recorder is not None:
            self.stop()
        shutil.rmtree(self.folder)

    def note(self) -> None:
        """Keep what a row of the recording must be: position and set-point of each joint."""
        q, *_ = self.arm.joints.readings()
        self.rows.append(
            (self.arm.joints.names, np.array([q, self.arm.runtime.snapshot(None).setpoint]))
        )

    def hear(self, entry: Entry) -> None:
        """Keep what the journal has."""
        self.entries.append((entry.kind, entry.name))

    @rule()
    @precondition(lambda self: self.recorder is None)
    def start(self) -> None:
        """Record into a new file."""
        self.files += 1
        self.file = self.folder / f"{self.files}.mcap"
        self.rows, self.entries = [], []
        self.note()
        self.recorder = record(self.world, self.file)

    @rule(steps=st.integers(1, 450))
    def step(self, steps: int) -> None:
        """Let time pass."""
        self.world.step(steps)

    @rule(yaw=st.floats(-0.5, 0.5), depth=st.floats(0.05, 0.2))
    def move(self, yaw: float, depth: float) -> None:
        """Send the arm somewhere."""
        self.arm.move_jp([yaw, 0.1, depth, 0.0, 0.0, 0.0])

    @rule()
    def reset(self) -> None:
        """Start again at time 0."""
        self.world.reset()

    @rule()
    def save(self) -> None:
        """Keep a state."""
        self.states.append(self.world.save())

    @rule(which=st.integers(0, 9))
    @precondition(lambda self: any(s.signature == self.world.signature for s in self.states))
    def load(self, which: int) -> None:
        """Go back to a state."""
        known = [s for s in self.states if s.signature == self.world.signature]
        self.world.load(known[which % len(known)])

    @rule(tool=st.sampled_from(TOOLS))
    def exchange(self, tool: str) -> None:
        """Change the model."""
        self.world.exchange_tool("PSM1", tool)

    @rule()
    @precondition(lambda self: self.recorder is not None)
    def stop(self) -> None:
        """End the recording: it is whole, and standard tools read it."""
        assert self.recorder is not None
        self.recorder.stop()
        self.recorder = None
        assert self.read(self.file, whole=True) == len(self.rows)
        with self.file.open("rb") as stream:
            reader = mcap_reader.SeekingReader(stream)
            assert (
                sum(1 for _ in reader.iter_messages())
                == reader.get_summary().statistics.message_count
            )

    @rule()
    @precondition(lambda self: self.recorder is not None)
    def kill(self) -> None:
        """Read the file of a program that is killed now: its last second may be missing."""
        killed = self.folder / "killed.mcap"
        shutil.copyfile(self.file, killed)
        assert self.read(killed) >= len(self.rows) - LOST_S / self.world.timestep

    @rule(share=st.floats(0.0, 1.0))
    def truncate(self, share: float) -> None:
        """Read a file that breaks off anywhere."""
        cut = self.folder / "cut.mcap"
        data = self.file.read_bytes()
        cut.write_bytes(data[: round(share * len(data))])
        self.read(cut)

    def read(self, file: Path, whole: bool = False) -> int:
        """Compare a file with what was seen; return how many rows it has."""
        try:
            recorded = open_recording(file)
        except LogError:  # nothing was written yet
            assert not whole
            return 0
        assert not (whole and recorded.problem)
        at = 0
        for block in recorded.blocks():
            (arm,) = recorded.layouts[block.layout]
            seen = self.rows[at : at + len(block.times)]
            assert block.first == at
            assert {names for names, _ in seen} == {arm.joints}
            got = block.values[[0, 3]][:, arm.columns]
            expected = np.array([values for _, values in seen]).transpose(1, 2, 0)
            # float32 keeps seven digits
            np.testing.assert_allclose(got, expected, rtol=2e-7, atol=1e-7)
            at += len(block.times)
        assert at == recorded.rows
        told = [(entry.kind, entry.name) for entry in recorded.entries]
        assert told == self.entries[: len(told)]
        assert not whole or told == self.entries
        return at


def run(examples: int, steps: int, derandomize: bool) -> None:
    run_state_machine_as_test(
        RecorderMachine,
        settings=settings(
            max_examples=examples,
            stateful_step_count=steps,
            derandomize=derandomize,
            deadline=None,
            database=None,
            suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
        ),
    )


def test_what_is_read_is_what_was_recorded() -> None:
    run(2, 12, derandomize=True)


@pytest.mark.slow
def test_what_is_read_is_what_was_recorded_at_length() -> None:
    run(30, 40, derandomize=False)
