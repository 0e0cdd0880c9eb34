"""The point of a body that stays where it is: pivot calibration by maximum likelihood.

The closed-loop paper's equations 3 and 4, `R_k tip + p_k = post`, are linear, but R is measured:
with noise sigma_R in it plain least squares draws the tip to the body. Here every sample's pose is
moved onto the model first, each part by its share of the noise (errors in variables), and the
residuals are weighted by their covariance.

A real centre wanders by millimetres. That is no error of a sample: all samples count but gross
outliers, see `robust.not_gross`, and `rms` is what all of them miss the point by. Where
the other body rests, its mean pose counts (`rest_pose`).

Source: equations 3 to 5 of the closed-loop paper, section 4; equation 5 lacks the 1/n that its
Table 7 needs, so the root mean square here has it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, UndeterminedError
from trocar.fitting.robust import ROUNDED, near, not_gross, shared_point, widening
from trocar.geometry.rotations import (
    matrix_from_rotation_vector,
    nearest_rotation,
    rotation_vector_from_matrix,
    skew,
)
from trocar.geometry.se3 import inverse, transform

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Rotations that turn by less than this about a second axis leave the point's place along the
#: first open [rad, root mean square]. Source: our choice; 0.05 rad of sweep, as for a hinge.
LEAST_TURN = 0.015
#: Source: our choice; six unknowns need three poses.
LEAST_POSES = 8
# Source: our choice; noise below this is rounding.
_ROUNDING = 1e-11
# Source: our choice; samples that miss the point by less count alike in the first guess, so that
# it is that of the whole sweep and not of the poses that one place of a wandering point fits. [m]
_ALIKE = 1e-3
_ROUNDS = 8
_STEPS = 6
# Source: our choice; a body whose spread exceeds its white noise by this factor is moving, with
# more room where few samples tell either.
_MOVING, _FEW = 1.15, 6.0
# Source: our choice; more poses than this away from the rest are no gross outliers.
_MOST_OUTLIERS = 0.1
# Source: median of |x| of a normal variable with unit deviation.
_MEDIAN_OF_ABSOLUTE = 0.6744897501960817
# Source: root of the sum of squares of 1, -3, 3, -1.
_THIRD = np.sqrt(20.0)
_LEAST_SAMPLES = 20


@dataclass(frozen=True, eq=False)
class PivotFit:
    """The point that a body turns about.

    Attributes:
        tip: the point in the body, the paper's b_tip, (3,) [m]
        post: the point in the frame of the poses, b_post, (3,) [m]
        rms_axes: root of the mean squared difference R tip + p - post per axis, (3,) [m]
        rms: the same as a distance [m]
        condition: of the normal matrix, (1 + s) / (1 - s), s the largest singular value of the
            mean rotation
        sigma_tip, sigma_post: standard deviations, (3,) [m]
        points: R tip + p, where each sample has the point, (n, 3) [m]; NaN where not tracked
        used: which samples were, (n,)
        influence: effect of each sample's own residual on (tip, post), (n, 6) [m]; zero where
            unused
        outliers: samples that were tracked but grossly off, and not used
        widened: factor of influence and sigma for residuals that are correlated in time, 1 where
            white
    """

    tip: Array
    post: Array
    rms_axes: Array
    rms: float
    condition: float
    sigma_tip: Array
    sigma_post: Array
    points: Array
    used: Mask
    influence: Array
    outliers: int
    widened: float = 1.0


@dataclass(frozen=True, eq=False)
class RestPose:
    """Mean pose of a body at rest.

    Attributes:
        pose: in the camera's frame, (4, 4)
        position_sigma, rotation_sigma: of this mean, per axis [m], [rad]
    """

    pose: Array
    position_sigma: float
    rotation_sigma: float


@dataclass(frozen=True)
class _Noise:
    """Noise of the body's pose and of its reference frame's [m], [rad]."""

    position: float
    rotation: float
    frame: bool


def fit_pivot(
    R: ArrayLike, p: ArrayLike, *, rotation_sigma: float | None = None, relative: bool = True
) -> PivotFit:
    """Find the point of a body that stays still.

    Args:
        R: rotations of the body, (n, 3, 3); NaN where not tracked
        p: its origin, (n, 3) [m], same frame
        rotation_sigma: noise of each measured rotation, per axis [rad]; estimated from the
            residuals when omitted
        relative: whether the frame is another measured body, with noise of its own, or rests

    Returns:
        the point in both frames and how well it stays

    Raises:
        InputError: wrong shapes, or fewer than `LEAST_POSES` poses
        UndeterminedError: all rotations share one axis, along which the point is not determined
    """
    T, tracked = _check(R, p)
    Rt, pt = T[tracked, :, :3], T[tracked, :, 3]
    tip, used = _start(Rt, pt)
    _check_determined(Rt[used])
    post = (Rt[used] @ tip + pt[used]).mean(axis=0)
    x, sigma = np.concatenate([tip, post]), _Noise(1.0, rotation_sigma or 0.0, relative)
    linear = _linear(x, Rt, pt, sigma)
    for _ in range(_ROUNDS):
        sigma = _noise(x, Rt, pt, used, rotation_sigma, relative)
        x, linear = _descend(x, Rt, pt, used, sigma)
        chosen = not_gross(np.linalg.norm(Rt @ x[:3] + pt - x[3:], axis=1))
        if (chosen == used).all():
            break
        used = chosen
    return _result(x, T, linear, used, tracked)


def fit_pivot_in_body(T_ca: ArrayLike, T_cb: ArrayLike) -> PivotFit:
    """Find the point of b that stays still in a, from the poses of both in the camera's frame.

    Where a rests, its mean pose is taken: its noise then counts once and not in each sample.

    Args:
        T_ca, T_cb: poses at equal steps of time, (n, 4, 4), NaN where not tracked

    Returns:
        the point, `post` and `points` in a, `tip` in b

    Raises:
        InputError: a body hardly tracked
        UndeterminedError: all rotations share one axis
    """
    a, b = np.asarray(T_ca, dtype=np.float64), np.asarray(T_cb, dtype=np.float64)
    noise = max(white_noise(b)[1], white_noise(a)[1])
    rest = rest_pose(a)
    if rest is None:
        moved = inverse(a) @ b
        return fit_pivot(moved[:, :3, :3], moved[:, :3, 3], rotation_sigma=noise)
    T_ab = inverse(rest.pose) @ b
    fit = fit_pivot(T_ab[:, :3, :3], T_ab[:, :3, 3], rotation_sigma=noise, relative=False)
    across = fit.post @ fit.post - fit.post**2
    more = rest.position_sigma**2 + rest.rotation_sigma**2 * across
    return replace(fit, sigma_post=np.sqrt(fit.sigma_post**2 + more))


def expected_pivot_sigma(T_ca: ArrayLike, T_cb: ArrayLike, sigmas: tuple[float, float]) -> Array:
    """Return the standard deviations that noise will give (tip, post), (6,) [m].

    Args:
        T_ca, T_cb: poses of both bodies without noise, as `fit_pivot_in_body` takes them
        sigmas: noise that each pose will have, position [m] and rotation [rad] per axis
    """
    a, b = np.asarray(T_ca, dtype=np.float64), np.asarray(T_cb, dtype=np.float64)
    fit, rest = fit_pivot_in_body(a, b), rest_pose(a)
    T = (inverse(a if rest is None else rest.pose) @ b)[fit.used]
    noise = _Noise(*sigmas, rest is None)
    _, C = _linear(np.concatenate([fit.tip, fit.post]), T[:, :3, :3], T[:, :3, 3], noise)
    flat = C.reshape(-1, 6)
    variance = np.diag(np.linalg.inv(flat.T @ flat)).copy()
    if rest is not None:
        across = fit.post @ fit.post - fit.post**2
        variance[3:] += (sigmas[0] ** 2 + sigmas[1] ** 2 * across) / len(a)
    return np.sqrt(variance)


def rest_pose(T_ca: ArrayLike) -> RestPose | None:
    """Average the pose of a body, outliers left out, if it does not move.

    Args:
        T_ca: poses at equal steps of time, (n, 4, 4), NaN where not tracked

    Returns:
        the mean, or None when the poses spread by more than their noise from sample to sample

    Raises:
        InputError: hardly tracked at all
    """
    every = np.asarray(T_ca, dtype=np.float64)
    position_noise, rotation_noise = white_noise(every)
    T = every[np.isfinite(every).all(axis=(1, 2))]
    R, p = _typical(T[:, :3, :3]), np.median(T[:, :3, 3], axis=0)
    away_R, away_p = rotation_vector_from_matrix(R.T @ T[:, :3, :3]), T[:, :3, 3] - p
    used = near(np.linalg.norm(away_R, axis=1)) & near(np.linalg.norm(away_p, axis=1))
    if used.mean() < 1.0 - _MOST_OUTLIERS:
        return None
    away_R, away_p = away_R[used], away_p[used]
    spread = float(away_p.std(axis=0).max()), float(away_R.std(axis=0).max())
    factor = _MOVING + _FEW / float(np.sqrt(used.sum()))
    for got, noise, least in zip(spread, (position_noise, rotation_noise), ROUNDED, strict=True):
        if got > max(factor * noise, least):
            return None
    pose = transform(R @ matrix_from_rotation_vector(away_R.mean(axis=0)), p + away_p.mean(axis=0))
    root = float(np.sqrt(used.sum()))
    return RestPose(pose, spread[0] / root, spread[1] / root)


def white_noise(T_ca: ArrayLike) -> tuple[float, float]:
    """Estimate the white noise of a body's pose from neighbouring samples.

    Third differences of a motion that is smooth on the scale of a few samples hold noise alone:
    their median size tells it, gross outliers or not. A camera that smooths its poses has less
    noise by this measure than in truth.

    Args:
        T_ca: poses at equal steps of time, (n, 4, 4), NaN where not tracked

    Returns:
        standard deviations per axis of position [m] and rotation [rad]

    Raises:
        InputError: fewer than 20 stretches of four neighbouring poses
    """
    T = np.asarray(T_ca, dtype=np.float64)
    R = T[:, :3, :3]
    position = np.diff(T[:, :3, 3], n=3, axis=0)
    step = np.swapaxes(R[:-1], 1, 2) @ R[1:]
    tracked = np.isfinite(step).all(axis=(1, 2))
    turn = np.full((len(step), 3), np.nan)
    turn[tracked] = rotation_vector_from_matrix(step[tracked])
    rotation = np.diff(turn, n=2, axis=0)
    if np.isfinite(position[:, 0]).sum() < _LEAST_SAMPLES:
        raise InputError(
            f"poses of a body: {int(np.isfinite(position[:, 0]).sum())} stretches of four "
            f"neighbouring samples; expected at least {_LEAST_SAMPLES}"
        )
    return _deviation(position) / _THIRD, _deviation(rotation) / _THIRD


def _check(R: ArrayLike, p: ArrayLike) -> tuple[Array, Mask]:
    """Return R beside p, (n, 3, 4), and which of them are finite, (n,)."""
    turns, origins = np.asarray(R, dtype=np.float64), np.asarray(p, dtype=np.float64)
    if turns.ndim != 3 or turns.shape[1:] != (3, 3) or origins.shape != (len(turns), 3):
        raise InputError(
            f"poses of a body: expected arrays of shape (n, 3, 3) and (n, 3), "
            f"got {turns.shape} and {origins.shape}"
        )
    T = np.concatenate([turns, origins[:, :, None]], axis=2)
    tracked: Mask = np.asarray(np.isfinite(T).all(axis=(1, 2)))
    if tracked.sum() < LEAST_POSES:
        raise InputError(
            f"poses of a body: it is tracked in {tracked.sum()} of {len(T)} samples; "
            f"expected at least {LEAST_POSES}"
        )
    return T, tracked


def _start(R: Array, p: Array) -> tuple[Array, Mask]:
    """Find a tip to start from, and the samples that are near it."""
    _, tip, missed = shared_point(R, p, np.ones(len(R)), free=3, least=_ALIKE)
    return tip, not_gross(missed)


def _check_determined(R: Array) -> None:
    """Reject rotations that share one axis.

    The two smaller of the three angles tell: the mean rotation shortens a direction by half the
    mean squared angle by which it is turned.
    """
    left, values, _ = np.linalg.svd(R.mean(axis=0))
    turn = float(np.sqrt(max(2.0 * (1.0 - values[0]), 0.0)))
    if turn < LEAST_TURN:
        raise UndeterminedError(
            "the poses turn about one axis only, so the point's place along it is not determined",
            got=turn,
            wanted=LEAST_TURN,
            condition=_condition(R),
            direction=left[:, 0],
        )


def _condition(R: Array) -> float:
    shared = float(np.linalg.svd(R.mean(axis=0))[1][0])
    return (1.0 + shared) / max(1.0 - shared, np.finfo(float).tiny)


def _levers(x: Array, R: Array, p: Array) -> tuple[Array, Array]:
    """Return the point's derivatives by the body's and the frame's rotation, (n, 3, 3) each."""
    return -R @ skew(x[:3]), skew(R @ x[:3] + p)


