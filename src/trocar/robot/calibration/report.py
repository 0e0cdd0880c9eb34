"""A calibration as one page: what was measured, how well, and what the mechanism explains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.descriptions.overlay import apply_overlay
from trocar.fitting import WanderFit
from trocar.plotting import pages
from trocar.plotting.drawing import MEASURED, PALETTE, SETPOINT, new_figure, svg
from trocar.robot.calibration.calibrate import Calibration
from trocar.robot.calibration.checks import distance_bound
from trocar.robot.calibration.linkage import home_points, shift_rows
from trocar.robot.calibration.rcm import (
    MOST,
    CloudPoint,
    RcmReport,
    Split,
    Table7,
    centre_links,
    centre_samples,
    over_cells,
    own_wander,
    split_centre,
)
from trocar.robot.calibration.robot import lengths_only

Array = NDArray[np.float64]

MM = 1e3
#: Positions of a joint at which the mechanism's own wander is drawn. Source: our own choice.
PLACES = 61


def check_report(folder: str | Path, overwrite: bool = False) -> Path:
    """Return the path of a report, before anything is computed for it.

    Raises:
        InputError: the folder is a file, or holds a report that may not be replaced
        MissingExtraError: matplotlib is not installed
    """
    return pages.page_in(folder, PURPOSE, overwrite)


def write_report(
    folder: str | Path, found: Calibration, arm: ArmDescription, *, overwrite: bool = False
) -> Path:
    """Write `index.html` into a folder and return its path.

    Args:
        folder: is made where it is not there
        found: what is reported
        arm: the description that was calibrated
        overwrite: replace a report that is there

    Raises:
        InputError: the file cannot be written
        MissingExtraError: matplotlib is not installed
    """
    path = check_report(folder, overwrite)
    pages.write(path, pages.document(f"Calibration: {found.arm}", _body(found, arm)), overwrite)
    return path


def _body(found: Calibration, arm: ArmDescription) -> str:
    source = found.overlay.source
    head = (
        f"<h1>Calibration: {pages.text(found.arm)}</h1>"
        f'<p class="quiet">from {pages.text(source["file"])} (SHA-256'
        f" {pages.text(source['sha256'][:12])}...), by {pages.text(source['version'])}</p>"
    )
    notes = "".join(f'<p class="note">{pages.text(text)}</p>' for text in found.warnings)
    parts = [_set_up(found), _sides(found), _axes(found)]
    if found.centre is not None:
        parts.append(_centre(found, found.centre, arm))
    return head + notes + "".join(parts)


def _set_up(found: Calibration) -> str:
    noise = found.axes.noise
    caption = (
        "Links (coloured), axes (dots; open where not measured) and clusters of markers (triangles)"
        " at q = 0, along the axes; dashed: the description."
    )
    return (
        "<h2>Set-up</h2>"
        f"<p>{found.refined.samples} samples. Pose noise of a cluster, estimated from the hinges:"
        f" {MM * noise[0]:.3g} mm and {MM * noise[1]:.3g} mrad per axis. Residual of the"
        f" simultaneous fit: {MM * found.refined.position_rms:.3g} mm and"
        f" {MM * found.refined.rotation_rms:.3g} mrad.</p>"
        + pages.picture(draw_set_up(found), caption)
    )


def _sides(found: Calibration) -> str:
    described = found.nominal_distances
    bound = distance_bound(described[label] for label in found.axis_distances)
    rows = [
        [
            label,
            f"{MM * described[label]:.3f}",
            f"{MM * value.value:.4f}",
            f"{MM * value.sigma:.4f}",
            f"{MM * found.closed_distances[label]:.4f}",
            f"{MM * found.absorbed[label]:+.4f}",
        ]
        for label, value in found.axis_distances.items()
    ]
    head = ["axes", "description [mm]", "measured [mm]", "1 sigma [mm]",
            f"{found.closure} [mm]", "absorbed [mm]"]  # fmt: skip
    how = (
        "The loops close exactly: of all parallelogram linkages this one fits all sweeps best,"
        " weighted by the noise. Absorbed is what each side gave way by."
        if found.closure == "parallelogram"
        else "Each side is as it fits all sweeps best; the loops are closed by computation at every"
        " joint position. Skew axes are nearer at one end than at the other: all distances are"
        " taken in the plane across them through the origin of the first."
    )
    text = (
        "<h2>Axis distances (Table 6 of the paper)</h2>"
        "<p>Measured: each separately, within the link of both axes. Tracks with a"
        f" distance more than {MM * bound:.3g} mm off the description"
        " are rejected.</p>"
        f"<p>{how} Model misfit: {MM * found.refined.misfit_m:.3g} mm (RMS),"
        f" chi-squared {found.refined.misfit:.3g} per degree of freedom.</p>"
    ) + pages.table(head, rows)
    if found.axis_distances:
        text += pages.picture(draw_sides(found, described), "Measured and closed distances.")
    if found.betas:
        angles = [[k, f"{v.value:.6f}", f"{v.sigma:.6f}"] for k, v in found.betas.items()]
        text += pages.table(["angle at q = 0", "[rad]", "1 sigma [rad]"], angles)
    return text


def _axes(found: Calibration) -> str:
    rows = [
        [
            found.axes.linkage.hinge[name].label,
            f"{found.axes.linkage.hinge[name].body_a} - {found.axes.linkage.hinge[name].body_b}",
            f"{fit.span:.3f}",
            f"{fit.condition:.0f}",
            f"{MM * fit.residual_position:.4f}",
            f"{MM * fit.residual_rotation:.4f}",
            f"{int(fit.used.sum())}",
            f"{fit.outliers}",
        ]
        for name, fit in found.axes.fits.items()
    ]
    head = ["axis", "bodies", "swept [rad]", "condition", "residual [mm]", "residual [mrad]",
            "samples", "left out"]  # fmt: skip
    return "<h2>Axes, each by itself</h2>" + pages.table(head, rows)


def _centre(found: Calibration, seen: RcmReport, arm: ArmDescription) -> str:
    text = (
        "<h2>Remote centre (Table 7 and Figure 9 of the paper)</h2>"
        f"<p>In {pages.text(seen.base)}: {_mm(seen.fit.post)} mm, 1 sigma"
        f" {_mm(seen.fit.sigma_post)} mm. Spread {MM * seen.fit.rms:.4f} mm (RMS), of which noise"
        f" makes {MM * seen.noise_rms:.4f} mm.</p>"
    )
    if seen.wander is not None:
        text += _wander(seen.wander, found, seen, arm)
    if seen.table7 is None or not seen.cloud:
        return text + '<p class="quiet">Yaw or pitch axis is unknown.</p>'
    split = centre_parts(found, seen, arm)
    text += _frame(seen.table7, split) + _positions(seen.table7, split)
    text += _spreads(seen.table7, split)
    caption = (
        "The centre over cells of yaw and pitch; crosses: what the calibrated mechanism does by"
        " itself in the same sweep. Both about their means."
    )
    dots, crosses = over_cells(split.q, split.cloud), over_cells(split.q, split.own.cloud)
    return text + pages.picture(draw_clouds(dots, crosses), caption)


def centre_parts(found: Calibration, seen: RcmReport, arm: ArmDescription) -> Split:
    """Split the remote centre of a calibration by cause.

    Args:
        found: the calibration
        seen: its remote centre, with Table 7
        arm: the description that was calibrated
    """
    on = seen.hinges.base_axis if found.closure == "general" else None
    lengths = lengths_only(found.refined.robot, arm, on)
    return split_centre(seen, arm, lengths, apply_overlay(arm, found.overlay).mechanism)


def _wander(seen: WanderFit, found: Calibration, report: RcmReport, arm: ArmDescription) -> str:
    """Show how the centre wanders with the pitch: as tracked, and as the mechanism has it."""
    axes = np.eye(3) if report.table7 is None else report.table7.axes
    curve, sigma = seen.curve @ axes, np.sqrt(seen.sigma**2 @ axes**2)
    own = None
    if found.closure == "general" and report.table7 is not None:
        swept, _ = centre_samples(report.hinges, report.fit)
        robot = apply_overlay(arm, found.overlay).mechanism
        pitch = cast(Array, np.linspace(robot.lower[1], robot.upper[1], PLACES))
        own = pitch, own_wander(robot, centre_links(arm), swept[:: 1 + len(swept) // MOST], pitch)
    rows = [
        [f"{np.degrees(q):.1f}", *(f"{MM * v:+.4f} +- {MM * s:.4f}" for v, s in
                                   zip(place, error, strict=True))]
        for q, place, error in zip(seen.q, curve, sigma, strict=True)
    ]  # fmt: skip
    text = (
        "<h3>Wander over the pitch</h3>"
        "<p>The centre is not a fixed point. The place above is the one with the smallest error"
        " over the sweep of yaw and pitch; the table has the displacement from it at yaw 0, with 1"
        " sigma, along the axes of Table 7's frame"
        + ("." if report.table7 is not None else " (of the base body, where that is unknown).")
        + "</p>"
    )
    caption = "Displacement at yaw 0, as tracked with 95 % intervals" + (
        "." if own is None else "; lines: the calibrated mechanism over the range of the joint."
    )
    return (
        text
        + pages.table(["pitch [deg]", "X [mm]", "Y [mm]", "Z [mm]"], rows)
        + pages.picture(draw_wander(seen.q, curve, sigma, own), caption)
    )


def _frame(seen: Table7, split: Split) -> str:
    """Return the text about the accuracy of the frame in which the centre is given."""
    frame, lever = seen.frame, float(np.linalg.norm(split.position))
    return (
        "<h3>Simulation and hardware: the difference and its parts</h3>"
        "<p>All relative to the pitch axis, in the frame of the first two joint axes. This frame is"
        f" set up from the two axes as tracked: 1 sigma {_mm(frame.origin)} mm of its origin and"
        f" {_mm(frame.turn)} mrad about its axes, to be carried {MM * lever:.1f} mm to the centre:"
        " the rows &ldquo;frame set-up&rdquo;.</p>"
    )


def _positions(seen: Table7, split: Split) -> str:
    """Split the difference of the measured centre from the description's."""
    part = split.place
    rows = [
        ("description", part["description"]),
        ("measured", split.position),
        ("difference", split.position - part["description"]),
        ("= link lengths", part["lengths"]),
        ("+ axis errors", part["axes"]),
        ("+ left unexplained", part["left"]),
        ("1 sigma of frame set-up", seen.frame.position),
        ("1 sigma of noise of the centre", seen.centre_sigma),
        ("1 sigma of both", seen.sigma),
    ]
    note = (
        "<p>Link lengths: the sides as calibrated, and the linkage as far off the yaw axis as"
        " measured, no axis leaning. Axis errors: what changes as they lean as measured. What is"
        " left unexplained holds the error of the calibrated geometry itself, too.</p>"
    )
    return _xyz("position [mm]", rows) + note


