"""Our frames keep the laws of frames, agree with `geometry`, and behave as PyKDL's do."""

from __future__ import annotations

import math

import numpy as np
import pytest

from trocar.geometry.rotations import matrix_from_quaternion, matrix_from_rpy
from trocar.scripts.kdl import (
    Equal,
    KdlFrame,
    KdlTwist,
    KdlWrench,
    Rotation,
    Vector,
    addDelta,
    diff,
    dot,
)

RNG = np.random.default_rng(5)


def numbers(rotation: Rotation) -> np.ndarray:
    return np.array([[rotation[i, j] for j in range(3)] for i in range(3)])


def some_frame() -> KdlFrame:
    q = RNG.normal(size=4)
    return KdlFrame(Rotation.Quaternion(*(q / np.linalg.norm(q))), Vector(*RNG.normal(size=3)))


def test_products_and_inverses_keep_the_laws_of_a_group():
    for _ in range(20):
        a, b, c, v = some_frame(), some_frame(), some_frame(), Vector(*RNG.normal(size=3))
        assert Equal((a * b) * c, a * (b * c), 1e-12)
        assert Equal(a * a.Inverse(), KdlFrame.Identity(), 1e-12)
        assert Equal((a * b) * v, a * (b * v), 1e-12)
        assert Equal(a.M.Inverse(a.M * v), v, 1e-12)
        assert Equal((a * b).Inverse(), b.Inverse() * a.Inverse(), 1e-12)


def test_rotations_agree_with_those_of_geometry():
    for _ in range(20):
        q = RNG.normal(size=4)
        q /= np.linalg.norm(q)
        turned = Rotation.Quaternion(*q)
        assert np.allclose(numbers(turned), matrix_from_quaternion(np.roll(q, 1)))
        assert np.isclose(abs(np.dot(turned.GetQuaternion(), q)), 1.0)
        roll, pitch, yaw = RNG.uniform(-1.5, 1.5, 3)
        rpy = Rotation.RPY(roll, pitch, yaw)
        assert np.allclose(numbers(rpy), matrix_from_rpy(roll, pitch, yaw))
        assert np.allclose(rpy.GetRPY(), (roll, pitch, yaw))
        assert Equal(rpy, Rotation.EulerZYX(yaw, pitch, roll), 1e-12)
        assert np.allclose(rpy.GetEulerZYX(), (yaw, pitch, roll))


def test_a_rotation_about_an_axis_is_told_again():
    axis = Vector(1.0, -2.0, 2.0)
    turned = Rotation.Rot(axis, 0.7)
    angle, found = turned.GetRotAngle()
    assert angle == pytest.approx(0.7)
    assert Equal(found, axis / 3.0, 1e-12)
    assert Equal(turned.GetRot(), axis * (0.7 / 3.0), 1e-12)
    assert Rotation().GetRotAngle() == (0.0, Vector(0.0, 0.0, 1.0))


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
def test_turning_about_its_own_axis_multiplies_from_the_right(axis: str):
    start = some_frame().M
    turned = Rotation(start)
    getattr(turned, f"DoRot{axis}")(math.pi / 5)
    assert Equal(turned, start * getattr(Rotation, f"Rot{axis}")(math.pi / 5), 1e-12)
    assert not Equal(turned, start)
    assert Equal(getattr(turned, f"Unit{axis}")(), getattr(start, f"Unit{axis}")(), 1e-12)


def test_what_is_assigned_is_copied_and_what_is_read_is_not():
    start, goal = some_frame(), KdlFrame()
    goal.p, goal.M = start.p, start.M
    before = Vector(start.p)
    goal.p[0] += 1.0
    goal.M.DoRotX(0.3)
    assert start.p == before
    assert goal.p[0] == pytest.approx(before[0] + 1.0)
    assert not Equal(goal.M, start.M)
    copy = KdlFrame(start)
    copy.p.x(9.0)
    assert start.p == before


def test_vectors_add_scale_and_multiply():
    a, b = Vector(1.0, 2.0, 3.0), Vector(-1.0, 0.5, 2.0)
    assert list(a + b) == [0.0, 2.5, 5.0]
    assert list(a - b) == [2.0, 1.5, 1.0]
    assert list(2.0 * a) == list(a * 2.0) == [2.0, 4.0, 6.0]
    assert list(a / 2.0) == [0.5, 1.0, 1.5]
    assert list(-a) == [-1.0, -2.0, -3.0]
    assert dot(a, b) == 6.0
    assert dot(a * b, a) == dot(a * b, b) == 0.0
    assert (a.x(), a.y(), a.z(), len(a)) == (1.0, 2.0, 3.0, 3)
    assert Vector(3.0, 0.0, 4.0).Norm() == 5.0
    unit = Vector(3.0, 0.0, 4.0)
    assert unit.Normalize() == 5.0
    assert list(unit) == [0.6, 0.0, 0.8]


