"""The joints of a chain from tracks, one axis after another: setup joints, and a master's wrist.

Each joint turns or slides in turn. Axes come from the relative poses of neighbouring links, as
those of loops do; at the still start, joint positions 0, the links then stand to one another as
measured. What a calibration cannot see stays as drawn: where the chain as a whole stands on the
root, and where the tip is on the last link. Links whose loops are calibrated keep their places.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar import __version__
from trocar.descriptions import ArmDescription
from trocar.descriptions.axis_lines import Line
from trocar.descriptions.overlay import Overlay, apply_overlay, frame_patch
from trocar.descriptions.serial_axes import (
    SerialJoint,
    parallel,
    serial_figures,
    serial_joints,
    spacing,
    tilt,
)
from trocar.errors import FarFromNominalError, InputError, TracksError
from trocar.fitting import (
    LEAST_SPAN,
    SMALL_SPAN,
    STILL_S,
    HingeFit,
    SharedHinge,
    SlideFit,
    fit_hinge,
    fit_slide,
    likely_cause,
    refine_hinges,
    still_start,
)
from trocar.fitting.adjust import Adjustable, Block, Values, adjust, slopes
from trocar.geometry import inverse, matrix_from_rotation_vector, rotation_z, transform
from trocar.geometry.rotations import rotation_vector_from_matrix, rpy_from_matrix
from trocar.kinematics.forward import poses
from trocar.kinematics.mechanism import Mechanism
from trocar.robot.calibration.axes import (
    LEAST_SAMPLES,
    ROUNDED_M,
    WRONG_M,
    Value,
)
from trocar.robot.calibration.calibrate import Calibration
from trocar.robot.calibration.checks import FAR_M, FAR_RAD
from trocar.robot.calibration.labels import Labels, labels_that_fit, relabelled
from trocar.robot.calibration.linkage import linkage
from trocar.robot.calibration.tracks import Tracks, check_together, select_bodies, thinned

Array = NDArray[np.float64]

#: A slide swept by less is refused, one by less than the second has a loose direction. Source: our
#: own choice; 0.25 mm of noise per sample turn 0.1 m by 0.2 mrad in 12 s. [m]
LEAST_SLIDE_M, SMALL_SLIDE_M = 0.02, 0.08
#: A direction counts as so much of a distance when the chain is laid on the drawing. Source: our
#: own choice, the length of a link. [m]
LEVER_M = 0.3
#: Axes of which the second direction weighs less than this are all parallel; then so many turns
#: about them are tried. Source: our own choice.
TURNS_BELOW, TURNS = 0.1, 12
#: An axis that is this far from the drawing, laid on it, is another one. Source: our own choice;
#: axes off by 3 mm and 1 degree each, as of `trocar mocap --perturb`, come to 20 mm. [m]
LAID_M = 0.1
#: A sweep has begun where it is this share of its range from home. Source: our own choice.
BEGUN = 0.2


@dataclass(frozen=True, eq=False)
class JointsCalibration:
    """The chain of one arm, measured.

    Attributes:
        arm: name of the description
        distances, angles: {axis to next axis: [m], [rad]}
        nominal: the same as drawn, as `serial_figures` has them
        residuals: {joint: RMS distance from its axis [m], RMS turn [rad], sweep [m or rad],
            samples left out}
        overlay: what is to be laid over the description
        warnings: what a user should know
    """

    arm: str
    distances: Mapping[str, Value]
    angles: Mapping[str, Value]
    nominal: Mapping[str, Mapping[str, float]]
    residuals: Mapping[str, tuple[float, float, float, int]]
    overlay: Overlay
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return everything as one JSON document, in SI units."""
        return {
            "arm": self.arm,
            "joints": {
                "distances_m": {k: v.as_dict() for k, v in self.distances.items()},
                "angles_rad": {k: v.as_dict() for k, v in self.angles.items()},
            },
            "residuals": {
                name: {"position_rms_m": p, "rotation_rms_rad": r, "span": s, "outliers": n}
                for name, (p, r, s, n) in self.residuals.items()
            },
            "warnings": list(self.warnings),
        }


