"""From tracks of markers to one robot's geometry."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar import __version__
from trocar.descriptions import ArmDescription
from trocar.descriptions.axis_lines import home_lines, line_distance
from trocar.descriptions.calibration_plan import default_plan
from trocar.descriptions.overlay import (
    ClosurePatch,
    FramePatch,
    Overlay,
    closure_patch,
    frame_patch,
)
from trocar.errors import InputError, LabelsError, TracksError, UndeterminedError
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.kinematics.mechanism import Mechanism
from trocar.robot.calibration.axes import (
    Axes,
    Datum,
    Home,
    Pair,
    Value,
    betas,
    distances,
    find_datum,
    find_home,
    measure_axes,
    shared_body,
    slopes,
)
from trocar.robot.calibration.checks import (
    LEAST_SCALED,
    SCALE,
    check_axes,
    check_centre,
    named,
    nominal_betas,
    scale_of,
)
from trocar.robot.calibration.labels import check_loops, fitting_labels, labels_error, relabelled
from trocar.robot.calibration.linkage import (
    ClosureKind,
    LoopedPart,
    Slot,
    home_points,
    linkage,
    slots,
)
from trocar.robot.calibration.rcm import RcmReport, find_centre
from trocar.robot.calibration.refine import LEAST_BODIES, Refined, Samples, refine
from trocar.robot.calibration.robot import (
    Centre,
    Robot,
    calibrated,
    displaced,
    first_guess,
    level_of,
    levelled,
    mechanism_of,
    remote_centre_of,
    still_point,
)
from trocar.robot.calibration.tracks import Tracks, select_bodies, thinned

Array = NDArray[np.float64]

#: Noise is taken to be at least this, so that exact tracks can be weighted: rounding. [m], [rad]
LEAST_NOISE = (1e-10, 1e-9)
#: A side that differs from the closed geometry by this many standard deviations and this much is
#: worth a warning. Source: our own choice. [m]
SIGMAS, ABSORBED_M = 5.0, 1e-4
#: Axes that lean by more are worth a warning where their plane is not known. Source: our own
#: choice; over the size of a cluster of markers it makes 10 um. [rad]
SKEW_RAD = 1e-4


@dataclass(frozen=True, eq=False)
class Calibration:
    """One robot, measured.

    Attributes:
        arm: name of the description
        closure: how its loops close
        axis_distances: {label: as measured, each by itself [m]}
        closed_distances: {label: in the closed geometry [m]}
        nominal_distances: {label: in the description [m]}
        betas: {name: angle at home [rad]}, empty without a still start
        centre: the remote centre, None where no sweep shows it
        wander: root of the mean squared distance of the closed geometry's own remote centre from
            its middle [m]; None where the arm has none
        axes, home, refined: how it was found
        mechanism: the whole arm's, calibrated
        overlay: what is to be laid over the description
        warnings: what a user should know
    """

    arm: str
    closure: ClosureKind
    axis_distances: Mapping[str, Value]
    closed_distances: Mapping[str, float]
    nominal_distances: Mapping[str, float]
    betas: Mapping[str, Value]
    centre: RcmReport | None
    wander: float | None
    axes: Axes
    home: Home
    refined: Refined
    mechanism: Mechanism
    overlay: Overlay
    warnings: tuple[str, ...]

    @property
    def absorbed(self) -> dict[str, float]:
        """{label: by how much a distance changed to close the loops [m]}."""
        return {k: self.closed_distances[k] - v.value for k, v in self.axis_distances.items()}

    def as_dict(self) -> dict[str, Any]:
        """Return everything as one JSON document, in SI units; what cannot be had is absent."""
        closure: dict[str, Any] = {
            "kind": self.closure,
            "axis_distances_m": dict(self.closed_distances),
            "absorbed_m": self.absorbed,
            "misfit_m": self.refined.misfit_m,
            "chi_squared_per_freedom": self.refined.misfit,
        }
        if self.wander is not None:
            closure["remote_centre_wanders_m"] = self.wander
        axes = {
            self.axes.linkage.hinge(name).label: {
                "position_rms_m": fit.residual_position,
                "rotation_rms_rad": fit.residual_rotation,
                "span_rad": fit.span,
                "condition": fit.condition,
                "samples": int(fit.used.sum()),
                "outliers": fit.outliers,
            }
            for name, fit in self.axes.fits.items()
        }
        return {
            "arm": self.arm,
            "axis_distances_m": {k: v.as_dict() for k, v in self.axis_distances.items()},
            "beta_rad": {k: v.as_dict() for k, v in self.betas.items()},
            **({} if self.centre is None else {"rcm": self.centre.centre_dict()}),
            "closure": closure,
            "residuals": {
                "position_rms_m": self.refined.position_rms,
                "rotation_rms_rad": self.refined.rotation_rms,
                "samples": self.refined.samples,
                "axes": axes,
            },
            "warnings": list(self.warnings),
        }


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
        watch: called with the name of each step

    Raises:
        InputError: tracks that cannot be used, with what was got and what is needed
        FarFromNominalError: distances or angles that no robot of this kind has
        LabelsError: the same, by exchanged names of bodies
    """
    if arm.overlay is not None:
        raise InputError(
            f"{arm.name}: is already calibrated; allowed: the nominal description, without overlay"
        )
    loops, names = linkage(arm), bodies or {}
    parallel = loops_are_parallelograms(loops.mechanism)
    if closure == "parallelogram" and not parallel:
        raise InputError(
            f"{arm.name}: its loops are not parallelograms; allowed: closure 'general'"
        )
    closure = closure or ("parallelogram" if parallel else "general")
    asked = Asked(arm, loops, remote_centre_of(arm, loops), closure, *planned_figures(arm), names)
    tracks, missing = chosen_bodies(tracks, loops, asked.centre, names)
    try:
        seen_axes = _measure(asked, tracks, rcm_tracks, watch)
    except InputError as problem:
        watch("labels")
        raise _mislabelled(problem, asked, tracks, rcm_tracks) or problem from None
    axes, home, datum, guess = seen_axes.axes, seen_axes.home, seen_axes.datum, seen_axes.guess
    seen, centre, pairs, nominal = seen_axes.centre, asked.centre, asked.pairs, asked.nominal
    samples, enough = seen_samples(tracks, axes, home, guess)
    first = first_positions(axes, home)[enough]
    level = level_of(guess, datum.points)
    refined = refine(guess, samples, first, closure == "parallelogram", level, watch)
    if refined.robot.tilts:
        refined = replace(refined, robot=levelled(refined.robot, level))
    closed = _closed_distances(refined.robot, pairs)
    wander = None if centre is None else still_point(refined.robot, centre.body)[1]
    if centre is not None and closure == "general":
        centre = replace(centre, axis=None if seen is None else seen.hinges.base_axis)
    found = Calibration(
        arm=arm.name,
        closure=closure,
        axis_distances=seen_axes.distances,
        closed_distances={label: closed[label] for label in seen_axes.distances},
        nominal_distances=nominal,
        betas=seen_axes.betas,
        centre=seen,
        wander=wander,
        axes=axes,
        home=home,
        refined=refined,
        mechanism=calibrated(arm, refined.robot, centre),
        overlay=Overlay(arm.name),
        warnings=(),
    )
    warnings = (
        *tracks.warnings,
        *missing,
        *axes.warnings,
        *_cautions(found, datum, bool(asked.lines), centre is not None),
        *seen_axes.warnings,
    )
    frames, closures = patches(arm, refined, centre)
    source = {"file": tracks.file, "sha256": tracks.sha256, "version": f"trocar {__version__}"}
    if rcm_tracks is not None:
        source |= {"rcm_file": rcm_tracks.file, "rcm_sha256": rcm_tracks.sha256}
    document = found.as_dict()
    measured = {
        key: document[key]
        for key in ("axis_distances_m", "beta_rad", "closure", "rcm")
        if key in document
    }
    overlay = Overlay(arm.name, closure, frames, closures, measured, source, warnings)
    return replace(found, overlay=overlay, warnings=warnings)


