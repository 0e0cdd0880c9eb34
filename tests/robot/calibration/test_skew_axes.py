"""Axes that are not parallel: one definition of their distances in truth, tracks and overlay."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.axis_lines import Line, home_lines, line_angle, line_distance
from trocar.descriptions.overlay import apply_overlay
from trocar.robot.calibration import Tracks, calibrate
from trocar.robot.mocap import MocapSettings, perturbed, simulate_tracks, worn
from trocar.robot.mocap.simulate import Parts

#: Pins join two links as balls do: with tilts of 1 mrad no axis is theirs to better than this. [m]
PIN_M = 3e-7


def in_plane(arm: ArmDescription) -> dict[str, float]:
    """Distances as a stranger takes them: where axes pierce a plane through axis 3's origin."""
    plan = arm.calibration
    assert plan is not None
    lines = home_lines(arm.mechanism, plan.axes)
    origin = next(iter(lines.values())).point
    found: dict[str, float] = {}
    for a, b in plan.distances:
        normal = lines[a].direction + lines[b].direction
        at = [
            np.linalg.solve(
                np.vstack([normal, np.linalg.svd(n.direction[None])[2][1:]]),
                np.append(normal @ origin, np.linalg.svd(n.direction[None])[2][1:] @ n.point),
            )
            for n in (lines[a], lines[b])
        ]
        found[f"{a}-{b}"] = float(np.linalg.norm(at[1] - at[0]))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), [("psm", 3), ("ecm", 4)])
def test_truth_tracks_and_overlay_tell_one_distance_of_skew_axes(name: str, seed: int) -> None:
    arm, rng = load_arm(name), np.random.default_rng(seed)
    robot = worn(perturbed(arm, rng), rng)
    made = simulate_tracks(robot, MocapSettings("kinematic", duration_s=8.0, rate_hz=20.0))
    truth = made.truth["axis_distances_m"]
    assert truth == pytest.approx(in_plane(robot), abs=1e-15)
    tracks = Tracks("t.csv", "", made.times, made.poses, made.rate_hz)
    found = calibrate(tracks, arm, closure="general")
    overlay = in_plane(apply_overlay(arm, found.overlay))
    for label, wanted in truth.items():
        # a hinge's place is exact; a pin's is where a ball moves most like a hinge
        close = PIN_M if "c" in label else 1e-8
        assert found.axis_distances[label].value == pytest.approx(wanted, abs=close), label
        assert found.closed_distances[label] == pytest.approx(wanted, abs=2 * close), label
        assert overlay[label] == pytest.approx(wanted, abs=2 * PIN_M), label
    # where along the axes a cluster sits is worth a hundred times that
    assert max(abs(t) for tilt in found.refined.robot.tilts.values() for t in tilt) > 5e-4
    assert not any("along the axes" in text for text in found.warnings)


@pytest.mark.slow
def test_without_the_ground_s_own_axis_the_place_along_skew_axes_is_said_to_be_open() -> None:
    arm = load_arm("psm")
    robot = worn(arm, np.random.default_rng(2))
    made = simulate_tracks(
        robot, MocapSettings("kinematic", parts="axes", duration_s=8.0, rate_hz=20.0)
    )
    found = calibrate(Tracks("t", "", made.times, made.poses, made.rate_hz), arm, closure="general")
    (said,) = (text for text in found.warnings if "along the axes" in text)
    assert "sweep the base's joint too" in said
    for label, value in found.axis_distances.items():
        # far along it from the ball that joins two links, a pin's direction counts too
        close = 1e-4 if "c" in label else 2e-8
        assert found.closed_distances[label] == pytest.approx(value.value, abs=close), label


# In the whole take the loops rest in most samples, and those in which they move are no outliers.
@pytest.mark.slow
@pytest.mark.parametrize(("parts", "seed"), [("", 1), ("axes", 0)])
def test_a_worn_master_is_calibrated_with_its_leaning_axes(parts: Parts, seed: int) -> None:
    arm = load_arm("mtml")
    robot = worn(arm, np.random.default_rng(seed))
    take = MocapSettings("kinematic", parts=parts, duration_s=8.0, rate_hz=20.0)
    made = simulate_tracks(robot, take)
    found = calibrate(Tracks("t", "", made.times, made.poses, made.rate_hz), arm, closure="general")
    assert max(abs(t) for tilt in found.refined.robot.tilts.values() for t in tilt) > 3e-4
    assert found.refined.misfit_m < 1e-9  # the motion is explained to rounding
    assert found.refined.samples == len(made.times)
    assert any("along the axes" in text for text in found.warnings)
    for label in ("2-3", "bar-rod"):
        value = found.axis_distances[label].value
        assert found.closed_distances[label] == pytest.approx(value, abs=1e-8)
        # up to 15 cm along axes that lean by 1 mrad
        assert value == pytest.approx(made.truth["axis_distances_m"][label], abs=1.5e-4)
    apply_overlay(arm, found.overlay)


def test_the_distance_of_parallel_lines_is_the_same_in_any_plane(rng: np.random.Generator) -> None:
    along = rng.normal(size=3)
    along /= np.linalg.norm(along)
    one, two = (Line(rng.normal(size=3), sign * along) for sign in (1.0, -1.0))
    wanted = np.linalg.norm(np.cross(two.point - one.point, along))
    for through in rng.normal(size=(5, 3)):
        assert line_distance(one, two, through) == pytest.approx(wanted, abs=1e-12)


def test_an_angle_of_lines_is_that_of_their_places_in_the_plane() -> None:
    up = np.array([0.0, 0.0, 1.0])
    start = (Line(np.array([0.0, 0.0, 3.0]), up), Line(np.array([2.0, 0.0, -1.0]), up))
    to = (Line(np.zeros(3), up), Line(np.array([-1.0, 1.0, 5.0]), up))
    assert line_angle(to, start, np.zeros(3)) == pytest.approx(0.75 * np.pi, abs=1e-15)
    down = tuple(Line(n.point, -up) for n in start)
    assert line_angle(to, (down[0], down[1]), np.zeros(3)) == pytest.approx(-0.75 * np.pi)