def _spreads(seen: Table7, split: Split) -> str:
    """Split the measured spread of the centre."""
    part = {name: _rms(cloud) for name, cloud in split.clouds.items()}
    rows = [
        ("measured", _rms(split.cloud)),
        ("the calibrated mechanism by itself", split.own.rms_axes),
        ("of link lengths", part["lengths"]),
        ("of axis errors", part["axes"]),
        ("measured less mechanism", part["left"]),
        ("of noise (a third of its square for each axis)", np.full(3, split.noise)),
        ("left unexplained", split.unexplained),
        ("1 sigma of frame set-up", seen.frame.spread),
    ]
    note = (
        "<p>Sample by sample, link lengths + axis errors = mechanism, and mechanism + what it is"
        " missed by = measured; their RMS need not add up, as one may undo the other. Noise and"
        " what is left unexplained add as squares.</p>"
    )
    return _xyz("spread, RMS [mm]", rows) + note


def _rms(cloud: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(cloud**2, axis=0)), dtype=np.float64)


def _xyz(what: str, rows: list[tuple[str, Array]]) -> str:
    cells = [[name, *(f"{MM * value:.4f}" for value in values)] for name, values in rows]
    return pages.table([what, "X", "Y", "Z"], cells)


def _mm(values: Array) -> str:
    return "(" + ", ".join(f"{MM * value:.4f}" for value in values) + ")"