def has_chain(tracks: Tracks, arm: ArmDescription, bodies: Mapping[str, str]) -> bool:
    """Return whether tracks have the links of an arm's chain, which has more than its loops.

    Never of an arm whose loops make a remote centre: the joints behind it are not swept.
    """
    looped = {hinge.name for hinge in linkage(arm).hinges}
    outside = [joint.frame for joint in serial_joints(arm) if joint.frame not in looped]
    if "rcm" in arm.mechanism.frame_index or not outside:
        return False
    return all(bodies.get(body, body) in tracks.poses for body in links_of(arm))


def links_of(arm: ArmDescription) -> tuple[str, ...]:
    """Return the bodies of an arm's chain, from the root's to the last link's."""
    joints = serial_joints(arm)
    return tuple(f"{arm.name}_{n}" for n in (arm.root, *(j.frame for j in joints)))


def calibrate_joints(
    tracks: Tracks,
    arm: ArmDescription,
    loops: Calibration | None = None,
    *,
    bodies: Mapping[str, str] | None = None,
    watch: Callable[[str], None] = lambda _: None,
) -> JointsCalibration:
    """Measure the joints of an arm's chain.

    Args:
        tracks: a still start at joint positions 0, then a sweep of each joint
        arm: the description
        loops: its loops, calibrated from the same tracks, if it has some
        bodies: {body: its name in the tracks} of those that are called otherwise
        watch: called with the name of each step

    Returns:
        the chain; its overlay has the loops' values, too

    Raises:
        InputError: tracks that cannot be used
        FarFromNominalError: distances or angles that no robot of this kind has
        LabelsError: the same, by exchanged names of bodies
    """
    if arm.overlay is not None:
        raise InputError(
            f"{arm.name}: is already calibrated; allowed: the nominal description, without overlay"
        )
    names = bodies or {}
    joints = serial_joints(arm)
    if len(joints) < 2:
        raise InputError(f"{arm.name}: has {len(joints)} joints; allowed: 2 or more")
    picked = select_bodies(tracks, {body: names.get(body, body) for body in links_of(arm)})
    nominal = serial_figures(joints)
    try:
        chain = _measure(picked, arm.name, joints, nominal, watch)
    except InputError as problem:
        watch("labels")
        some = thinned(picked)
        tries = (
            ({body: {one: two, two: one}.get(body, body) for body in picked.poses},)
            for one, two in combinations(picked.poses, 2)
        )

        def fits(labels: Sequence[Labels]) -> object:
            return _measure(relabelled(some, labels[0]), arm.name, joints, nominal, lambda _: None)

        raise labels_that_fit(problem, [picked.file], tries, fits, names) or problem from None
    warnings = (*tracks.warnings, *chain.warnings())
    watch("placement")
    overlay = _overlay(arm, chain, loops)
    distances, angles = chain.figures()
    found = JointsCalibration(
        arm.name,
        distances,
        angles,
        nominal,
        {
            j.frame: (fit.residual_position, fit.residual_rotation, fit.span, fit.outliers)
            for j, fit in zip(joints, chain.fits, strict=True)
        },
        overlay,
        warnings,
    )
    measured = {**overlay.measured, "joints": found.as_dict()["joints"]}
    source = {"file": tracks.file, "sha256": tracks.sha256, "version": f"trocar {__version__}"}
    said = tuple(dict.fromkeys((*overlay.warnings, *warnings)))
    overlay = replace(overlay, measured=measured, source=source, warnings=said)
    return replace(found, overlay=overlay)


