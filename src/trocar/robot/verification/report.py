"""One page of a verification: tables, plots, sources, and the commands that measure it again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trocar import __version__
from trocar.descriptions.paper import TABLE6_SPREAD_M, TABLE7
from trocar.plotting import pages
from trocar.plotting.drawing import EFFORT, ERROR, MEASURED, SETPOINT, new_figure, svg
from trocar.plotting.pages import Cell
from trocar.robot.verification.figures import ReportPart, figure_rows
from trocar.robot.verification.linkage import Fold
from trocar.robot.verification.rcm import TOLD as RUNS
from trocar.robot.verification.rcm import Cloud
from trocar.robot.verification.tracking import TOLD as GAINS
from trocar.robot.verification.tracking import TrackedJoints
from trocar.robot.verification.verify import Verification

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing


PURPOSE = "drawing a report"
HARDWARE, THEIRS, OURS = SETPOINT, MEASURED, EFFORT
GRID = {"color": "#e3e8ed", "linewidth": 0.7}
#: Samples of a curve per drawn point. Source: our own choice; 50 Hz.
DRAWN = 4
#: Largest number of dots in a drawing. Source: our own choice; a page of less than 2 MB.
MOST_DOTS = 500
PLANES = ((0, 1), (0, 2), (1, 2))


def figure10(found: TrackedJoints) -> Drawing:
    """Draw commanded and actual positions left and the error right, a row per joint."""
    figure: Any = new_figure(10.5, 1.45 * len(found.joints) + 0.8, PURPOSE)
    axes: Any = figure.subplots(len(found.joints), 2, sharex=True, squeeze=False)
    kept = slice(None, None, DRAWN)
    for index, (joint, kind) in enumerate(zip(found.joints, found.kinds, strict=True)):
        slides = kind == "prismatic"
        left, right = axes[index]
        factor = 1e3 if slides else 180.0 / np.pi
        left.plot(found.time[kept], factor * found.commanded[kept, index], color=MEASURED,
                  linewidth=2.4, label="commanded")  # fmt: skip
        left.plot(found.time[kept], factor * found.actual[kept, index], color=SETPOINT,
                  linewidth=1.2, linestyle=(0, (4, 2)), label="actual")  # fmt: skip
        right.plot(found.time[kept], 1e3 * found.error[kept, index], color=ERROR, linewidth=1.2,
                   label="error")  # fmt: skip
        left.set_ylabel(f"{joint}\n[{'mm' if slides else 'deg'}]")
        right.set_ylabel("[mm]" if slides else "[mrad]")
        for axis in (left, right):
            _plain(axis)
            axis.margins(x=0.0)
    axes[0][0].set_title("commanded and actual", fontsize=10)
    axes[0][1].set_title("error (actual - commanded)", fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    return figure


def figure9(kind: str, clouds: Sequence[Cloud], compared: bool) -> Drawing:
    """Draw the remote centre from three sides: beside the paper's in mm, and ours alone in um."""
    beside = compared and kind in TABLE7
    figure: Any = new_figure(10.5, 7.2 if beside else 3.9, PURPOSE)
    axes: Any = figure.subplots(2 if beside else 1, 3, squeeze=False)
    if beside:
        for axis, plane in zip(axes[0], PLANES, strict=True):
            _beside_the_paper(axis, kind, clouds[-1], plane)
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    drawn = [_ours_alone(axis, clouds[-1], p) for axis, p in zip(axes[-1], PLANES, strict=True)]
    figure.colorbar(drawn[0], ax=list(axes[-1]), label="pitch [deg]", pad=0.02)
    return figure


