"""Draw a recording into PNG files, one arm each, or into one page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trocar.apps.drawing import png, svg
from trocar.apps.plotting.figure import arm_figure
from trocar.apps.plotting.page import Section, page
from trocar.errors import InputError, UnknownNameError
from trocar.recording import ArmStates, Recorded, open_recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Samples of a joint that are read; of longer recordings every n-th. Source: our own choice, 60 MB.
MOST_SAMPLES = 300_000
#: An arm whose joints all moved less is left out when arms are not named [rad or m].
#: Source: our own choice; brakes and servos hold to some 1e-5.
RESTS = 1e-3
KINDS = (".png", ".html")


@dataclass(frozen=True)
class PlotReport:
    """What was drawn.

    Attributes:
        files: what was written
        arms: whose figures these are
        problem: why the recording ends early, "" where it is whole
    """

    files: tuple[str, ...]
    arms: tuple[str, ...]
    problem: str


def plot(
    file: str | Path,
    out: str | Path | None = None,
    arm: str | None = None,
    joint: str | None = None,
) -> PlotReport:
    """Draw positions, errors and efforts of a recording, a figure per arm.

    Args:
        file: the recording
        out: a .png or .html file; the recording's name with .png when omitted. Of several arms
            each PNG has the arm's name at the end of its own
        arm: this arm alone; every arm that moved when omitted
        joint: this joint alone

    Raises:
        LogError: no recording, or one without states
        UnknownNameError: no such arm or joint
        InputError: another kind of file, or one that cannot be written
        MissingExtraError: matplotlib is not installed
    """
    target = Path(out).expanduser() if out is not None else Path(file).expanduser()
    if out is None:
        target = target.with_suffix(".png")
    if target.suffix.lower() not in KINDS:
        raise InputError(f"{target}: got the ending {target.suffix!r}; allowed: {', '.join(KINDS)}")
    recorded = open_recording(file)
    if arm is not None and arm not in recorded.arms:
        raise UnknownNameError("arm", arm, recorded.arms, recorded.file)
    chosen = _chosen(recorded, arm, joint)
    if target.suffix.lower() == ".html":
        sections = [
            Section(states, which, svg(_figure(recorded, states, which)))
            for states, which in chosen
        ]
        _write(target, page(recorded, sections).encode())
        files = [target]
    else:
        files = []
        for states, which in chosen:
            name = f"{target.stem}-{states.arm.name}{target.suffix}"
            files.append(target.with_name(name) if len(chosen) > 1 else target)
            _write(files[-1], png(_figure(recorded, states, which)))
    arms = tuple(states.arm.name for states, _ in chosen)
    return PlotReport(tuple(map(str, files)), arms, recorded.problem)


def _chosen(
    recorded: Recorded, arm: str | None, joint: str | None
) -> list[tuple[ArmStates, list[int]]]:
    """Return the arms that are drawn and their joints.

    Raises:
        UnknownNameError: none of them has that joint
    """
    every = max(1, recorded.rows // MOST_SAMPLES)
    found: list[tuple[ArmStates, list[int]]] = []
    resting: list[tuple[ArmStates, list[int]]] = []
    joints: dict[str, None] = {}
    for name in recorded.arms if arm is None else (arm,):
        columns = recorded.columns(name)
        if columns is None:
            continue
        joints |= dict.fromkeys(columns.joints)
        which = [k for k, j in enumerate(columns.joints) if joint in (None, j)]
        if not which:
            continue
        states = recorded.states(columns, every)
        shown = arm is not None or _moves(states)
        (found if shown else resting).append((states, which))
    if joint is not None and joint not in joints:
        raise UnknownNameError("joint", joint, joints, recorded.file)
    return found or resting


def _moves(states: ArmStates) -> bool:
    """Tell whether any joint, or its set-point, moved."""
    return any(
        float(np.ptp(values[:, joint])) > RESTS
        for values in (states.position, states.setpoint)
        for joint in range(values.shape[1])
    )


def _figure(recorded: Recorded, states: ArmStates, which: Sequence[int]) -> Figure:
    name = states.arm.name
    title = f"{name}  -  {Path(recorded.file).name}, rig {recorded.about['rig']}"
    times = [
        e.time
        for e in recorded.entries
        if e.kind == "event" and e.source == name and e.name in ("warning", "error")
    ]
    return arm_figure(states, which, title, times)


def _write(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
