"""Identify an arm's dynamics from logs by convex optimisation, with possible bodies only."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import sparse  # pyright: ignore[reportMissingTypeStubs]
from scipy.linalg import qr  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]
from scipy.ndimage import maximum_filter1d  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from trocar.descriptions import ArmDescription
from trocar.descriptions.overlay_records import (
    POSITIVE,
    BodyDynamics,
    Drivetrain,
    Dynamics,
    Overlay,
)
from trocar.errors import (
    InputError,
    LogError,
    MissingExtraError,
    TrocarError,
    UnknownNameError,
)
from trocar.robot.identification.bounds import MASS_RATIOS, BodyBounds, all_bounds
from trocar.robot.identification.drivetrains import (
    described_trains,
    labels,
    structure,
    weights,
    with_coefficients,
)
from trocar.robot.identification.logs import FilteredLog
from trocar.robot.identification.regression import (
    EffortModel,
    Weight,
    filtered_regressor,
    loaded,
    moving_bodies,
)
from trocar.robot.identification.rigid_body import JointMotion, mass_com_inertia

Array = NDArray[np.float64]

#: Weight of the description's bodies against the relative squared errors of all columns, at most
#: the variance of a row. Source: our own choice; the fit of the recordings loses less than 1 % by
#: it, and links that efforts cannot distinguish stay like their CAD models instead of at a bound.
PRIOR = 1e-6
#: Least variance of a row, relative to efforts. Source: rounding, 1e-9 of an effort, which leaves
#: the regression a triangle that can be inverted.
ROUNDING = 1e-18
#: One standard deviation of that prior: ratio of the mass, and of the mass times the hull's size.
#: Source: our own choice.
PRIOR_SIGMA = 0.5
#: Solutions of one identification: each column is weighted by its error of the one before, as a
#: ratio of a usual error and not below the least one. Source: our own choice; a third pass changes
#: the recordings' scores by less than 0.1 %.
PASSES, USUAL_ERROR, LEAST_ERROR = 3, 0.1, 1e-3
#: Power of the errors in these weights: 1 is best for errors that are noise, 0 has every column's
#: relative error alike. Source: our own choice between both, as errors of the model are no noise;
#: held-out errors of a PSM's yaw rise and those of its pitch and insertion fall towards 0.
TEMPER = 0.7
#: Weight that draws drivetrain coefficients to 0, by the effort they make. Source: our own choice.
RIDGE = 1e-6
#: Parameters count as base parameters down to this ratio of the regressor's singular values, with
#: columns scaled to length 1. Source: our own choice; measured efforts have three digits.
RANK = 1e-4
#: Columns whose lengths differ by less, as a ratio, are equally good pivots: the first named is
#: taken. All have length 1 to begin with, and those of bodies that move alike stay alike, so that
#: rounding would choose. Source: our own choice, far below the three digits of measured efforts and
#: far above rounding.
ALIKE = 1e-6
#: Ratio of standard error to value below which a base parameter is identifiable. Source: our own
#: choice.
IDENTIFIABLE = 0.1
#: A log excites an arm if one standard deviation of the efforts that it predicts, at random motions
#: within the joints' limits, is below this ratio of each joint's effort. Source: our own choice;
#: 0.02 to 0.07 with the recordings of 30 s (docs/dynamics.md), 0.06 to 0.31 with 5 s of one.
EXCITED = 0.5
#: A model explains a column if this ratio of its effort, or more, is not left over. Source: our own
#: choice; 0.03 to 0.27 with the recordings, 0.97 where two columns are swapped.
UNEXPLAINED = 0.7
#: A joint sticks where it is slower than this ratio of its RMS velocity or turns back, and
#: differences of velocities are wrong as many samples beside it. Source: our own choice of the
#: ratio; the differences have five points. Efforts of an Si's insertion by the true parameters are
#: off by 0.02 % of their RMS with samples within 0.1 s cut behind the filters, by 0.003 % without
#: these few ahead of the filters. [ratio, samples]
STILL, BESIDE = 1e-3, 3
#: Random motions, and the ratio of the limits of velocities and accelerations that they use.
#: Source: our own choice.
MOTIONS, BRISK = 200, 0.3
#: Largest number of parameters that an error names for a joint.
NAMED = 4
#: Least variance of a mass distribution along each axis of its frame, as a ratio of the squared
#: half edge of the box about its hull. Source: our own choice; a homogeneous box has a third, and
#: without this bound links end as points and rods.
LEAST_VARIANCE = 0.02


@dataclass(frozen=True, eq=False)
class Compressed:
    """Rows of a regression reduced to a triangle: |R x - r|^2 + rest = weighted squared errors.

    Attributes:
        triangle: R, (m, p)
        target: r, (m,)
        rest: what no parameter explains
        rows: how many there were
        independent: how many of them are independent, given the filters
    """

    triangle: Array
    target: Array
    rest: float
    rows: int
    independent: float

    @staticmethod
    def of(matrix: Array, target: Array, ratio: float) -> Compressed:
        """Return the triangle of rows, of which a ratio is independent."""
        joined = np.hstack([matrix, target[:, None]])
        decomposed = cast("tuple[Array]", qr(joined, mode="r", check_finite=False))
        triangle = np.asarray(decomposed[0])[: joined.shape[1]]
        own = triangle[:-1] if len(triangle) == joined.shape[1] else triangle
        last = float(triangle[-1, -1] ** 2) if len(triangle) == joined.shape[1] else 0.0
        return Compressed(own[:, :-1], own[:, -1], last, len(matrix), ratio * len(matrix))

    @staticmethod
    def joined(parts: Sequence[Compressed]) -> Compressed:
        """Return the triangle of several."""
        one = Compressed.of(
            np.concatenate([p.triangle for p in parts]),
            np.concatenate([p.target for p in parts]),
            1,
        )
        return Compressed(
            one.triangle,
            one.target,
            one.rest + sum(p.rest for p in parts),
            sum(p.rows for p in parts),
            sum(p.independent for p in parts),
        )


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """Combinations of parameters that efforts determine.

    Attributes:
        names: of the parameter that each is named after, (b,)
        combinations: each one = combinations @ all parameters, (b, p)
        values, sigma: (b,)
        condition: condition number of their regressor, columns scaled to length 1
    """

    names: tuple[str, ...]
    combinations: Array
    values: Array
    sigma: Array
    condition: float

    @property
    def identifiable(self) -> tuple[str, ...]:
        """Those whose standard error is below a tenth of their value."""
        good = self.sigma < IDENTIFIABLE * np.abs(self.values)
        return tuple(name for name, one in zip(self.names, good, strict=True) if one)


@dataclass(frozen=True, eq=False)
class Identified:
    """The result of an identification.

    Attributes:
        model: its parameters
        bounds: of its bodies
        parameters, sigma: values and one standard deviation, (p,)
        covariance: of the parameters, (p, p)
        dynamics: the same as bodies and drivetrains
        base: what the logs determine
        logs: files
        kept: {joint: the reason to keep the numbers of the description}
    """

    model: EffortModel
    bounds: Mapping[str, BodyBounds]
    parameters: Array
    sigma: Array
    covariance: Array
    dynamics: Dynamics
    base: BaseParameters
    logs: tuple[str, ...]
    kept: Mapping[str, str] = field(default_factory=dict[str, str])

    def overlay(self, version: str) -> Overlay:
        """Return the overlay of this robot, with its provenance."""
        source = {"version": version}
        for number, file in enumerate(self.logs, 1):
            data = Path(file).expanduser()
            source[f"log_{number}"] = data.name
            if data.is_file():
                source[f"log_{number}_sha256"] = hashlib.sha256(data.read_bytes()).hexdigest()
        source["tool"] = self.model.arm.tool or "none"
        measured: dict[str, Any] = {
            "parameters": len(self.parameters),
            "base_parameters": len(self.base.names),
            "condition_number": self.base.condition,
            "identifiable": list(self.base.identifiable),
        }
        if self.kept:
            measured["kept_as_described"] = list(self.kept)
        return Overlay(
            self.model.arm.name, source=source, measured=measured, dynamics=self.dynamics
        )


@dataclass(frozen=True, eq=False)
class FitProblem:
    """Parameters that logs identify, and the rows of their regression.

    Attributes:
        model: the parameters
        parts: regressor (k, n, p) and efforts (k, n) of each log, filtered; 0 in columns that leave
            the fit: without recorded efforts, or whose joint or motor stands still
        kept: {joint: the reason to keep its drivetrains as described}
        trains: the drivetrains of these
    """

    model: EffortModel
    parts: list[tuple[Array, Array]]
    kept: Mapping[str, str]
    trains: Mapping[str, Drivetrain]


def fit_problem(
    logs: Sequence[FilteredLog],
    arm: ArmDescription,
    known: Sequence[Sequence[Weight]] = (),
    keep: Sequence[str] = (),
    watch: Callable[[str], None] = lambda _: None,
) -> FitProblem:
    """Set up the regression of the parameters that logs can identify.

    Args:
        logs: filtered alike, of the same joints
        arm: the nominal arm, with the tool that was mounted
        known: weights strapped to the arm in each log; none when omitted
        keep: joints to leave as described
        watch: called with the name of each step

    Raises:
        LogError: nothing to identify
        UnknownNameError: no such joint
        InputError: an arm without masses, or weights of other logs
    """
    _check_alike(logs)
    strapped = list(known) or [[]] * len(logs)
    if len(strapped) != len(logs):
        raise InputError(f"weights: got {len(strapped)} for {len(logs)} logs; allowed: one per log")
    names = arm.mechanism.joint_names[: logs[0].log.q.shape[1]]
    for name in keep:
        if name not in names:
            raise UnknownNameError("joint", name, names, arm.name)
    columns = logs[0].log.columns
    reasons = [_unused(log, arm, keep) for log in logs]
    used = [[name not in reason for name in columns] for reason in reasons]
    if not np.any(used):
        why = "; ".join(f"{name} {text}" for name, text in reasons[0].items())
        raise LogError(
            ", ".join(log.log.file for log in logs),
            f"determines nothing of the arm ({why}); allowed: a joint that moves with recorded"
            " efforts",
        )
    kept: dict[str, str] = {}
    for k, joint in enumerate(names):
        why = [
            reason.get(columns[k], "did not move" if joint in log.log.still_joints(arm) else "")
            for log, reason in zip(logs, reasons, strict=True)
        ]
        if all(why):
            kept[joint] = why[0]
    free = [name for name in names if name not in kept]
    still_poses = all(log.log.poses for log in logs)
    trains = {
        name: train
        for name, train in structure(arm, [log.motion.q for log in logs]).items()
        if not still_poses and any(train.along.get(joint) for joint in free)
    }
    covered = {joint for train in trains.values() for joint in train.along}
    described = {
        name: train
        for name, train in described_trains(arm).items()
        if name not in trains and not covered & set(train.along)
    }
    model = EffortModel(arm, moving_bodies(arm, names), trains)
    parts: list[tuple[Array, Array]] = []
    for log, load, which in zip(logs, strapped, used, strict=True):
        watch(f"regressor of {log.log.file}")
        counted = np.asarray(~_stuck(model, log), float) if log.log.simulated else None
        matrix, target = filtered_regressor(replace(model, arm=loaded(arm, load)), log, counted)
        matrix[:, ~np.array(which)], target[:, ~np.array(which)] = 0.0, 0.0
        parts.append((matrix, target))
    return FitProblem(model, parts, kept, described)


def _unused(log: FilteredLog, arm: ArmDescription, keep: Sequence[str]) -> dict[str, str]:
    """Return the columns that leave the fit, and the reason of each."""
    one = log.log
    silent = dict.fromkeys(one.silent, "has no recorded efforts")
    still = {} if one.poses else dict.fromkeys(one.still(arm), "did not move")
    names = zip(arm.mechanism.joint_names, one.columns, strict=False)
    asked = {column: "is to stay as described" for joint, column in names if joint in keep}
    found = {name: [why[name] for why in (still, silent, asked) if name in why]
             for name in one.columns}  # fmt: skip
    return {name: " and ".join(why) for name, why in found.items() if why}


def identify(
    logs: Sequence[FilteredLog],
    arm: ArmDescription,
    known: Sequence[Sequence[Weight]] = (),
    mass_ratios: tuple[float, float] = MASS_RATIOS,
    watch: Callable[[str], None] = lambda _: None,
    keep: Sequence[str] = (),
) -> Identified:
    """Identify an arm's bodies and drivetrains from logs together.

    Minimises the squared errors of the efforts, relative to each column's RMS over all logs, with
    every body's pseudo-inertia positive semidefinite, its centre of mass in its hull, its mass and
    second moments within their bounds, and friction that dissipates. A column without recorded
    efforts, or that stands still, leaves the fit; drivetrains of joints without a column in it
    stay as described, and poses at rest identify bodies alone.

    Args:
        logs: filtered alike, of the same joints
        arm: the nominal arm, with the tool that was mounted
        known: weights strapped to the arm in each log; none when omitted
        mass_ratios: bounds of the masses, as ratios of the CAD estimates
        watch: called with the name of each step
        keep: joints to leave as described

    Raises:
        LogError: no joint moves with recorded efforts, or the logs do not excite the arm: the
            parameters that they do not determine
        UnknownNameError: no such joint
        InputError: an arm without masses, or bounds that exclude each other
        MissingExtraError: clarabel is not installed
    """
    problem = fit_problem(logs, arm, known, keep, watch)
    bounds = all_bounds(arm, problem.model.frames, mass_ratios)
    found = reweighted(problem.model, bounds, problem.parts, logs, watch)
    error = np.concatenate([t - m @ found.parameters for m, t in problem.parts])
    left = np.linalg.norm(error, axis=0) / effort_scale(problem.parts, logs)
    for name, ratio in zip(logs[0].log.columns, left, strict=True):
        if ratio > UNEXPLAINED:
            raise LogError(
                ", ".join(found.logs),
                f"efforts: {name}: no arm of this kind explains {ratio:.0%} of them; allowed:"
                f" {UNEXPLAINED:.0%} (are columns swapped, is a unit or a sign wrong, or were held"
                " set-points sampled in step with them? Log faster than they come;"
                f" --keep {name} leaves it as described)",
            )
    if weak := _undetermined(found, logs, problem):
        joint, (ratio, parameters) = next(iter(weak.items()))
        raise LogError(
            ", ".join(found.logs),
            f"excites too little: one standard deviation of the efforts that it predicts is"
            f" {ratio:.0%} of the effort of {joint}"
            + (f", and too much of {', '.join(list(weak)[1:])}" if len(weak) > 1 else "")
            + f"; allowed: {EXCITED:.0%} (of {joint}, {', '.join(parameters)} cannot be identified;"
            " move faster, farther or longer, e.g. along a trajectory of `trocar excite`, or keep"
            f" {', '.join(weak)} as described)",
        )
    trains = {**found.dynamics.drivetrains, **problem.trains}
    return replace(found, dynamics=replace(found.dynamics, drivetrains=trains), kept=problem.kept)


def _stuck(model: EffortModel, log: FilteredLog) -> NDArray[np.bool_]:
    """Return samples of a simulated log that say nothing of a joint's effort, (k, n).

    While a drivetrain sticks, its dry friction balances the other forces and has no sign.
    """
    count = log.log.q.shape[1]
    found = np.zeros((len(log.log.q), count))
    for train in model.trains.values():
        along = weights(train, model.arm)[:count]
        rate = log.log.qd @ along
        if "coulomb" in train.terms:
            still = np.abs(rate) < STILL * np.sqrt(np.mean(rate**2))
            turns = np.sign(rate[1:]) != np.sign(rate[:-1])
            still[1:] |= turns
            still[:-1] |= turns
            found[still] += along != 0.0
    return cast("Array", maximum_filter1d(found, 2 * BESIDE + 1, axis=0)) > 0.0


def _undetermined(
    found: Identified, logs: Sequence[FilteredLog], problem: FitProblem
) -> dict[str, tuple[float, tuple[str, ...]]]:
    """Return joints whose efforts are not determined: {joint: (sigma / effort, parameters)}.

    At random positions in the limits, with random velocities and accelerations, but for joints that
    are kept as described, which rest where the first log has them, and for poses, which rest. The
    parameters are those whose own standard deviations make the largest differences.
    """
    arm, log = found.model.arm, logs[0]
    count = log.log.q.shape[1]
    joints = arm.mechanism.joint_names[:count]
    lower, upper = arm.mechanism.lower[:count], arm.mechanism.upper[:count]
    limits = [(0.5 * (upper - lower)).tolist()]
    limits += [[BRISK * joint.velocity_max for joint in arm.joints[:count]]]
    limits += [[BRISK * joint.acceleration_max for joint in arm.joints[:count]]]
    rng = np.random.default_rng(0)
    parts = np.zeros((3, MOTIONS, len(arm.joints)))
    parts[:, :, :count] = np.array(limits)[:, None] * rng.uniform(-1.0, 1.0, (3, MOTIONS, count))
    parts[0, :, :count] += 0.5 * (lower + upper)
    parts[0, :, count:] = arm.poses["home"][count:]
    for k, joint in enumerate(joints):
        if joint in problem.kept:
            parts[0, :, k], parts[1:, :, k] = log.motion.q[:, k].mean(), 0.0
    if all(one.log.poses for one in logs):
        parts[1:] = 0.0
    matrix, rest = found.model.regressor(JointMotion(*parts, up=log.log.up))
    efforts = np.sqrt(np.mean((matrix @ found.parameters + rest)[:, :count] ** 2, axis=0))
    weak: dict[str, tuple[float, tuple[str, ...]]] = {}
    for k, joint in enumerate(joints):
        if joint in problem.kept:
            continue
        rows = matrix[:, k]
        variances = cast("Array", np.sum(rows @ found.covariance * rows, axis=1))
        ratio = float(np.sqrt(np.mean(np.maximum(variances, 0.0))) / efforts[k])
        if ratio > EXCITED:
            own = np.sqrt(cast("Array", np.mean(rows**2, axis=0))) * found.sigma
            worst: list[int] = np.argsort(-own)[:NAMED].tolist()
            weak[joint] = ratio, tuple(found.model.names[p] for p in worst)
    return weak


def effort_scale(parts: Sequence[tuple[Array, Array]], logs: Sequence[FilteredLog]) -> Array:
    """Return the length of each column's efforts over the logs that have some, (n,); 1 without."""
    efforts = np.concatenate(
        [log.cut(log.effort) * _filled(part) for part, log in zip(parts, logs, strict=True)]
    )
    size = np.linalg.norm(efforts, axis=0)
    return np.where(size > 0.0, size, 1.0)