PURPOSE = "the report of a calibration"
DRAWN, GRID = "#9aa5b1", "#dddddd"


def draw_set_up(found: Calibration) -> str:
    """Draw links, axes and clusters of markers in the plane across the axes, at q = 0."""
    robot, linkage = found.refined.robot, found.axes.linkage
    figure: Any = new_figure(9.5, 6.5, PURPOSE)
    axis: Any = figure.subplots()
    points = home_points(linkage, robot.moved)
    shifts = shift_rows(linkage)
    for colour, body in zip(PALETTE * 3, linkage.bodies, strict=False):
        drawn = MM * np.stack([linkage.points[name] for name in linkage.carried[body]])
        axis.plot(*_ring(drawn).T, color=DRAWN, linewidth=1.0, linestyle="--", zorder=1)
        here = [points[s] for s in points if s.body == body]
        axis.plot(*_ring(MM * np.stack(here)).T, color=colour, linewidth=4, alpha=0.55, zorder=2)
        if body not in robot.markers:
            continue
        frame = linkage.frames[linkage.bodies[body]].copy()
        frame[:3, 3] += linkage.plane[:, :2] @ (shifts[body] @ robot.moved)
        cluster = MM * (linkage.plane.T @ (frame @ robot.markers[body])[:3, 3])[:2]
        middle = np.mean(MM * np.stack(here), axis=0)
        axis.plot(*np.stack([middle, cluster]).T, color=colour, linewidth=0.7, zorder=1)
        axis.plot(*cluster, marker="^", markersize=8, color=colour, linestyle="", label=body)
    for hinge in linkage.hinges:
        x, y = MM * next(at for slot, at in points.items() if slot.hinge == hinge.name)
        measured = hinge.name in found.axes.fits
        face = "black" if measured else "white"
        axis.plot(x, y, marker="o", color="black", markerfacecolor=face, markersize=6, zorder=3)
        axis.annotate(hinge.label, (x, y), (6, 6), textcoords="offset points", fontsize=11)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel("in the plane across the axes [mm]")
    axis.set_ylabel("[mm]")
    axis.grid(visible=True, color=GRID, linewidth=0.6)
    figure.legend(loc="outside right upper", frameon=False, title="markers")
    return svg(figure)