def _linear(x: Array, R: Array, p: Array, sigma: _Noise) -> tuple[Array, Array]:
    """Return whitened residuals, (n, 3), and their derivatives, (n, 3, 6), at adjusted poses."""
    residual = R @ x[:3] + p - x[3:]
    body, frame = _levers(x, R, p)
    covariance = _covariance(body, frame, sigma)
    share = sigma.rotation**2 * np.linalg.solve(covariance, residual[..., None])
    adjusted = R @ matrix_from_rotation_vector(-(np.swapaxes(body, 1, 2) @ share)[..., 0])
    if sigma.frame:
        turn = -(np.swapaxes(frame, 1, 2) @ share)[..., 0]
        adjusted = matrix_from_rotation_vector(-turn) @ adjusted
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    derivative = np.concatenate([adjusted, np.broadcast_to(-np.eye(3), R.shape)], axis=2)
    return (white @ residual[..., None])[..., 0], white @ derivative


def _covariance(body: Array, frame: Array, sigma: _Noise) -> Array:
    count = 2.0 if sigma.frame else 1.0
    turned = body @ np.swapaxes(body, 1, 2)
    if sigma.frame:
        turned = turned + frame @ np.swapaxes(frame, 1, 2)
    return count * sigma.position**2 * np.eye(3) + sigma.rotation**2 * turned


