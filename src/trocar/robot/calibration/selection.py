"""Selection of the tracks of the bodies that count, after the plan of an arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from trocar.descriptions import ArmDescription
from trocar.descriptions.calibration_plan import Pair, default_plan
from trocar.errors import InputError, TracksError
from trocar.robot.calibration.axes import LEAST_SAMPLES
from trocar.robot.calibration.labels import Labels, relabelled
from trocar.robot.calibration.linkage import ClosureKind, LoopedPart
from trocar.robot.calibration.rcm import CentreLinks, centre_links
from trocar.robot.calibration.robot import Centre, nominal_distances, remote_centre_of
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


def selected_tracks(plan: MeasurementPlan, tracks: Tracks, sweep: Tracks | None) -> SelectedTracks:
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
