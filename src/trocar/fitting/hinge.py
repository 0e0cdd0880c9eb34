"""The hinge between two bodies by maximum likelihood, and the distance of two axes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError
from trocar.fitting.robust import near, shared_direction, shared_point, widening
from trocar.geometry.rotations import rotation_vector_from_matrix, rotation_z
from trocar.geometry.se3 import exp_twist, inverse, translation

Mask = NDArray[np.bool_]

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
    """Differences of the samples from a model, along the axes of its hinge frame before the turn.

    Attributes:
        eps: rotation, (n, 3) [rad]
        shift: position, p - p_model, (n, 3) [m]
        y: position made independent of the rotation, (n, 3) [m]
        p: the model's place of b from a, (n, 3) [m]
        lever: displacement of y per turn about the axes through the hinge, (n, 3) [m]
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
    """A hinge as estimated: one axis, in both bodies' frames.

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
            over the samples of (grad f . influence)^2. Where noise is correlated in time they are
            scaled so that it still is (`widened`)
        outliers: samples that were tracked but far off, and not used
        before, after: T_ab(angle) = before @ Rz(angle) @ after, (4, 4) each
        slides: whether b shifted along the axis besides, by as much as each sample says
        widened: factor of the influences for residuals that are correlated in time, 1 where white
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
    widened: float = 1.0

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
    under white noise on both bodies' poses (see `HingeModel`).

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
    model, used = rough_hinge(T[tracked])
    given = (position_sigma, rotation_sigma)
    model, used, sigmas, linear = _maximum_likelihood(model, T[tracked], used, given, slides)
    return _result(model, T[tracked], linear, used, tracked, sigmas[1], slides)


def check_poses(T_ab: ArrayLike) -> tuple[Array, Mask]:
    """Return poses as an array, (n, 4, 4), and which of them are finite, (n,).

    Raises:
        InputError: wrong shape, or fewer than `LEAST_POSES` finite poses
    """
    T = np.asarray(T_ab, dtype=np.float64)
    if T.ndim != 3 or T.shape[1:] != (4, 4):
        raise InputError(
            f"poses of two bodies: expected an array of shape (n, 4, 4), got {T.shape}"
        )
    tracked: Mask = np.asarray(np.isfinite(T).all(axis=(1, 2)))
    if tracked.sum() < LEAST_POSES:
        raise InputError(
            f"poses of two bodies: both are tracked at once in {tracked.sum()} of {len(T)} "
            f"samples; expected at least {LEAST_POSES}"
        )
    return T, tracked


def rough_hinge(T: Array) -> tuple[HingeModel, Mask]:
    """Find a hinge by least absolute deviations, and the samples that are near it.

    Any poses have one: whether they turn about it, its residuals show.

    Args:
        T: poses of b in a, (n, 4, 4), all finite
    """
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
    left = _root_mean_square(found.shift[used]), _root_mean_square(found.eps[used])
    widened = widening(_spread(effect, tracked, 0.0), left)
    influence_a, influence_b = _influences(model, widened * effect)
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
        residual_position=left[0],
        residual_rotation=left[1],
        position_sigma=position,
        rotation_sigma=rotation,
        influence_a=_spread(influence_a, tracked, 0.0),
        influence_b=_spread(influence_b, tracked, 0.0),
        outliers=int((~used).sum()),
        before=model.before,
        after=model.after,
        slides=slides,
        widened=widened,
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
    left = _root_mean_square(found.shift), _root_mean_square(found.eps)
    widened = widening(influence, left)
    influence_a, influence_b = _influences(model, widened * influence)
    return replace(
        fit,
        widened=widened,
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


def hinge_covariance(fit: HingeFit, T_ab: Array, sigmas: tuple[float, float]) -> Array:
    """Return the covariance that noise will give the free coordinates of a hinge, (9, 9).

    Args:
        fit: to poses without noise
        T_ab: these poses, (n, 4, 4)
        sigmas: noise that each body's pose will have, position [m] and rotation [rad]
    """
    model = HingeModel(fit.before, fit.after, fit.angles[fit.used])
    found = residuals(model, T_ab[fit.used])
    every = np.ones(int(fit.used.sum()), dtype=bool)
    return normal(model, found, sigmas, fit.slides).step(every)[1]


def angle_sigma(fit: HingeFit, T_ab: Array, sigmas: tuple[float, float]) -> Array:
    """Return the standard deviation that noise will give each sample's angle, (n,) [rad].

    Args:
        fit: to poses without noise
        T_ab: these poses, (n, 4, 4)
        sigmas: noise that each body's pose will have, position [m] and rotation [rad]
    """
    model = HingeModel(fit.before, fit.after, fit.angles[fit.used])
    found = residuals(model, T_ab[fit.used])
    z = np.broadcast_to([0.0, 0.0, 1.0], found.lever.shape)
    turn = np.concatenate([-np.cross(z, found.lever), -z], axis=1)[..., None]
    size = np.linalg.norm(_whitened(turn, found.p, sigmas), axis=(1, 2))
    return _spread(1.0 / size, fit.used, np.nan)


def with_influence(fit: HingeFit, influence: Array) -> HingeFit:
    """Return a fit with other errors of its free coordinates, (m, 9)."""
    model = HingeModel(fit.before, fit.after, fit.angles)
    influence_a, influence_b = _influences(model, influence)
    return replace(fit, influence_a=influence_a, influence_b=influence_b)


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


def axis_distance(first: Axis, second: Axis, through: Array | None = None) -> AxisDistance:
    """Measure the distance of two axes in the plane across their mean direction.

    The directions may differ in sign.

    Args:
        first, second: in one frame, estimated from the same n samples
        through: a point of the plane, (3,) [m]; None: midway between the axes' points

    Returns:
        the distance with its standard deviation
    """
    sign = 1.0 if first.direction @ second.direction >= 0 else -1.0
    total = first.direction + sign * second.direction
    length = float(np.linalg.norm(total))
    h = total / length
    turns = first.influence[:, 3:] + sign * second.influence[:, 3:]
    dh = (turns - np.outer(turns @ h, h)) / length

    middle = 0.5 * (first.point + second.point) if through is None else through
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