def _filled(part: tuple[Array, Array]) -> NDArray[np.bool_]:
    """Return the columns of a regression that have rows, (n,)."""
    matrix, target = part
    return np.asarray(matrix.any(axis=(0, 2)) | target.any(axis=0), np.bool_)


def reweighted(
    model: EffortModel,
    bounds: Mapping[str, BodyBounds],
    parts: Sequence[tuple[Array, Array]],
    logs: Sequence[FilteredLog],
    watch: Callable[[str], None] = lambda _: None,
) -> Identified:
    """Return the parameters that fit best, each column weighted by the error that it is left with.

    Source: Gautier, Poignet 2001, Extended Kalman filtering and weighted least squares dynamic
    identification of robot.

    Args:
        model, bounds: what to identify
        parts: regressor (k, n, p) and efforts (k, n) of each log
        logs: where these are from
        watch: called with the name of each fit
    """
    size = effort_scale(parts, logs)

    def fit(scale: Array) -> Identified:
        rows = [compressed_rows(m, t, log, scale) for (m, t), log in zip(parts, logs, strict=True)]
        return solved(model, bounds, Compressed.joined(rows), logs)

    watch(f"fit 1 of {PASSES}")
    found = fit(size)
    for number in range(2, PASSES + 1):
        watch(f"fit {number} of {PASSES}")
        error = np.concatenate([t - m @ found.parameters for m, t in parts])
        left = np.linalg.norm(error, axis=0) / size
        found = fit(size * (np.maximum(left, LEAST_ERROR) / USUAL_ERROR) ** TEMPER)
    return found