def draw_sides(found: Calibration, described: Mapping[str, float]) -> str:
    """Draw each distance against the description's, with its 95 % interval."""
    labels = list(found.axis_distances)
    figure: Any = new_figure(9.5, 0.45 * len(labels) + 1.2, PURPOSE)
    axis: Any = figure.subplots()
    rows = np.arange(len(labels))
    values = list(found.axis_distances.values())
    off = np.array([v.value - described[k] for k, v in found.axis_distances.items()])
    bars = 1.96 * np.array([v.sigma for v in values])
    axis.errorbar(
        MM * off, rows - 0.12, xerr=MM * bars, fmt="o", color=MEASURED, capsize=4,
        label="measured, 95 % interval",
    )  # fmt: skip
    closed = np.array([found.closed_distances[k] - described[k] for k in labels])
    axis.plot(MM * closed, rows + 0.12, "D", color=SETPOINT, label=f"closed: {found.closure}")
    axis.axvline(0.0, color=DRAWN, linestyle="--", linewidth=1.0, label="description")
    axis.set_yticks(rows, labels)
    axis.invert_yaxis()
    axis.set_xlabel("distance of two axes less the description's [mm]")
    axis.grid(visible=True, axis="x", color=GRID, linewidth=0.6)
    figure.legend(loc="outside upper center", ncols=3, frameon=False)
    return svg(figure)


def draw_clouds(measured: Sequence[CloudPoint], own: Sequence[CloudPoint]) -> str:
    """Draw where the remote centre was at each pose, measured and as the mechanism has it.

    Both are in the frame of the first two joint axes, each about its mean.
    """
    seen, explained = (np.stack([point.position for point in part]) for part in (measured, own))
    pitch = np.array([point.q[1] for point in measured])
    figure: Any = new_figure(11.5, 4.0, PURPOSE)
    each: Any = figure.subplots(1, 3)
    reach = 1.1 * MM * max(float(np.abs(seen).max()), float(np.abs(explained).max()), 1e-6)
    dots: Any = None
    for axis, (i, j) in zip(each, ((0, 1), (2, 1), (0, 2)), strict=True):
        dots = axis.scatter(
            MM * seen[:, i], MM * seen[:, j], c=np.degrees(pitch), cmap="viridis", s=22,
            label="measured",
        )  # fmt: skip
        axis.plot(
            MM * explained[:, i], MM * explained[:, j], "+", color=SETPOINT, label="mechanism"
        )
        axis.set(xlabel=f"{'XYZ'[i]} [mm]", ylabel=f"{'XYZ'[j]} [mm]")
        axis.set_xlim(-reach, reach)
        axis.set_ylim(-reach, reach)
        axis.set_aspect("equal")
        axis.grid(visible=True, color=GRID, linewidth=0.6)
    figure.colorbar(dots, ax=each, label="pitch [deg]")
    handles, labels = each[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    return svg(figure)


def draw_wander(pitch: Array, curve: Array, sigma: Array, own: tuple[Array, Array] | None) -> str:
    """Draw the displacement of a centre that wanders.

    Args:
        pitch: (g,) [rad]
        curve, sigma: as tracked, (g, 3) [m]
        own: pitch (n,) and displacement (n, 3) of the calibrated mechanism; None: not drawn
    """
    figure: Any = new_figure(9.5, 4.0, PURPOSE)
    axis: Any = figure.subplots()
    for k, (name, colour) in enumerate(zip("XYZ", PALETTE, strict=False)):
        axis.errorbar(
            np.degrees(pitch), MM * curve[:, k], yerr=1.96 * MM * sigma[:, k], fmt="o",
            color=colour, capsize=3, label=name,
        )  # fmt: skip
        if own is not None:
            axis.plot(np.degrees(own[0]), MM * own[1][:, k], color=colour, linewidth=1.0)
    axis.set(xlabel="pitch [deg]", ylabel="displacement [mm]")
    axis.grid(visible=True, color=GRID, linewidth=0.6)
    figure.legend(loc="outside upper center", ncols=3, frameon=False)
    return svg(figure)


def _ring(points: Array) -> Array:
    """Return points as a closed line, in the order of their angle about their middle."""
    away = points - points.mean(axis=0)
    order = np.argsort(np.arctan2(away[:, 1], away[:, 0]))
    return points[[*order, order[0]]]
