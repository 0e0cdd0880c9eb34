"""The drawings of a calibration's report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.geometry import home_points, shift_rows
from trocar.apps.calibration.rcm_cloud import CloudPoint
from trocar.apps.calibration.records import Calibration
from trocar.apps.drawing import MEASURED, PALETTE, SETPOINT, new_figure, svg

Array = NDArray[np.float64]

PURPOSE = "the report of a calibration"
DRAWN, GRID = "#9aa5b1", "#dddddd"
MM = 1e3


def set_up(found: Calibration) -> str:
    """Draw links, axes and clusters of markers in the plane across the axes, at q = 0."""
    robot, linkage = found.refined.robot, found.axes.linkage
    figure = new_figure(9.5, 6.5, PURPOSE)
    axis: Any = figure.subplots()
    points = home_points(linkage, robot.moved)
    shifts = shift_rows(linkage)
    for colour, body in zip(PALETTE * 3, linkage.bodies, strict=False):
        drawn = MM * np.stack([linkage.points[name] for name in linkage.carried(body)])
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


def sides(found: Calibration, described: Mapping[str, float]) -> str:
    """Draw each distance against the description's, with its 95 % interval."""
    labels = list(found.axis_distances)
    figure = new_figure(9.5, 0.45 * len(labels) + 1.2, PURPOSE)
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


def clouds(measured: Sequence[CloudPoint], own: Sequence[CloudPoint]) -> str:
    """Draw where the remote centre was at each pose, measured and as the mechanism has it.

    Both are in the frame of the first two joint axes, each about its mean.
    """
    seen, explained = (np.stack([point.position for point in part]) for part in (measured, own))
    pitch = np.array([point.q[1] for point in measured])
    figure = new_figure(11.5, 4.0, PURPOSE)
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


def _ring(points: Array) -> Array:
    """Return points as a closed line, in the order of their angle about their middle."""
    away = points - points.mean(axis=0)
    order = np.argsort(np.arctan2(away[:, 1], away[:, 0]))
    return points[[*order, order[0]]]
