"""The hinge between two bodies by maximum likelihood, and the distance of two axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError
from trocar.fitting.hinge_model import (
    LEAST_SIGMA,
    HingeModel,
    Normal,
    Residuals,
    noise,
    normal,
    residuals,
)
from trocar.fitting.robust import near, shared_direction, shared_point, weighted_point
from trocar.geometry.se3 import inverse

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: A sweep below this leaves plain least squares biased low, and every estimate loose [rad].
#: Source: our own measurement, tests/fitting.
SMALL_SPAN = 0.15
#: A sweep below this is no measurement of an axis [rad]. Source: as above.
LEAST_SPAN = 0.05
#: Source: our choice; eight unknowns of the axes and one of their offset, three poses would do.
LEAST_POSES = 8
# Source: our choice; chi-squared with five degrees of freedom exceeds it once in a million.
_FAR_SQUARED = 36.0
_ROUNDS = 6
_STEPS = 8


@dataclass(frozen=True, eq=False)
class Axis:
    """An axis of rotation, and what each sample contributed to its error.

    Attributes:
        point: on the axis, (3,) [m]
        direction: along it, a unit vector, (3,)
        influence: first-order effect of each sample's own residual on (point, direction), (n, 6)
            [m; 1], across the axis only: sliding the point along the axis changes nothing
    """

    point: Array
    direction: Array
    influence: Array


@dataclass(frozen=True, eq=False)
class HingeFit:
    """A hinge as estimated: one axis, told in both bodies' frames.

    Turning b by a positive angle about `direction_a`, right-handed, increases `angles`; their zero
    is arbitrary, and so is the sign of the directions (here: the largest component of `direction_a`
    is positive). `point_a` and `point_b` are one point, midway between the feet of the two bodies'
    origins on the axis.

    Attributes:
        point_a, point_b: on the axis, in a and in b, (3,) [m]
        direction_a, direction_b: along it, unit vectors, (3,)
        angles: of b in a, (n,) [rad]; NaN where a sample was not used
        used: which samples were, (n,)
        span: largest minus smallest angle [rad]
        condition: of the normal matrix of the axis' place, (1 + m) / (1 - m) with m the length of
            the mean of exp(i angle); 1 is best
        residual_position: root of the mean squared distance from the model [m]
        residual_rotation: root of the mean squared angle from the model [rad]
        position_sigma, rotation_sigma: noise of each body's pose, per axis [m], [rad]
        influence_a, influence_b: effect of each sample's own residual on (point, direction) in a
            and in b, (n, 6); zero where unused, unless hinges were weighed jointly and another
            one used it. The variance of any function f of hinges that share samples is the sum
            over the samples of (grad f . influence)^2
        outliers: samples that were tracked but far off, and not used
        before, after: T_ab(angle) = before @ Rz(angle) @ after, (4, 4) each
        slides: whether b shifted along the axis besides, by as much as each sample says
    """

    point_a: Array
    direction_a: Array
    point_b: Array
    direction_b: Array
    angles: Array
    used: Mask
    span: float
    condition: float
    residual_position: float
    residual_rotation: float
    position_sigma: float
    rotation_sigma: float
    influence_a: Array
    influence_b: Array
    outliers: int
    before: Array
    after: Array
    slides: bool = False

    @property
    def in_a(self) -> Axis:
        """The axis in a."""
        return Axis(self.point_a, self.direction_a, self.influence_a)

    @property
    def in_b(self) -> Axis:
        """The axis in b."""
        return Axis(self.point_b, self.direction_b, self.influence_b)


def fit_hinge(
    T_ab: ArrayLike,
    *,
    position_sigma: float | None = None,
    rotation_sigma: float | None = None,
    slides: bool = False,
) -> HingeFit:
    """Find the axis about which one body turns in another.

    No guess is needed, gross outliers are left out, and the rest is fitted by maximum likelihood
    under white noise on both bodies' poses (see `hinge_model`).

    Args:
        T_ab: poses of b in a, (n, 4, 4); NaN where either was not tracked
        position_sigma: noise of each body's position, per axis [m]; estimated when omitted
        rotation_sigma: noise of each body's rotation, per axis [rad]; estimated when omitted
        slides: whether b may shift along the axis as it turns, as a pin does that closes a loop
            of axes that lean. Positions along the axis then say nothing of its direction

    Returns:
        the axis in both frames; its `span` and `condition` tell whether it can be trusted

    Raises:
        InputError: wrong shape, or fewer than `LEAST_POSES` poses
    """
    T, tracked = check_poses(T_ab)
    model, used = _start(T[tracked])
    given = (position_sigma, rotation_sigma)
    model, used, sigmas, linear = _maximum_likelihood(model, T[tracked], used, given, slides)
    return _result(model, T[tracked], linear, used, tracked, sigmas[1], slides)


def fit_hinge_least_squares(T_ab: ArrayLike) -> tuple[Axis, Axis]:
    """Find a hinge's axis as the paper does: least squares, every sample alike.

    The direction is what the rotations change least, `R_k h_b = h_a`; the point is what the poses
    move least, `R_k g_b + p_k = g_a`, no way along the axis. With noise in R the point is drawn to
    b's origin, the more so the smaller the sweep.

    Source: section 2.4 of the closed-loop paper; Gamage and Lasenby, New least squares solutions
    for estimating the average centre of rotation and the axis of rotation, 2002.

    Args:
        T_ab: poses of b in a, (n, 4, 4); NaN where either was not tracked

    Returns:
        the axis in a and in b, without influences

    Raises:
        InputError: wrong shape, or too few poses
    """
    T, tracked = check_poses(T_ab)
    R, p = T[tracked, :3, :3], T[tracked, :3, 3]
    left, _, right = np.linalg.svd(R.mean(axis=0))
    g_a, g_b = weighted_point(R, p, np.ones(len(R)))
    nothing = np.zeros((len(T), 6))
    return Axis(g_a, left[:, 0], nothing), Axis(g_b, right[0], nothing)


def check_poses(T_ab: ArrayLike) -> tuple[Array, Mask]:
    """Return poses as an array, (n, 4, 4), and which of them are finite, (n,).

    Raises:
        InputError: wrong shape, or fewer than `LEAST_POSES` finite poses
    """
    T = np.asarray(T_ab, dtype=np.float64)
    if T.ndim != 3 or T.shape[1:] != (4, 4):
        raise InputError(f"poses of two bodies: an array of shape (n, 4, 4) wanted, got {T.shape}")
    tracked: Mask = np.asarray(np.isfinite(T).all(axis=(1, 2)))
    if tracked.sum() < LEAST_POSES:
        raise InputError(
            f"poses of two bodies: both are tracked at once in {tracked.sum()} of {len(T)} "
            f"samples; at least {LEAST_POSES} wanted"
        )
    return T, tracked


def _start(T: Array) -> tuple[HingeModel, Mask]:
    """Find a hinge to start from, and the samples that are near it."""
    R, p = T[:, :3, :3], T[:, :3, 3]
    h_a, h_b, missed = shared_direction(R)
    sign = np.copysign(1.0, h_a[np.argmax(np.abs(h_a))])
    h_a, h_b = sign * h_a, sign * h_b
    used = near(missed)
    g_a, g_b, missed = shared_point(R, p, used.astype(np.float64))
    used &= near(missed)
    before, after = _frame(g_a, h_a), inverse(_frame(g_b, h_b))
    turn = before[:3, :3].T @ R @ after[:3, :3].T
    theta = np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
    model = HingeModel(before, after, _unwrapped(theta, used))
    return model, used


def _unwrapped(theta: Array, used: Mask) -> Array:
    """Return angles, (n,), within half a turn of their mean direction."""
    centre = float(np.angle(np.mean(np.exp(1j * theta[used]))))
    return centre + np.angle(np.exp(1j * (theta - centre)))


def _frame(point: Array, z: Array) -> Array:
    """Return a frame at a point with its z axis along a unit direction, (4, 4)."""
    side = np.eye(3)[np.argmin(np.abs(z))]
    x = np.cross(side, z)
    x /= np.linalg.norm(x)
    frame = np.eye(4)
    frame[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    frame[:3, 3] = point
    return frame


def _maximum_likelihood(
    model: HingeModel,
    T: Array,
    used: Mask,
    given: tuple[float | None, float | None],
    slides: bool,
) -> tuple[HingeModel, Mask, tuple[float, float], Normal]:
    """Iterate model, noise and choice of samples until they agree."""
    sigmas = _sigmas(residuals(model, T), used, given, slides)
    for _ in range(_ROUNDS):
        model = _descend(model, T, used, sigmas, slides)
        found = residuals(model, T, sigmas[1])
        sigmas = _sigmas(found, used, given, slides)
        estimated = noise(found, used, slides)
        far = normal(model, found, estimated, slides).r
        chosen = np.einsum("ki,ki->k", far, far) < _FAR_SQUARED
        if (chosen == used).all():
            break
        used = chosen
    model = _centred(_descend(model, T, used, sigmas, slides))
    found = residuals(model, T, sigmas[1])
    return model, used, sigmas, normal(model, found, sigmas, slides)


def _sigmas(
    found: Residuals, used: Mask, given: tuple[float | None, float | None], slides: bool
) -> tuple[float, float]:
    estimated = noise(found, used, slides)
    position, rotation = (
        e if g is None else max(g, LEAST_SIGMA) for e, g in zip(estimated, given, strict=True)
    )
    return position, rotation


def _descend(
    model: HingeModel, T: Array, used: Mask, sigmas: tuple[float, float], slides: bool
) -> HingeModel:
    """Take Gauss-Newton steps until they are rounding."""
    for _ in range(_STEPS):
        linear = normal(model, residuals(model, T, sigmas[1]), sigmas, slides)
        step, _ = linear.step(used)
        model = model.moved(step, linear.turn + linear.turn_by @ step)
        if np.abs(step).max() < 1e-13:
            break
    return model


def _centred(model: HingeModel) -> HingeModel:
    """Put the hinge's frames midway between the feet of the bodies' origins on the axis."""
    foot_a = -float(model.before[:3, 2] @ model.before[:3, 3])
    foot_b = float(model.after[2, 3])
    return model.slid(0.5 * (foot_a + foot_b))


def _result(
    model: HingeModel,
    T: Array,
    linear: Normal,
    used: Mask,
    tracked: Mask,
    sigma: float,
    slides: bool,
) -> HingeFit:
    """Gather what a fit of the tracked samples has found."""
    found = residuals(model, T, sigma)
    position, rotation = noise(found, used, slides)
    _, inverse_matrix = linear.step(used)
    effect: Array = -np.einsum("kij,ki->kj", linear.C, linear.r) @ inverse_matrix * used[:, None]
    influence_a, influence_b = _influences(model, effect)
    mean = abs(complex(np.mean(np.exp(1j * model.theta[used]))))
    return HingeFit(
        point_a=model.before[:3, 3].copy(),
        direction_a=model.before[:3, 2].copy(),
        point_b=-model.after[:3, :3].T @ model.after[:3, 3],
        direction_b=model.after[2, :3].copy(),
        angles=_spread(np.where(used, model.theta, np.nan), tracked, np.nan),
        used=_spread(used, tracked, False),
        span=float(np.ptp(model.theta[used])),
        condition=(1.0 + mean) / max(1.0 - mean, np.finfo(float).tiny),
        residual_position=_root_mean_square(found.shift[used]),
        residual_rotation=_root_mean_square(found.eps[used]),
        position_sigma=position,
        rotation_sigma=rotation,
        influence_a=_spread(influence_a, tracked, 0.0),
        influence_b=_spread(influence_b, tracked, 0.0),
        outliers=int((~used).sum()),
        before=model.before,
        after=model.after,
        slides=slides,
    )


def _root_mean_square(vectors: Array) -> float:
    """Return the root of the mean squared length of vectors, (n, 3)."""
    return float(np.sqrt(np.mean(vectors**2) * 3.0))


def _influences(model: HingeModel, x: Array) -> tuple[Array, Array]:
    """Give each sample's effect on (point, direction), in a and in b, (n, 6) each.

    Args:
        model: at the solution
        x: effect on the free coordinates, (n, 9)
    """
    axes_a, axes_b = model.before[:3, :2], -model.after[:2, :3].T
    # A turn by w about x and y moves the z axis by w x z = (w_y, -w_x, 0).
    tilt: Array = np.array([[0.0, -1.0], [1.0, 0.0]])
    influence_a = np.hstack([x[:, 0:2] @ axes_a.T, x[:, 3:5] @ tilt @ axes_a.T])
    influence_b = np.hstack([x[:, 5:7] @ axes_b.T, x[:, 7:9] @ tilt @ axes_b.T])
    return influence_a, influence_b


def moved_fit(
    fit: HingeFit, T_ab: Array, influence: Array, sigmas: tuple[float, float]
) -> HingeFit:
    """Return a fit whose axis is moved by what samples say besides, its angles with it.

    Args:
        fit: as it was
        T_ab: the poses that it was fitted to, (n, 4, 4)
        influence: effect of each sample on the free coordinates of `HingeModel`, (n, 9)
        sigmas: noise of each body's position [m] and rotation [rad]
    """
    angles = fit.angles[fit.used]
    model = HingeModel(fit.before, fit.after, angles).moved(influence.sum(axis=0), 0.0 * angles)
    found = residuals(model, T_ab[fit.used], sigmas[1])
    turn = normal(model, found, sigmas, fit.slides).turn
    influence_a, influence_b = _influences(model, influence)
    return replace(
        fit,
        point_a=model.before[:3, 3].copy(),
        direction_a=model.before[:3, 2].copy(),
        point_b=-model.after[:3, :3].T @ model.after[:3, 3],
        direction_b=model.after[2, :3].copy(),
        angles=_spread(angles + turn, fit.used, np.nan),
        influence_a=influence_a,
        influence_b=influence_b,
        before=model.before,
        after=model.after,
    )


def _spread(values: NDArray[Any], tracked: Mask, missing: float) -> NDArray[Any]:
    """Put values of the tracked samples, (m, ...), among all, (n, ...)."""
    out = np.full((len(tracked), *values.shape[1:]), missing, dtype=values.dtype)
    out[tracked] = values
    return out


@dataclass(frozen=True, eq=False)
class AxisDistance:
    """The distance of two axes.

    Attributes:
        value: [m]
        sigma: its standard deviation [m]
        influence: effect of each sample's residual on it, (n,) [m]; those of two distances from
            the same samples give their covariance, `influence_1 @ influence_2`
    """

    value: float
    sigma: float
    influence: Array


def axis_distance(first: Axis, second: Axis, across: Sequence[Axis] = ()) -> AxisDistance:
    """Measure the distance of two axes in the plane across their mean direction.

    Both are cut by the plane that lies midway between their points. The directions may differ in
    sign.

    Args:
        first, second: in one frame, estimated from the same n samples
        across: every axis whose direction counts for the mean, in the same frame and from the same
            samples; the two themselves when empty

    Returns:
        the distance with its standard deviation
    """
    axes = tuple(across) or (first, second)
    signs = [1.0 if a.direction @ first.direction >= 0 else -1.0 for a in axes]
    total = np.sum([s * a.direction for s, a in zip(signs, axes, strict=True)], axis=0)
    length = float(np.linalg.norm(total))
    h = total / length
    turns = np.sum([s * a.influence[:, 3:] for s, a in zip(signs, axes, strict=True)], axis=0)
    dh = (turns - np.outer(turns @ h, h)) / length

    middle = 0.5 * (first.point + second.point)
    (p1, dp1), (p2, dp2) = (_cut(axis, middle, h, dh) for axis in (first, second))
    value = float(np.linalg.norm(p2 - p1))
    influence = (dp2 - dp1) @ ((p2 - p1) / max(value, np.finfo(float).tiny))
    return AxisDistance(value, float(np.sqrt(influence @ influence)), influence)


def _cut(axis: Axis, middle: Array, h: Array, dh: Array) -> tuple[Array, Array]:
    """Cut an axis by the plane through `middle` across h: the point, and its influence."""
    g, d = axis.point, axis.direction
    dg, dd = axis.influence[:, :3], axis.influence[:, 3:]
    along = float(d @ h)
    s = float((middle - g) @ h) / along
    ds = (dh @ (middle - g) - dg @ h - s * (dd @ h + dh @ d)) / along
    return g + s * d, dg + s * dd + np.outer(ds, d)
