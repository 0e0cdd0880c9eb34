"""The point of a body that stays where it is."""

import numpy as np
import pytest

from tests.fitting.simulated import NOISE, about_a_point
from trocar.errors import InputError, UndeterminedError
from trocar.fitting import fit_pivot


def pivot(T, **options):
    return fit_pivot(T[:, :3, :3], T[:, :3, 3], **options)


def test_a_point_without_noise_is_found_to_rounding():
    T, tip, post = about_a_point(np.random.default_rng(1))
    fit = pivot(T)
    assert np.allclose(fit.tip, tip, atol=1e-13) and np.allclose(fit.post, post, atol=1e-13)
    assert fit.rms < 1e-13


def test_equations_three_and_four_of_the_paper_give_the_same_point_without_noise():
    T, *_ = about_a_point(np.random.default_rng(2), samples=300)
    rows = np.concatenate([np.hstack([R, -np.eye(3)]) for R in T[:, :3, :3]])
    solution = np.linalg.pinv(rows) @ -T[:, :3, 3].reshape(-1)
    fit = pivot(T)
    assert np.allclose(np.concatenate([fit.tip, fit.post]), solution, atol=1e-12)


def test_the_rms_has_the_root_of_n_that_equation_five_lacks():
    T, *_ = about_a_point(np.random.default_rng(3), **NOISE)
    fit = pivot(T)
    off = fit.post - fit.points
    assert np.allclose(fit.rms_axes, np.sqrt((off**2).mean(axis=0)))
    assert fit.rms == pytest.approx(np.sqrt((off**2).sum(axis=1).mean()))
    assert pivot(np.concatenate([T, T])).rms == pytest.approx(fit.rms, rel=1e-6)


def test_turns_about_one_axis_leave_the_point_open_and_the_error_says_along_what():
    T, *_ = about_a_point(np.random.default_rng(4), yaw=0.0, **NOISE)
    with pytest.raises(UndeterminedError, match="one axis only") as caught:
        pivot(T)
    along = np.array(caught.value.direction)
    assert np.allclose(
        T[:, :3, :3].mean(axis=0) @ T[:, :3, :3].mean(axis=0).T @ along, along, atol=1e-4
    )
    assert caught.value.got < caught.value.wanted


def test_dropouts_and_gross_outliers_are_left_out():
    T, _, post = about_a_point(np.random.default_rng(5), dropout=0.05, outliers=0.01, **NOISE)
    fit = pivot(T)
    assert 30 < fit.outliers < 90
    assert np.linalg.norm(fit.post - post) < 1e-4
    assert np.isnan(fit.points[np.isnan(T[:, 0, 0])]).all()


def test_a_point_that_wanders_as_far_as_the_papers_ecm_keeps_its_samples():
    rng = np.random.default_rng(6)
    T, *_ = about_a_point(rng, **NOISE)
    # Source: closed-loop paper, Table 7: 3.72, 2.45 and 1.33 mm, here along the angles' squares.
    turned = T[:, :3, :3].transpose(0, 2, 1) @ T[0, :3, :3]
    shape = np.stack([turned[:, 0, 1], turned[:, 0, 2] ** 2, turned[:, 1, 2]], axis=1)
    shape -= shape.mean(axis=0)
    T[:, :3, 3] += np.array([3.72e-3, 2.45e-3, 1.33e-3]) * shape / shape.std(axis=0)
    wandering = pivot(T, rotation_sigma=NOISE["rotation"])
    assert wandering.outliers == 0
    T[::100, :3, 3] += 0.04 * rng.choice([-1.0, 1.0], (len(T[::100]), 1))
    found = pivot(T, rotation_sigma=NOISE["rotation"])
    assert found.outliers == len(T[::100])
    assert found.rms == pytest.approx(wandering.rms, rel=0.02)


def test_too_few_poses_are_rejected():
    with pytest.raises(InputError, match="tracked in 5 of 5"):
        fit_pivot(np.tile(np.eye(3), (5, 1, 1)), np.zeros((5, 3)))


def test_arrays_of_other_shapes_are_rejected():
    with pytest.raises(InputError, match=r"\(n, 3, 3\) and \(n, 3\)"):
        fit_pivot(np.zeros((9, 3, 3)), np.zeros((8, 3)))