@dataclass(frozen=True, eq=False)
class TrackedChain:
    """Every joint of a chain as the tracks show it.

    Attributes:
        joints: as drawn
        fits: of each
        home: T_ab of each joint's links at the still start, (4, 4)
        effects: of each sample's residual on axis and pose, (n + n_joints, 12) each: point and
            direction of the axis in a, then shift and turn of b at the axis, in a
        signs: whether the fits' directions agree with the drawing (1) or not (-1)
        onto: T_root_markers of the root link that lays the axes on the drawing, (4, 4)
        follows: how it follows what is left between axes and drawing, (6, rows)
    """

    joints: tuple[SerialJoint, ...]
    fits: tuple[HingeFit | SlideFit, ...]
    home: tuple[Array, ...]
    effects: tuple[Array, ...]
    signs: tuple[float, ...]
    onto: Array
    follows: Array

    def line(self, i: int, step: Array | None = None) -> Line:
        """Return a joint's axis in the link before it, moved by a step of its twelve."""
        fit, x = self.fits[i], np.zeros(12) if step is None else step
        point = fit.point if isinstance(fit, SlideFit) else fit.point_a
        direction = self.signs[i] * (fit.direction_a + x[3:6])
        return Line(point + x[:3], direction / np.linalg.norm(direction))

    def relative(self, i: int, step: Array | None = None) -> Array:
        """Return T_ab of a joint at home, moved by a step of its twelve."""
        if step is None:
            return self.home[i]
        at = self.line(i).point
        about = transform(matrix_from_rotation_vector(step[9:12]), step[6:9])
        return transform(np.eye(3), at) @ about @ transform(np.eye(3), -at) @ self.home[i]

    def figures(self) -> tuple[dict[str, Value], dict[str, Value]]:
        """Return distances [m] and angles [rad] from each axis to the next."""
        distances: dict[str, Value] = {}
        angles: dict[str, Value] = {}
        for i, (one, two) in enumerate(pairwise(self.joints)):
            level, label = parallel(one.line, two.line), f"{one.frame}-{two.frame}"
            effect = np.hstack(self.effects[i : i + 2])
            markers = np.zeros(3) if level else None  # of the link that carries both

            def value(
                of: Callable[[Line, Line], float], i: int = i, effect: Array = effect
            ) -> Value:
                def at(x: Array) -> float:
                    first = self.line(i, x[:12]).moved(inverse(self.relative(i, x[:12])))
                    return of(first, self.line(i + 1, x[12:]))

                errors = effect @ slopes(at, np.zeros(24))
                return Value(at(np.zeros(24)), float(np.sqrt(errors @ errors)))

            if not (one.slides or two.slides):
                distances[label] = value(lambda a, b, at=markers: spacing(a, b, at))
            if not level:
                angles[label] = value(tilt)
        return distances, angles

    def lines(self, steps: Array | None = None) -> tuple[list[Line], list[Array]]:
        """Return the axes at home in the root link's markers, and each link's markers there."""
        links, lines = [np.eye(4)], list[Line]()
        for i in range(len(self.joints)):
            step = None if steps is None else steps[i]
            lines.append(self.line(i, step).moved(links[-1]))
            links.append(links[-1] @ self.relative(i, step))
        return lines, links

    def warnings(self) -> Iterator[str]:
        """Yield warnings about the sweeps and their noise."""
        for joint, fit in zip(self.joints, self.fits, strict=True):
            least, unit = (SMALL_SLIDE_M, "m") if joint.slides else (SMALL_SPAN, "rad")
            if fit.span < least:
                yield (
                    f"{joint.frame} was swept by {fit.span:.3f} {unit} only; below {least}"
                    f" {unit} its axis is loose"
                )
        widened = max(fit.widened for fit in self.fits)
        if widened > 1.0 and self.fits[-1].residual_position > ROUNDED_M:
            yield (
                "the residuals are correlated in time: noise is not white, and standard deviations"
                f" are widened, up to {widened:.1f} times"
            )


