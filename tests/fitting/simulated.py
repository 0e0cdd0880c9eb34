"""Poses of bodies on two parallel hinges, and about a point, with noise, dropouts and outliers."""

import numpy as np

from trocar.fitting import Axis
from trocar.fitting.robust import weighted_point
from trocar.geometry import (
    inverse,
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    rotation_x,
    rotation_z,
    transform,
    translation,
)

#: The noise of the project's figures: 0.1 mm and 0.05 deg.
NOISE = {"position": 1e-4, "rotation": np.deg2rad(0.05)}
SAMPLES = 24 * 120


def unit(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def any_rotation(rng, *shape):
    q = rng.normal(size=(*shape, 4))
    return matrix_from_quaternion(q / np.linalg.norm(q, axis=-1, keepdims=True))


def measured(rng, T, position=0.0, rotation=0.0, dropout=0.0, outliers=0.0):
    """Add noise per axis [m], [rad], gross outliers (20 mm, any orientation), bursts of NaN."""
    T, n = np.array(T), len(T)
    T[:, :3, 3] += position * rng.normal(size=(n, 3))
    T[:, :3, :3] = T[:, :3, :3] @ matrix_from_rotation_vector(rotation * rng.normal(size=(n, 3)))
    wrong = np.flatnonzero(rng.random(n) < outliers)
    for k in wrong:
        T[k, :3, 3] += 0.02 * unit(rng)
        T[k, :3, :3] = any_rotation(rng)
    lost = 0
    while lost < dropout * n:
        start, length = rng.integers(0, n), rng.integers(5, 40)
        T[start : start + length] = np.nan
        lost += length
    return T


def cluster(rng):
    """Place a marker cluster 0.15 to 0.6 m from the axis z, turned anyhow."""
    turn, away = rng.uniform(0, 2 * np.pi), rng.uniform(0.15, 0.6)
    place = [away * np.cos(turn), away * np.sin(turn), rng.uniform(-0.1, 0.1)]
    return transform(any_rotation(rng), place)


def turned(theta):
    return transform(rotation_z(theta), np.zeros((len(theta), 3)))


def sweep(rng, amplitude, samples=SAMPLES):
    return amplitude * np.sin(2 * np.pi * np.arange(samples) / 720 + rng.uniform(0, 2 * np.pi))


def two_hinges(rng, amplitude=0.6, distance=None, samples=SAMPLES, **noise):
    """Give the poses of three bodies in a chain, told by a camera, and the distance of its axes."""
    distance = distance or rng.uniform(0.03, 0.5)
    places = [cluster(rng) for _ in range(3)]
    camera = transform(any_rotation(rng), rng.normal(size=3))
    links = [np.tile(camera, (samples, 1, 1))]
    links.append(links[0] @ turned(sweep(rng, amplitude, samples)))
    links.append(links[1] @ translation([distance, 0, 0]) @ turned(sweep(rng, amplitude, samples)))
    bodies = [
        measured(rng, link @ place, **noise) for link, place in zip(links, places, strict=True)
    ]
    return bodies, distance


def one_hinge(rng, amplitude=0.6, samples=SAMPLES, **noise):
    """Give the poses of b in a, and the frames (a: hinge, hinge: b) that made them."""
    first, second = inverse(cluster(rng)), cluster(rng)
    theta = sweep(rng, amplitude, samples)
    camera = transform(any_rotation(rng), rng.normal(size=3))
    a = measured(rng, np.tile(camera @ inverse(first), (samples, 1, 1)), **noise)
    b = measured(rng, camera @ turned(theta) @ second, **noise)
    return inverse(a) @ b, first, second, theta


def about_a_point(rng, yaw=0.6, pitch=0.6, samples=SAMPLES, reach=(0.3, 0.3), **noise):
    """Give the poses of a body in another that rests, and the point: in the body, in the other."""
    time = np.arange(samples) / 120
    turns = rotation_z(yaw * np.sin(2 * np.pi * time / 8 + 1.0)) @ rotation_x(
        pitch * np.sin(2 * np.pi * time / 3)
    )
    post, tip = reach[0] * unit(rng), reach[1] * unit(rng)
    R = any_rotation(rng) @ turns @ any_rotation(rng)
    rest = transform(any_rotation(rng), rng.normal(size=3))
    a = measured(rng, np.tile(rest, (samples, 1, 1)), **noise)
    b = measured(rng, rest @ transform(R, post - R @ tip), **noise)
    return inverse(a) @ b, tip, post


def fit_hinge_least_squares(T_ab):
    """Find a hinge's axis as the paper does, in a and in b: least squares, every sample alike.

    With noise in R the point is drawn to b's origin, the more so the smaller the sweep.

    Source: section 2.4 of the closed-loop paper; Gamage and Lasenby, New least squares solutions
    for estimating the average centre of rotation and the axis of rotation, 2002.
    """
    T = T_ab[np.isfinite(T_ab).all(axis=(1, 2))]
    R, p = T[:, :3, :3], T[:, :3, 3]
    left, _, right = np.linalg.svd(R.mean(axis=0))
    g_a, g_b = weighted_point(R, p, np.ones(len(R)))
    nothing = np.zeros((len(T_ab), 6))
    return Axis(g_a, left[:, 0], nothing), Axis(g_b, right[0], nothing)
