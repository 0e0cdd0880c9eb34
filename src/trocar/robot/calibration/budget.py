"""The error budget of a calibration: which sweep reaches which accuracy, before it is recorded.

The estimators of axes and of the remote centre are linearised at tracks without noise; the
covariance of the poses' noise then gives that of each figure. Nothing is drawn at random. A figure
gains from a sweep in so far as its standard deviation falls when that sweep is recorded twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import InputError, UndeterminedError
from trocar.fitting import angle_sigma, expected_hinges, expected_pivot_sigma
from trocar.geometry import inverse
from trocar.plotting import pages
from trocar.plotting.drawing import MEASURED, PALETTE, new_figure, svg
from trocar.robot.calibration.axes import (
    Axes,
    Value,
    betas,
    distances,
    find_datum,
    find_home,
    joined_hinges,
    measure_axes,
)
from trocar.robot.calibration.linkage import linkage
from trocar.robot.calibration.robot import remote_centre_of
from trocar.robot.calibration.selection import chosen_bodies, planned_figures
from trocar.robot.calibration.tracks import Tracks

Array = NDArray[np.float64]
#: Times of the part that sweeps some joints, (from, to) [s]
Span = tuple[float, float]

PURPOSE = "the error budget"


def pose_noise(marker_m: float, markers: int, spread_m: float) -> tuple[float, float]:
    """Return the noise of a cluster's pose, position [m] and rotation [rad] per axis.

    The markers lie in all directions alike about their centre: squares of their distances from an
    axis add up to two thirds of those from the centre.

    Args:
        marker_m: noise of a marker along each axis, one standard deviation [m]
        markers: how many a cluster has
        spread_m: root of their mean squared distance from their centre [m]

    Raises:
        InputError: noise or spread not above 0, or fewer than three markers
    """
    for name, got in (("marker noise", marker_m), ("marker spread", spread_m)):
        if not 0.0 < got < 1.0:
            raise InputError(f"{name}: got {1e3 * got:g} mm; allowed: above 0 to 1000 mm")
    if markers < 3:
        raise InputError(f"markers: got {markers}; allowed: 3 or more, which a pose needs")
    each = marker_m / np.sqrt(markers)
    return float(each), float(each / (spread_m * np.sqrt(2.0 / 3.0)))


@dataclass(frozen=True, eq=False)
class Budget:
    """Expected accuracy of a calibration from a recording.

    Attributes:
        arm: name of the arm
        noise: of a pose, position [m] and rotation [rad] per axis
        rate_hz: of the cameras [Hz]
        seconds: {joints that are swept: how long [s]}
        sigma: {figure: its standard deviation [m or rad]}
        doubled: {joints that are swept: the same with their sweep twice as long}
    """

    arm: str
    noise: tuple[float, float]
    rate_hz: float
    seconds: Mapping[str, float]
    sigma: Mapping[str, float]
    doubled: Mapping[str, Mapping[str, float]]

    def sweep_longer(self, figure: str) -> str:
        """Return the sweep from which a figure gains most."""
        return min(self.doubled, key=lambda joints: self.doubled[joints][figure])

    def as_dict(self) -> dict[str, Any]:
        """Return the budget as one JSON document, in SI units."""
        return {
            "arm": self.arm,
            "noise": {"position_m": self.noise[0], "rotation_rad": self.noise[1]},
            "rate_hz": self.rate_hz,
            "sweeps_s": dict(self.seconds),
            "sigma": dict(self.sigma),
            "sigma_with_sweep_doubled": {name: dict(v) for name, v in self.doubled.items()},
            "sweep_longer": {figure: self.sweep_longer(figure) for figure in self.sigma},
        }


def error_budget(
    tracks: Tracks,
    arm: ArmDescription,
    noise: tuple[float, float],
    sweeps: Mapping[str, Span],
    rate_hz: float,
) -> Budget:
    """Predict the standard deviations of what `calibrate` measures.

    Args:
        tracks: of the planned motion, without noise; their own rate does not matter
        arm: the description
        noise: that poses will have, position [m] and rotation [rad] per axis
        sweeps: {joints: when they are swept}
        rate_hz: of the cameras [Hz]

    Raises:
        InputError: an arm or tracks that cannot be calibrated
    """
    share = float(np.sqrt(tracks.rate_hz / rate_hz))

    def sigma(some: Tracks) -> dict[str, float]:
        return {name: share * value for name, value in expected_sigma(some, arm, noise).items()}

    return Budget(
        arm=arm.name,
        noise=noise,
        rate_hz=rate_hz,
        seconds={joints: end - begin for joints, (begin, end) in sweeps.items()},
        sigma=sigma(tracks),
        doubled={joints: sigma(_twice(tracks, span)) for joints, span in sweeps.items()},
    )


def expected_sigma(
    tracks: Tracks, arm: ArmDescription, noise: tuple[float, float]
) -> dict[str, float]:
    """Return the standard deviation of each figure of a calibration, {name: [m or rad]}.

    Args:
        tracks: without noise
        arm: the description
        noise: that poses will have, position [m] and rotation [rad] per axis
    """
    loops = linkage(arm)
    centre = remote_centre_of(arm, loops)
    chosen, _ = chosen_bodies(tracks, loops, centre, {})
    axes, home = find_home(chosen, measure_axes(chosen, loops))
    axes = _with_noise(axes, chosen, noise)
    pairs, lines = planned_figures(arm)
    found = {f"distance {k}": v.sigma for k, v in distances(axes, pairs).items()}
    if home.still:
        still: dict[str, Value] = {}
        for name, value in home.angles.items():
            each = angle_sigma(axes.fits[name], _relative(axes, chosen, name), noise)
            here = each[home.samples & np.isfinite(each)]
            still[name] = Value(value.value, float(np.sqrt(np.mean(here**2) / len(here))))
        datum = find_datum(axes, home, None)
        angles = betas(axes, replace(home, angles=still), lines, datum.at_home)
        found |= {name: value.sigma for name, value in angles.items()}
    if centre is not None and {centre.base, centre.body} <= chosen.poses.keys():
        moving = np.where(home.samples[:, None, None], np.nan, chosen.poses[centre.body])
        try:
            place = expected_pivot_sigma(chosen.poses[centre.base], moving, noise)[3:]
        except UndeterminedError:
            return found
        found["remote centre"] = float(np.linalg.norm(place))
    return found


def _with_noise(axes: Axes, tracks: Tracks, noise: tuple[float, float]) -> Axes:
    """Return axes whose errors are those that noise will make."""
    bodies, shared = joined_hinges(axes.linkage, axes.fits)
    poses = np.stack([tracks.poses[body] for body in bodies], axis=1)
    return replace(axes, fits=dict(zip(axes.fits, expected_hinges(poses, shared, noise),
                                       strict=True)))  # fmt: skip


def _relative(axes: Axes, tracks: Tracks, name: str) -> Array:
    hinge = axes.linkage.hinge[name]
    return inverse(tracks.poses[hinge.body_a]) @ tracks.poses[hinge.body_b]


def _twice(tracks: Tracks, span: Span) -> Tracks:
    """Return tracks with one sweep recorded a second time."""
    again = (tracks.times > span[0]) & (tracks.times <= span[1])
    later = tracks.times[-1] + 1.0 / tracks.rate_hz - tracks.times[again][:1]
    return replace(
        tracks,
        times=np.concatenate([tracks.times, tracks.times[again] + later]),
        poses={body: np.concatenate([T, T[again]]) for body, T in tracks.poses.items()},
    )


def write_budget(
    folder: str | Path,
    found: Budget,
    by_amplitude: Mapping[float, Budget],
    overwrite: bool = False,
) -> Path:
    """Write `index.html` with tables and plots into a folder and return its path.

    Args:
        folder: is made where it is not there
        found: the budget of the chosen amplitude
        by_amplitude: {amplitude [rad]: its budget}
        overwrite: replace a report that is there

    Raises:
        InputError: the file cannot be written
        MissingExtraError: matplotlib is not installed
    """
    path = pages.page_in(folder, PURPOSE, overwrite)
    body = (
        f"<h1>Error budget: {pages.text(found.arm)}</h1>"
        f"<p>Noise of a pose {1e3 * found.noise[0]:.3g} mm and {1e3 * found.noise[1]:.3g} mrad per"
        f" axis, {found.rate_hz:g} Hz.</p>"
        + pages.table(*budget_rows(found))
        + pages.picture(draw_budget(found, by_amplitude), "One standard deviation of each figure.")
    )
    pages.write(path, pages.document(f"Error budget: {found.arm}", body), overwrite)
    return path


def budget_rows(found: Budget) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of a budget as a table: each figure, and what a longer sweep brings."""
    head = [
        "1 sigma",
        "planned",
        *(f"{joints} x 2" for joints in found.doubled),
        "",
        "sweep longer",
    ]
    rows = [
        [
            figure,
            f"{1e6 * sigma:.3g}",
            *(f"{1e6 * twice[figure]:.3g}" for twice in found.doubled.values()),
            "urad" if figure.startswith("beta") else "um",
            found.sweep_longer(figure),
        ]
        for figure, sigma in found.sigma.items()
    ]
    return head, rows


