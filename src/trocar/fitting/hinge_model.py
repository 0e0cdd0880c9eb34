"""Two bodies on one hinge: T_ab = A Rz(theta) B, and its likelihood under noise on both poses.

Each body's pose in the camera has white noise: sigma_p on the position, sigma_R on the rotation
(per axis). To first order, in the frame of a, with the measured T_ab = (R, p) and the model's:

    rotation   eps = log(R R_model^T)          covariance 2 sigma_R^2 I
    position   y = p - p_model + p x eps / 2   covariance 2 sigma_p^2 I, and sigma_R^2 |p|^2 / 2
                                               more across p

The half turn of y makes the two independent of one another: the noise of a's rotation acts on p by
its whole length, that of b's not at all, and eps holds equal parts of both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import rotation_vector_from_matrix, rotation_z
from trocar.geometry.se3 import exp_twist, translation

Array = NDArray[np.float64]

#: Free coordinates: A is moved along x, y, z and turned about x, y; B along x, y and about x, y.
#: What is missing of the twelve is the zero of theta, a common turn, and a common slide.
FREE = 9
# Source: our choice; noise below this is rounding, and only the ratio of the two matters.
LEAST_SIGMA = 1e-11


@dataclass(frozen=True, eq=False)
class HingeModel:
    """A hinge: T_ab(theta) = before @ Rz(theta) @ after; the axis is z between the two.

    Attributes:
        before: the hinge in a, (4, 4)
        after: b in the turned hinge, (4, 4)
        theta: angle of each sample, (n,) [rad]
    """

    before: Array
    after: Array
    theta: Array

    def poses(self) -> Array:
        """Return the pose of b in a for each sample, (n, 4, 4)."""
        turn = np.zeros((len(self.theta), 4, 4))
        turn[:, :3, :3] = rotation_z(self.theta)
        turn[:, 3, 3] = 1.0
        return self.before @ turn @ self.after

    def moved(self, step: Array, turn: Array) -> HingeModel:
        """Return the model after a step of its free coordinates, (9,), and of its angles, (n,)."""
        x = np.concatenate([step[:5], [0.0], step[5:7], [0.0], step[7:9], [0.0]])
        before, after = exp_twist(x[:6]), exp_twist(x[6:])
        return HingeModel(self.before @ before, after @ self.after, self.theta + turn)

    def slid(self, distance: float) -> HingeModel:
        """Return the same model with its hinge frames moved along the axis [m]."""
        slide = translation([0.0, 0.0, distance])
        back = translation([0.0, 0.0, -distance])
        return replace(self, before=self.before @ slide, after=back @ self.after)


@dataclass(frozen=True, eq=False)
class Residuals:
    """How the samples differ from a model, along the axes of its hinge frame before the turn.

    Attributes:
        eps: rotation, (n, 3) [rad]
        shift: position, p - p_model, (n, 3) [m]
        y: position made independent of the rotation, (n, 3) [m]
        p: the model's place of b from a, (n, 3) [m]
        lever: what a turn about the axes through the hinge moves y by, (n, 3) [m]
    """

    eps: Array
    shift: Array
    y: Array
    p: Array
    lever: Array


def residuals(model: HingeModel, T_ab: Array, rotation_sigma: float = 0.0) -> Residuals:
    """Compare samples with a model.

    Args:
        model: of n samples
        T_ab: measured, (n, 4, 4), all finite
        rotation_sigma: noise of each body's rotation [rad]; a noisy a shortens the mean of p by
            sigma^2 |p|, which is given back

    Returns:
        the differences
    """
    made = model.poses()
    axes = model.before[:3, :3]
    difference = T_ab[:, :3, :3] @ np.swapaxes(made[:, :3, :3], 1, 2)
    eps = rotation_vector_from_matrix(difference) @ axes
    p = made[:, :3, 3] @ axes
    shift = (T_ab[:, :3, 3] - made[:, :3, 3]) @ axes
    y = shift + 0.5 * np.cross(p, eps) + rotation_sigma**2 * p
    return Residuals(eps, shift, y, p, 0.5 * p - model.before[:3, 3] @ axes)


@dataclass(frozen=True, eq=False)
class Normal:
    """The whitened linear problem with the angles eliminated: minimise |r + C dx|^2.

    Attributes:
        r: residuals across the sample's own angle, (n, 6)
        C: their derivatives, (n, 6, 9)
        turn: what a sample's own angle has to turn by, from the unreduced problem, (n,) [rad]
        turn_by: ... and its derivative with the free coordinates, (n, 9)
    """

    r: Array
    C: Array
    turn: Array
    turn_by: Array

    def step(self, used: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return the Gauss-Newton step, (9,), and the matrix that made it, (9, 9)."""
        C = self.C[used].reshape(-1, FREE)
        square = C.T @ C
        square[np.diag_indices(FREE)] += np.diag(square) == 0.0  # what counts for nothing stays
        try:
            inverse = np.asarray(np.linalg.inv(square), dtype=np.float64)
        except np.linalg.LinAlgError:  # exact poses of two bodies that do not turn
            inverse = np.asarray(np.linalg.pinv(square, hermitian=True), dtype=np.float64)
        return -inverse @ (C.T @ self.r[used].reshape(-1)), inverse