def compressed_rows(
    matrix: Array,
    target: Array,
    log: FilteredLog,
    scale: Array,
) -> Compressed:
    """Return rows, (k, n, p) and (k, n), as a triangle."""
    filled = _filled((matrix, target))
    weighted = matrix[:, filled] / scale[filled, None]
    ratio = 1.0 if log.log.poses else min(1.0, 2.0 * log.settings.cutoff_hz / log.log.rate_hz)
    return Compressed.of(
        weighted.reshape(-1, matrix.shape[-1]),
        (target[:, filled] / scale[filled]).reshape(-1),
        ratio,
    )


def solved(
    model: EffortModel,
    bounds: Mapping[str, BodyBounds],
    rows: Compressed,
    logs: Sequence[FilteredLog],
) -> Identified:
    """Return the parameters that fit rows best."""
    start = model.values
    spread = _prior_sigma(model, bounds, rows)
    prior = np.where(np.arange(len(start)) < 10 * len(model.frames), PRIOR, RIDGE) / spread**2

    def fit(share: float) -> tuple[Array, float]:
        values = _solve(model, bounds, rows, start, share * prior, spread)
        error = rows.triangle @ values - rows.target
        return values, (float(error @ error) + rows.rest) / rows.rows

    values, variance = fit(1.0)
    if variance < PRIOR:  # the weight of one standard deviation, so that priors give way to logs
        values, variance = fit(max(variance, ROUNDING) / PRIOR)
    weight = np.sqrt(rows.independent / rows.rows / max(variance, ROUNDING))
    informed = np.concatenate([weight * rows.triangle * spread, np.eye(len(spread))])
    root = spread[:, None] * np.linalg.inv(np.linalg.qr(informed, mode="r"))
    covariance = root @ root.T
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    base = base_parameters(model, rows, values, covariance)
    return Identified(
        model,
        bounds,
        values,
        sigma,
        covariance,
        dynamics_of(model, values, covariance, logs),
        base,
        tuple(log.log.file for log in logs),
    )


