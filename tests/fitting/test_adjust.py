"""The adjustment engine: poses and vectors, noise, priors and covariance by their laws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.fitting import Axis, axis_distance
from trocar.fitting.adjust import Adjustable, Block, Values, adjust, layout, slopes
from trocar.geometry.se3 import exp_twist, inverse, log_transform

Array = NDArray[np.float64]


def line(x: Array, y: Array, analytic: bool) -> Callable[[Values], dict[str, Block]]:
    """Return the blocks of a line through points, y = a + b x."""
    columns = np.stack([np.ones_like(x), x], axis=1)

    def blocks(values: Values) -> dict[str, Block]:
        return {"y": Block(columns @ values["line"] - y, columns if analytic else None)}

    return blocks


@pytest.mark.parametrize("analytic", [True, False])
def test_a_line_has_the_figures_of_linear_regression(analytic: bool) -> None:
    rng = np.random.default_rng(0)
    x = np.linspace(0.0, 1.0, 12)
    y = 1.0 + 2.0 * x + 0.1 * rng.normal(size=12)
    found = adjust(
        Adjustable(line(x, y, analytic), {"y": 1.0}, {"y": 0.0}), {"line": np.zeros(2)}, 2
    )
    (b, a), covariance = np.polyfit(x, y, 1, cov=True)
    np.testing.assert_allclose(found.values["line"], [a, b], rtol=1e-9)
    np.testing.assert_allclose(found.sigma("line"), np.sqrt(np.diag(covariance))[::-1], rtol=1e-7)
    left = found.residuals["y"]
    assert found.problem.noise["y"] == pytest.approx(np.sqrt(left @ left / 10.0))


def test_the_pose_between_points_is_found_from_far_away() -> None:
    rng = np.random.default_rng(1)
    truth, points = exp_twist(np.array([0.3, -0.2, 0.5, 1.0, -0.7, 0.4])), rng.normal(size=(6, 3))
    seen = points @ truth[:3, :3].T + truth[:3, 3]

    def blocks(values: Values) -> dict[str, Block]:
        T = values["T"]
        return {"points": Block((points @ T[:3, :3].T + T[:3, 3] - seen).ravel())}

    found = adjust(Adjustable(blocks, {"points": 1e-3}), {"T": np.eye(4)})
    assert np.abs(log_transform(inverse(truth) @ found.values["T"])).max() < 1e-9


def test_errors_of_two_kinds_are_told_apart_and_as_large_as_their_covariance_says() -> None:
    x, rng = np.linspace(-1.0, 1.0, 8), np.random.default_rng(2)
    squares, ratios = [], []
    for _ in range(200):
        fine, coarse = x + 0.01 * rng.normal(size=8), x + 0.1 * rng.normal(size=8)

        def blocks(values: Values, fine: Array = fine, coarse: Array = coarse) -> dict[str, Block]:
            b = values["b"][0]
            return {"fine": Block(b * x - fine), "coarse": Block(b * x - coarse)}

        least = {"fine": 0.0, "coarse": 0.0}
        problem = Adjustable(blocks, {"fine": 1.0, "coarse": 1.0}, least)
        found = adjust(problem, {"b": np.zeros(1)}, 4)
        squares.append(((found.values["b"][0] - 1.0) / found.sigma("b")[0]) ** 2)
        ratios.append(found.problem.noise["coarse"] / found.problem.noise["fine"])
    assert np.median(ratios) == pytest.approx(10.0, rel=0.15)
    # of t with seven degrees of freedom: variance 7 / 5, whose mean over 200 scatters by 0.2
    assert 0.8 < np.mean(squares) < 2.0


def test_a_prior_that_nothing_narrows_is_undetermined_and_keeps_its_deviation() -> None:
    x = np.linspace(0.0, 1.0, 5)

    def blocks(values: Values) -> dict[str, Block]:
        return {"y": Block(values["seen"][0] * x - 2.0 * x)}

    prior = {"seen": np.array([100.0]), "unseen": np.array([0.5, np.inf])}
    start = {"seen": np.zeros(1), "unseen": np.zeros(2)}
    found = adjust(Adjustable(blocks, {"y": 1e-3}, priors=prior), start)
    assert found.undetermined("unseen", 0.5) == [0]
    assert found.undetermined("seen", 0.5) == []
    assert found.sigma("unseen")[0] == pytest.approx(0.5)
    assert found.sigma("unseen")[1] > 1e6  # open
    assert layout(start)["unseen"] == slice(1, 3)


def test_the_error_of_a_distance_through_a_point_is_its_derivative() -> None:
    rng = np.random.default_rng(3)
    through = np.array([0.02, -0.01, 0.3])
    numbers = np.array([0.0, 0.0, 0.0, 2e-3, 1e-3, 1.0, 0.1, 0.05, 0.02, -1e-3, 3e-3, 1.0])

    def axes(x: Array, influence: Array) -> tuple[Axis, Axis]:
        found: list[Axis] = []
        for part, own in zip(x.reshape(2, 6), np.split(influence, 2, axis=1), strict=True):
            size = np.linalg.norm(part[3:])
            d = part[3:] / size
            flat = own.copy()
            flat[:, 3:] = (own[:, 3:] - np.outer(own[:, 3:] @ d, d)) / size
            found.append(Axis(part[:3], d, flat))
        return found[0], found[1]

    influence = 1e-4 * rng.normal(size=(3, 12))

    def distance(x: Array) -> float:
        return axis_distance(*axes(x, influence), through).value

    found = axis_distance(*axes(numbers, influence), through)
    np.testing.assert_allclose(found.influence, influence @ slopes(distance, numbers), rtol=1e-5)
    one, two = axes(numbers, influence)
    assert axis_distance(one, replace(two, direction=-two.direction,
                                      influence=two.influence * np.repeat([1.0, -1.0], 3)),
                         through).sigma == pytest.approx(found.sigma)  # fmt: skip