def _noise(
    x: Array, R: Array, p: Array, used: Mask, rotation: float | None, relative: bool
) -> _Noise:
    """Split the residuals' covariance into noise of positions and of rotations."""
    residual = (R @ x[:3] + p - x[3:])[used]
    unit = _Noise(0.0, 1.0, relative)
    body, frame = _levers(x, R[used], p[used])
    turned = _covariance(body, frame, unit)
    still = (2.0 if relative else 1.0) * np.eye(3)
    squares = residual[:, :, None] * residual[:, None, :]
    if rotation is None:
        columns = np.stack([np.broadcast_to(still, turned.shape).ravel(), turned.ravel()], axis=1)
        found = np.linalg.lstsq(columns, squares.ravel())[0]
        rotation = float(np.sqrt(max(found[1], 0.0)))
    left = np.trace((squares - rotation**2 * turned).mean(axis=0)) / np.trace(still)
    total = float(np.trace(squares.mean(axis=0)) / np.trace(still))
    return _Noise(float(np.sqrt(max(left, 1e-2 * total, _ROUNDING**2))), rotation, relative)


def _descend(
    x: Array, R: Array, p: Array, used: Mask, sigma: _Noise
) -> tuple[Array, tuple[Array, Array]]:
    """Take Gauss-Newton steps until they are rounding."""
    for _ in range(_STEPS):
        r, C = _linear(x, R, p, sigma)
        flat = C[used].reshape(-1, 6)
        step = -np.linalg.solve(flat.T @ flat, flat.T @ r[used].reshape(-1))
        x = x + step
        if np.abs(step).max() < 1e-13:
            break
    return x, _linear(x, R, p, sigma)