def _beside_the_paper(axis: Any, kind: str, cloud: Cloud, plane: tuple[int, int]) -> None:
    """Draw positions with the RMS of their clouds as bars, in mm."""
    i, j = plane
    rows = zip(("hardware", "paper's simulation"), TABLE7[kind], (HARDWARE, THEIRS), strict=True)
    for label, row, colour in rows:
        at, rms = 1e3 * np.array(row.position), 1e3 * np.array(row.rms)
        axis.errorbar(at[i], at[j], xerr=rms[i], yerr=rms[j], fmt="o", color=colour, capsize=3,
                      label=f"{label}, bars: RMS")  # fmt: skip
    points = 1e3 * cloud.points[:: max(1, len(cloud.points) // MOST_DOTS)]
    axis.plot(points[:, i], points[:, j], ".", color=OURS, markersize=2)
    axis.plot(*(1e3 * cloud.centre[[i, j]]), "D", color=OURS, markersize=7, label="ours, its cloud")
    axis.set_xlabel(f"{'XYZ'[i]} [mm]")
    axis.set_ylabel(f"{'XYZ'[j]} [mm]")
    axis.set_aspect("equal", adjustable="datalim")
    axis.margins(0.2)
    _plain(axis)


def _ours_alone(axis: Any, cloud: Cloud, plane: tuple[int, int]) -> Any:
    """Draw every estimate about their centre, its colour the pitch."""
    i, j = plane
    every = max(1, len(cloud.points) // MOST_DOTS)
    off = (cloud.points - cloud.centre)[::every]
    most = float(np.abs(off).max(initial=1e-12))
    unit, factor = ("um", 1e6) if most < 1e-4 else ("mm", 1e3)
    pitch = np.degrees(cloud.pitch[::every])
    drawn = axis.scatter(factor * off[:, i], factor * off[:, j], s=5, c=pitch, cmap="viridis")
    reach = 1.1 * factor * most
    axis.set_xlim(-reach, reach)
    axis.set_ylim(-reach, reach)
    axis.set_aspect("equal")
    axis.set_xlabel(f"{'XYZ'[i]} - centre [{unit}]")
    axis.set_ylabel(f"{'XYZ'[j]} - centre [{unit}]")
    _plain(axis)
    return drawn


def loops(found: Fold) -> Drawing:
    """Draw how near each loop is to flat along the joint that folds it, its range shaded."""
    figure = new_figure(10.5, 2.7, PURPOSE)
    axis: Any = figure.subplots()
    degrees = np.degrees(found.positions)
    axis.axvspan(np.degrees(found.lower), np.degrees(found.upper), color="#e8f3ee", zorder=0,
                 label="range")  # fmt: skip
    axis.axhline(0.0, color="#51606f", linewidth=0.8)
    colours = (OURS, THEIRS, HARDWARE, ERROR)
    for index, name in enumerate(found.loops):
        axis.plot(degrees, found.determinants[:, index], color=colours[index % len(colours)],
                  linewidth=1.6, label=f"loop {name}")  # fmt: skip
    axis.set_xlabel(f"{found.joint} [deg]")
    axis.set_ylabel("branch\ndeterminant")
    axis.margins(x=0.0)
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    _plain(axis)
    return figure


def table6(part: ReportPart) -> Drawing:
    """Draw how far the description is from the paper's measured distances."""
    rows = [f for f in part.figures if f.paper is not None and f.name.endswith("description")]
    off = [1e3 * (f.value - (f.paper or 0.0)) for f in rows]
    figure = new_figure(10.5, 2.6, PURPOSE)
    axis: Any = figure.subplots()
    spread = 1e3 * TABLE6_SPREAD_M
    axis.axhspan(-spread, spread, color="#e8f3ee", zorder=0)
    axis.axhline(0.0, color="#51606f", linewidth=0.8)
    places = np.arange(len(rows))
    axis.vlines(places, 0.0, off, color=OURS, linewidth=1.5)
    axis.plot(places, off, "o", color=OURS)
    axis.set_xticks(places, [f.name.partition(":")[0] for f in rows])
    axis.set_ylabel("description\n- measured [mm]")
    axis.set_ylim(-1.25 * spread, 1.25 * spread)
    _plain(axis)
    return figure


def table9(part: ReportPart) -> Drawing:
    """Draw real-time coefficients beside the paper's, on a logarithmic scale."""
    figure = new_figure(10.5, 0.5 * len(part.figures) + 1.0, PURPOSE)
    axis: Any = figure.subplots()
    places = np.arange(len(part.figures))[::-1]
    ours = [f.value for f in part.figures]
    theirs = [f.paper_simulation or 0.3 for f in part.figures]
    axis.barh(places + 0.19, ours, 0.36, color=OURS, label="trocar")
    axis.barh(places - 0.19, theirs, 0.36, color=THEIRS, label="paper (Gazebo)")
    for place, value, paper in zip(places, ours, theirs, strict=True):
        axis.text(1.06 * value, place + 0.19, f"{value:.0f}", va="center", fontsize=9)
        axis.text(1.06 * paper, place - 0.19, f"{paper:g}", va="center", fontsize=9)
    axis.set_xscale("log")
    axis.set_xlim(0.25, 3.0 * max(ours))
    axis.set_xticks([1.0, 10.0, 100.0], ["1", "10", "100"])
    axis.set_yticks(places, [f.name for f in part.figures])
    axis.set_xlabel("real-time coefficient (1: as fast as time)")
    axis.axvline(1.0, color="#51606f", linewidth=0.8)
    axis.legend(loc="lower right", frameon=False)
    _plain(axis)
    axis.grid(visible=False, axis="y")
    return figure


def _plain(axis: Any) -> None:
    axis.grid(visible=True, **GRID)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    axis.tick_params(labelsize=8.5)
    axis.ticklabel_format(axis="y", useOffset=False) if _linear(axis) else None


def _linear(axis: Any) -> bool:
    """Test whether the ticks of an axis are plain numbers, not names or powers."""
    return type(axis.yaxis.get_major_formatter()).__name__ == "ScalarFormatter"


VERDICTS = {
    None: Cell('<span class="quiet">stated</span>'),
    True: Cell('<span class="good">met</span>'),
    False: Cell('<span class="bad">MISSED</span>'),
}
PAPER = (
    "An Approach to Modeling Closed-Loop Kinematic Chain Mechanisms, Applied to Simulations of the"
    " da Vinci Surgical System"
)


def check_report(folder: str | Path, overwrite: bool = False) -> Path:
    """Check the folder of a report before anything is measured, and give the path of its page.

    Raises:
        InputError: the folder is a file, or holds a report that may not be replaced
        MissingExtraError: matplotlib is not installed
    """
    return pages.page_in(folder, PURPOSE, overwrite)


def write_report(folder: str | Path, found: Verification, *, overwrite: bool = False) -> str:
    """Write a page with everything that was verified, and return its path.

    Args:
        folder: where index.html goes; is made when it is not there
        found: what to tell
        overwrite: replace a report that is there

    Raises:
        InputError: it cannot be written
        MissingExtraError: matplotlib is not installed
    """
    target = check_report(folder, overwrite)
    page = pages.document("Verification of the simulation", _body(found))
    pages.write(target, page, overwrite)
    return str(target)


def _body(found: Verification) -> str:
    sections = [_section([*parts]) for _, parts in groupby(found.parts, key=lambda part: part.name)]
    return "".join([*_head(found), *sections])


def _head(found: Verification) -> Iterator[str]:
    kind = {None: "quiet", True: "good", False: "bad"}[found.met]
    arms = ", ".join(dict.fromkeys(part.arm for part in found.parts if part.arm))
    yield f"<h1>Verification of the simulation: {pages.text(arms or 'speed')}</h1>"
    yield (
        f'<p><span class="{kind}">{found.summary}</span>'
        " Each experiment is the closed-loop paper's, repeated on the simulation; its figures stand"
        " beside ours.</p>"
    )
    if found.missed:
        rows = "".join(f"<li>{pages.text(f.name)}</li>" for f in found.missed)
        yield f"<p>Out of tolerance:</p><ul>{rows}</ul>"
    links = ", ".join(
        f'<a href="#{part.name}">{pages.text(_head_of(part))}</a>'
        for part in {part.name: part for part in found.parts}.values()
    )
    yield f"<p>{links}</p>"
    yield (
        f'<p class="quiet">trocar {__version__}, MuJoCo {version("mujoco")}. The paper: '
        f"&ldquo;{PAPER}&rdquo;. Stated: without a tolerance.</p>"
    )


def _head_of(part: ReportPart) -> str:
    return part.title.partition(":")[0]


def _section(parts: list[ReportPart]) -> str:
    """Return one experiment, of every arm."""
    body = [f'<h2 id="{parts[0].name}">{pages.text(parts[0].title)}</h2>']
    for part in parts:
        if part.arm and part.figures:
            own = ", with its calibration" if "--calibration" in part.command else ""
            body.append(f"<h3>{pages.text(part.arm + own)}</h3>")
        notes = part.notes if part.figures else [f"{part.arm}: {note}" for note in part.notes]
        body += [f"<p>{pages.text(note)}</p>" for note in notes]
        if part.figures:
            body += [*_pictures(part), *_numbers(part)]
            body.append(f"<p>Measure again: <code>{pages.text(part.command)}</code></p>")
    return "".join(body)


def _numbers(part: ReportPart) -> Iterator[str]:
    """Return the table of a part, and the sources of its numbers below."""
    if part.name == "rcm":
        yield _table7(part)
    shown = [f for f in part.figures if not (part.name == "rcm" and f.name[-1] in "XYZ")]
    sources = list(dict.fromkeys(f.source for f in part.figures if f.source))
    letters = {source: chr(ord("a") + i) for i, source in enumerate(sources)}
    head, rows = figure_rows(shown)
    rows = [
        [*row[:-1], VERDICTS[figure.met], letters.get(figure.source, "")]
        for figure, row in zip(shown, rows, strict=True)
    ]
    yield pages.table([*head, "source"], rows)
    listed = "; ".join(f"<b>{letters[s]}</b> {pages.text(s)}" for s in sources)
    yield f'<p class="quiet">Sources: {listed}.</p>'


def _table7(part: ReportPart) -> str:
    """Return Table 7 as the paper has it, with our rows."""
    clouds: Sequence[Cloud] = part.data
    kind = clouds[0].kind
    compared = any(f.paper is not None for f in part.figures)
    rows: list[list[str]] = []
    if compared:
        for label, row in zip(("hardware", "simulation (Gazebo)"), TABLE7[kind], strict=True):
            values = (*row.position, *row.rms)
            rows.append([f"paper, {label}", *(f"{1e3 * v:.2f}" for v in values)])
    for cloud in clouds:
        position = [f"{round(1e3 * v, 3) + 0.0:.3f}" for v in cloud.centre]
        rms = [f"{1e3 * v:.5f}" for v in cloud.rms]
        rows.append([f"trocar, {RUNS[cloud.drive]}", *position, *rms])
    head = ["", "X [mm]", "Y [mm]", "Z [mm]", "RMS X [mm]", "RMS Y [mm]", "RMS Z [mm]"]
    return pages.table(head, rows)


def _pictures(part: ReportPart) -> Iterator[str]:
    """Return the plots of a part with their captions."""
    if isinstance(part.data, Fold):
        yield pages.picture(svg(loops(part.data)), LOOPS)
    elif part.name == "rcm":
        compared = any(f.paper is not None for f in part.figures)
        drawn = svg(figure9(part.data[0].kind, part.data, compared))
        yield pages.picture(drawn, FIGURE9 if compared else FIGURE9_ALONE)
    elif part.name == "axes" and any(f.paper is not None for f in part.figures):
        yield pages.picture(svg(table6(part)), TABLE6)
    elif part.name == "tracking":
        for track in part.data:
            gains = "; ".join(
                f"{joint} {p:g}, {i:g}, {d:g}"
                for joint, (p, i, d) in zip(track.joints, track.gains, strict=True)
            )
            caption = f"With {GAINS[track.model]} (P, I, D): {gains}."
            yield pages.picture(svg(figure10(track)), caption)
    elif part.name == "realtime":
        yield pages.picture(svg(table9(part)), "The scale is logarithmic.")


LOOPS = (
    "The sine of the angle at which the passive links of each loop stand. Where it is zero the loop"
    " is flat and could go on by the wrong branch; the range keeps clear of that on both sides."
)
FIGURE9 = (
    "Figure 9. Above: where the remote centre is, from three sides, the paper's hardware and"
    " simulation with the RMS of their clouds as bars, ours with its cloud, which is smaller than"
    " its mark. Below: our cloud alone, with servos, on a scale of its own: each dot is the remote"
    " centre as the link has it at one yaw and pitch."
)
FIGURE9_ALONE = "The cloud of Figure 9: each dot is the remote centre at one yaw and pitch."
TABLE6 = (
    "How far the description's distances are from what the paper measured on its hardware; the band"
    " is what is allowed."
)
