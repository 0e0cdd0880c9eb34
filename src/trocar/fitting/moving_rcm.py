"""The smallest-error point of a body whose centre wanders with the joints, and its curve.

A linkage whose loops are no parallelograms has no remote centre: the point that errs least,

    minimise sum_k |R_k tip + p_k - post|^2

misses by a smooth function of one joint's position, its wander, besides noise. Weights by the noise
would move that point, so each pose counts alike; noise in R_k shortens the mean rotation by its
variance, which is given back. Intervals come from what is left beside the wander.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray

from trocar.fitting.pivot import PivotFit, rest_pose, white_noise
from trocar.fitting.robust import widening
from trocar.geometry.se3 import inverse

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Degree of the polynomial of the joint position that a wander is taken for. Source: our choice;
#: over 0.6 rad to either side it leaves less than 1 um of 2 mm (measured on PSM and ECM).
DEGREE = 6


@dataclass(frozen=True, eq=False)
class WanderFit:
    """The smallest-error point, and how it wanders.

    Attributes:
        pivot: the point; its intervals leave the wander out
        noise_rms: what is left beside the wander, as a distance [m]
        q: positions of the joint, (g,) [rad]
        curve: R tip + p - post there where the frame has not turned, (g, 3) [m]
        sigma: its standard deviation, (g, 3) [m]
    """

    pivot: PivotFit
    noise_rms: float
    q: Array
    curve: Array
    sigma: Array


def fit_wander(
    T_ca: ArrayLike,
    T_cb: ArrayLike,
    turned: ArrayLike,
    q: ArrayLike,
    pivot: PivotFit,
    places: Array,
) -> WanderFit:
    """Find the point of b that errs least in a, and how it wanders with the joint that moves it.

    Args:
        T_ca, T_cb: poses of both in the camera's frame at equal steps of time, (n, 4, 4), NaN
            where not tracked
        turned: pose in a of the frame in which b moves with the joint alone, (n, 4, 4), as an
            earlier joint turns it
        q: positions of the joint, (n,) [rad], NaN for samples that do not count
        pivot: a first fit; samples that it leaves out do not count
        places: positions of the joint for the curve, (g,) [rad]
    """
    a, b = np.asarray(T_ca, dtype=np.float64), np.asarray(T_cb, dtype=np.float64)
    joint, frame = np.asarray(q, dtype=np.float64), np.asarray(turned, dtype=np.float64)
    rest = rest_pose(a)
    noise_a, noise_b = (0.0 if rest else white_noise(a)[1]), white_noise(b)[1]
    T_ab = inverse(a if rest is None else rest.pose) @ b
    used = np.isfinite(T_ab).all(axis=(1, 2)) & np.isfinite(joint) & pivot.used
    R, p = T_ab[used, :3, :3], T_ab[used, :3, 3]
    tip, post = _smallest_error(R, p, (1.0 - noise_a**2, 1.0 - noise_b**2))
    residual = R @ tip + p - post
    back = inverse(frame[used])
    centres = np.einsum("kij,kj->ki", back[:, :3, :3], R @ tip + p) + back[:, :3, 3]
    low, high = float(joint[used].min()), float(joint[used].max())
    basis, there = (
        np.array(legendre.legvander((2.0 * x - low - high) / (high - low), DEGREE), dtype=float)
        for x in (joint[used], places)
    )
    share = np.asarray(np.linalg.pinv(basis), dtype=np.float64)
    weights = there @ share  # of the samples in the curve
    freed = len(centres) / max(len(centres) - basis.shape[1], 1)
    noise: Array = np.sqrt(freed) * (centres - basis @ (share @ centres))
    in_base = np.einsum("kji,kj->ki", back[:, :3, :3], noise)

    # What the noise of each sample does to tip and post, and to the curve.
    count, mean = len(R), R.mean(axis=0)
    square = np.block([[np.eye(3), -mean.T], [-mean, np.eye(3)]])
    pulled = np.concatenate([np.einsum("kji,kj->ki", R, in_base), -in_base], axis=1)
    effect = -(pulled / count) @ np.linalg.inv(square)
    left = float(np.linalg.norm(noise)) / float(np.sqrt(count))
    widened = widening(effect, (left, 0.0))
    sigma = widened * np.sqrt(np.sum(effect**2, axis=0))
    smoothed = np.tensordot(weights, back[:, :3, :3] @ R, 1)  # the body's rotations there
    of_curve = np.einsum("gij,kj->kgi", smoothed, effect[:, :3]) - effect[:, None, 3:]
    of_curve += weights.T[:, :, None] * noise[:, None, :]
    flat = of_curve.reshape(count, -1)
    curve_sigma = widening(flat, (left, 0.0)) * np.sqrt(np.sum(flat**2, axis=0)).reshape(
        len(places), 3
    )
    if rest is not None:
        across = post @ post - post**2
        more = rest.position_sigma**2 + rest.rotation_sigma**2 * across
        sigma[3:] = np.sqrt(sigma[3:] ** 2 + more)

    influence, points = np.zeros((len(a), 6)), T_ab[:, :3, :3] @ tip + T_ab[:, :3, 3]
    influence[used] = widened * effect
    rms_axes = np.sqrt(np.mean(residual**2, axis=0))
    found = replace(
        pivot,
        tip=tip,
        post=post,
        rms_axes=rms_axes,
        rms=float(np.linalg.norm(rms_axes)),
        sigma_tip=sigma[:3],
        sigma_post=sigma[3:],
        points=points,
        used=used,
        influence=influence,
        widened=widened,
    )
    return WanderFit(found, left, places, weights @ centres - post, curve_sigma)


def _smallest_error(R: Array, p: Array, shrink: tuple[float, float]) -> tuple[Array, Array]:
    """Return tip and post by least squares, less what noise of the rotations makes of them.

    Args:
        R, p: poses of the body, (n, 3, 3) and (n, 3)
        shrink: by which noise shortens the mean of the frame's rotation, and of the body's
    """
    frame, body = shrink
    mean_R, mean_p = R.mean(axis=0) / (frame * body), p.mean(axis=0) / frame
    mean_Rp = np.einsum("kji,kj->i", R, p) / (len(R) * body)
    left, right = np.eye(3) - mean_R.T @ mean_R, mean_R.T @ mean_p - mean_Rp
    tip = np.asarray(np.linalg.solve(left, right), dtype=np.float64)
    return tip, mean_R @ tip + mean_p
