"""Measurements of a robot from tracks before its loops are closed, checked with its description."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product

from trocar.errors import UndeterminedError
from trocar.fitting import Axis
from trocar.robot.calibration.axes import (
    Axes,
    Datum,
    Home,
    Value,
    betas,
    distances,
    find_datum,
    find_home,
    in_plane,
    measure_axes,
)
from trocar.robot.calibration.checks import check_axes, check_centre, nominal_betas
from trocar.robot.calibration.labels import (
    Labels,
    check_loops,
    fitting_labels,
    likely_labels,
)
from trocar.robot.calibration.rcm import RcmReport, find_centre
from trocar.robot.calibration.robot import Robot, first_guess
from trocar.robot.calibration.selection import MeasurementPlan, SelectedTracks


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements from tracks before the loops are closed, checked against the description.

    Attributes:
        axes, home, datum: places of the axes
        distances: {label: [m]}
        betas: {name: [rad]}, empty without a still start
        centre: the remote centre, None where no sweep shows it
        warnings: of its sweep
        guess: a closed robot to begin with
    """

    axes: Axes
    home: Home
    datum: Datum
    distances: Mapping[str, Value]
    betas: Mapping[str, Value]
    centre: RcmReport | None
    warnings: tuple[str, ...]
    guess: Robot


def measure(
    plan: MeasurementPlan, recording: SelectedTracks, watch: Callable[[str], None]
) -> Measured:
    """Measure axes, angles and remote centre, and compare them with the description.

    Args:
        plan: what is measured
        recording: tracks of the bodies
        watch: called with the name of each step

    Raises:
        InputError: tracks that cannot be used, or are not those of a robot of this kind
    """
    tracks, loops, flat = recording.tracks, plan.loops, plan.closure == "parallelogram"
    likely = likely_labels(list(tracks.poses), plan.names)
    check_loops(recording.few, loops, plan.nominal, plan.pairs, likely)
    axes = measure_axes(tracks, loops, watch, sliding=not flat)
    axes, home = find_home(tracks, axes)
    first = axes.of_first_hinge()
    watch("remote centre")
    seen, warnings = _centre(plan, recording, first)
    datum = find_datum(axes, home, None if seen is None else seen.hinges.base_axis)
    # Axes that are taken for parallel are compared where the tracks know them best.
    measured = distances(axes, plan.pairs, None if flat else datum.points)
    plane = in_plane(axes, home)
    found_betas = betas(axes, home, plan.lines, datum.at_home) if home.still else {}
    guess = first_guess(loops, plane, home.poses, datum.at_home, flat)
    at_start = nominal_betas(plan.arm, loops.first, plan.lines)
    check_axes(
        tracks.file,
        {label: (value.value, plan.nominal[label]) for label, value in measured.items()},
        {name: (value.value, at_start[name]) for name, value in found_betas.items()},
        likely,
    )
    if seen is not None:
        check_centre((recording.sweep or tracks).file, seen, plan.arm, loops, likely)
    if recording.few_of_sweep is not None:
        check_loops(recording.few_of_sweep, loops, plan.nominal, plan.pairs, likely)
    return Measured(axes, home, datum, measured, found_betas, seen, warnings, guess)


def _centre(
    plan: MeasurementPlan, recording: SelectedTracks, first: Mapping[str, Axis]
) -> tuple[RcmReport | None, tuple[str, ...]]:
    """Find the remote centre where there is a sweep that shows it, with its warnings."""
    tracks, links = recording.tracks, plan.links
    if links is None:
        return None, ()
    if recording.sweep is not None:
        found = find_centre(recording.sweep, links, first)
        return found, found.warnings
    if links.base not in tracks.poses or links.body not in tracks.poses:
        return None, ()
    try:
        found = find_centre(tracks, links, first)
    except UndeterminedError:
        return None, ("no remote centre: nothing but the loops moves; sweep the base's joint too",)
    return found, tuple(text for text in found.warnings if text not in tracks.warnings)


def exchanged_labels(plan: MeasurementPlan, recording: SelectedTracks) -> list[tuple[Labels, ...]]:
    """Return the exchanges of labels under which tracks may be the arm's, the least first.

    Args:
        plan: what is measured
        recording: with the bodies under the names that do not fit

    Returns:
        {body: the label that it has} of each file
    """
    base = "" if plan.centre is None else plan.centre.base
    options = [
        fitting_labels(few, plan.loops, plan.nominal, plan.pairs, base)
        for few in (recording.few, recording.few_of_sweep)
        if few is not None
    ]
    tries = [
        labels
        for labels in product(*options)
        if any(body != label for one in labels for body, label in one.items())
    ]
    return sorted(tries, key=lambda every: sum(b != label for o in every for b, label in o.items()))