def _measure(
    tracks: Tracks,
    name: str,
    joints: tuple[SerialJoint, ...],
    nominal: Mapping[str, Mapping[str, float]],
    watch: Callable[[str], None],
) -> TrackedChain:
    """Fit every joint, and compare the chain with its description.

    Raises:
        InputError: tracks that cannot be used, or are not those of a robot of this kind
    """
    fits: list[HingeFit | SlideFit] = []
    for joint in joints:
        watch(f"axis {joint.frame}")
        fits.append(_fit(tracks, name, joint))
    fits = _jointly(tracks, name, joints, fits)
    still = still_start(
        tracks.times,
        {
            j.frame: fit.positions if isinstance(fit, SlideFit) else fit.angles
            for j, fit in zip(joints, fits, strict=True)
        },
    )
    if still is None:
        raise TracksError(
            tracks.file,
            f"the arm does not rest at the start; allowed: a rest of {STILL_S:g} s or more at"
            " joint positions 0",
        )
    home = tuple(_at_home(fit, still) for fit in fits)
    count = len(tracks.times)
    effects = tuple(_effect(fit, T[0], T[1], count, i, len(fits))
                    for i, (fit, T) in enumerate(zip(fits, home, strict=True)))  # fmt: skip
    signs = tuple(j.sense * _sense(fit, still) for j, fit in zip(joints, fits, strict=True))
    chain = TrackedChain(joints, tuple(fits), tuple(T for T, _ in home), effects, signs, np.eye(4),
                  np.zeros((6, 0)))  # fmt: skip
    lines, _ = chain.lines()
    onto = _laid(lines, joints)
    _check_senses(tracks.file, name, joints, [line.moved(onto) for line in lines])
    left = slopes(lambda x: _misfit(lines, joints, _moved(onto, x)), np.zeros(6))
    follows = np.asarray(np.linalg.pinv(left, rcond=1e-6), dtype=np.float64)
    chain = replace(chain, onto=onto, follows=follows)
    _check(tracks.file, chain, nominal)
    return chain


def _fit(tracks: Tracks, name: str, joint: SerialJoint) -> HingeFit | SlideFit:
    a, b = f"{name}_{joint.parent}", f"{name}_{joint.frame}"
    check_together(tracks, a, b, LEAST_SAMPLES)
    T_ab = inverse(tracks.poses[a]) @ tracks.poses[b]
    fit = fit_slide(T_ab) if joint.slides else fit_hinge(T_ab)
    least, unit = (LEAST_SLIDE_M, "m") if joint.slides else (LEAST_SPAN, "rad")
    if fit.span < least:
        raise InputError(
            f"{tracks.file}: {joint.frame} ({a} to {b}) was swept by {fit.span:.4f} {unit};"
            f" allowed: {least} {unit} or more"
        )
    if fit.residual_position > WRONG_M or fit.outliers > 0.3 * (fit.outliers + fit.used.sum()):
        cause = likely_cause(tracks.poses[a], tracks.poses[b])
        motion = "slide along" if joint.slides else "rotate about"
        raise InputError(
            f"{tracks.file}: {a} and {b} do not {motion} a common axis ({joint.frame}):"
            f" {1e3 * fit.residual_position:.1f} mm from the nearest, {fit.outliers} samples"
            f" excluded; allowed: {1e3 * WRONG_M:.0f} mm and 30 %. Probable cause:"
            f" {cause or 'wrong names, or a loose cluster'}"
        )
    return fit


def _jointly(
    tracks: Tracks,
    name: str,
    joints: tuple[SerialJoint, ...],
    fits: Sequence[HingeFit | SlideFit],
) -> list[HingeFit | SlideFit]:
    """Weigh the hinges together: each link's poses tell of both of its axes."""
    hinges = {i: fit for i, fit in enumerate(fits) if isinstance(fit, HingeFit)}
    links = [joints[0].parent, *(joint.frame for joint in joints)]
    seen = np.stack([tracks.poses[f"{name}_{link}"] for link in links], axis=1)
    sigmas = (
        float(np.median([fit.position_sigma for fit in hinges.values()])),
        float(np.median([fit.rotation_sigma for fit in hinges.values()])),
    )
    shared = [SharedHinge(i, i + 1, fit, False) for i, fit in hinges.items()]
    refined = dict(zip(hinges, refine_hinges(seen, shared, sigmas), strict=True))
    return [refined.get(i, fit) for i, fit in enumerate(fits)]


