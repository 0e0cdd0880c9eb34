"""Draw a recording into PNG files, one for each arm, or into one interactive page."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, UnknownNameError
from trocar.outputs import check_file, whole_file
from trocar.plotting import pages
from trocar.plotting.drawing import EFFORT, ERROR, MEASURED, SETPOINT, WARNING, new_figure, png
from trocar.recording import ArmStates, Recorded, open_recording
from trocar.simulation.journal import Entry

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: Most samples of a joint; of longer recordings every n-th is read. Source: our own choice, 60 MB.
MOST_SAMPLES = 300_000
#: Least motion of an arm that is drawn when arms are not named [rad or m]. Source: our own choice;
#: brakes and servos hold to some 1e-5.
RESTS = 1e-3
KINDS = (".png", ".html")
#: Stretches of a thinned curve, and means of a dense one: pixels of a figure's column.
BINS, MEANS = 1500, 450
WIDTH_IN, ROW_IN, HEAD_IN, LONE_ROW_IN = 15.0, 1.75, 1.1, 4.0
#: Half of the least height of an axis in its unit, so that a joint at rest looks at rest. Source:
#: our own choice.
LEAST = 1e-3
#: Stretches of a thinned curve in a page. Source: our own choice; 2 MB for an arm of seven joints.
PAGE_BINS = 4000
#: Most commands and events in a page. Source: our own choice.
MOST_ENTRIES = 500
HELP = (
    "Drag to move in time, turn the wheel to zoom, double-click for the whole recording; values at"
    " the pointer stand above each chart. Steps are held set-points; pale lines are curves that are"
    " too dense to be resolved, below their means."
)
STYLE = """<style>
.joint { display: grid; grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); gap: 0 1rem; }
canvas { width: 100%; height: 150px; cursor: crosshair; }
body { max-width: 1500px; }
</style>"""
HEADS = ("position", "error (set-point - measured)", "effort")


@dataclass(frozen=True)
class Units:
    """Units of a joint's position, error and effort, and their factors from SI."""

    position: str
    error: str
    effort: str
    factors: tuple[float, float, float]

    @property
    def names(self) -> tuple[str, str, str]:
        """Return the units in the order of the factors."""
        return self.position, self.error, self.effort


REVOLUTE = Units("deg", "mrad", "N m", (180.0 / np.pi, 1e3, 1.0))
PRISMATIC = Units("mm", "mm", "N", (1e3, 1e3, 1.0))


def units_of(kind: str) -> Units:
    """Return the units of a kind of joint."""
    return PRISMATIC if kind == "prismatic" else REVOLUTE


@dataclass(frozen=True)
class PlotCurve:
    """One quantity of a joint over time.

    Attributes:
        label, color: of the legend
        values: (k,) [unit of the chart]
        held: whether a value is held until the next, so that the curve is drawn as steps
    """

    label: str
    color: str
    values: Array
    held: bool = False


def curves_of(
    states: ArmStates, joint: int
) -> tuple[list[PlotCurve], list[PlotCurve], list[PlotCurve]]:
    """Return the curves of a joint's position, error and effort, in the units of its kind."""
    factors = units_of(states.arm.kinds[joint]).factors
    position, setpoint = states.position[:, joint], states.setpoint[:, joint]
    return (
        [
            PlotCurve("set-point", SETPOINT, factors[0] * setpoint, held=True),
            PlotCurve("measured", MEASURED, factors[0] * position),
        ],
        [PlotCurve("error", ERROR, factors[1] * (setpoint - position))],
        [PlotCurve("effort", EFFORT, factors[2] * states.effort[:, joint])],
    )


@dataclass(frozen=True)
class PlotReport:
    """The files of `plot`.

    Attributes:
        files: written files
        arms: names of the arms in them
        problem: reason why the recording ends early, "" where it is whole
    """

    files: tuple[str, ...]
    arms: tuple[str, ...]
    problem: str


def plot(
    file: str | Path,
    out: str | Path | None = None,
    arm: str | None = None,
    joint: str | None = None,
    *,
    overwrite: bool = False,
) -> PlotReport:
    """Draw positions, errors and efforts of a recording.

    Args:
        file: the recording
        out: a .png or .html file; the recording's name with .png when omitted. Of several arms
            each PNG has the arm's name at the end of its own
        arm: this arm alone; every arm that moved when omitted
        joint: this joint alone
        overwrite: replace files that exist

    Raises:
        LogError: no recording, or one without states
        UnknownNameError: no such arm or joint
        InputError: another kind of file, or one that exists or cannot be written
        MissingExtraError: PNG, and matplotlib is not installed
    """
    target = Path(out if out is not None else file).expanduser()
    if out is None:
        target = target.with_suffix(".png")
    if target.suffix.lower() not in KINDS:
        raise InputError(f"{target}: got extension {target.suffix!r}; allowed: {', '.join(KINDS)}")
    recorded = open_recording(file)
    if arm is not None and arm not in recorded.arms:
        raise UnknownNameError("arm", arm, recorded.arms, recorded.file)
    chosen = _chosen(recorded, arm, joint)
    files: dict[Path, bytes] = {}
    if target.suffix.lower() == ".html":
        files[target] = page(recorded, chosen).encode()
    else:
        for states, which in chosen:
            name = states.arm.name
            title = f"{name}  -  {Path(recorded.file).name}, rig {recorded.about['rig']}"
            own = target.with_name(f"{target.stem}-{name}{target.suffix}")
            times = warnings_of(recorded, name)
            files[own if len(chosen) > 1 else target] = png(arm_figure(states, which, title, times))
    for path in files:
        check_file(path, overwrite)
    for path, data in files.items():
        with whole_file(path, overwrite) as part:
            part.write_bytes(data)
    arms = tuple(states.arm.name for states, _ in chosen)
    return PlotReport(tuple(map(str, files)), arms, recorded.problem)