def dynamics_of(
    model: EffortModel, values: Array, covariance: Array, logs: Sequence[FilteredLog]
) -> Dynamics:
    """Return parameters as bodies and drivetrains, with standard deviations."""
    bodies: dict[str, BodyDynamics] = {}
    for k, frame in enumerate(model.frames):
        own = slice(10 * k, 10 * k + 10)
        mass, com, inertia = mass_com_inertia(values[own])
        slopes = _derivative(values[own])
        spread = np.sqrt(np.maximum(np.diag(slopes @ covariance[own, own] @ slopes.T), 0.0))
        sigma = np.zeros((3, 3))
        for value, (i, j) in zip(spread[4:], _SIX, strict=True):
            sigma[i, j] = sigma[j, i] = value
        bodies[frame] = BodyDynamics(mass, com, inertia, float(spread[0]), spread[1:4], sigma)
    sigma_all = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    at = 10 * len(model.frames)
    trains: dict[str, Drivetrain] = {}
    for name, train in model.trains.items():
        own = slice(at, at + len(labels(train)))
        trains[name] = with_coefficients(train, values[own], sigma_all[own])
        at = own.stop
    settings = replace(logs[0].settings, rate_hz=logs[0].log.rate_hz)
    return Dynamics(bodies, trains, settings)


