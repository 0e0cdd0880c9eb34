"""One page of what a calibration found: tables, the linkage drawn, and what explains the spread."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trocar import __version__
from trocar.apps import pages
from trocar.apps.calibration.geometry import home_points
from trocar.apps.calibration.records import Calibration
from trocar.apps.drawing import MEASURED, SETPOINT, new_figure, svg
from trocar.errors import InputError

PAGE = "index.html"
PURPOSE = "drawing a calibration"


def check_report(folder: str | Path) -> Path:
    """Return where a report goes, before anything is computed for it.

    Raises:
        InputError: the folder is none
        MissingExtraError: matplotlib is not installed
    """
    target = Path(folder).expanduser()
    if target.exists() and not target.is_dir():
        raise InputError(f"{target}: is no folder; allowed: one that is there or can be made")
    new_figure(1.0, 1.0, PURPOSE)
    return target / PAGE


def write_report(folder: str | Path, found: Calibration) -> str:
    """Write a page of a calibration, and return its path.

    Raises:
        InputError: it cannot be written
        MissingExtraError: matplotlib is not installed
    """
    target = check_report(folder)
    parts = [
        f"<p>{pages.text(_source(found))}</p>",
        *(f"<p>{pages.text(warning)}</p>" for warning in found.warnings),
        "<h2>Axis distances</h2>",
        _distances(found),
        "<h2>The linkage at joint positions 0</h2>",
        pages.picture(
            _linkage(found),
            "axes as described and as calibrated: the first axis, and the direction from there to"
            " the next, laid on one another",
        ),
        "<h2>Axes</h2>",
        _axes(found),
    ]
    if found.betas:
        rows = [[k, f"{v.value:.6f}", f"{v.sigma:.6f}"] for k, v in found.betas.items()]
        parts += ["<h2>Angles</h2>", pages.table(["at q = 0", "[rad]", "sigma [rad]"], rows)]
    if found.centre is not None:
        parts += ["<h2>Remote centre</h2>", _centre(found)]
    page = pages.document(f"Calibration of {found.arm}", "\n".join(parts))
    pages.write(target, page)
    return str(target)


def _source(found: Calibration) -> str:
    source = found.overlay.source
    left = found.refined
    return (
        f"From {source['file']} (sha256 {source['sha256'][:12]}...), trocar {__version__}:"
        f" {left.samples} samples; left of a pose {1e3 * left.position_rms:.4f} mm and"
        f" {1e3 * left.rotation_rms:.4f} mrad per axis (RMS). Loops closed as {found.closure}."
    )


def _distances(found: Calibration) -> str:
    """Measured each by itself, closed, and as the description has it."""
    linkage = found.refined.robot.linkage
    drawn = found.nominal_distances
    rows = [
        [label, f"{1e3 * drawn[label]:.3f}", f"{1e3 * v.value:.4f}", f"{1e3 * v.sigma:.4f}",
         f"{1e3 * found.closed_distances[label]:.4f}",
         f"{1e3 * (found.closed_distances[label] - v.value):+.4f}"]
        for label, v in found.axis_distances.items()
    ]  # fmt: skip
    head = ["axes", f"{linkage.arm} as described [mm]", "measured [mm]", "sigma [mm]",
            f"{found.closure} [mm]", "absorbed [mm]"]  # fmt: skip
    return pages.table(head, rows)


def _axes(found: Calibration) -> str:
    linkage = found.axes.linkage
    rows = [
        [linkage.hinge(name).label, f"{fit.span:.3f}", f"{fit.condition:.1f}",
         f"{1e3 * fit.residual_position:.4f}", f"{1e3 * fit.residual_rotation:.4f}",
         str(int(fit.used.sum())), str(fit.outliers)]
        for name, fit in found.axes.fits.items()
    ]  # fmt: skip
    head = ["axis", "swept [rad]", "condition", "position left [mm]", "rotation left [mrad]",
            "samples", "left out"]  # fmt: skip
    return pages.table(head, rows)


def _centre(found: Calibration) -> str:
    """Split the spread of the remote centre into what the mechanism explains, noise and the rest.

    Squares add up, as the parts know nothing of one another.
    """
    if found.centre is None:
        return ""
    report, explained = found.centre.report, found.wander or 0.0
    rest = report.fit.rms**2 - report.noise_rms**2 - explained**2
    rows = [
        ["all", f"{1e3 * report.fit.rms:.4f}"],
        ["noise of the cameras", f"{1e3 * report.noise_rms:.4f}"],
        ["link lengths and axes, as calibrated", f"{1e3 * explained:.4f}"],
        ["unexplained", f"{1e3 * float(np.sqrt(max(rest, 0.0))):.4f}"],
    ]
    place = [
        [axis, f"{1e3 * p:.4f}", f"{1e3 * s:.4f}"]
        for axis, p, s in zip("xyz", report.fit.post, report.fit.sigma_post, strict=True)
    ]
    return pages.table([f"in {report.base}", "[mm]", "sigma [mm]"], place) + pages.table(
        ["spread of the remote centre", "RMS [mm]"], rows
    )


def _linkage(found: Calibration) -> str:
    robot = found.refined.robot
    linkage = robot.linkage
    figure = new_figure(8.0, 3.4, PURPOSE)
    axes = figure.add_subplot()
    for moved, color, label in (
        (np.zeros_like(robot.moved), SETPOINT, "description"),
        (robot.moved, MEASURED, "calibrated"),
    ):
        points = home_points(linkage, moved)
        for body in linkage.bodies:
            places = np.stack([p for slot, p in points.items() if slot.body == body])
            closed = np.vstack([places, places[:1]]) * 1e3
            axes.plot(closed[:, 1], closed[:, 0], color=color, linewidth=1.0, marker="o",
                      markersize=3.0, label=label)  # fmt: skip
            label = "_" + label
    for name, point in linkage.points.items():
        axes.annotate(linkage.hinge(name).label, (1e3 * point[1], 1e3 * point[0]),
                      xytext=(4, 4), textcoords="offset points")  # fmt: skip
    axes.set_aspect("equal")
    axes.set_xlabel("[mm]")
    axes.set_ylabel("[mm]")
    axes.legend()
    return svg(figure)
