"""Least-squares adjustment: poses and vectors that explain residuals within their noise.

Minimised is

    sum over blocks |r_b(x) / sigma_b|^2  +  sum over priors |x_i / sigma_i|^2

by Levenberg-Marquardt steps. A pose turns and shifts in its own axes, T exp(x); a vector adds. The
noise of a block may be unknown: it is then what is left of its residuals, divided by their
redundancy (variance components), and the blocks are weighted anew. The covariance is that of the
normal equations at the solution; what nothing determines has a large variance there, and a prior
that is not narrowed is listed by `Adjustment.undetermined`.

Source: Foerstner and Wrobel, Photogrammetric Computer Vision, 2016, sections 4.2.4 (variance
components) and 4.7 (nonlinear models); Marquardt's scaling by the diagonal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.se3 import exp_twist

Array = NDArray[np.float64]
#: {unknown: pose (4, 4) or vector (k,)}
Values = Mapping[str, Array]

#: Step of numerical derivatives. Source: our own choice; geometry is smooth on this scale, so it
#: leaves 1e-9 of slopes. [m, rad]
STEP = 1e-6
#: Most steps of a minimisation, and the part of the cost that a step must gain to go on.
STEPS, GAIN = 60, 1e-9
#: Damping of the first step, its bounds, and its change after each. Source: our own choice.
DAMPING, LEAST_DAMPING, MOST_DAMPING, CHANGE = 1e-4, 1e-12, 1e8, 10.0
#: Least eigenvalue of scaled normal equations that counts: rounding of a condition number of 1e13.
LEAST_EIGENVALUE = 1e-13


def slopes(of: Callable[[Array], Any], x: Array) -> Array:
    """Return the derivative of a function of x, (m, n) or (n,), by central differences."""
    steps = STEP * np.eye(len(x))
    return np.stack([(of(x + s) - of(x - s)) / (2.0 * STEP) for s in steps], axis=-1)


@dataclass(frozen=True, eq=False)
class Block:
    """Residuals that have one noise.

    Attributes:
        residuals: (m,), all finite
        derivative: by a step of all unknowns, (m, n); None: found by central differences
    """

    residuals: Array
    derivative: Array | None = None


@dataclass(frozen=True, eq=False)
class Adjustable:
    """A least-squares problem.

    Attributes:
        blocks: of values of the unknowns, {block: residuals}
        noise: standard deviation of each block's residuals, in the order of `blocks`
        least: of blocks whose noise is estimated, the least that is believed
        priors: {vector: standard deviations of its elements about 0; inf: no prior}
    """

    blocks: Callable[[Values], Mapping[str, Block]]
    noise: Mapping[str, float]
    least: Mapping[str, float] = field(default_factory=dict[str, float])
    priors: Mapping[str, Array] = field(default_factory=dict[str, Array])

    def linear(self, values: Values) -> tuple[Array, Array]:
        """Return weighted residuals (m,) and their derivative (m, n), the blocks before the priors.

        Args:
            values: of the unknowns
        """
        left, J = self.evaluated(values)
        return left, self.derivative(values) if J is None else J

    def evaluated(self, values: Values) -> tuple[Array, Array | None]:
        """Return the same, without the derivative where the blocks have none."""
        blocks = self.blocks(values)
        left = [blocks[name].residuals / sigma for name, sigma in self.noise.items()]
        left += [values[name] / sigma for name, sigma in self.priors.items()]
        parts = [
            block.derivative / self.noise[name]
            for name, block in blocks.items()
            if block.derivative is not None
        ]
        at = layout(values)
        for name, sigma in self.priors.items():
            parts.append(np.zeros((len(sigma), _size(at))))
            parts[-1][:, at[name]] = np.diag(1.0 / sigma)
        whole = len(parts) == len(self.noise) + len(self.priors)
        return np.concatenate(left), np.vstack(parts) if whole else None

    def derivative(self, values: Values) -> Array:
        """Return the derivative of weighted residuals by central differences, (m, n)."""
        start = np.zeros(_size(layout(values)))
        return slopes(lambda x: self.evaluated(moved(values, x))[0], start)


def layout(values: Values) -> dict[str, slice]:
    """Return the place of each unknown in a step of all, {unknown: slice}; a pose has six."""
    found: dict[str, slice] = {}
    end = 0
    for name, value in values.items():
        begin, end = end, end + (6 if value.ndim == 2 else len(value))
        found[name] = slice(begin, end)
    return found


def _size(at: Mapping[str, slice]) -> int:
    return max(part.stop for part in at.values())


def moved(values: Values, step: Array) -> dict[str, Array]:
    """Return values a step further, (n,); poses move in their own axes."""
    return {
        name: value @ exp_twist(step[at]) if value.ndim == 2 else value + step[at]
        for (name, value), at in zip(values.items(), layout(values).values(), strict=True)
    }


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Unknowns that explain the residuals best.

    Attributes:
        problem: with the noise as estimated
        values: of the unknowns
        residuals: {block: (m,)}
        covariance: of small steps of all unknowns, (n, n)
    """

    problem: Adjustable
    values: Values
    residuals: Mapping[str, Array]
    covariance: Array

    def covariance_of(self, *names: str) -> Array:
        """Return the covariance of small steps of some unknowns, one after another, (k, k)."""
        at = layout(self.values)
        index = np.array(
            [k for name in names for k in range(at[name].start, at[name].stop)], np.intp
        )
        return self.covariance[np.ix_(index, index)]

    def sigma(self, name: str) -> Array:
        """Return the standard deviations of small steps of an unknown, (k,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance_of(name)), 0.0))

    def ratio(self, name: str) -> float:
        """Return the deviation of a vector from its prior by what that allows, RMS; about 1."""
        prior = self.problem.priors[name]
        scaled = self.values[name] / prior
        redundancy = len(prior) - float(np.sum((self.sigma(name) / prior) ** 2))
        return float(np.sqrt(scaled @ scaled / max(redundancy, 1.0)))

    def undetermined(self, name: str, part: float) -> list[int]:
        """Return the elements of a vector that are known little better than by their prior.

        Args:
            name: of the vector
            part: of the prior's standard deviation, above which an element is undetermined
        """
        prior = self.problem.priors[name]
        return np.flatnonzero(self.sigma(name) > part * prior).tolist()


def adjust(
    problem: Adjustable,
    values: Values,
    rounds: int = 1,
    watch: Callable[[int], None] = lambda _: None,
) -> Adjustment:
    """Adjust all unknowns, and the noise of blocks that have it estimated.

    Args:
        problem: the residuals
        values: where to begin
        rounds: minimisations; after each the noise is estimated anew
        watch: called with the number of each round, from 1
    """
    for number in range(1, rounds + 1):
        watch(number)
        values = minimised(problem, values)
        if problem.least:
            problem = replace(problem, noise=_estimated_noise(problem, values))
    _, J = problem.linear(values)
    left = {name: block.residuals for name, block in problem.blocks(values).items()}
    return Adjustment(problem, values, left, inverted(J.T @ J))


def minimised(problem: Adjustable, values: Values) -> Values:
    """Return the values of least cost from these on."""
    left, jacobian = problem.linear(values)
    damping, cost, last = DAMPING, float(left @ left), False
    for _ in range(STEPS):
        square, slope = jacobian.T @ jacobian, jacobian.T @ left
        scale = _scale(square)
        before = cost
        while damping < MOST_DAMPING:
            damped = square / np.outer(scale, scale) + damping * np.eye(len(scale))
            tried = moved(values, -np.linalg.solve(damped, slope / scale) / scale)
            there, by = problem.evaluated(tried)
            if np.isfinite(there).all() and there @ there < cost:
                values, left, cost = tried, there, float(there @ there)
                jacobian = problem.derivative(values) if by is None else by
                damping = max(damping / CHANGE, LEAST_DAMPING)
                break
            damping *= CHANGE
        if before - cost <= GAIN * before:
            if last:
                break
            # Damping holds back what little determines: go on without.
            last, damping = True, LEAST_DAMPING
    return values


def inverted(square: Array) -> Array:
    """Return the inverse of normal equations, (n, n); open directions get a large variance."""
    scale = _scale(square)
    values, vectors = np.linalg.eigh(square / np.outer(scale, scale))
    found = (vectors / np.maximum(values, LEAST_EIGENVALUE)) @ vectors.T
    return np.asarray(found / np.outer(scale, scale), dtype=np.float64)


def _scale(square: Array) -> Array:
    return np.sqrt(np.maximum(np.diag(square), 1e-30))


def _estimated_noise(problem: Adjustable, values: Values) -> dict[str, float]:
    """Return the blocks' noise: what is left of each, by its redundancy, m - tr(J C J^T)."""
    left, J = problem.linear(values)
    covariance = inverted(J.T @ J)
    blocks, noise, end = problem.blocks(values), dict(problem.noise), 0
    for name, before in problem.noise.items():
        begin, end = end, end + len(blocks[name].residuals)
        if name in problem.least:
            rows, part = J[begin:end], left[begin:end]
            redundancy = end - begin - float(np.einsum("ij,jk,ik->", rows, covariance, rows))
            sigma = before * float(np.sqrt(part @ part / max(redundancy, 1.0)))
            noise[name] = max(sigma, problem.least[name])
    return noise