def warnings_of(recorded: Recorded, arm: str) -> list[float]:
    """Return the times of an arm's warnings and errors [s]."""
    return [
        e.time
        for e in recorded.entries
        if e.kind == "event" and e.source == arm and e.name in ("warning", "error")
    ]


def _chosen(
    recorded: Recorded, arm: str | None, joint: str | None
) -> list[tuple[ArmStates, list[int]]]:
    """Return the arms to draw with the indices of their joints.

    Raises:
        UnknownNameError: none of them has that joint
    """
    every = max(1, recorded.rows // MOST_SAMPLES)
    moving: list[tuple[ArmStates, list[int]]] = []
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
        moved = any((np.ptp(q, axis=0) > RESTS).any() for q in (states.position, states.setpoint))
        (moving if moved or arm is not None else resting).append((states, which))
    if joint is not None and joint not in joints:
        raise UnknownNameError("joint", joint, joints, recorded.file)
    return moving or resting


def arm_figure(
    states: ArmStates, which: Sequence[int], title: str, warnings: Sequence[float]
) -> Figure:
    """Draw joints of one arm: a row for each, with position, error and effort.

    Held set-points are steps. A curve with more samples than the figure has pixels is its mean,
    over a pale line of its range.

    Args:
        states: the arm over time
        which: indices of the joints
        title: above it all
        warnings: times of warnings and faults [s]

    Raises:
        MissingExtraError: matplotlib is not installed
    """
    height = HEAD_IN + (ROW_IN * len(which) if len(which) > 1 else LONE_ROW_IN)
    figure: Any = new_figure(WIDTH_IN, height, "drawing a recording")  # its stubs are partial
    figure.suptitle(title, fontsize=13, fontweight="bold")
    axes: Any = figure.subplots(len(which), 3, sharex=True, squeeze=False)
    for row, joint in zip(axes, which, strict=True):
        units = units_of(states.arm.kinds[joint])
        for axis, curves, unit in zip(row, curves_of(states, joint), units.names, strict=True):
            for curve in curves:
                _draw(axis, states.time, curve)
            for index, time in enumerate(warnings):
                label = "warning or fault" if index == 0 else None
                axis.axvline(time, color=WARNING, linewidth=0.8, linestyle="--", label=label)
            axis.set_ylabel(f"[{unit}]")
            axis.grid(visible=True, color="#dddddd", linewidth=0.6)
            axis.margins(x=0.0)
            axis.ticklabel_format(axis="y", useOffset=False)
            low, high = axis.get_ylim()
            if high - low < 2.0 * LEAST:
                axis.set_ylim(0.5 * (low + high) - LEAST, 0.5 * (low + high) + LEAST)
        row[0].set_ylabel(f"{states.arm.joints[joint]}\n[{units.position}]", fontweight="bold")
    for axis, head in zip(axes[0], HEADS, strict=True):
        axis.set_title(head, fontsize=11)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    handles = {
        label: handle
        for axis in axes[0]
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=5, frameon=False
    )
    return figure


def _draw(axis: Any, time: Array, curve: PlotCurve) -> None:
    """Draw a curve: steps where values are held, a mean over a pale range where it is dense."""
    style = {"color": curve.color, "linewidth": 1.1}
    if curve.held:
        time, values = steps(time, curve.values)
        kept = thinned(time, values, BINS)
        axis.plot(*kept, **style, drawstyle="steps-post", label=curve.label)
    elif len(time) <= 2 * MEANS:
        axis.plot(time, curve.values, **style, label=curve.label)
    else:
        axis.plot(*thinned(time, curve.values, BINS), color=curve.color, linewidth=0.5, alpha=0.25)
        half = 2 * len(time) // MEANS
        window = np.hanning(2 * half + 1) / half
        mean = np.convolve(np.pad(curve.values, half, mode="edge"), window, "valid")
        axis.plot(*thinned(time, mean, BINS), **style, label=curve.label)


def steps(time: Array, values: Array) -> tuple[Array, Array]:
    """Return the samples of a held curve at which its value changes, and its last."""
    changes = np.flatnonzero(values[1:] != values[:-1]) + 1
    index = np.unique(np.concatenate([[0], changes, [len(values) - 1]]))
    return time[index], values[index]


def thinned(time: Array, values: Array, bins: int) -> tuple[Array, Array]:
    """Return the lowest and the highest point of each stretch of a curve.

    Args:
        time: (k,), rising
        values: (k,)
        bins: largest number of stretches; a curve of up to twice as many points is returned whole
    """
    count = len(time)
    if count <= 2 * bins:
        return time, values
    edges: list[int] = np.linspace(0, count, bins + 1).astype(int).tolist()
    kept = [0, count - 1]
    for begin, end in pairwise(edges):
        part = values[begin:end]
        if np.isnan(part).all():
            kept.append(begin)
        else:
            kept += [begin + int(np.nanargmin(part)), begin + int(np.nanargmax(part))]
    index = np.unique(kept)
    return time[index], values[index]


def page(recorded: Recorded, chosen: Sequence[tuple[ArmStates, list[int]]]) -> str:
    """Return a page of a recording: charts of joints, largest errors and efforts, and commands.

    Args:
        recorded: the recording
        chosen: arms and the indices of their joints
    """
    about = recorded.about
    facts = [
        ("rig", about["rig"]),
        ("simulated", f"{recorded.start:g} to {recorded.end:g} s"),
        ("period", f"{1e3 * recorded.timestep:g} ms, {recorded.rows} states"),
        ("written by", f"trocar {about['trocar']}, MuJoCo {about['mujoco']}"),
    ]
    charts: list[dict[str, Any]] = []
    body = [STYLE, f"<h1>{pages.text(recorded.file)}</h1>"]
    if recorded.problem:
        body.append(f'<p class="note">{pages.text(recorded.problem)}</p>')
    body += [pages.table(("", ""), facts, words=True), f'<p class="quiet">{pages.text(HELP)}</p>']
    for states, which in chosen:
        body += [f"<h2>{pages.text(states.arm.name)}</h2>", _table(states, which)]
        times = warnings_of(recorded, states.arm.name)
        for joint in which:
            more = list(_charts(states, joint, times))
            shown = "".join(f'<canvas data-chart="{len(charts) + k}"></canvas>' for k in range(3))
            body.append(f'<h3>{pages.text(states.arm.joints[joint])}</h3><div class="joint">')
            body.append(f"{shown}</div>")
            charts += more
    script = Path(__file__).with_name("chart.js").read_text(encoding="utf-8")
    body += [*_entries(recorded.entries), f"<script>const CHARTS = {json.dumps(charts)};\n{script}"]
    return pages.document(recorded.file, "".join([*body, "</script>"]))


def _charts(states: ArmStates, joint: int, warnings: list[float]) -> Iterator[dict[str, Any]]:
    """Yield the data of a joint's three charts."""
    units = units_of(states.arm.kinds[joint])
    for head, unit, curves in zip(HEADS, units.names, curves_of(states, joint), strict=True):
        lines: list[dict[str, object]] = []
        for curve in curves:
            points = states.time, curve.values
            if curve.held:
                points = steps(*points)
            t, v = (_base64(x) for x in thinned(*points, PAGE_BINS))
            lines.append(
                {"label": curve.label, "color": curve.color, "held": curve.held, "t": t, "v": v}
            )
        yield {"title": head, "unit": unit, "curves": lines, "warnings": warnings}


def _base64(values: Array) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode()


def _table(states: ArmStates, which: Sequence[int]) -> str:
    """Return errors and efforts of each joint, in numbers."""
    rows: list[tuple[str, ...]] = []
    for joint in which:
        units = units_of(states.arm.kinds[joint])
        _, (error,), (effort,) = curves_of(states, joint)
        rows.append(
            (
                states.arm.joints[joint],
                f"{np.sqrt(np.mean(error.values**2)):.3f} {units.error}",
                f"{np.max(np.abs(error.values)):.3f} {units.error}",
                f"{np.max(np.abs(effort.values)):.3f} {units.effort}",
            )
        )
    return pages.table(("joint", "error, RMS", "error, largest", "effort, largest"), rows)


def _entries(entries: Sequence[Entry]) -> Iterator[str]:
    """Yield commands and events, folded away."""
    rows: list[tuple[str, ...]] = []
    for e in entries[:MOST_ENTRIES]:
        values = ", ".join(f"{k} = {v}" for k, v in e.values.items())
        values = values if len(values) <= 160 else f"{values[:157]}..."
        rows.append((f"{e.time:.3f} s", e.kind, e.source, e.name, values))
    yield f"<h2>Commands and events</h2><details><summary>{len(entries)}</summary>"
    yield pages.table(("time", "kind", "source", "name", "values"), rows, words=True)
    more = len(entries) - MOST_ENTRIES
    yield f"<p>and {more} more</p></details>" if more > 0 else "</details>"
