"""The hinge between two bodies, by maximum likelihood."""

import numpy as np
import pytest

from tests.fitting.simulated import NOISE, one_hinge, turned, two_hinges
from trocar.errors import InputError
from trocar.fitting import axis_distance, fit_hinge
from trocar.geometry import inverse, point_line_distance, rotation_z, transform, translation


def test_a_hinge_without_noise_is_found_to_rounding():
    T, first, second, theta = one_hinge(np.random.default_rng(1))
    fit = fit_hinge(T)
    sign = np.sign(fit.direction_a @ first[:3, 2])
    assert np.allclose(sign * fit.direction_a, first[:3, 2], atol=1e-13)
    assert np.allclose(sign * fit.direction_b, inverse(second)[:3, 2], atol=1e-13)
    assert point_line_distance(fit.point_a, first[:3, 3], first[:3, 2]) < 1e-13
    assert np.allclose(sign * (fit.angles - fit.angles[0]), theta - theta[0], atol=1e-12)
    assert fit.span == pytest.approx(np.ptp(theta), abs=1e-12)


@pytest.mark.parametrize("given", [{}, {"position_sigma": 0.0, "rotation_sigma": 0.0}])
@pytest.mark.parametrize("on_axis", ["both", "a", "b"])
def test_exact_poses_may_have_their_origins_on_the_axis(on_axis, given):
    theta = np.linspace(-0.6, 0.6, 50)
    away = translation([0.1, 0.0, 0.0])
    first = np.eye(4) if on_axis in {"both", "a"} else away
    second = np.eye(4) if on_axis in {"both", "b"} else away
    fit = fit_hinge(first @ turned(theta) @ second, **given)
    assert np.allclose(fit.point_a, first[:3, 3], atol=1e-14)
    assert np.allclose(fit.point_b, -second[:3, 3], atol=1e-14)
    assert np.allclose(fit.direction_a, [0.0, 0.0, 1.0], atol=1e-14)
    assert fit.used.all()


def test_angles_and_frames_of_a_fit_repeat_the_poses():
    T, *_ = one_hinge(np.random.default_rng(2))
    fit = fit_hinge(T)
    assert np.allclose(fit.before @ turned(fit.angles) @ fit.after, T, atol=1e-12)
    assert np.allclose(T[:, :3, :3] @ fit.point_b + T[:, :3, 3], fit.point_a, atol=1e-12)
    assert np.allclose(T[:, :3, :3] @ fit.direction_b, fit.direction_a, atol=1e-12)


def test_a_positive_angle_turns_b_right_handed_about_the_direction():
    T, *_ = one_hinge(np.random.default_rng(3))
    fit = fit_hinge(T)
    k = int(np.argmax(np.abs(np.diff(fit.angles))))
    step = T[k + 1, :3, :3] @ T[k, :3, :3].T
    axis = np.array([step[2, 1] - step[1, 2], step[0, 2] - step[2, 0], step[1, 0] - step[0, 1]])
    assert np.sign(axis @ fit.direction_a) == np.sign(fit.angles[k + 1] - fit.angles[k])


def test_the_two_bodies_may_change_places():
    T, *_ = one_hinge(np.random.default_rng(4), **NOISE)
    there, back = fit_hinge(T), fit_hinge(inverse(T))
    sign = np.sign(there.direction_b @ back.direction_a)
    assert np.allclose(there.point_b, back.point_a, atol=1e-7)
    assert np.allclose(there.direction_b, sign * back.direction_a, atol=1e-7)
    assert np.allclose(there.influence_b[:, :3], back.influence_a[:, :3], atol=1e-8)


def test_dropouts_and_gross_outliers_are_left_out():
    T, *_ = one_hinge(np.random.default_rng(5), samples=1200, **NOISE)
    clean = fit_hinge(T)
    T[100:160] = np.nan
    T[300:330, :3, 3] += 0.02
    T[500:510, :3, :3] = T[500:510, :3, :3] @ rotation_z(2.0)
    fit = fit_hinge(T)
    assert fit.outliers == 40
    assert not fit.used[[120, 310, 505]].any() and np.isnan(fit.angles[~fit.used]).all()
    assert (fit.influence_a[~fit.used] == 0).all()
    assert np.linalg.norm(fit.point_a - clean.point_a) < 1e-5


def test_the_noise_of_the_bodies_is_found():
    T, *_ = one_hinge(np.random.default_rng(6), **NOISE)
    fit = fit_hinge(T)
    assert fit.rotation_sigma == pytest.approx(NOISE["rotation"], rel=0.05)
    assert fit.position_sigma == pytest.approx(NOISE["position"], rel=0.1)


def test_influences_say_how_the_axis_answers_to_a_disturbed_sample():
    rng = np.random.default_rng(7)
    T, *_ = one_hinge(rng, samples=200, **NOISE)
    sigmas = {"position_sigma": NOISE["position"], "rotation_sigma": NOISE["rotation"]}
    fit = fit_hinge(T, **sigmas)
    k, shift = 50, 1e-7 * fit.direction_a + 2e-7 * rng.normal(size=3)
    effects = []
    for amount in (-1, 1):
        moved = T.copy()
        moved[k, :3, 3] += amount * shift
        effects.append(fit_hinge(moved, **sigmas))
    before, after = effects
    measured = (after.influence_a[k] - before.influence_a[k])[:3]
    moved_by = after.point_a - before.point_a
    moved_by -= moved_by @ fit.direction_a * fit.direction_a
    assert np.allclose(moved_by, measured, atol=0.05 * np.linalg.norm(measured))


def test_the_distance_of_two_axes_of_a_link_needs_no_home_pose():
    (a, b, c), distance = two_hinges(np.random.default_rng(8))
    first, second = fit_hinge(inverse(a) @ b), fit_hinge(inverse(b) @ c)
    assert axis_distance(first.in_b, second.in_a).value == pytest.approx(distance, abs=1e-13)


@pytest.mark.parametrize("n", [0, 7])
def test_too_few_poses_are_rejected(n):
    with pytest.raises(InputError, match=r"tracked at once in .* at least 8"):
        fit_hinge(np.tile(np.eye(4), (n, 1, 1)))


def test_arrays_that_are_no_poses_are_rejected():
    with pytest.raises(InputError, match=r"shape \(n, 4, 4\)"):
        fit_hinge(np.zeros((10, 3, 3)))


def test_the_condition_number_grows_as_the_sweep_shrinks():
    conditions = [
        fit_hinge(one_hinge(np.random.default_rng(9), amplitude)[0]).condition
        for amplitude in (0.6, 0.3, 0.1)
    ]
    assert conditions == sorted(conditions)
    # For the mean m of exp(i angle) over a sine: the Bessel function J0(0.6) = 0.912005.
    assert conditions[0] == pytest.approx(1.912005 / 0.087995, rel=1e-3)


def test_bodies_that_do_not_turn_at_all_span_no_angle():
    fit = fit_hinge(np.tile(np.eye(4), (40, 1, 1)))
    assert fit.span == 0.0
    assert fit.condition > 1e300


def test_a_hinge_is_found_from_any_pose_of_the_camera_and_of_the_markers():
    rng = np.random.default_rng(10)
    T, *_ = one_hinge(rng, **NOISE)
    moved = transform(rotation_z(1.0), [0.1, 0.2, 0.3])
    there = fit_hinge(moved @ T)
    here = fit_hinge(T)
    assert there.span == pytest.approx(here.span, abs=1e-3)
