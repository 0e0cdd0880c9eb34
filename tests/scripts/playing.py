"""Run the text of a script over a stepped simulation."""

from __future__ import annotations

from pathlib import Path
from textwrap import dedent

from trocar.scripts import Outcome, Stepped, run_script
from trocar.simulation import World
from trocar.teleoperation import components

RATE_HZ = 100.0


def play(
    folder: Path, text: str, rig: str = "psm", arguments: tuple[str, ...] = (),
    timeout_s: float | None = 120.0,
) -> Outcome:  # fmt: skip
    """Run a script in simulated time; what it prints goes where pytest has it."""
    script = folder / "script.py"
    script.write_text(dedent(text), encoding="utf-8")
    flow = Stepped(World(rig), timeout_s, components, rate_hz=RATE_HZ)
    return run_script(script, arguments, flow, timeout_s)