def _result(x: Array, T: Array, linear: tuple[Array, Array], used: Mask, tracked: Mask) -> PivotFit:
    """Gather what a fit of the tracked samples has found."""
    R, p = T[:, :, :3], T[:, :, 3]
    r, C = linear
    flat = C[used].reshape(-1, 6)
    effect = -np.einsum("kij,ki->kj", C, r) @ np.linalg.inv(flat.T @ flat) * used[:, None]
    influence = np.zeros((len(R), 6))
    influence[tracked] = effect
    chosen = np.zeros(len(R), dtype=bool)
    chosen[tracked] = used
    points = R @ x[:3] + p
    rms_axes = np.sqrt(np.mean((points[chosen] - x[3:]) ** 2, axis=0))
    rms = float(np.linalg.norm(rms_axes))
    widened = widening(influence, (rms, 0.0))
    influence *= widened
    sigma = np.sqrt(np.sum(influence**2, axis=0))
    return PivotFit(
        tip=x[:3],
        post=x[3:],
        rms_axes=rms_axes,
        rms=rms,
        condition=_condition(R[chosen]),
        sigma_tip=sigma[:3],
        sigma_post=sigma[3:],
        points=points,
        used=chosen,
        influence=influence,
        outliers=int(tracked.sum() - chosen.sum()),
        widened=widened,
    )


def _typical(R: Array) -> Array:
    """Return the rotation that is nearest to all in the sense of least absolute deviations."""
    weights = np.ones(len(R))
    centre = R[0]
    for _ in range(20):
        centre = nearest_rotation(np.tensordot(weights, R, 1) / weights.sum())
        away = np.linalg.norm(R - centre, axis=(1, 2))
        weights = 1.0 / np.maximum(away, max(float(np.median(away)), 1e-12))
    return centre


def _deviation(values: Array) -> float:
    return float(np.nanmedian(np.abs(values))) / _MEDIAN_OF_ABSOLUTE
