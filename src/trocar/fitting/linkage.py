"""All hinges of a linkage at once: maximum likelihood over the measured poses of all its bodies.

A hinge by itself has to take the turn of each of its bodies from that body's own markers, and a
lever of 0.3 m makes 0.26 mm of 0.05 degrees. The places of the neighbours tell the same turn, and
better. So every pose of a sample is one and the same for all hinges that its body carries:

    f_h(T_a, T_b; axis) = 0     of each hinge: both bodies have the same point, and the same line
    minimise the squares of what the poses must be moved by, over their noise

Distances between hinges are free: no side equals another. A pin that closes a loop
is a hinge like the others across its axis, and free along and about the rest, where its loop would
be held twice; its direction is that of its own fit.

Condition equations with the poses' corrections eliminated (the Gauss-Helmert model), one step from
the hinges' own fits, taken at the corrected poses so that their noise does not bias it.
Source: Foerstner and Wrobel, Photogrammetric Computer Vision, 2016, section 4.8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.fitting.hinge import FREE, HingeFit, hinge_covariance, moved_fit, with_influence
from trocar.geometry.rotations import matrix_from_rotation_vector, rotation_z, skew
from trocar.geometry.se3 import inverse

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Source: our choice; samples that are worked on at once, to spare memory.
_CHUNK = 1500


@dataclass(frozen=True, eq=False)
class SharedHinge:
    """A hinge among others.

    Attributes:
        a, b: its two bodies, places in the array of poses
        fit: as found by itself
        pin: whether it closes a loop of hinges, and so holds across its axis alone
    """

    a: int
    b: int
    fit: HingeFit
    pin: bool

    @property
    def rows(self) -> list[int]:
        """Return the indices of the vanishing (shift x, y, z; turn x, y) in the hinge's frame."""
        return [0, 1] if self.pin else [0, 1, 2, 3, 4]

    @property
    def columns(self) -> list[int]:
        """Return the indices of the free ones of the nine coordinates of `HingeModel.moved`."""
        return [0, 1, 5, 6] if self.pin else list(range(FREE))


@dataclass(frozen=True, eq=False)
class _Conditions:
    """Conditions that should vanish in some samples, and their derivatives.

    Attributes:
        f: values in the hinges' frames, (k, rows) [m; rad]
        by_pose: derivative with the poses' noise, in deviations of it, (k, rows, 6 bodies)
        by_axis: derivative with the axes, (k, rows, columns)
    """

    f: Array
    by_pose: Array
    by_axis: Array


def refine_hinges(
    T_c: Array, hinges: Sequence[SharedHinge], sigmas: tuple[float, float]
) -> tuple[HingeFit, ...]:
    """Weigh all hinges jointly.

    A sample counts for the hinges whose own fit has used it. A hinge that its two bodies leave by
    more than the noise of their poses counts less.

    Args:
        T_c: poses of all bodies in the camera's frame, (n, bodies, 4, 4)
        hinges: which bodies they join, and what is known of them
        sigmas: noise of a pose, position [m] and rotation [rad] per axis

    Returns:
        the fits, with axes, angles and influences of the joint estimate
    """
    cofactor, right = _normal_equations(T_c, hinges, sigmas)
    influence = -right @ cofactor
    ends = np.cumsum([len(hinge.columns) for hinge in hinges])[:-1]
    return tuple(
        _moved(hinge, inverse(T_c[:, hinge.a]) @ T_c[:, hinge.b], own, sigmas)
        for hinge, own in zip(hinges, np.split(influence, ends, axis=1), strict=True)
    )