@dataclass(frozen=True, eq=False)
class Asked:
    """What is measured, of which arm.

    Attributes:
        arm: the description
        loops: its loops
        centre: its remote centre, None without one
        closure: how the loops are to close
        pairs: {label: two hinges} of the axis distances
        lines: {name: (pair, pair)} of the angles at home
        names: {body: its name in the files} of those that are called otherwise
    """

    arm: ArmDescription
    loops: LoopedPart
    centre: Centre | None
    closure: ClosureKind
    pairs: Mapping[str, Pair]
    lines: Mapping[str, tuple[Pair, Pair]]
    names: Mapping[str, str]

    @property
    def bodies(self) -> tuple[str, ...]:
        """The bodies of the loops, and the base."""
        base = () if self.centre is None else (self.centre.base,)
        return tuple(dict.fromkeys((*self.loops.bodies, *base)))

    @property
    def nominal(self) -> dict[str, float]:
        """The axis distances in the description, {label: [m]}."""
        drawn = Robot(self.loops, np.zeros((len(slots(self.loops)), 2)), {}, {})
        return _flat_distances(drawn, self.pairs)


@dataclass(frozen=True, eq=False)
class Measured:
    """What tracks show before the loops are closed, checked against the description.

    Attributes:
        axes, home, datum: where the axes are
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


def _measure(
    asked: Asked, tracks: Tracks, sweep: Tracks | None, watch: Callable[[str], None]
) -> Measured:
    """Measure axes, angles and remote centre, and compare them with the description.

    Args:
        asked: what is measured
        tracks: with the bodies under the description's names
        sweep: of the remote centre, with the bodies as the file names them; None: in `tracks`
        watch: called with the name of each step

    Raises:
        InputError: tracks that cannot be used, or are not those of a robot of this kind
    """
    arm, loops, flat = asked.arm, asked.loops, asked.closure == "parallelogram"
    nominal = asked.nominal
    likely = named(list(tracks.poses), asked.names)
    check_loops(tracks, loops, nominal, asked.pairs, likely)
    axes = measure_axes(tracks, loops, watch, sliding=not flat)
    axes, home = find_home(tracks, axes)
    watch("remote centre")
    seen, warnings = _find_centre(tracks, sweep, arm, axes, asked.centre, asked.names)
    datum = find_datum(axes, home, None if seen is None else seen.hinges.base_axis)
    # Axes that are taken for parallel are compared where the tracks know them best.
    measured = distances(axes, asked.pairs, None if flat else datum.points)
    found_betas = betas(axes, home, asked.lines, datum.at_home) if home.still else {}
    guess = first_guess(axes, home, flat, datum.at_home)
    at_start = nominal_betas(arm, loops.first, asked.lines)
    check_axes(
        tracks.file,
        {label: (value.value, nominal[label]) for label, value in measured.items()},
        {name: (value.value, at_start[name]) for name, value in found_betas.items()},
        likely,
    )
    if seen is not None:
        check_centre((sweep or tracks).file, seen, arm, loops, likely)
    if sweep is not None:
        check_loops(_renamed(asked, sweep), loops, nominal, asked.pairs, likely)
    return Measured(axes, home, datum, measured, found_betas, seen, warnings, guess)


def _renamed(asked: Asked, sweep: Tracks) -> Tracks:
    """Return the sweep's bodies under the description's names, those that it has."""
    called = {body: asked.names.get(body, body) for body in asked.bodies}
    poses = {body: sweep.poses[name] for body, name in called.items() if name in sweep.poses}
    return replace(sweep, poses=poses)


def _mislabelled(
    problem: InputError, asked: Asked, tracks: Tracks, sweep: Tracks | None
) -> LabelsError | None:
    """Return which labels are exchanged, None if tracks that cannot be used fit under no others.

    Args:
        problem: what is wrong under these names
        asked: what is measured
        tracks: with the bodies under the description's names
        sweep: of the remote centre, with the bodies as the file names them; None: in `tracks`
    """
    base = "" if asked.centre is None else asked.centre.base
    nominal = asked.nominal
    options = [fitting_labels(tracks, asked.loops, nominal, asked.pairs, base)]
    if sweep is not None:
        swept = _renamed(asked, sweep)
        options.append(fitting_labels(swept, asked.loops, nominal, asked.pairs, base))
    tries = [
        labels
        for labels in product(*options)
        if any(body != label for one in labels for body, label in one.items())
    ]
    tries.sort(key=lambda every: sum(b != label for one in every for b, label in one.items()))
    for labels in tries:
        some = relabelled(thinned(tracks), labels[0], {})
        swept = None if sweep is None else relabelled(thinned(sweep), labels[1], asked.names)
        try:
            _measure(asked, some, swept, lambda _: None)
        except InputError:
            continue
        files = [tracks.file] if sweep is None else [tracks.file, sweep.file]
        return labels_error(problem, dict(zip(files, labels, strict=True)), asked.names)
    return None


def _cautions(found: Calibration, datum: Datum, has_betas: bool, has_centre: bool) -> Iterator[str]:
    """Yield warnings about what the tracks leave open and what the closed geometry cannot explain.

    Args:
        found: the calibration
        datum: where along the axes distances are taken
        has_betas: whether the arm's plan has angles at home
        has_centre: whether the arm has a remote centre
    """
    refined = found.refined
    if not found.home.still:
        yield (
            "no rest of 0.5 s at the start, so joint position 0 is where the linkage matches the"
            " nominal description" + ("; the betas are absent" if has_betas else "")
        )
    lengths = {k: (v.value, found.nominal_distances[k]) for k, v in found.axis_distances.items()}
    if len(lengths) >= LEAST_SCALED and abs(scale_of(lengths) - 1.0) > SCALE:
        yield (
            f"axis distances are {scale_of(lengths):.4f} times the nominal on average: check the"
            " scale of the tracking volume"
        )
    if not refined.settled:
        yield (
            f"the refinement has not come to rest after {len(refined.history) - 1} rounds, so the"
            " closed geometry is not quite the likeliest: longer or wider sweeps help"
        )
    skew = max((float(np.linalg.norm(tilt)) for tilt in refined.robot.tilts.values()), default=0.0)
    if not datum.shown and skew >= SKEW_RAD:
        yield (
            "where along the axes the drawing's plane is does not show: distances are taken midway"
            " between the clusters of the first axis' two links, and axes lean by up to"
            f" {1e3 * skew:.2f} mrad, which is as many um for each mm"
            + ("; sweep the base's joint too" if has_centre else "")
        )
    if found.closure == "general" and found.wander is not None and found.wander > ABSORBED_M:
        yield (
            f"the remote centre of this linkage moves by {1e3 * found.wander:.2f} mm (RMS): it is"
            " not a fixed point"
        )
    off = [
        f"{label} by {-1e3 * by:+.2f} mm"
        for label, by in found.absorbed.items()
        if abs(by) > max(SIGMAS * found.axis_distances[label].sigma, ABSORBED_M)
    ]
    if found.closure == "parallelogram" and off:
        yield (
            "the loops do not close as parallelograms: measured sides differ from the closed"
            f" geometry ({', '.join(off)}), so no fixed remote centre exists; the covariance is"
            f" scaled by {refined.misfit:.3g}. --closure general keeps the sides as they are"
        )


def chosen_bodies(
    tracks: Tracks, loops: LoopedPart, centre: Centre | None, names: Mapping[str, str]
) -> tuple[Tracks, tuple[str, ...]]:
    """Select the bodies of the linkage, with a warning that names missing ones.

    Raises:
        TracksError: a body that is named after this arm but is none of its links, a body that is
            needed and missing, or no body of the loops
    """
    wanted = dict.fromkeys(loops.bodies) | ({centre.base: None} if centre else {})
    unknown = [body for body in names if body not in wanted]
    unknown += [
        b
        for b in tracks.poses
        if b.startswith(f"{loops.arm}_") and b not in loops.known and b not in names.values()
    ]
    if unknown:
        raise TracksError(
            tracks.file,
            f"unknown bodies: {', '.join(unknown)}; found: {', '.join(tracks.poses)}; expected:"
            f" {', '.join(wanted)}",
        )
    # The base may be missing, and passive links with two hinges.
    driven = {loops.body_of.get(f) for j in loops.mechanism.joints for f, _ in j.drive}
    needed = {loops.ground, *driven} | ({centre.body} if centre else set())
    optional = [b for b in loops.bodies if b not in needed and len(loops.carried(b)) == 2]
    optional += [b for b in wanted if b not in loops.bodies]
    chosen = select_bodies(tracks, {b: names.get(b, b) for b in wanted}, optional)
    if not set(chosen.poses) & set(loops.bodies):
        raise TracksError(tracks.file, f"no body of {loops.arm}'s loops")
    missing = [body for body in loops.bodies if body not in chosen.poses]
    if not missing:
        return chosen, ()
    return chosen, (
        f"not in the tracks: {', '.join(missing)}; the geometry of these links is not calibrated,"
        " and their axis distances are absent",
    )


def seen_samples(
    tracks: Tracks, axes: Axes, home: Home, robot: Robot
) -> tuple[Samples, NDArray[np.bool_]]:
    """Gather the poses of the linkage's bodies, without what the hinges found far off."""
    bodies = list(robot.markers)
    poses = np.stack([tracks.poses[body] for body in bodies], axis=1)
    seen = np.asarray(np.isfinite(poses).all(axis=(2, 3)))
    for i, body in enumerate(bodies):
        fits = [axes.fits[name] for name in axes.linkage.carried(body) if name in axes.fits]
        seen[:, i] &= np.stack([fit.used for fit in fits]).any(axis=0)
    poses = np.where(seen[..., None, None], poses, np.eye(4))
    enough = seen.sum(axis=1) >= min(LEAST_BODIES, len(bodies))
    position, rotation = axes.noise
    sigmas = (max(position, LEAST_NOISE[0]), max(rotation, LEAST_NOISE[1]))
    some = Samples(poses[enough], seen[enough], home.samples[enough], sigmas, axes.widened)
    return some, enough


