"""Scores of predicted efforts, and cross-validation by blocks of a periodic trajectory's phase."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.robot.identification.bounds import MASS_RATIOS, all_bounds
from trocar.robot.identification.fit import fit_problem, reweighted
from trocar.robot.identification.logs import FilteredLog

Array = NDArray[np.float64]

#: Blocks of the phase that are held out one after the other, and samples beside a block that train
#: nothing [s]. Source: identification of the recordings; random samples or whole periods would
#: measure repeatability only.
BLOCKS = 6
GAP_S = 0.2
#: Largest difference of a periodic trajectory from itself one period later, as a ratio of its size.
#: Source: our own choice; recorded ones differ by 0.01.
PERIODIC = 0.1


@dataclass(frozen=True)
class Score:
    """Errors of predicted efforts.

    Attributes:
        relative_rms_percent: {column: RMS of the error / RMS of the effort, in percent}
        rms: {column: RMS of the error} [N m or N]
    """

    relative_rms_percent: dict[str, float | None]
    rms: dict[str, float]


def score(columns: Sequence[str], effort: Array, predicted: Array) -> Score:
    """Return the errors of predicted efforts, (k, n) each [N m or N].

    Source: |effort - predicted| / |effort| per column, as the published work has it (Wang 2019).
    A column whose efforts are 0 has no relative error.
    """
    error = np.linalg.norm(effort - predicted, axis=0)
    size = np.linalg.norm(effort, axis=0)
    root = np.sqrt(max(len(effort), 1))
    return Score(
        {
            name: float(100.0 * e / s) if s > 0.0 else None
            for name, e, s in zip(columns, error, size, strict=True)
        },
        {name: float(e / root) for name, e in zip(columns, error, strict=True)},
    )


def period(log: FilteredLog) -> int:
    """Return the samples of one period of a trajectory, all of the log if it does not repeat."""
    q = log.cut(log.motion.q)[:, : log.log.q.shape[1]]
    q = (q - q.mean(axis=0)) / np.maximum(q.std(axis=0), 1e-12)
    shortest = round(2.0 * log.log.rate_hz)
    differences = np.array(
        [
            np.sqrt(np.mean(cast("Array", (q[lag:] - q[:-lag]) ** 2)))
            for lag in range(shortest, 2 * len(q) // 3)
        ]
    )
    if not len(differences) or differences.min() > PERIODIC:
        return len(q)
    # the first minimum: later ones are multiples
    low = np.flatnonzero(differences <= max(2.0 * differences.min(), 0.25 * PERIODIC))
    first = low[low < low[0] + shortest]
    return int(shortest + first[np.argmin(differences[first])])


def cross_validate(
    log: FilteredLog,
    arm: ArmDescription,
    mass_ratios: tuple[float, float] = MASS_RATIOS,
    watch: Callable[[str], None] = lambda _: None,
    keep: Sequence[str] = (),
) -> Score:
    """Return the errors at samples whose block of the phase was held out of the identification.

    All repeats of a block are held out together, with a gap on both sides. Columns that
    `identify` leaves out have no relative error; `keep` names joints to leave as described.
    """
    problem = fit_problem([log], arm, keep=keep)
    model, ((matrix, target),) = problem.model, problem.parts
    fitted = np.asarray(matrix.any(axis=(0, 2)), np.bool_)
    bounds = all_bounds(arm, model.frames, mass_ratios)
    effort = log.cut(log.effort)
    length = period(log)
    phase = np.arange(len(effort)) % length
    gap = round(GAP_S * log.log.rate_hz)
    predicted = np.zeros_like(effort)
    for number in range(BLOCKS):
        watch(f"holding out block {number + 1} of {BLOCKS}")
        first, last = (length * k // BLOCKS for k in (number, number + 1))
        held = (phase >= first) & (phase < last)
        beside = (phase - (first - gap)) % length < last - first + 2 * gap
        part = matrix[~beside], target[~beside]
        best = reweighted(model, bounds, [part], [log]).parameters
        predicted[held] = (effort - target)[held] + matrix[held] @ best
    found = score(log.log.columns, effort, predicted)
    errors = found.relative_rms_percent
    left = zip(errors.items(), fitted.tolist(), strict=True)
    return Score({name: error if one else None for (name, error), one in left}, found.rms)