def _at_home(fit: HingeFit | SlideFit, still: NDArray[np.bool_]) -> tuple[Array, float]:
    """Return T_ab at the still start, and the noise of its joint position [m or rad]."""
    at = fit.positions if isinstance(fit, SlideFit) else fit.angles
    here = at[still & np.isfinite(at)]
    mean, sigma = float(here.mean()), fit.widened * float(here.std() / np.sqrt(len(here)))
    if isinstance(fit, SlideFit):
        return transform(fit.rotation, fit.point + mean * fit.direction_a), sigma
    return fit.before @ transform(rotation_z(mean), np.zeros(3)) @ fit.after, sigma


def _sense(fit: HingeFit | SlideFit, still: NDArray[np.bool_]) -> float:
    """Return the sense of a joint's first motion along its fit's direction, 1 or -1."""
    at = fit.positions if isinstance(fit, SlideFit) else fit.angles
    away = at - np.nanmean(at[still])
    far = np.flatnonzero(np.abs(away) > BEGUN * fit.span)
    return float(np.sign(away[far[0]])) if len(far) else 1.0


def _check_senses(
    file: str, name: str, joints: tuple[SerialJoint, ...], lines: Sequence[Line]
) -> None:
    """Reject axes whose places or senses contradict the drawing.

    Raises:
        TracksError: with the joints that are elsewhere or the other way round
    """
    against = [
        joint.frame
        for joint, line in zip(joints, lines, strict=True)
        if line.direction @ joint.line.direction < 0.5
        or np.abs(_misfit([line], [joint], np.eye(4))).max() > LAID_M
    ]
    if against:
        raise TracksError(
            file,
            f"axes of {', '.join(against)} are elsewhere, or point the other way, than {name}'s as"
            f" drawn; allowed: within {LAID_M:g} m, of sweeps that begin towards positive joint"
            " positions, with bodies that are labelled rightly",
        )


def _effect(
    fit: HingeFit | SlideFit, home: Array, sigma: float, count: int, place: int, joints: int
) -> Array:
    """Return the effect of each sample's residual, and of the still start's, on a joint's twelve.

    The pose at home takes b's axis onto a's, so errors of both turn and shift it.
    """
    effect = np.zeros((count + joints, 12))
    d, R = fit.direction_a, home[:3, :3]
    if isinstance(fit, SlideFit):
        effect[:count, 3:6] = fit.influence_a[:, :3]
        effect[:count, 6:9] = fit.influence_a[:, 3:6]
        effect[:count, 9:12] = fit.influence_a[:, 6:9]
        effect[count + place, 6:9] = sigma * d
        return effect
    a, b = fit.influence_a, fit.influence_b
    effect[:count, :6] = a
    effect[:count, 6:9] = a[:, :3] - b[:, :3] @ R.T
    effect[:count, 9:12] = np.cross(d, a[:, 3:] - b[:, 3:] @ R.T)
    effect[count + place, 9:12] = sigma * d
    return effect


def _check(file: str, chain: TrackedChain, nominal: Mapping[str, Mapping[str, float]]) -> None:
    """Reject a chain that is none of this kind.

    Raises:
        FarFromNominalError: with every figure that is too far off
    """
    distances, angles = chain.figures()
    off: dict[str, tuple[float, float]] = {}
    said: list[str] = []
    for found, drawn, bound, factor, unit in (
        (distances, nominal["distances_m"], FAR_M, 1e3, "mm"),
        (angles, nominal["angles_rad"], FAR_RAD, 1.0, "rad"),
    ):
        for label, value in found.items():
            if abs(value.value - drawn[label]) > bound:
                off[label] = value.value, drawn[label]
                said.append(
                    f"{label} {factor * value.value:.4g} {unit} (nominal"
                    f" {factor * drawn[label]:.4g})"
                )
    if off:
        raise FarFromNominalError(
            file,
            f"too far from the description: {', '.join(said)}; allowed: within {1e3 * FAR_M:g} mm"
            f" and {FAR_RAD:g} rad of nominal",
            off,
            "bodies that are labelled wrongly, or another arm",
        )


