"""Virtual fixtures: laws of force and filter, and files that are rejected."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions.fixtures import (
    Cone,
    Fixture,
    NeedleArc,
    Plane,
    Region,
    Tube,
    read_fixtures,
)
from trocar.errors import DescriptionError

Array = NDArray[np.float64]


def unit(*values: float) -> Array:
    return np.array(values) / np.linalg.norm(values)


REGIONS: dict[str, Region] = {
    "plane": Plane(np.array([0.01, -0.02, 0.03]), unit(1.0, 2.0, -0.5)),
    "cone": Cone(np.array([0.0, 0.01, -0.01]), unit(-1.0, 0.3, 2.0), 0.5),
    "tube": Tube(np.array([[0.0, 0.0, 0.0], [0.04, 0.0, 0.0], [0.05, 0.03, 0.02]]), 0.006),
    "needle_arc": NeedleArc(
        np.zeros(3), unit(0.0, 0.0, 1.0), np.array([0.02, 0.0, 0.0]), np.pi, 0.01
    ),
}
#: Points all about the regions. [m]
POINTS = np.random.default_rng(5).uniform(-0.05, 0.05, (200, 3))
EVERY = pytest.mark.parametrize("kind", REGIONS)
STIFFNESS, FORCE_MAX = 500.0, 4.0


def fixture(kind: str, force_max: float = np.inf) -> Fixture:
    return Fixture(kind, "PSM1", "force", "world", REGIONS[kind], STIFFNESS, force_max)


def distance(region: Region, p: Array) -> float:
    return float(np.linalg.norm(region.nearest(p) - p))


@EVERY
def test_no_allowed_point_is_nearer_than_the_nearest(kind: str) -> None:
    region = REGIONS[kind]
    allowed = np.array([region.nearest(p) for p in POINTS])
    for p in POINTS[::4]:
        others = np.linalg.norm(allowed - p, axis=1)
        assert distance(region, p) <= others.min() + 1e-12


@EVERY
def test_the_filter_is_idempotent_and_leaves_allowed_points_alone(kind: str) -> None:
    region = REGIONS[kind]
    moved = 0
    for p in POINTS:
        q = region.nearest(p)
        np.testing.assert_allclose(region.nearest(q), q, rtol=0.0, atol=1e-15)
        inside = q + 1e-6 * (q - p) / (np.linalg.norm(q - p) or 1.0)
        if (q == p).all():
            continue
        moved += 1
        # A micrometre behind the border is inside, and stays to the last bit.
        if kind != "cone" or np.linalg.norm(q - REGIONS["cone"].apex) > 1e-4:  # type: ignore[attr-defined]
            assert (region.nearest(inside) == inside).all()
    assert 20 < moved < 200


@EVERY
def test_the_filter_never_moves_a_point_farther_from_an_allowed_one(kind: str) -> None:
    region = REGIONS[kind]
    for p in POINTS:
        assert distance(region, region.nearest(p)) <= min(distance(region, p), 1e-15)


@EVERY
@pytest.mark.parametrize("scale", [1.0, 0.2])
@pytest.mark.parametrize("force_max", [np.inf, FORCE_MAX])
def test_the_force_is_the_gradient_of_the_potential(
    kind: str, scale: float, force_max: float
) -> None:
    one = fixture(kind, force_max)

    def potential(master: Array) -> float:
        d = distance(one.region, scale * master) / scale
        bend = force_max / STIFFNESS
        if d <= bend:
            return 0.5 * STIFFNESS * d**2
        return force_max * (d - 0.5 * bend)

    h, compared = 1e-6, 0
    for p in POINTS[::4]:
        master = p / scale
        steps = h * np.eye(3)
        found = [-(potential(master + s) - potential(master - s)) / (2.0 * h) for s in steps]
        ways = [one.region.nearest(p + 1e-4 * s / h) - one.region.nearest(p) for s in steps]
        if max(map(np.linalg.norm, ways)) > 1e-3:
            continue  # between two equally near branches of a tube the gradient jumps
        compared += 1
        np.testing.assert_allclose(one.force(p, scale), found, atol=1e-3)
    assert compared > 40


@EVERY
def test_the_force_is_zero_inside_continuous_at_the_border_and_bounded(kind: str) -> None:
    one = fixture(kind, FORCE_MAX)
    largest = 0.0
    for p in POINTS:
        q = one.region.nearest(p)
        force = one.force(p)
        largest = max(largest, float(np.linalg.norm(force)))
        if (q == p).all():
            assert not force.any()
            continue
        assert force @ (q - p) > 0.0  # towards the region
        way = (p - q) / np.linalg.norm(p - q)
        # One nanometre outside the border: half a micronewton.
        assert np.linalg.norm(one.force(q + 1e-9 * way)) < 2.0 * STIFFNESS * 1e-9
    assert FORCE_MAX - 1e-9 < largest <= FORCE_MAX + 1e-12


def test_regions_agree_with_one_another() -> None:
    wide = Cone(np.array([0.01, 0.0, 0.0]), unit(0.0, 0.0, 1.0), 0.5 * np.pi - 1e-9)
    half = Plane(np.array([0.01, 0.0, 0.0]), unit(0.0, 0.0, 1.0))
    angles = np.linspace(0.0, np.pi, 2001)
    arc = REGIONS["needle_arc"]
    assert isinstance(arc, NeedleArc)
    chords = Tube(np.array([arc.at(a) for a in angles]), arc.clearance)
    for p in POINTS:
        np.testing.assert_allclose(wide.nearest(p), half.nearest(p), atol=1e-9)
        # 2,000 chords leave the circle by r a^2 / 8 = 6 nm.
        assert distance(arc, p) == pytest.approx(distance(chords, p), abs=1e-8)


TUBE = """schema = 1
[[fixture]]
kind = "tube"
arm = "PSM1"
mode = "force"
points_mm = [[0, 0, 0], [10, 0, 0]]
clearance_mm = 2
stiffness_n_per_m = 400
"""
ARC = """schema = 1
[[fixture]]
kind = "needle_arc"
arm = "PSM1"
mode = "filter"
center_mm = [0, 0, 0]
normal = [0, 0, 2]
start_mm = [8, 0, 0]
sweep_deg = 180
clearance_mm = 1
"""


def test_a_file_is_read_in_si(tmp_path: Path) -> None:
    file = tmp_path / "f.toml"
    file.write_text(TUBE)
    (one,) = read_fixtures(file)
    assert (one.name, one.arm, one.mode, one.frame) == ("tube", "PSM1", "force", "world")
    assert (one.stiffness, one.force_max) == (400.0, 5.0)
    np.testing.assert_allclose(one.region.nearest(np.array([0.005, 0.01, 0.0])), [0.005, 0.002, 0])
    file.write_text(ARC)
    (one,) = read_fixtures(file)
    np.testing.assert_allclose(
        one.region.nearest(np.array([0.0, 0.02, 0.0])), [0, 0.009, 0], atol=1e-12
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("schema = 2\n", "schema: got 2; allowed: 1"),
        ("schema = 1\n", "fixture: is missing"),
        (TUBE.replace('"tube"', '"sphere"'), "kind: got 'sphere'; allowed: plane, cone, tube"),
        (TUBE.replace('"force"', '"push"'), "mode: got 'push'; allowed: force, filter"),
        (TUBE.replace("400", "-1"), "stiffness: got -1; allowed: above 0"),
        (TUBE.replace("stiffness", "stifness"), "stiffness: is missing; allowed keys"),
        (TUBE.replace("= 2\n", "= 0\n"), "clearance: got 0; allowed: above 0"),
        (TUBE.replace("[10, 0, 0]", "[0, 0, 0]"), "got the same point twice"),
        (TUBE.replace(", [10, 0, 0]", ""), "allowed: 2 or more points"),
        (TUBE.replace("[10, 0, 0]", "[10, 0]"), "allowed: a list of 3 numbers"),
        (TUBE + "radius_mm = 2\n", "unknown key; this table knows"),
        (TUBE + TUBE.removeprefix("schema = 1\n"), "name: got 'tube' a second time"),
        (ARC.replace("[0, 0, 2]", "[0, 0, 0]"), "got [0.0, 0.0, 0.0]; allowed: a direction"),
        (ARC.replace("[8, 0, 0]", "[8, 0, 1]"), "start: allowed: a point in the plane"),
        (ARC.replace("180", "400"), "sweep: got 6.98132 rad; allowed: above 0 to 2 pi"),
        (ARC.replace("_mm = 1\n", "_mm = 9\n"), "allowed: below the radius of the arc, 0.008 m"),
        (ARC + "stiffness_n_per_m = 3\n", "stiffness_n_per_m: unknown key"),
    ],
)
def test_a_wrong_file_is_one_clear_error(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "f.toml"
    file.write_text(text)
    with pytest.raises(DescriptionError, match=re.escape(message)) as caught:
        read_fixtures(file)
    assert str(caught.value).startswith(str(file))