def base_parameters(
    model: EffortModel, rows: Compressed, values: Array, covariance: Array
) -> BaseParameters:
    """Return the combinations of parameters that the rows determine.

    Source: Gautier 1991, Numerical calculation of the base inertial parameters of robots (QR
    decomposition with column pivoting).
    """
    length, used, triangle, order, rank = _pivoted(rows)
    mix = np.linalg.solve(triangle[:rank, :rank], triangle[:rank, rank:])
    combinations = np.zeros((rank, len(values)))
    chosen, others = used[order[:rank]], used[order[rank:]]
    combinations[np.arange(rank), chosen] = 1.0
    combinations[:, others] = mix * length[others] / length[chosen][:, None]
    variance = cast("Array", np.einsum("bp,pq,bq->b", combinations, covariance, combinations))
    sigma = np.sqrt(np.maximum(variance, 0.0))
    names = model.names
    return BaseParameters(
        tuple(names[k] for k in cast("list[int]", chosen.tolist())),
        combinations,
        combinations @ values,
        sigma,
        float(np.linalg.cond(triangle[:rank, :rank])),
    )


def base_condition(rows: Compressed, least: float = RANK) -> tuple[float, int]:
    """Return the condition number and the number of the base parameters of rows.

    Args:
        rows: of a regression
        least: ratio of the pivots down to which parameters count
    """
    _, _, triangle, _, rank = _pivoted(rows, least)
    return float(np.linalg.cond(triangle[:rank, :rank])), rank