def normal(
    model: HingeModel, found: Residuals, sigmas: tuple[float, float], slides: bool = False
) -> Normal:
    """Linearise the likelihood about a model.

    Args:
        model: where
        found: its residuals
        sigmas: noise of each body's position [m] and rotation [rad]
        slides: whether each sample has a slide along the axis of its own, besides its angle
    """
    n = len(model.theta)
    x, y, z = np.eye(3)
    turned = rotation_z(model.theta)
    moves = [np.broadcast_to(v, (n, 3)) for v in (x, y, z)] + [turned[..., 0], turned[..., 1]]
    turns = [np.broadcast_to(v, (n, 3)) for v in (x, y)] + [turned[..., 0], turned[..., 1]]
    full = np.zeros((n, 6, FREE + 2))
    places = ([0, 1, 2, 5, 6], [3, 4, 7, 8])
    for column, v in zip(places[0], moves, strict=True):
        full[:, :3, column] = -v
    for column, w in zip(places[1], turns, strict=True):
        full[:, :3, column], full[:, 3:, column] = -np.cross(w, found.lever), -w
    full[:, :3, FREE], full[:, 3:, FREE] = -np.cross(z, found.lever), -z
    full[:, :3, FREE + 1], full[:, 3:, FREE + 1] = found.y, found.eps
    full = _whitened(full, found.p, sigmas)

    if slides:
        full, _ = _without(full, full[..., 2].copy())
        full[..., 2] = 0.0
    others, along = _without(np.delete(full, FREE, axis=2), full[..., FREE])
    return Normal(others[..., FREE], others[..., :FREE], -along[:, FREE], -along[:, :FREE])


def _without(columns: Array, own: Array) -> tuple[Array, Array]:
    """Return columns, (n, 6, m), less what lies along one of a sample's own, (n, 6); and how much.

    Returns:
        what is left, (n, 6, m), and the shares of `own` that were taken, (n, m)
    """
    square = np.einsum("ki,ki->k", own, own)
    along = np.einsum("ki,kij->kj", own, columns) / square[:, None]
    return columns - own[..., None] * along[:, None, :], along


def _whitened(columns: Array, p: Array, sigmas: tuple[float, float]) -> Array:
    """Divide columns of (y; eps), (n, 6, m), by the root of their covariance."""
    along, across, rotation = _deviations(p, sigmas)
    unit = p / np.maximum(np.linalg.norm(p, axis=1), np.finfo(float).tiny)[:, None]
    out = columns.copy()
    part = np.einsum("ki,kij->kj", unit, columns[:, :3])
    out[:, :3] /= across[:, None, None]
    out[:, :3] += unit[..., None] * (part * (1.0 / along - 1.0 / across)[:, None])[:, None, :]
    out[:, 3:] /= rotation
    return out


def _deviations(p: Array, sigmas: tuple[float, float]) -> tuple[Array, Array, float]:
    """Return the deviations of y along and across p, (n,) each [m], and of the rotation [rad]."""
    square = 2.0 * sigmas[0] ** 2
    lever = 0.5 * sigmas[1] ** 2 * np.einsum("ki,ki->k", p, p)
    return np.full(len(p), np.sqrt(square)), np.sqrt(square + lever), np.sqrt(2.0) * sigmas[1]


def noise(found: Residuals, used: NDArray[np.bool_], slides: bool = False) -> tuple[float, float]:
    """Estimate the noise of each body's pose from what its own angle cannot explain.

    Args:
        found: residuals at the solution
        used: which samples count, (n,)
        slides: whether each sample has a slide along the axis of its own

    Returns:
        standard deviations of position [m] and rotation [rad], per axis and per body
    """
    eps, y, p, lever = found.eps[used], found.y[used], found.p[used], found.lever[used]
    rotation = max(float(np.sqrt(np.mean(eps[:, :2] ** 2) / 2.0)), LEAST_SIGMA)
    # Two directions that the sample's own angle does not move: along the axis and along the lever.
    radial = lever * [1.0, 1.0, 0.0]
    radial /= np.maximum(np.linalg.norm(radial, axis=1), np.finfo(float).tiny)[:, None]
    first = 1 if slides else 0  # the slide is along the first
    along = np.concatenate([y[:, 2], np.einsum("ki,ki->k", y, radial)][first:])
    part = np.concatenate([p[:, 2], np.einsum("ki,ki->k", p, radial)][first:])
    square = np.einsum("ki,ki->k", p, p)
    turned = 0.5 * rotation**2 * (np.concatenate([square, square][first:]) - part**2)
    least = max(1e-3 * float(np.mean(turned)), 2.0 * LEAST_SIGMA**2)
    position = max(float(np.mean(along**2)), least)
    for _ in range(20):
        weights = 1.0 / (position + turned) ** 2
        position = float(weights @ (along**2 - turned) / weights.sum())
        position = max(position, least)
    return float(np.sqrt(position / 2.0)), rotation