def expected_hinges(
    T_c: Array, hinges: Sequence[SharedHinge], sigmas: tuple[float, float]
) -> tuple[HingeFit, ...]:
    """Return hinges with the errors that noise will make, not those that it has made.

    Args:
        T_c: poses of all bodies without noise, (n, bodies, 4, 4)
        hinges: as `refine_hinges` has them
        sigmas: noise that poses will have, position [m] and rotation [rad] per axis

    Returns:
        the fits as they are, whose influences are independent errors of one standard deviation, as
        many as there are unknowns, in place of those of samples
    """
    cofactor, _ = _normal_equations(T_c, hinges, sigmas)
    ends = np.cumsum([len(hinge.columns) for hinge in hinges])[:-1]
    errors = np.split(np.linalg.cholesky(cofactor).T, ends, axis=1)
    pins = [hinge for hinge in hinges if hinge.pin]
    count = len(cofactor) + FREE * len(pins)
    found: list[HingeFit] = []
    for hinge, own in zip(hinges, errors, strict=True):
        influence = np.zeros((count, FREE))
        influence[: len(own), hinge.columns] = own
        if hinge.pin:  # its direction is that of its own fit
            alone = hinge_covariance(hinge.fit, inverse(T_c[:, hinge.a]) @ T_c[:, hinge.b], sigmas)
            begin = len(own) + FREE * pins.index(hinge)
            directions = np.linalg.cholesky(alone).T[:, [3, 4, 7, 8]]
            influence[begin : begin + FREE, [3, 4, 7, 8]] = directions
        found.append(with_influence(hinge.fit, influence))
    return tuple(found)


def _normal_equations(
    T_c: Array, hinges: Sequence[SharedHinge], sigmas: tuple[float, float]
) -> tuple[Array, Array]:
    """Return the inverse normal matrix, (columns, columns), and right sides, (n, columns)."""
    columns = sum(len(hinge.columns) for hinge in hinges)
    normal, right = np.zeros((columns, columns)), np.zeros((len(T_c), columns))
    for start in range(0, len(T_c), _CHUNK):
        part = slice(start, start + _CHUNK)
        A, f, weight = _weighed(T_c[part], hinges, part, sigmas)
        weighted = weight @ A
        normal += np.tensordot(A, weighted, ((0, 1), (0, 1)))
        right[part] = np.einsum("kij,ki->kj", weighted, f)
    scale = 1.0 / np.sqrt(np.diag(normal))
    return scale[:, None] * np.linalg.inv(scale[:, None] * normal * scale) * scale, right


def _weighed(
    T_c: Array, hinges: Sequence[SharedHinge], part: slice, sigmas: tuple[float, float]
) -> tuple[Array, Array, Array]:
    """Return slopes (k, rows, columns), conditions (k, rows) and their weights (k, rows, rows)."""
    T = np.where(np.isfinite(T_c), T_c, np.eye(4))
    used = np.concatenate(
        [np.repeat(h.fit.used[part, None], len(h.rows), axis=1) for h in hinges], axis=1
    )
    measured = _conditions(T, hinges, used, sigmas)
    play = np.concatenate([_play(hinge, sigmas)[hinge.rows] for hinge in hinges])
    covariance = measured.by_pose @ np.swapaxes(measured.by_pose, 1, 2)
    diagonal = np.arange(len(play))
    covariance[:, diagonal, diagonal] += np.where(used, play, 1.0)
    weight = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    # The poses as the conditions have them: there the slopes know nothing of the noise.
    share = np.swapaxes(measured.by_pose, 1, 2) @ (weight @ measured.f[..., None])
    adjusted = _conditions(_adjusted(T, -share[..., 0], sigmas), hinges, used, sigmas)
    return adjusted.by_axis, adjusted.f + (adjusted.by_pose @ share)[..., 0], weight


def _play(hinge: SharedHinge, sigmas: tuple[float, float]) -> Array:
    """Return the variance by which a hinge is looser than noise makes it, (5,) [m^2; rad^2]."""
    position = 2.0 * max(hinge.fit.position_sigma**2 - sigmas[0] ** 2, 0.0)
    rotation = 2.0 * max(hinge.fit.rotation_sigma**2 - sigmas[1] ** 2, 0.0)
    return np.repeat([position, rotation], [3, 2])