def _overlay(arm: ArmDescription, chain: TrackedChain, loops: Calibration | None) -> Overlay:
    """Return the overlay whose frames stand on the measured axes, with standard deviations."""
    base = Overlay(arm.name) if loops is None else loops.overlay
    drawn = arm if loops is None else apply_overlay(arm, base)
    count = len(chain.joints)
    held: set[str] = set() if loops is None else set(base.frames)
    start = _anchor(arm, drawn, chain, loops)

    def placed(x: Array) -> dict[str, Array]:
        steps = x.reshape(count, 12)
        return _placed(drawn.mechanism, chain, steps, held, start)

    here = placed(np.zeros(12 * count))
    moved = {
        name: before
        for name, before in here.items()
        if name in held or not np.array_equal(before, arm.mechanism.frame(name).before)
    }

    def flat(x: Array) -> Array:
        there = placed(x)
        parts = [
            (there[n][:3, 3],
             rotation_vector_from_matrix(moved[n][:3, :3].T @ there[n][:3, :3]))
            for n in moved
        ]  # fmt: skip
        return np.concatenate([value for pair in parts for value in pair])

    errors = np.hstack(chain.effects) @ slopes(flat, np.zeros(12 * count)).T
    sigma = np.sqrt(np.sum(errors**2, axis=0)).reshape(-1, 2, 3)
    frames = dict(base.frames)
    for (name, before), (xyz, turn) in zip(moved.items(), sigma, strict=True):
        old = base.frames.get(name)
        if old is not None and np.allclose(before, drawn.mechanism.frame(name).before, atol=1e-12):
            continue
        patch = frame_patch(replace(arm.mechanism.frame(name), before=before))
        if old is not None and old.xyz_sigma is not None:
            xyz = np.hypot(xyz, old.xyz_sigma)
        frames[name] = replace(
            patch, rpy=rpy_from_matrix(before[:3, :3]), xyz_sigma=xyz, rpy_sigma=turn
        )
    return replace(base, frames=frames)


def _anchor(
    arm: ArmDescription, drawn: ArmDescription, chain: TrackedChain, loops: Calibration | None
) -> tuple[int, Array] | None:
    """Return a link of calibrated loops and where its markers are at home, T_root_markers."""
    if loops is None:
        return None
    robot = loops.refined.robot
    links = [chain.joints[0].parent, *(joint.frame for joint in chain.joints)]
    q = np.clip(np.zeros(len(arm.joints)), arm.mechanism.lower, arm.mechanism.upper)
    at = poses(drawn.mechanism, q, arm.root)
    place = max(i for i, link in enumerate(links) if f"{arm.name}_{link}" in robot.markers)
    body = f"{arm.name}_{links[place]}"
    return place, at[robot.linkage.bodies[body]] @ robot.markers[body]


def _placed(
    mechanism: Mechanism,
    chain: TrackedChain,
    steps: Array,
    held: set[str],
    anchor: tuple[int, Array] | None,
) -> dict[str, Array]:
    """Return the poses of frames in their parents, {frame: before (4, 4)} of those that may move.

    Args:
        mechanism: with its loops calibrated
        chain: as measured
        steps: of each joint's twelve, (n_joints, 12)
        held: frames of loops, which stay where they are in the root
        anchor: a link and T_root_markers of it, None where the chain is laid on the drawing
    """
    lines, links = chain.lines(steps)
    if anchor is None:
        onto = _moved(chain.onto, -chain.follows @ _misfit(lines, chain.joints, chain.onto))
    else:
        onto = anchor[1] @ inverse(links[anchor[0]])
    q = np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)
    at = poses(mechanism, q, mechanism.frames[0].name)
    axes = {
        joint.frame: _onto(at[joint.frame] @ inverse(mechanism.frame(joint.frame).after),
                           line.moved(onto), joint.slides)
        for joint, line in zip(chain.joints, lines, strict=True)
    }  # fmt: skip
    found: dict[str, Array] = {}
    new: dict[str, Array] = {mechanism.frames[0].name: at[mechanism.frames[0].name]}
    for frame in mechanism.frames[1:]:
        parent, old = str(frame.parent), at[frame.name]
        if frame.name in held:
            found[frame.name] = inverse(new[parent]) @ at[parent] @ frame.before
            new[frame.name] = old
        elif frame.name in axes:
            axis = axes[frame.name]
            found[frame.name] = inverse(new[parent]) @ axis
            new[frame.name] = axis @ frame.after
        else:
            new[frame.name] = new[parent] @ inverse(at[parent]) @ old
    return found


