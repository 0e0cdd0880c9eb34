"""From tracks of markers to one robot's geometry."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar import __version__
from trocar.descriptions import ArmDescription
from trocar.descriptions.overlay import (
    ClosurePatch,
    FramePatch,
    Overlay,
    closure_patch,
    frame_patch,
)
from trocar.errors import InputError
from trocar.fitting.adjust import slopes
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.kinematics.mechanism import Mechanism
from trocar.robot.calibration.axes import Axes, Datum, Home, Value
from trocar.robot.calibration.checks import LEAST_SCALED, SCALE, scale_of
from trocar.robot.calibration.labels import Labels, labels_that_fit
from trocar.robot.calibration.linkage import ClosureKind, linkage
from trocar.robot.calibration.measure import Measured, exchanged_labels, measure
from trocar.robot.calibration.rcm import RcmReport
from trocar.robot.calibration.refine import Refined, refine, seen_samples
from trocar.robot.calibration.robot import (
    Centre,
    Robot,
    calibrated,
    closed_distances,
    displaced,
    level_of,
    levelled,
    still_point,
)
from trocar.robot.calibration.selection import (
    MeasurementPlan,
    SelectedTracks,
    plan_of,
    selected_tracks,
)
from trocar.robot.calibration.tracks import Tracks

Array = NDArray[np.float64]

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
            self.axes.linkage.hinge[name].label: {
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
    loops = linkage(arm)
    parallel = loops_are_parallelograms(loops.mechanism)
    if closure == "parallelogram" and not parallel:
        raise InputError(
            f"{arm.name}: its loops are not parallelograms; allowed: closure 'general'"
        )
    plan = plan_of(arm, loops, closure or ("parallelogram" if parallel else "general"), bodies)
    recording = selected_tracks(plan, tracks, rcm_tracks)
    try:
        seen = measure(plan, recording, watch)
    except InputError as problem:
        watch("labels")
        tries = exchanged_labels(plan, recording)

        def fits(labels: Sequence[Labels]) -> object:
            return measure(plan, recording.relabelled(labels), lambda _: None)

        raise (
            labels_that_fit(problem, recording.files, tries, fits, plan.names) or problem
        ) from None
    level = level_of(seen.guess, seen.datum.points)
    samples, first = seen_samples(recording.tracks, seen.axes, seen.home, seen.guess)
    refined = refine(seen.guess, samples, first, plan.closure == "parallelogram", level, watch)
    if refined.robot.tilts:
        refined = replace(refined, robot=levelled(refined.robot, level))
    return _calibration(plan, recording, seen, refined)


def _calibration(
    plan: MeasurementPlan, recording: SelectedTracks, seen: Measured, refined: Refined
) -> Calibration:
    """Return the calibration of a refined robot, with its overlay."""
    tracks, sweep = recording.tracks, recording.sweep
    arm, centre = plan.arm, plan.centre
    closed = closed_distances(refined.robot, plan.pairs)
    wander = None if centre is None else still_point(refined.robot, centre.body)[1]
    if centre is not None and plan.closure == "general":
        axis = None if seen.centre is None else seen.centre.hinges.base_axis
        centre = replace(centre, axis=axis)
    found = Calibration(
        arm=arm.name,
        closure=plan.closure,
        axis_distances=seen.distances,
        closed_distances={label: closed[label] for label in seen.distances},
        nominal_distances=plan.nominal,
        betas=seen.betas,
        centre=seen.centre,
        wander=wander,
        axes=seen.axes,
        home=seen.home,
        refined=refined,
        mechanism=calibrated(arm, refined.robot, centre),
        overlay=Overlay(arm.name),
        warnings=(),
    )
    warnings = (
        *tracks.warnings,
        *recording.warnings,
        *seen.axes.warnings,
        *_cautions(found, seen.datum, bool(plan.lines), centre is not None),
        *seen.warnings,
    )
    frames, closures = patches(arm, refined, centre)
    source = {"file": tracks.file, "sha256": tracks.sha256, "version": f"trocar {__version__}"}
    if sweep is not None:
        source |= {"rcm_file": sweep.file, "rcm_sha256": sweep.sha256}
    document = found.as_dict()
    measured = {
        key: document[key]
        for key in ("axis_distances_m", "beta_rad", "closure", "rcm")
        if key in document
    }
    overlay = Overlay(arm.name, plan.closure, frames, closures, measured, source, warnings)
    return replace(found, overlay=overlay, warnings=warnings)


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


def patches(
    arm: ArmDescription, refined: Refined, centre: Centre | None
) -> tuple[dict[str, FramePatch], dict[str, ClosurePatch]]:
    """Return the calibrated linkage's patches of its description, with standard deviations.

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
