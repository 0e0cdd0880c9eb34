"""Labels of the bodies of tracks: exchanges of names after which the bodies fit the arm."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from trocar.descriptions.axis_lines import Line, line_distance
from trocar.descriptions.calibration_plan import Pair
from trocar.errors import FarFromNominalError, InputError, LabelsError, TracksError
from trocar.fitting import LEAST_SPAN, SMALL_SPAN, rough_hinge
from trocar.geometry import inverse
from trocar.robot.calibration.axes import LEAST_SAMPLES, WRONG_M, check_span, shared_body
from trocar.robot.calibration.checks import check_axes, distance_bound
from trocar.robot.calibration.linkage import APART_M, LoopedPart
from trocar.robot.calibration.tracks import Tracks

Labels = Mapping[str, str]


@dataclass(frozen=True)
class Condition:
    """Condition that some bodies satisfy if they are the links of the arm.

    Attributes:
        bodies: the links
        holds: given the bodies of the tracks that have these links' places
    """

    bodies: tuple[str, ...]
    holds: Callable[[Sequence[str]], bool]


@dataclass(frozen=True, eq=False)
class RoughHinge:
    """The axis of two bodies as some of the samples show it.

    Attributes:
        lines: in the first body, and in the second
        span: by which they turn about it [rad]
        missed: how far they are from turning about it, median [m]
    """

    lines: tuple[Line, Line]
    span: float
    missed: float


def rough_hinges(
    tracks: Tracks, pairs: Iterable[tuple[str, str]]
) -> dict[tuple[str, str], RoughHinge]:
    """Return the axes of pairs of bodies, of those that are tracked together, both ways round."""
    found: dict[tuple[str, str], RoughHinge] = {}
    for one, two in pairs:
        both = tracks.together(one, two)
        if both.sum() < LEAST_SAMPLES:
            continue
        T = inverse(tracks.poses[one][both]) @ tracks.poses[two][both]
        model, used = rough_hinge(T)
        away = (model.poses() - T)[:, :3, 3]
        lines = (
            Line(model.before[:3, 3], model.before[:3, 2]),
            Line(-model.after[:3, :3].T @ model.after[:3, 3], model.after[2, :3]),
        )
        span = float(np.ptp(model.theta[used])) if used.any() else 0.0
        hinge = RoughHinge(lines, span, float(np.median(np.linalg.norm(away, axis=1))))
        found[one, two] = hinge
        found[two, one] = replace(hinge, lines=(lines[1], lines[0]))
    return found


def check_loops(
    tracks: Tracks,
    linkage: LoopedPart,
    nominal: Mapping[str, float],
    pairs: Mapping[str, Pair],
    names: str,
) -> None:
    """Reject tracks whose loops are not those of any robot of this kind, before all else.

    Loops that hardly move, and bodies that do not turn about an axis, are left to others.

    Args:
        tracks: some samples, their bodies under the description's names
        linkage: the loops
        nominal: {label: distance [m]}
        pairs: {label: two hinges} of the distances
        names: which bodies were taken for the links

    Raises:
        InputError: bodies that do not turn where others do
        FarFromNominalError: with every distance that is too far off
    """
    known = [h for h in linkage.hinges if {h.body_a, h.body_b} <= set(tracks.poses)]
    fits = rough_hinges(tracks, [(h.body_a, h.body_b) for h in known])
    if max((fit.span for fit in fits.values()), default=0.0) < SMALL_SPAN:
        return
    for hinge in known:
        if (hinge.body_a, hinge.body_b) in fits:
            check_span(tracks.file, hinge, fits[hinge.body_a, hinge.body_b].span)
    measured: dict[str, tuple[float, float]] = {}
    for label, drawn in nominal.items():
        ends = _ends(linkage, pairs[label])
        if ends is not None and drawn > APART_M and all((ends[0], e) in fits for e in ends[1:]):
            one, two = (fits[ends[0], end] for end in ends[1:])
            if max(one.missed, two.missed) < WRONG_M:
                measured[label] = _distance(one, two), drawn
    if measured:
        check_axes(tracks.file, measured, {}, names)


def fitting_labels(
    tracks: Tracks,
    linkage: LoopedPart,
    nominal: Mapping[str, float],
    pairs: Mapping[str, Pair],
    base: str,
) -> list[dict[str, str]]:
    """Return every permutation of the bodies under which the tracks may be the described arm's.

    Bodies that share a hinge turn about one axis, the base turns or rests on the ground of the
    loops, and every axis distance is near the nominal one.

    Args:
        tracks: some samples, their bodies under the description's names
        linkage: the loops
        nominal: {label: distance [m]}
        pairs: {label: two hinges} of the distances
        base: the body on which the ground of the loops turns, "" without one

    Returns:
        {body: label that it has in the tracks}
    """
    bodies = [b for b in dict.fromkeys((*linkage.bodies, base)) if b in tracks.poses]
    fits = rough_hinges(tracks, combinations(bodies, 2))
    bound = distance_bound(nominal.values())

    def turns(labels: Sequence[str]) -> bool:
        return rests(labels) and fits[labels[0], labels[1]].span >= LEAST_SPAN

    def rests(labels: Sequence[str]) -> bool:
        fit = fits.get((labels[0], labels[1]))
        return fit is not None and fit.missed < WRONG_M

    wanted = [Condition((h.body_a, h.body_b), turns) for h in linkage.hinges]
    wanted.append(Condition((base, linkage.ground), rests))
    for label, drawn in nominal.items():
        ends = _ends(linkage, pairs[label])
        if ends is not None and drawn > APART_M:

            def near(labels: Sequence[str], drawn: float = drawn) -> bool:
                one, two = (fits.get((labels[0], other)) for other in labels[1:])
                return one is None or two is None or abs(_distance(one, two) - drawn) <= bound

            wanted.append(Condition(ends, near))
    return list(_permuted(bodies, wanted, {}))


def _ends(linkage: LoopedPart, pair: Pair) -> tuple[str, str, str] | None:
    """Return the body that carries two hinges, and the other body of each."""
    body = shared_body(linkage, *pair)
    if body is None:
        return None
    one, two = (linkage.hinge[name] for name in pair)
    first = one.body_b if body == one.body_a else one.body_a
    return body, first, two.body_b if body == two.body_a else two.body_a


def _distance(one: RoughHinge, two: RoughHinge) -> float:
    return line_distance(one.lines[0], two.lines[0], one.lines[0].point)


def likely_labels(bodies: Sequence[str], names: Labels) -> str:
    """Return the likely cause of figures that are far off, with the name in the file of each body.

    Args:
        bodies: those that were used
        names: {body: its name in the file} of those that are called otherwise
    """
    return (
        "Bodies may be labelled wrongly: check which cluster is on which link"
        f" ({', '.join(_shown(body, names) for body in bodies)});"
        " --bodies BODY=NAME,... sets their names"
    )


def _shown(body: str, names: Labels) -> str:
    return body if names.get(body, body) == body else f"{body} ({names[body]!r})"


def relabelled(tracks: Tracks, labels: Labels) -> Tracks:
    """Return tracks with their bodies' names put right.

    Args:
        tracks: as they are
        labels: {body: the label that it has}
    """
    right = {body: tracks.poses[label] for body, label in labels.items()}
    return replace(tracks, poses={**tracks.poses, **right})


def labels_that_fit(
    problem: InputError,
    files: Sequence[str],
    tries: Iterable[Sequence[Labels]],
    fits: Callable[[Sequence[Labels]], object],
    names: Labels,
) -> LabelsError | None:
    """Return the error that names exchanged labels, None if tracks fit under no others.

    Args:
        problem: the defect under the labels as they are
        files: where the tracks were read
        tries: {body: the label that it has} of each file, the likeliest first
        fits: raises InputError where tracks with these labels are not the arm's
        names: {body: its name in the files} of those that are called otherwise
    """
    for labels in tries:
        try:
            fits(labels)
        except InputError:
            continue
        return labels_error(problem, dict(zip(files, labels, strict=True)), names)
    return None


def exchange_text(labels: Labels, names: Labels) -> str:
    """Return the exchanged labels, in words, "" where each is right."""
    cycles: list[list[str]] = []
    for body in labels:
        if labels[body] != body and not any(body in cycle for cycle in cycles):
            cycle = [body]
            while labels[cycle[-1]] != body:
                cycle.append(labels[cycle[-1]])
            cycles.append(cycle)
    parts: list[str] = []
    for cycle in cycles:
        if len(cycle) == 2:
            parts.append(f"{' and '.join(_shown(body, names) for body in cycle)} are exchanged")
        else:
            parts.append(", ".join(f"{body} is labelled {labels[body]}" for body in cycle))
    return "; ".join(parts)


def labels_error(problem: InputError, labels: Mapping[str, Labels], names: Labels) -> LabelsError:
    """Return the error that gives the exchanged labels.

    Args:
        problem: what does not fit under the names as they are
        labels: {file: {body: the label that it has there}}
        names: {body: its name in the files} of those that are called otherwise
    """
    wrong = {file: one for file, one in labels.items() if exchange_text(one, names)}
    file, one = next(iter(wrong.items()))
    if all(other == one for other in labels.values()):
        right = {body: names.get(label, label) for body, label in one.items()}
        given = ",".join(f"{body}={name}" for body, name in right.items() if body != name)
        advice = f"--bodies {given} puts them right" if given else "omit --bodies"
        said = f"{exchange_text(one, names)}; {advice}"
    else:
        said = "; ".join(f"{exchange_text(o, names)} in {f}" for f, o in wrong.items())
        said += "; rename them there"
    at = problem.file if isinstance(problem, TracksError) else file
    text = problem.problem if isinstance(problem, FarFromNominalError) else str(problem)
    return LabelsError(
        at,
        text.removeprefix(f"{at}: "),
        {f: {b: names.get(n, n) for b, n in o.items()} for f, o in labels.items()},
        f"Bodies are labelled wrongly: {said}",
    )


def _permuted(
    bodies: Sequence[str], wanted: Sequence[Condition], done: dict[str, str]
) -> Iterator[dict[str, str]]:
    """Yield the permutations of the bodies under which all conditions hold."""
    if len(done) == len(bodies):
        yield done
        return
    body = bodies[len(done)]
    for label in bodies:
        if label in done.values():
            continue
        labels = {**done, body: label}
        if all(
            c.holds([labels[b] for b in c.bodies])
            for c in wanted
            if body in c.bodies and all(b in labels for b in c.bodies)
        ):
            yield from _permuted(bodies, wanted, labels)
