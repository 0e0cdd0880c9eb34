import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import UnknownNameError
from trocar.kinematics.forward import poses

pytest.importorskip("build123d", reason="solids need the extra cad")

from build123d import GeomType
from build123d.topology import Shape

from tools.cad import kit

OWN = kit.Hinge(np.zeros(3), np.array([0.0, 0.0, 1.0]))
FAR = kit.Hinge(np.array([150.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
LEANING = kit.Hinge(np.array([1.0, 2.0, 3.0]), np.array([0.6, 0.0, 0.8]))


def volume(shape: Shape) -> float:
    return sum(solid.volume for solid in shape.solids())


def sound(shape: Shape) -> bool:
    return shape.is_valid and volume(shape) > 0.0


@pytest.mark.parametrize(
    ("link", "name"),
    [
        ("yaw", "pitch_back"),
        ("yaw", "pitch_front"),
        ("pitch_back", "pitch_bottom"),
        ("pitch_back", "counterweight"),
        ("pitch_bottom", "c1"),
        ("pitch_front", "c1"),
        ("pitch_end", "c2"),
        ("pitch_end", "insertion"),
    ],
)
def test_a_hinge_lies_where_the_kinematics_put_it(link, name):
    mechanism = load_arm("psm").mechanism
    at = kit.hinge(mechanism, link, name)
    expected = poses(mechanism, np.zeros(len(mechanism.joints)), link)[name]
    np.testing.assert_allclose(at.point, 1000.0 * expected[:3, 3], atol=1e-6)
    np.testing.assert_allclose(at.direction, expected[:3, 2], atol=1e-9)


def test_a_hinge_beyond_another_joint_is_refused():
    with pytest.raises(UnknownNameError, match="pitch_end"):
        kit.hinge(load_arm("psm").mechanism, "pitch_back", "pitch_end")


@pytest.mark.parametrize("make", [kit.pin, kit.cap])
def test_pins_and_caps_turn_about_a_leaning_axis(make):
    shape = make(LEANING, 5.0, 9.0, 12.0)
    assert sound(shape)
    rounds = shape.faces().filter_by(GeomType.CYLINDER)
    assert rounds
    for face in rounds:
        axis = face.axis_of_rotation
        direction = np.array(tuple(axis.direction))
        offset = np.array(tuple(axis.position)) - LEANING.point
        np.testing.assert_allclose(np.cross(direction, LEANING.direction), 0.0, atol=1e-9)
        np.testing.assert_allclose(np.cross(offset, LEANING.direction), 0.0, atol=1e-6)


def test_a_cap_looks_the_way_it_is_told():
    low = kit.cap(OWN, -10.0, -16.0, 15.0).bounding_box().min.Z
    assert low == pytest.approx(-16.0, abs=1e-4)


def test_a_plate_between_two_hinges_has_the_volume_of_its_belt():
    """Two half discs and the trapezoid between the tangent points, for equal radii."""
    shape = kit.plate(kit.outline([OWN.disc(10.0), FAR.disc(10.0)]), 2.0, 7.0)
    assert volume(shape) == pytest.approx(5.0 * (np.pi * 100.0 + 20.0 * 150.0))


@pytest.mark.parametrize(
    "shape",
    [
        kit.plate(kit.outline([OWN.disc(20.0), FAR.disc(14.0)]), 0.0, 10.0, 3.0, round_off=True),
        kit.mirrored(kit.plate(kit.polygon([(0, 0), (50, 0), (40, 30)], 4.0), 3.0, 10.0, 1.0)),
        kit.rounded_box((1, 2, 3), (40, 50, 60), 8.0),
        kit.lofted([(0, 0, 0, 20, 30, 5), (100, 2, 0, 26, 34, 7), (300, 0, 0, 20, 30, 5)]),
        kit.turning(OWN, [(0, 0), (20, 0), (20, 30), (0, 40)], 3.0),
        kit.tube(OWN, 0.0, 10.0, 5.0, 4.0),
    ],
    ids=["plate", "pair", "box", "loft", "lathe", "tube"],
)
def test_what_the_kit_makes_is_solid(shape):
    assert sound(shape)
