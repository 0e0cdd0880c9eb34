"""Measurements of a robot from tracks before its loops are closed, checked with its description."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

from trocar.descriptions import ArmDescription
from trocar.descriptions.calibration_plan import Pair, default_plan
from trocar.errors import InputError, TracksError, UndeterminedError
from trocar.fitting import Axis
from trocar.robot.calibration.axes import (
    LEAST_SAMPLES,
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
    relabelled,
)
from trocar.robot.calibration.linkage import ClosureKind, LoopedPart
from trocar.robot.calibration.rcm import CentreLinks, RcmReport, centre_links, find_centre
from trocar.robot.calibration.robot import (
    Centre,
    Robot,
    first_guess,
    nominal_distances,
    remote_centre_of,
)
from trocar.robot.calibration.tracks import Tracks, check_together, select_bodies, thinned


@dataclass(frozen=True, eq=False)
class MeasurementPlan:
    """Quantities of an arm to be measured.

    Attributes:
        arm: the description
        loops: its loops
        centre: its remote centre, None without one
        links: the bodies of the remote centre, None without one
        closure: how the loops are to close
        pairs: {label: two hinges} of the axis distances
        lines: {name: (pair, pair)} of the angles at home
        nominal: the axis distances in the description, {label: [m]}
        names: {body: its name in the files} of those that are called otherwise
    """

    arm: ArmDescription
    loops: LoopedPart
    centre: Centre | None
    links: CentreLinks | None
    closure: ClosureKind
    pairs: Mapping[str, Pair]
    lines: Mapping[str, tuple[Pair, Pair]]
    nominal: Mapping[str, float]
    names: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class SelectedTracks:
    """Tracks of the bodies that count, under the description's names.

    Attributes:
        tracks: of the loops, and of the base where the file has it
        few: some of their samples
        sweep: of the remote centre, None where `tracks` is to show it
        few_of_sweep: some of its samples
        warnings: what a user should know
    """

    tracks: Tracks
    few: Tracks
    sweep: Tracks | None
    few_of_sweep: Tracks | None
    warnings: tuple[str, ...] = ()

    def relabelled(self, labels: Sequence[Labels]) -> SelectedTracks:
        """Return some of the samples with their bodies' names put right.

        Args:
            labels: {body: the label that it has} of each file
        """
        few = relabelled(self.few, labels[0])
        swept = None if self.few_of_sweep is None else relabelled(self.few_of_sweep, labels[1])
        return SelectedTracks(few, few, swept, swept, self.warnings)

    @property
    def files(self) -> list[str]:
        """Return the files of the tracks."""
        return [part.file for part in (self.tracks, self.sweep) if part is not None]


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


def plan_of(
    arm: ArmDescription,
    loops: LoopedPart,
    closure: ClosureKind,
    names: Mapping[str, str] | None = None,
) -> MeasurementPlan:
    """Return the plan of an arm.

    Args:
        arm: the description
        loops: its loops
        closure: how the loops are to close
        names: {body: its name in the files} of those that are called otherwise
    """
    centre = remote_centre_of(arm, loops)
    pairs, lines = planned_figures(arm)
    return MeasurementPlan(
        arm=arm,
        loops=loops,
        centre=centre,
        links=None if centre is None else centre_links(arm),
        closure=closure,
        pairs=pairs,
        lines=lines,
        nominal=nominal_distances(loops, pairs),
        names=names or {},
    )


def planned_figures(arm: ArmDescription) -> tuple[dict[str, Pair], dict[str, tuple[Pair, Pair]]]:
    """Return the distances and angles of an arm's plan, by hinges: (pairs, lines)."""
    plan = arm.calibration or default_plan(arm.mechanism)
    name = plan.axes
    pairs = {f"{a}-{b}": (name[a], name[b]) for a, b in plan.distances}
    lines = {
        beta: ((name[to[0]], name[to[1]]), (name[start[0]], name[start[1]]))
        for beta, (to, start) in plan.betas.items()
    }
    return pairs, lines


def record(plan: MeasurementPlan, tracks: Tracks, sweep: Tracks | None) -> SelectedTracks:
    """Select the bodies that count from files of tracks.

    Args:
        plan: what is measured
        tracks: of the loops, as read
        sweep: of the remote centre, as read; None: in `tracks`

    Raises:
        InputError: a sweep of an arm without a remote centre
        TracksError: bodies that are missing, unknown, or not tracked together
    """
    if sweep is not None and plan.centre is None:
        raise InputError(f"{plan.arm.name}: has no remote centre, got {sweep.file}")
    chosen, missing = chosen_bodies(tracks, plan.loops, plan.centre, plan.names)
    swept = None if sweep is None else _sweep_bodies(plan, sweep)
    pairs = [(hinge.body_a, hinge.body_b) for hinge in plan.loops.hinges]
    if plan.links is not None and sweep is None:
        pairs.append((plan.links.base, plan.links.body))
    for pair in pairs:
        if chosen.poses.keys() >= set(pair):
            check_together(chosen, *pair, LEAST_SAMPLES)
    if plan.links is not None and swept is not None:
        check_together(swept, plan.links.base_in(swept), plan.links.body, LEAST_SAMPLES)
    few = None if swept is None else thinned(swept)
    return SelectedTracks(chosen, thinned(chosen), swept, few, missing)


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
        name
        for name in tracks.poses
        if name.startswith(f"{loops.arm}_")
        and name not in loops.known
        and name not in names.values()
    ]
    if unknown:
        raise TracksError(
            tracks.file,
            f"unknown bodies: {', '.join(unknown)}; found: {', '.join(tracks.poses)}; expected:"
            f" {', '.join(wanted)}",
        )
    # The base may be missing, and passive links with two hinges.
    driven = {loops.body_of.get(f) for j in loops.mechanism.joints for f, _ in j.drive}
    needed = {loops.ground, *driven} | ({centre.body} if centre else set[str]())
    optional = [b for b in loops.bodies if b not in needed and len(loops.carried[b]) == 2]
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


def _sweep_bodies(plan: MeasurementPlan, sweep: Tracks) -> Tracks:
    """Select the bodies of the remote centre, and those of the loops that are there besides."""
    called = {body: plan.names.get(body, body) for body in plan.loops.bodies}
    others = {b: sweep.poses[name] for b, name in called.items() if name in sweep.poses}
    chosen = plan.links.selected(sweep, plan.names) if plan.links is not None else sweep
    return replace(chosen, poses={**others, **chosen.poses})


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