def first_positions(axes: Axes, home: Home) -> Array:
    """Guess the joint positions from the hinges' angles, (n, n_moving) [rad]."""
    loops = axes.linkage
    columns = list(loops.joints)
    normal = np.zeros((len(home.samples), len(columns), len(columns)))
    right = np.zeros((len(home.samples), len(columns)))
    for name, zero in home.angles.items():
        hinge = loops.hinge(name)
        row = (loops.turns[hinge.body_b] - loops.turns[hinge.body_a])[columns]
        away = np.angle(np.exp(1j * (axes.angles(name) - zero.value)))
        known = np.isfinite(away)
        normal += known[:, None, None] * np.outer(row, row)
        right += np.where(known, away, 0.0)[:, None] * row
    normal += 1e-9 * np.eye(len(columns))
    return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], dtype=np.float64)


def planned_figures(arm: ArmDescription) -> tuple[dict[str, Pair], dict[str, tuple[Pair, Pair]]]:
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


def _find_centre(
    tracks: Tracks,
    rcm_tracks: Tracks | None,
    arm: ArmDescription,
    axes: Axes,
    centre: Centre | None,
    names: Mapping[str, str],
) -> tuple[RcmReport | None, tuple[str, ...]]:
    """Find the remote centre where there is a sweep that shows it."""
    if centre is None:
        if rcm_tracks is not None:
            raise InputError(f"{arm.name}: has no remote centre, got {rcm_tracks.file}")
        return None, ()
    if rcm_tracks is not None:
        found = find_centre(rcm_tracks, arm, axes, centre, names)
        return found, found.warnings
    if centre.base not in tracks.poses or centre.body not in tracks.poses:
        return None, ()
    try:
        found = find_centre(tracks, arm, axes, centre, {})
    except UndeterminedError:
        return None, ("no remote centre: nothing but the loops moves; sweep the base's joint too",)
    return found, tuple(text for text in found.warnings if text not in tracks.warnings)