def _pivoted(
    rows: Compressed, least: float = RANK
) -> tuple[Array, NDArray[np.intp], Array, NDArray[np.intp], int]:
    """Return lengths of the columns, the used ones, their pivoted triangle, its order and rank."""
    length = np.linalg.norm(rows.triangle, axis=0)
    used = np.flatnonzero(length > 1e-12 * length.max())
    preferred = 1.0 - ALIKE * np.arange(len(used))
    scaled = rows.triangle[:, used] / length[used] * preferred
    found = cast(
        "tuple[Array, Array, NDArray[np.int_]]", qr(scaled, mode="economic", pivoting=True)
    )
    _, triangle, order = found
    triangle = triangle / preferred[order]
    diagonal = np.abs(np.diag(triangle))
    return length, used, triangle, order, int(np.sum(diagonal > least * diagonal[0]))


def _prior_sigma(model: EffortModel, bounds: Mapping[str, BodyBounds], rows: Compressed) -> Array:
    """Return one standard deviation of each parameter before any log, (p,)."""
    found: list[Array] = []
    for frame in model.frames:
        one = bounds[frame]
        size = np.abs(one.middle) + one.half
        second = [size[i] * size[j] for i, j in _SIX]
        found.append(PRIOR_SIGMA * one.cad_mass * np.array([1.0, *size, *second]))
    columns = np.linalg.norm(rows.triangle[:, 10 * len(model.frames) :], axis=0)
    found.append(1.0 / np.maximum(columns, 1e-6 * columns.max(initial=1.0)))
    return np.concatenate(found)


