"""All hinges of a linkage at once: a four-bar with four unequal sides, before cameras."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.fitting.simulated import NOISE, any_rotation, measured, turned, unit
from trocar.fitting import SharedHinge, axis_distance, fit_hinge, refine_hinges
from trocar.geometry import inverse, rotation_vector_from_matrix, transform
from trocar.geometry.se3 import exp_twist

SIGMAS = (NOISE["position"], NOISE["rotation"])
#: Ground, crank, coupler, rocker [m]; between which two bodies each hinge is, the last one a pin.
SIDES = (0.30, 0.12, 0.28, 0.21)
HINGES = ((0, 1), (1, 2), (0, 3), (2, 3))


def four_bar(crank):
    """Return the links' poses, (n, 4, 4, 4): of each, at its first hinge, x to its second."""
    ground, a, b, c = SIDES
    at_crank = a * np.stack([np.cos(crank), np.sin(crank)], axis=1)
    to_rocker = [ground, 0.0] - at_crank
    far = np.linalg.norm(to_rocker, axis=1)
    turn = np.arctan2(to_rocker[:, 1], to_rocker[:, 0])
    coupler = turn + np.arccos((b**2 + far**2 - c**2) / (2 * b * far))
    knee = at_crank + b * np.stack([np.cos(coupler), np.sin(coupler)], axis=1)
    rocker = np.arctan2(knee[:, 1], knee[:, 0] - ground)
    links = [np.tile(np.eye(4), (len(crank), 1, 1)), turned(crank), turned(coupler), turned(rocker)]
    links[2][:, :2, 3] = at_crank
    links[3][:, 0, 3] = ground
    return np.stack(links, axis=1)


def tracks(seed, samples=400, **noise):
    """Return poses of clusters on the four links, (n, 4, 4, 4)."""
    rng = np.random.default_rng(seed)
    links = four_bar(1.2 + 0.6 * np.sin(np.linspace(0, 4 * np.pi, samples)))
    camera = transform(any_rotation(rng), rng.normal(size=3))
    bodies = [
        camera @ links[:, i] @ transform(any_rotation(rng), rng.uniform(0.05, 0.2) * unit(rng))
        for i in range(4)
    ]
    return np.stack([measured(rng, body, **noise) for body in bodies], axis=1)


def shared(poses):
    return [
        SharedHinge(a, b, fit_hinge(inverse(poses[:, a]) @ poses[:, b]), pin=(a, b) == (2, 3))
        for a, b in HINGES
    ]


def sides(fits):
    """Measure ground, crank, coupler, rocker."""
    zero, one, two, pin = fits
    return [
        axis_distance(zero.in_a, two.in_a),
        axis_distance(zero.in_b, one.in_a),
        axis_distance(one.in_b, pin.in_a),
        axis_distance(two.in_b, pin.in_b),
    ]


def test_exact_poses_leave_exact_hinges_as_they_are():
    poses = tracks(1)
    hinges = shared(poses)
    found = refine_hinges(poses, hinges, (1e-10, 1e-9))
    assert [side.value for side in sides(found)] == pytest.approx(SIDES, abs=1e-12)
    for hinge, fit in zip(hinges, found, strict=True):
        made = fit.before @ turned(fit.angles) @ fit.after
        assert np.allclose(made, inverse(poses[:, hinge.a]) @ poses[:, hinge.b], atol=1e-11)


def test_it_is_where_the_likelihood_of_all_poses_is_largest():
    poses = tracks(2, 20, **NOISE)
    # So few samples guess their noise badly, and a hinge that seems loose counts less.
    known = {"position_sigma": SIGMAS[0], "rotation_sigma": SIGMAS[1]}
    hinges = [replace(hinge, fit=replace(hinge.fit, **known)) for hinge in shared(poses)]
    found = sides(refine_hinges(poses, hinges, SIGMAS))
    sought = sides(most_likely(poses, hinges))
    alone = sides([hinge.fit for hinge in hinges])
    for one, other in zip(found, sought, strict=True):
        # One step leaves what is of second order in the noise.
        assert abs(one.value - other.value) < 0.03 * one.sigma
    away = np.array([b.value - s.value for b, s in zip(alone, sought, strict=True)])
    assert np.abs(away).max() > 1e-5