def test_entries_are_found_by_row_and_column():
    frame = KdlFrame(Rotation.RotZ(0.1), Vector(4.0, 5.0, 6.0))
    assert [frame[i, 3] for i in range(3)] == [4.0, 5.0, 6.0]
    assert frame[1, 0] == frame.M[1, 0] == pytest.approx(math.sin(0.1))
    frame.M[0, 0] = 0.5
    assert frame.M[0, 0] == 0.5


def test_what_is_no_frame_is_refused():
    with pytest.raises(TypeError, match="allowed: a Rotation, a Vector"):
        KdlFrame(3.0)
    with pytest.raises(TypeError, match="allowed: none, 9, or 3 vectors"):
        Rotation(1.0, 2.0)


def test_what_leads_from_one_to_another_leads_there():
    for _ in range(20):
        a, b = some_frame(), some_frame()
        assert Equal(addDelta(a, diff(a, b)), b, 1e-9)
        assert Equal(addDelta(a, diff(a, b, 0.1), 0.1), b, 1e-9)
        assert Equal(addDelta(a.M, diff(a.M, b.M)), b.M, 1e-9)
        assert Equal(addDelta(a.p, diff(a.p, b.p)), b.p, 1e-12)
        assert Equal(diff(a, a), KdlTwist(), 1e-12)


def test_power_is_the_same_in_every_frame_and_at_every_point():
    def two() -> tuple[Vector, Vector]:
        return Vector(*RNG.normal(size=3)), Vector(*RNG.normal(size=3))

    for _ in range(20):
        T, twist, wrench = some_frame(), KdlTwist(*two()), KdlWrench(*two())
        power, point = dot(twist, wrench), Vector(*RNG.normal(size=3))
        assert dot(T * twist, T * wrench) == pytest.approx(power)
        assert dot(T.M * twist, T.M * wrench) == pytest.approx(power)
        assert dot(twist.RefPoint(point), wrench.RefPoint(point)) == pytest.approx(power)
        assert Equal(twist + -twist, KdlTwist.Zero(), 1e-12)
        assert Equal(2.0 * twist - twist / 0.5, KdlTwist(), 1e-12)
    twist = KdlTwist()
    twist.vel = Vector(1.0, 2.0, 3.0)
    twist[5] = 9.0
    assert [twist[k] for k in (0, 2, 5)] == [1.0, 3.0, 9.0]
    with pytest.raises(TypeError, match="two Vectors"):
        KdlTwist(1.0)


def test_a_twist_integrated_over_small_periods_is_a_screw():
    twist = KdlTwist(Vector(0.0, 0.0, 0.02), Vector(0.0, 0.0, 0.5))
    frame = KdlFrame(Rotation.RotX(0.3), Vector(1.0, 0.0, 0.0))
    begun = KdlFrame(frame)
    for _ in range(100):
        frame.Integrate(twist, 50.0)
    assert Equal(frame, begun * KdlFrame(Rotation.RotZ(1.0), Vector(0.0, 0.0, 0.04)), 1e-9)


def test_links_by_dh_and_euler_angles_come_back():
    for _ in range(20):
        a, alpha, d, theta = RNG.normal(size=4)
        standard = KdlFrame(Rotation.RotZ(theta), Vector(0, 0, d)) * KdlFrame(
            Rotation.RotX(alpha), Vector(a, 0, 0)
        )
        assert Equal(KdlFrame.DH(a, alpha, d, theta), standard, 1e-12)
        modified = KdlFrame(Rotation.RotX(alpha), Vector(a, 0, 0)) * KdlFrame(
            Rotation.RotZ(theta), Vector(0, 0, d)
        )
        assert Equal(KdlFrame.DH_Craig1989(a, alpha, d, theta), modified, 1e-12)
        turned = some_frame().M
        assert Equal(Rotation.EulerZYZ(*turned.GetEulerZYZ()), turned, 1e-9)
    for beta in (0.0, math.pi):
        turned = Rotation.EulerZYZ(0.4, beta, 0.3)
        assert Equal(Rotation.EulerZYZ(*turned.GetEulerZYZ()), turned, 1e-9)