def patches(
    arm: ArmDescription, refined: Refined, centre: Centre | None
) -> tuple[dict[str, FramePatch], dict[str, ClosurePatch]]:
    """Return what the calibrated linkage replaces in its description, with standard deviations.

    Returns:
        {frame: patch} and {closure: patch}
    """
    robot, linkage = refined.robot, refined.robot.linkage
    axis = None if centre is None else centre.axis
    frames = [hinge.name for hinge in linkage.tree]
    frames += [centre.slide] if centre is not None else []
    tilted = list(refined.tilted)
    if axis is not None:  # the whole linkage may lean
        ground = [hinge.name for hinge in linkage.tree if hinge.body_a == linkage.ground]
        tilted += [name for name in ground if name not in tilted]

    def places(robot: Robot, centre: Centre | None) -> Array:
        """Return points of frames and of closures, and tilts, (3 n,) [m, rad]."""
        mechanism = calibrated(arm, robot, centre)
        parts = [mechanism.frame(name).before[:3, 3] for name in frames]
        for closure in mechanism.closures:
            parts += [closure.point_a, closure.point_b]
        # A small turn of a frame about its own x and y shows in its z axis as the parent has it.
        for name in tilted:
            start = linkage.mechanism.frame(name).before[:3, :3]
            z = start.T @ mechanism.frame(name).before[:3, 2]
            parts.append(np.array([-z[1], z[0], 0.0]))
        return np.concatenate(parts)

    def of_geometry(step: Array) -> Array:
        return places(displaced(robot, refined.basis, refined.tilted, step), centre)

    slope = slopes(of_geometry, np.zeros(len(refined.covariance)))
    variance = np.einsum("ij,jk,ik->i", slope, refined.covariance, slope)
    if centre is not None and axis is not None:

        def of_axis(step: Array) -> Array:
            moved = replace(axis, point=axis.point + step[:3], direction=axis.direction + step[3:])
            return places(robot, replace(centre, axis=moved))

        slope = slopes(of_axis, np.zeros(6))
        variance += np.einsum("ij,jk,ik->i", slope, axis.covariance, slope)
    sigma = list(np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 3))
    mechanism = calibrated(arm, robot, centre)
    of_tilts = dict(zip(tilted, sigma[len(frames) + 2 * len(mechanism.closures) :], strict=True))
    patched = {
        name: replace(
            frame_patch(mechanism.frame(name)), xyz_sigma=sigma[i], rpy_sigma=of_tilts.get(name)
        )
        for i, name in enumerate(frames)
    }
    closures = {
        closure.name: replace(
            closure_patch(closure, slides=bool(refined.tilted)),
            point_a_sigma=sigma[len(frames) + 2 * i],
            point_b_sigma=sigma[len(frames) + 2 * i + 1],
        )
        for i, closure in enumerate(mechanism.closures)
    }
    return patched, closures