def _onto(axis: Array, line: Line, slides: bool) -> Array:
    """Return a frame whose z axis is on a line, as near as can be to where it was."""
    z = axis[:3, 2]
    d = np.copysign(1.0, z @ line.direction) * line.direction
    across = np.cross(z, d)
    size = float(np.linalg.norm(across))
    turn = across * (np.arctan2(size, float(z @ d)) / size) if size > 0.0 else across
    R = matrix_from_rotation_vector(turn) @ axis[:3, :3]
    at = axis[:3, 3]
    if not slides:
        at = line.point + ((at - line.point) @ d) * d
    return transform(R, at)


def _laid(lines: Sequence[Line], joints: Sequence[SerialJoint]) -> Array:
    """Return the pose that lays measured axes on those as drawn, least squares, (4, 4)."""

    def blocks(values: Values) -> dict[str, Block]:
        return {"axes": Block(_misfit(lines, joints, values["onto"]))}

    problem = Adjustable(blocks, {"axes": 1.0})
    found = [adjust(problem, {"onto": T}) for T in _starts(lines, joints)]
    best = min(found, key=lambda one: float(one.residuals["axes"] @ one.residuals["axes"]))
    return best.values["onto"]


def _moved(T: Array, x: Array) -> Array:
    """Return a pose shifted and turned by a step, (6,) [m, rad]."""
    return transform(matrix_from_rotation_vector(x[3:]) @ T[:3, :3], T[:3, 3] + x[:3])


def _misfit(lines: Sequence[Line], joints: Sequence[SerialJoint], T: Array) -> Array:
    """Return the distances of measured axes from those as drawn [m]."""
    parts: list[Array] = []
    for line, joint in zip(lines, joints, strict=True):
        got = line.moved(T)
        parts.append(LEVER_M * (got.direction - joint.line.direction))
        if not joint.slides:
            between = joint.line.point - got.point
            parts.append(between - (between @ got.direction) * got.direction)
    return np.concatenate(parts)


def _starts(lines: Sequence[Line], joints: Sequence[SerialJoint]) -> Iterator[Array]:
    """Yield poses that lay the directions of axes on the drawing's, (4, 4) each."""
    pairs = [(line, joint.line) for line, joint in zip(lines, joints, strict=True)]
    left, sizes, right = np.linalg.svd(
        np.sum([np.outer(want.direction, line.direction) for line, want in pairs], axis=0)
    )
    proper = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    hinges = [pair for pair, joint in zip(pairs, joints, strict=True) if not joint.slides]
    sides = [np.eye(3) - np.outer(want.direction, want.direction) for _, want in hinges]
    turns = TURNS if sizes[1] < TURNS_BELOW * sizes[0] else 1
    for angle in np.linspace(0.0, 2.0 * np.pi, turns, endpoint=False):
        R = matrix_from_rotation_vector(angle * left[:, 0]) @ left @ proper @ right
        away = [s @ (want.point - R @ line.point)
                for s, (line, want) in zip(sides, hinges, strict=True)]  # fmt: skip
        shift = np.linalg.lstsq(np.concatenate(sides), np.concatenate(away), rcond=1e-9)[0]
        yield transform(R, shift)
