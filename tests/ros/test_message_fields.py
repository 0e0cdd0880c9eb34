"""Values that messages carry are checked before anything is done with them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.geometry.rotations import matrix_from_quaternion
from trocar.ros import message_fields as fields
from trocar.ros.message_fields import RefusedError

NAMES = ("yaw", "pitch", "insertion")


def joints(*position, name=()):
    return {"name": list(name), "position": list(position)}


@pytest.mark.parametrize("name", [(), NAMES, ("0", "1", "2"), ("a", "b", "c"), ("yaw",)])
def test_joints_count_by_position_whatever_they_are_called(name):
    found = fields.joints(joints(1.0, 2.0, 3.0, name=name), "position", NAMES)
    np.testing.assert_array_equal(found, [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (joints(1.0, 2.0, 3.0, name=("insertion", "yaw", "pitch")), "names are ignored"),
        (joints(1.0, 2.0, 3.0, 4.0), "got 4 numbers in position; used: the first 3"),
        (joints(1.0, 2.0, 3.0, 4.0, name=("0", "1", "2", "3")), "the first 3, for yaw"),
    ],
)
def test_joints_that_contradict_or_are_too_many_are_taken_by_position(message, reason):
    with pytest.raises(fields.DoubtfulError, match=reason) as caught:
        fields.joints(message, "position", NAMES)
    found = fields.joints(caught.value.message, "position", NAMES)
    np.testing.assert_array_equal(found, [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (joints(1.0, 2.0), "got 2 numbers in position; allowed: 3, for yaw, pitch, insertion"),
        (joints(1.0, np.nan, 2.0), r"position\[1\] nan; allowed: finite"),
        (joints(1.0, 2.0, np.inf), r"position\[2\] inf; allowed: finite"),
        (joints(1.0, 2.0, 1e9), "magnitude up to 1e"),
        (joints(1.0, 2.0, "a"), "allowed: a number"),
        (joints(1.0, 2.0, True), "allowed: a number"),
        (joints(1.0, 2.0, 3.0, np.nan), r"position\[3\] nan; allowed: finite"),
        ({"position": "123"}, "allowed: a list of numbers"),
        ({"position": np.zeros((3, 3))}, "an array of shape"),
        ({"position": [0.0] * 1000}, "up to 256"),
        ({}, "position is missing"),
        (None, "position is missing"),
        ({"position": [10**6000] * 3}, "a huge number"),
    ],
)
def test_a_joint_vector_that_cannot_be_used_says_what_is_allowed(message, reason):
    with pytest.raises(RefusedError, match=reason):
        fields.joints(message, "position", NAMES)


def test_a_quaternion_of_zeros_is_refused():
    with pytest.raises(RefusedError, match="of norm 0; allowed: above 0"):
        fields.rotation({"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}, "")


@pytest.mark.parametrize("norm", [0.01, 1.01, 2.0])
def test_a_quaternion_of_another_norm_is_normalised(norm):
    R = fields.rotation({"x": 0.0, "y": 0.0, "z": 0.6 * norm, "w": 0.8 * norm}, "")
    np.testing.assert_allclose(R, matrix_from_quaternion([0.8, 0.0, 0.0, 0.6]), atol=1e-12)


@given(st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4))
def test_quaternions_are_xyzw(values):
    length = float(np.linalg.norm(values))
    if length < 1e-3:
        return
    x, y, z, w = (v / length for v in values)
    R = fields.rotation({"x": x, "y": y, "z": z, "w": w}, "")
    np.testing.assert_allclose(R, matrix_from_quaternion([w, x, y, z]), atol=1e-12)


def test_a_pose_is_metres_and_axes():
    T = fields.pose(
        {
            "pose": {
                "position": {"x": 1.0, "y": 2.0, "z": 3.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": np.sqrt(0.5), "w": np.sqrt(0.5)},
            }
        },
        "pose",
    )
    np.testing.assert_allclose(T[:3, 3], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(T[:3, :3] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("buttons", [[], [3], [-1], [True], ["1"], None, [1.0]])
def test_a_button_is_released_pressed_or_tapped(buttons):
    assert [fields.button({"buttons": [k]}) for k in (0, 1, 2)] == [0, 1, 2]
    with pytest.raises(RefusedError, match="tapped"):
        fields.button({"buttons": buttons})


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.binary(),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(
                ["position", "name", "pose", "orientation", "x", "w", "header", "stamp", "buttons"]
            ),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)


@given(anything)
def test_whatever_a_message_holds_it_is_used_or_refused(message):
    for read in (
        lambda m: fields.joints(m, "position", NAMES),
        lambda m: fields.joints_or_none(m, "position", NAMES),
        lambda m: fields.pose(m, "pose"),
        lambda m: fields.wrench(m, "pose"),
        lambda m: fields.text(m, "name"),
        lambda m: fields.flag(m, "x"),
        lambda m: fields.rotation(m, ""),
        fields.button,
        fields.stamp,
    ):
        try:
            read(message)
        except (RefusedError, fields.DoubtfulError) as problem:
            assert 0 < len(str(problem)) < 1000  # noqa: PT017  an error must not repeat a flood