def _solve(
    model: EffortModel,
    bounds: Mapping[str, BodyBounds],
    rows: Compressed,
    start: Array,
    prior: Array,
    spread: Array,
) -> Array:
    """Minimise |R x - r|^2 + sum prior (x - start)^2 over possible parameters.

    The solver gets y of x = spread (x_0 + T^-1 y), with x_0 the minimum without constraints and T
    the triangle of the regression, so that it minimises |y|^2. Its tolerance is a ratio of that: of
    the squared efforts it would be errors of 1e-4 of them, and of several per cent in parameters.
    """
    try:
        import clarabel as library  # pyright: ignore[reportMissingTypeStubs]
    except ImportError as error:
        raise MissingExtraError("clarabel", "identify", "identifying dynamics") from error
    clarabel: Any = library
    own = np.sqrt(prior)
    rows_of_both = np.concatenate([rows.triangle * spread, np.diag(own * spread)])
    whole = Compressed.of(rows_of_both, np.concatenate([rows.target, own * start]), 1.0)
    inverse = np.linalg.inv(whole.triangle)
    free = inverse @ whole.target
    half_spaces, sides = _linear_constraints(model, bounds)
    blocks, offsets = [half_spaces], [sides]
    cones: list[Any] = [clarabel.NonnegativeConeT(len(sides))]
    for k in range(len(model.frames)):
        half = bounds[model.frames[k]].half
        blocks.append(_pseudo_inertia_rows(k, len(start), LEAST_VARIANCE * half**2))
        offsets.append(np.zeros(10))
        cones.append(clarabel.PSDTriangleConeT(4))
    sizes = [np.linalg.norm(half_spaces * spread @ inverse, axis=1)]
    sizes += [np.full(10, np.linalg.norm(block * spread @ inverse)) for block in blocks[1:]]
    matrix = np.concatenate(blocks) * spread
    size = np.concatenate(sizes)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix(np.eye(len(start))),
        np.zeros(len(start)),
        sparse.csc_matrix(matrix @ inverse / size[:, None]),
        (np.concatenate(offsets) - matrix @ free) / size,
        cones,
        settings,
    )
    solution = solver.solve()
    status = str(solution.status)
    if "Infeasible" in status:
        raise InputError(f"bounds: no possible body satisfies all of them ({status})")
    if "Solved" not in status:
        raise TrocarError(f"identification: the solver ended with {status}")
    return (free + inverse @ np.array(solution.x)) * spread


