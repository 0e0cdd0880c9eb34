"""From tracks of markers to one robot's geometry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar import __version__
from trocar.apps.calibration.axes import (
    Axes,
    distances,
    measure_axes,
    shared_body,
)
from trocar.apps.calibration.betas import Pair, betas
from trocar.apps.calibration.bodies import chosen_bodies, first_positions, seen_samples
from trocar.apps.calibration.cautions import (
    closing_warnings,
    datum_warnings,
    home_warnings,
    rest_warnings,
)
from trocar.apps.calibration.datum import find_datum
from trocar.apps.calibration.geometry import Slot, home_points
from trocar.apps.calibration.home import find_home
from trocar.apps.calibration.level import level_of, levelled
from trocar.apps.calibration.linkage import Linkage, linkage
from trocar.apps.calibration.motion import mechanism_of
from trocar.apps.calibration.nominal import check_axes, check_centre, named, nominal_betas
from trocar.apps.calibration.patches import patches
from trocar.apps.calibration.placement import Centre, calibrated, remote_centre_of, still_point
from trocar.apps.calibration.records import Calibration, ClosureKind
from trocar.apps.calibration.refine import refine
from trocar.apps.calibration.start import Robot, first_guess
from trocar.apps.calibration.sweep_centre import CentreFound, base_axis, find_centre
from trocar.apps.calibration.tracks import Tracks
from trocar.descriptions import ArmDescription
from trocar.descriptions.axis_lines import home_lines, line_distance
from trocar.descriptions.calibration_plan import default_plan
from trocar.descriptions.overlay import Overlay
from trocar.errors import InputError, UndeterminedError
from trocar.kinematics.loops import loops_are_parallelograms

Array = NDArray[np.float64]


def calibrate(
    tracks: Tracks,
    arm: ArmDescription,
    rcm_tracks: Tracks | None = None,
    closure: ClosureKind | None = None,
    *,
    bodies: Mapping[str, str] | None = None,
    watch: Callable[[str], None] = lambda _: None,
) -> Calibration:
    """Measure one robot.

    Args:
        tracks: a still start, then a sweep of the joints that move the loops
        arm: the description of its kind
        rcm_tracks: a sweep that turns the base's joint too, where `tracks` has none
        closure: "parallelogram" or "general"; by default what the description's loops are
        bodies: {body: its name in the files} of those that are called otherwise
        watch: is told what is being done

    Raises:
        InputError: tracks that cannot be used, with what was got and what is needed
        FarFromNominalError: distances or angles that no robot of this kind has, as exchanged names
            of bodies make them
    """
    if arm.overlay is not None:
        raise InputError(f"{arm.name}: is calibrated already; give its description without overlay")
    loops = linkage(arm)
    closure = _closure(arm, loops, closure)
    centre = remote_centre_of(arm, loops)
    tracks, missing = chosen_bodies(tracks, loops, centre, bodies or {})
    found_axes = measure_axes(tracks, loops, watch, sliding=closure == "general")
    axes, home = find_home(tracks.times, found_axes)
    pairs, lines = _plan(arm)
    watch("remote centre")
    seen, told = _centre(tracks, rcm_tracks, arm, axes, centre, bodies or {})
    base = None if seen is None else base_axis(seen.report)
    datum = find_datum(axes, home, base)
    # Axes that are taken for parallel are compared where the tracks know them best.
    measured = distances(axes, pairs, None if closure == "parallelogram" else datum.points)
    found_betas = betas(axes, home, lines, datum.at_home) if home.still else {}
    guess = first_guess(axes, home, closure == "parallelogram", datum.at_home)
    nominal = _flat_distances(replace(guess, moved=0.0 * guess.moved), pairs)
    names = named(list(tracks.poses), bodies or {})
    at_start = nominal_betas(arm, loops.first, lines)
    check_axes(
        tracks.file,
        {label: (value.value, nominal[label]) for label, value in measured.items()},
        {name: (value.value, at_start[name]) for name, value in found_betas.items()},
        names,
    )
    if seen is not None:
        check_centre((rcm_tracks or tracks).file, seen, arm, loops, names)
    samples, enough = seen_samples(tracks, axes, home, guess)
    first = first_positions(axes, home)[enough]
    level = level_of(guess, datum.points)
    refined = refine(guess, samples, first, closure == "parallelogram", level, watch)
    if refined.robot.tilts:
        refined = replace(refined, robot=levelled(refined.robot, level))
    closed = _closed_distances(refined.robot, pairs)
    wander = None if centre is None else still_point(refined.robot, centre.body)[1]
    warnings = (
        *tracks.warnings,
        *missing,
        *axes.warnings,
        *home_warnings(home, bool(lines)),
        *rest_warnings(refined),
        *datum_warnings(datum, refined, centre is not None),
        *closing_warnings(closure, measured, closed, refined, wander),
        *told,
    )
    if centre is not None and closure == "general":
        centre = replace(centre, axis=base)
    found = Calibration(
        arm=arm.name,
        closure=closure,
        axis_distances=measured,
        closed_distances={label: closed[label] for label in measured},
        nominal_distances=nominal,
        betas=found_betas,
        centre=seen,
        wander=wander,
        axes=axes,
        home=home,
        refined=refined,
        mechanism=calibrated(arm, refined.robot, centre),
        overlay=Overlay(arm.name),
        warnings=warnings,
    )
    return replace(found, overlay=_overlay(arm, found, tracks, rcm_tracks, centre))


def _closure(arm: ArmDescription, loops: Linkage, wanted: ClosureKind | None) -> ClosureKind:
    parallel = loops_are_parallelograms(loops.mechanism)
    if wanted == "parallelogram" and not parallel:
        raise InputError(
            f"{arm.name}: its loops are no parallelograms; allowed: the closure 'general'"
        )
    return wanted or ("parallelogram" if parallel else "general")


def _plan(arm: ArmDescription) -> tuple[dict[str, Pair], dict[str, tuple[Pair, Pair]]]:
    """Return which distances and angles are wanted, by hinges."""
    plan = arm.calibration or default_plan(arm.mechanism)
    name = plan.axes
    pairs = {f"{a}-{b}": (name[a], name[b]) for a, b in plan.distances}
    lines = {
        beta: ((name[to[0]], name[to[1]]), (name[start[0]], name[start[1]]))
        for beta, (to, start) in plan.betas.items()
    }
    return pairs, lines


def _closed_distances(robot: Robot, pairs: Mapping[str, Pair]) -> dict[str, float]:
    """Return the distances of axes in the closed geometry, {label: [m]}."""
    found = _flat_distances(robot, pairs)
    if not robot.tilts:
        return found
    lines = home_lines(mechanism_of(robot), {h.name: h.name for h in robot.linkage.hinges})
    through = lines[robot.linkage.first].point
    at = {label: [lines[name] for name in pairs[label]] for label in found}
    return {label: line_distance(one, two, through) for label, (one, two) in at.items()}


def _flat_distances(robot: Robot, pairs: Mapping[str, Pair]) -> dict[str, float]:
    """Return the same where all axes are parallel."""
    points = home_points(robot.linkage, robot.moved)
    found: dict[str, float] = {}
    for label, (one, two) in pairs.items():
        body = shared_body(robot.linkage, one, two)
        if body is not None:
            between = points[Slot(one, body)] - points[Slot(two, body)]
            found[label] = float(np.linalg.norm(between))
    return found


def _centre(
    tracks: Tracks,
    rcm_tracks: Tracks | None,
    arm: ArmDescription,
    axes: Axes,
    centre: Centre | None,
    names: Mapping[str, str],
) -> tuple[CentreFound | None, tuple[str, ...]]:
    """Find the remote centre where there is a sweep that shows it."""
    if centre is None:
        if rcm_tracks is not None:
            raise InputError(f"{arm.name}: has no remote centre, got {rcm_tracks.file}")
        return None, ()
    if rcm_tracks is not None:
        found = find_centre(rcm_tracks, arm, axes, centre, names)
        return found, found.report.warnings
    if centre.base not in tracks.poses or centre.body not in tracks.poses:
        return None, ()
    try:
        found = find_centre(tracks, arm, axes, centre, {})
    except UndeterminedError:
        return None, ("no remote centre: nothing but the loops moves; sweep the base's joint too",)
    return found, tuple(text for text in found.report.warnings if text not in tracks.warnings)


def _overlay(
    arm: ArmDescription,
    found: Calibration,
    tracks: Tracks,
    rcm_tracks: Tracks | None,
    centre: Centre | None,
) -> Overlay:
    frames, closures = patches(arm, found.refined, centre)
    source = {"file": tracks.file, "sha256": tracks.sha256, "version": f"trocar {__version__}"}
    if rcm_tracks is not None:
        source |= {"rcm_file": rcm_tracks.file, "rcm_sha256": rcm_tracks.sha256}
    document = found.as_dict()
    measured = {key: document[key] for key in ("axis_distances_m", "beta_rad", "closure")}
    if found.centre is not None:
        measured["rcm"] = found.centre.as_dict()
    return Overlay(arm.name, found.closure, frames, closures, measured, source, found.warnings)