def _adjusted(T: Array, share: Array, sigmas: tuple[float, float]) -> Array:
    """Move poses by so many deviations of their noise, (k, 6 bodies)."""
    by = share.reshape(*T.shape[:2], 6)
    out = T.copy()
    out[..., :3, 3] += sigmas[0] * by[..., :3]
    out[..., :3, :3] = matrix_from_rotation_vector(sigmas[1] * by[..., 3:]) @ T[..., :3, :3]
    return out


def _conditions(
    T: Array, hinges: Sequence[SharedHinge], used: Mask, sigmas: tuple[float, float]
) -> _Conditions:
    rows, columns = used.shape[1], sum(len(hinge.columns) for hinge in hinges)
    f = np.zeros((len(T), rows))
    by_pose, by_axis = np.zeros((*f.shape, 6 * T.shape[1])), np.zeros((*f.shape, columns))
    row = column = 0
    for hinge in hinges:
        here = slice(row, row + len(hinge.rows))
        row, first, column = here.stop, column, column + len(hinge.columns)
        value, one, two, axis = _condition(T[:, hinge.a], T[:, hinge.b], hinge.fit, sigmas)
        f[:, here] = value[:, hinge.rows]
        by_pose[:, here, 6 * hinge.a : 6 * hinge.a + 6] = one[:, hinge.rows]
        by_pose[:, here, 6 * hinge.b : 6 * hinge.b + 6] = two[:, hinge.rows]
        by_axis[:, here, first:column] = axis[:, hinge.rows][:, :, hinge.columns]
    by_pose *= used[..., None]
    by_axis *= used[..., None]
    return _Conditions(f * used, by_pose, by_axis)


def _condition(
    T_a: Array, T_b: Array, fit: HingeFit, sigmas: tuple[float, float]
) -> tuple[Array, Array, Array, Array]:
    """Return f of one hinge, (k, 5), and its slopes with both poses and the axis.

    f is how far b's hinge frame is shifted (x, y, z) and turned (x, y) in that of a.
    """
    in_a, in_b = T_a @ fit.before, T_b @ inverse(fit.after)
    apart = inverse(in_a) @ in_b
    f = np.concatenate([apart[:, :3, 3], -apart[:, 1:2, 2], apart[:, :1, 2]], axis=1)
    to_hinge = np.swapaxes(in_a[:, :3, :3], 1, 2)
    slopes: list[Array] = []
    for pose, hinge, sign in ((T_a, in_a, -1.0), (T_b, in_b, 1.0)):
        slope = np.zeros((len(f), 5, 6))
        slope[:, :3, :3] = sign * sigmas[0] * to_hinge
        lever = skew(hinge[:, :3, 3] - pose[:, :3, 3])
        slope[:, :3, 3:] = -sign * sigmas[1] * (to_hinge @ lever)
        slope[:, 3:, 3:] = sign * sigmas[1] * to_hinge[:, :2]
        slopes.append(slope)
    sine, cosine = apart[:, 1, 0] - apart[:, 0, 1], apart[:, 0, 0] + apart[:, 1, 1]
    axis = np.zeros((len(f), 5, FREE))
    axis[:, range(5), range(5)] = -1.0
    axis[:, :2, 5:7] = axis[:, 3:, 7:9] = -rotation_z(np.arctan2(sine, cosine))[:, :2, :2]
    return f, slopes[0], slopes[1], axis


def _moved(hinge: SharedHinge, T_ab: Array, own: Array, sigmas: tuple[float, float]) -> HingeFit:
    """Return a fit with its axis moved by the sum of what each sample says, (n, columns)."""
    influence = np.zeros((len(own), FREE))
    influence[:, hinge.columns] = own
    found = moved_fit(hinge.fit, T_ab, influence, sigmas)
    if not hinge.pin:
        return found
    for new, old in (
        (found.influence_a, hinge.fit.influence_a),
        (found.influence_b, hinge.fit.influence_b),
    ):
        new[:, 3:] = old[:, 3:]
    return found