def _linear_constraints(
    model: EffortModel, bounds: Mapping[str, BodyBounds]
) -> tuple[Array, Array]:
    """Return G, h of G x <= h: mass bounds, hulls, boxes and signs."""
    count = len(model.names)
    rows: list[Array] = []
    sides: list[float] = []

    def add(entries: Mapping[int, float], side: float) -> None:
        row = np.zeros(count)
        for column, value in entries.items():
            row[column] = value
        rows.append(row)
        sides.append(side)

    for k, frame in enumerate(model.frames):
        at, one = 10 * k, bounds[frame]
        add({at: 1.0}, one.upper)
        add({at: -1.0}, -one.lower)
        for normal, offset in zip(one.normals, one.offsets, strict=True):
            add({at: -offset, **{at + 1 + i: normal[i] for i in range(3)}}, 0.0)
        for i in range(3):
            middle, half = one.middle[i], one.half[i]
            # integral of (x - middle)^2 dm <= half^2 m, as the body lies in its box
            add({at + 4 + i: 1.0, at + 1 + i: -2.0 * middle, at: middle**2 - half**2}, 0.0)
    at = 10 * len(model.frames)
    for train in model.trains.values():
        for term, _ in labels(train):
            if term in POSITIVE:
                add({at: -1.0}, 0.0)
            at += 1
    return np.stack(rows), np.array(sides)


#: Entries of the upper triangle of a (4, 4) pseudo-inertia by columns: the parameter's number.
_TRIANGLE = (
    *((0, 0, 4), (0, 1, 7), (1, 1, 5), (0, 2, 8), (1, 2, 9), (2, 2, 6)),
    *((0, 3, 1), (1, 3, 2), (2, 3, 3), (3, 3, 0)),
)
_SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def _pseudo_inertia_rows(body: int, count: int, variance: Array) -> Array:
    """Return minus the triangle of a body's pseudo-inertia, as Clarabel's cone has it, (10, p).

    Less the mass times `variance`, (3,) [m^2], which leaves at least that about the centre of mass.
    """
    matrix = np.zeros((10, count))
    for row, (i, j, number) in enumerate(_TRIANGLE):
        matrix[row, 10 * body + number] = -1.0 if i == j else -np.sqrt(2.0)
        if i == j < 3:
            matrix[row, 10 * body] = variance[i]
    return matrix


def _derivative(values: Array) -> Array:
    """Return d (mass, centre, inertia) / d parameters of a body by differences, (10, 10)."""

    def six(parameters: Array) -> Array:
        mass, com, inertia = mass_com_inertia(parameters)
        return np.array([mass, *com, *(inertia[i, j] for i, j in _SIX)])

    step = 1e-6 * values[0]
    return np.stack(
        [(six(values + step * e) - six(values - step * e)) / (2.0 * step) for e in np.eye(10)],
        axis=1,
    )


def _check_alike(logs: Sequence[FilteredLog]) -> None:
    if not logs:
        raise InputError("logs: got none; allowed: one or more")
    first = logs[0]
    for log in logs[1:]:
        if log.settings != first.settings or log.log.columns != first.log.columns:
            raise InputError(
                f"{log.log.file}: filtered or recorded unlike {first.log.file}; allowed: logs"
                " of the same columns"
            )