def draw_budget(found: Budget, by_amplitude: Mapping[float, Budget]) -> str:
    """Draw what doubling each sweep brings, and each figure over the amplitude, as SVG."""
    names = list(found.sigma)
    figure = new_figure(10.5, 0.36 * len(names) + 1.6, PURPOSE)
    left, right = figure.subplots(1, 2)
    rows = np.arange(len(names))
    left.barh(rows, [1e6 * found.sigma[n] for n in names], color="#dddddd", label="planned")
    for colour, (joints, twice) in zip(PALETTE, found.doubled.items(), strict=False):
        left.plot([1e6 * twice[n] for n in names], rows, "D", color=colour, label=f"{joints} x 2")
    left.set_yticks(rows, names)
    left.invert_yaxis()
    left.set_xlabel("1 sigma [um; urad of angles]")
    left.legend(frameon=False)
    amplitudes = list(by_amplitude)
    for name in names:
        values = [1e6 * one.sigma.get(name, np.nan) for one in by_amplitude.values()]
        colour = MEASURED if name.startswith("distance") else PALETTE[1]
        right.loglog(amplitudes, values, "o-", color=colour, linewidth=1.0)
        right.annotate(name.removeprefix("distance "), (amplitudes[-1], values[-1]), (4, 0),
                       textcoords="offset points", fontsize=8)  # fmt: skip
    right.set_xlabel("amplitude [rad]")
    right.grid(visible=True, which="both", color="#dddddd", linewidth=0.6)
    return svg(figure)
