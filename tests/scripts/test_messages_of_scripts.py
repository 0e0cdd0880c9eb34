"""Messages and times as scripts have them: rospy's behaviour, and the core's dicts behind."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from trocar.messages import blank, cdr_encode, message_names, service_names
from trocar.scripts.messages import (
    Duration,
    Rate,
    Time,
    fields_of,
    message_class,
    message_of,
    service_class,
)
from trocar.scripts.modules import message_modules


def test_every_message_becomes_fields_and_comes_back():
    for name in message_names():
        kind = message_class(name)
        fields = fields_of(kind())
        assert cdr_encode(name, fields)
        assert fields_of(message_of(kind, fields)) == fields
        assert message_of(kind, blank(name)) == kind()
        assert repr(kind()) == repr(message_of(kind, fields))


def test_every_service_has_its_two_messages():
    modules = message_modules()
    for name in service_names():
        package, own = name.split("/")
        kind, made = service_class(name), vars(modules[f"{package}.srv"])
        assert made[own] is kind
        assert (made[f"{own}Request"], made[f"{own}Response"]) == (kind.Request, kind.Response)
        assert fields_of(kind.Response()) is not None


def test_fields_are_given_in_order_or_by_name_and_no_other():
    point: Any = message_class("geometry_msgs/Point")
    assert point(1.0, 2.0, 3.0) == point(z=3.0, x=1.0, y=2.0)
    assert point(y=2.0).x == 0.0
    with pytest.raises(TypeError, match="got 2 values; allowed: one for each of x, y, z"):
        point(1.0, 2.0)
    with pytest.raises(AttributeError, match="has no field 'w'; known: x, y, z"):
        point(w=1.0)
    with pytest.raises(AttributeError):
        point().w = 1.0


def test_arrays_and_stamps_are_those_of_ros():
    kind: Any = message_class("sensor_msgs/JointState")
    message = kind(position=np.array([1.0, 2.0]))
    message.header.stamp = Time(3, 4)
    fields = fields_of(message)
    assert fields["position"] == [1.0, 2.0]
    assert fields["header"]["stamp"] == (3, 4)
    found = message_of(kind, {**fields, "position": np.array([5.0])})
    assert found.position == [5.0]
    assert (found.header.stamp.secs, found.header.stamp.nanosec) == (3, 4)
    assert kind().position is not kind().position


def test_times_and_durations_keep_to_rospys_arithmetic():
    moment = Time(10, 500_000_000)
    assert moment.to_sec() == 10.5
    assert moment - Time(10) == Duration(0.5)
    assert moment + Duration(1.5) == Time(12)
    assert moment - Duration(0.5) == Time(10)
    assert Time(1) < Time(1, 1) <= Time(1, 1)
    assert Duration(0.5) + Duration(0.25) == Duration(0.75)
    assert 2 * Duration(0.5) == -Duration(-1.0) == abs(Duration(-1.0))
    assert Duration(3.0) / Duration(1.5) == 2.0
    assert not Time()
    assert Time().is_zero()
    assert Time(1) != Duration(1)
    with pytest.raises(TypeError):
        _ = Time(1) < Duration(1)
    with pytest.raises(TypeError):
        _ = Time(1) + Time(1)
    moment.secs = 7
    moment.nsecs = 1
    assert moment.to_nsec() == 7_000_000_001
    assert Time.from_sec(1.25) == Time(1, 250_000_000)


def test_a_rate_catches_up_a_late_turn_and_lets_old_ones_go():
    now, slept = [0], []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now[0] += round(1e9 * seconds)

    rate = Rate(10.0, lambda: now[0], sleep)
    rate.sleep()
    now[0] += 130_000_000  # late
    rate.sleep()
    rate.sleep()
    assert np.allclose(slept, [0.1, 0.07])
    assert now[0] == 300_000_000
    now[0] += 1_000_000_000  # much too late: from here on
    rate.sleep()
    assert rate.remaining() == Duration(0.1)
    with pytest.raises(ValueError, match="above 0 Hz"):
        Rate(0.0, lambda: 0, sleep)