def most_likely(poses, hinges):
    """Minimise over everything by brute force: axes, angles, and the ground's pose each sample."""
    count = len(poses)
    begin = [hinge.fit for hinge in hinges]
    free = [9, 9, 9, 4]
    ends = np.cumsum([*free, 6 * count, 3 * count])[:-1]

    def fits(parts):
        out = []
        for fit, x in zip(begin, parts, strict=True):
            x = x if len(x) == 9 else np.array([x[0], x[1], 0, 0, 0, x[2], x[3], 0, 0])
            a, b = np.array([*x[:5], 0.0]), np.array([*x[5:7], 0.0, *x[7:9], 0.0])
            before, after = fit.before @ exp_twist(a), exp_twist(b) @ fit.after
            out.append(replace(
                fit, before=before, after=after, point_a=before[:3, 3],
                point_b=inverse(after)[:3, 3], direction_a=before[:3, 2], direction_b=after[2, :3],
            ))  # fmt: skip
        return out

    def left_over(x):
        *parts, ground, angles = np.split(x, ends)
        zero, one, two, pin = fits(parts)
        ground, angles = ground.reshape(-1, 6), angles.reshape(3, -1)
        at = [poses[:, 0] @ exp_twist(ground)]
        for parent, fit, angle in ((0, zero, angles[0]), (1, one, angles[1]), (0, two, angles[2])):
            at.append(at[parent] @ fit.before @ turned(fit.angles + angle) @ fit.after)
        expected = np.stack(at, axis=1)
        shift = (poses - expected)[..., :3, 3] / SIGMAS[0]
        turn = poses[..., :3, :3] @ np.swapaxes(expected[..., :3, :3], -1, -2)
        gap = inverse(at[2] @ pin.before) @ at[3] @ inverse(pin.after)
        # The pin holds as good as exactly, but only across its axis.
        held = gap[:, :2, 3] / (1e-3 * SIGMAS[0])
        return np.concatenate([
            shift.ravel(), rotation_vector_from_matrix(turn).ravel() / SIGMAS[1], held.ravel()
        ])  # fmt: skip

    start = np.zeros(sum(free) + 9 * count)
    solved = least_squares(left_over, start, xtol=1e-10, ftol=1e-10, max_nfev=6)
    return fits(np.split(solved.x, ends)[:4])


def test_a_body_that_is_lost_or_far_off_leaves_the_others_hinges_alone():
    poses = tracks(3, **NOISE)
    poses[50:80, 1] = np.nan
    poses[100:110, 3, :3, 3] += 0.02
    poses[200:205, 1:] = np.nan
    hinges = shared(poses)
    found = refine_hinges(poses, hinges, SIGMAS)
    for (a, b), fit in zip(HINGES, found, strict=True):
        lost = np.zeros(len(poses), dtype=bool)
        lost[50:80] = 1 in (a, b)
        lost[100:110] = 3 in (a, b)
        lost[200:205] = True
        assert (fit.influence_a[200:205] == 0).all() and (fit.influence_b[200:205] == 0).all()
        assert (np.isnan(fit.angles) == lost).all()
    for side, expected in zip(sides(found), SIDES, strict=True):
        assert abs(side.value - expected) < 4 * side.sigma < 5e-4


def test_a_pin_with_play_counts_less():
    """Two links that miss their pin by more than noise say little of the others' hinges."""
    poses = tracks(4, **NOISE)
    rng = np.random.default_rng(0)
    # A rocker whose pin is loose: it stands at angles of its own about the ground's hinge.
    rocker = shared(poses)[2].fit
    loose = rocker.before @ turned(rocker.angles + 0.02 * rng.normal(size=len(poses)))
    poses[:, 3] = poses[:, 0] @ loose @ rocker.after
    hinges = shared(poses)
    found = sides(refine_hinges(poses, hinges, SIGMAS))
    alone = sides([hinge.fit for hinge in hinges])
    for one, before in zip(found[:3], alone[:3], strict=True):
        assert abs(one.value - before.value) < 3 * before.sigma
