"""From tracks of markers to one robot's geometry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar import __version__
from trocar.apps.calibration.axes import (
    Axes,
    Value,
    distances,
    measure_axes,
    shared_body,
)
from trocar.apps.calibration.betas import Line, betas
from trocar.apps.calibration.bodies import chosen_bodies, first_positions, seen_samples
from trocar.apps.calibration.geometry import Slot, home_points
from trocar.apps.calibration.home import Home, find_home
from trocar.apps.calibration.linkage import Linkage, linkage
from trocar.apps.calibration.patches import patches
from trocar.apps.calibration.placement import Centre, calibrated, remote_centre_of, still_point
from trocar.apps.calibration.records import Calibration, ClosureKind
from trocar.apps.calibration.refine import Refined, refine
from trocar.apps.calibration.start import Robot, first_guess
from trocar.apps.calibration.sweep_centre import CentreFound, base_axis, find_centre
from trocar.apps.calibration.tracks import Tracks
from trocar.descriptions import ArmDescription
from trocar.descriptions.calibration_plan import default_plan
from trocar.descriptions.overlay import Overlay
from trocar.errors import InputError, UndeterminedError
from trocar.kinematics.loops import loops_are_parallelograms

Array = NDArray[np.float64]

#: A side that differs from the closed geometry by this many standard deviations and this much is
#: worth a warning. Source: our own choice. [m]
SIGMAS, ABSORBED_M = 5.0, 1e-4


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
    """
    if arm.overlay is not None:
        raise InputError(f"{arm.name}: is calibrated already; give its description without overlay")
    loops = linkage(arm)
    closure = _closure(arm, loops, closure)
    centre = remote_centre_of(arm, loops)
    tracks, missing = chosen_bodies(tracks, loops, centre, bodies or {})
    axes, home = find_home(tracks.times, measure_axes(tracks, loops, watch))
    pairs, lines = _plan(arm)
    measured = distances(axes, pairs)
    found_betas = betas(axes, home, lines) if home.still else {}
    guess = first_guess(axes, home, closure == "parallelogram")
    samples, enough = seen_samples(tracks, axes, home, guess)
    first = first_positions(axes, home)[enough]
    refined = refine(guess, samples, first, closure == "parallelogram", watch)
    closed = _closed_distances(refined.robot, pairs)
    wander = None if centre is None else still_point(refined.robot, centre.body)[1]
    watch("remote centre")
    seen, told = _centre(tracks, rcm_tracks, arm, axes, centre, bodies or {})
    warnings = (
        *tracks.warnings,
        *missing,
        *axes.warnings,
        *_home_warnings(home, bool(lines)),
        *_closing_warnings(closure, measured, closed, refined, wander),
        *told,
    )
    if seen is not None and centre is not None and closure == "general":
        centre = replace(centre, axis=base_axis(seen.report))
    found = Calibration(
        arm=arm.name,
        closure=closure,
        axis_distances=measured,
        closed_distances={label: closed[label] for label in measured},
        nominal_distances=_closed_distances(replace(guess, moved=0.0 * guess.moved), pairs),
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


def _plan(arm: ArmDescription) -> tuple[dict[str, Line], dict[str, tuple[Line, Line]]]:
    """Return which distances and angles are wanted, by hinges."""
    plan = arm.calibration or default_plan(arm.mechanism)
    name = plan.axes
    pairs = {f"{a}-{b}": (name[a], name[b]) for a, b in plan.distances}
    lines = {
        beta: ((name[to[0]], name[to[1]]), (name[start[0]], name[start[1]]))
        for beta, (to, start) in plan.betas.items()
    }
    return pairs, lines


def _closed_distances(robot: Robot, pairs: Mapping[str, Line]) -> dict[str, float]:
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


def _home_warnings(home: Home, wanted: bool) -> tuple[str, ...]:
    if home.still:
        return ()
    return (
        "no still start of 0.5 s, so joint position 0 is taken where the linkage looks as the"
        " description has it there" + ("; the betas are absent" if wanted else ""),
    )


def _closing_warnings(
    closure: ClosureKind,
    measured: Mapping[str, Value],
    closed: Mapping[str, float],
    refined: Refined,
    wander: float | None,
) -> tuple[str, ...]:
    """Say what the closed geometry cannot explain."""
    if closure == "general":
        if wander is not None and wander > ABSORBED_M:
            return (
                f"the remote centre of this linkage wanders by {1e3 * wander:.2f} mm (RMS): no"
                " fixed one exists",
            )
        return ()
    off = {
        label: value.value - closed[label]
        for label, value in measured.items()
        if abs(value.value - closed[label]) > max(SIGMAS * value.sigma, ABSORBED_M)
    }
    if not off:
        return ()
    sides = ", ".join(f"{label} by {1e3 * by:+.2f} mm" for label, by in off.items())
    return (
        f"the loops do not close as parallelograms: measured sides differ from the closed geometry"
        f" ({sides}), so no fixed remote centre exists; the covariance is scaled by"
        f" {refined.misfit:.3g}. --closure general keeps the sides as they are",
    )


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
