"""What publishing computes, and what a new subscriber gets."""

from __future__ import annotations

import sys
from collections import Counter

import pytest

from tests.ros.served import Served
from trocar.errors import InputError


def calls(served: Served, *topics: str) -> Counter[str]:
    """Return how often each function is called, by its name, to publish one sample."""
    served.transport.want(*topics)
    served.run()
    served.loop.tick()
    found: Counter[str] = Counter()

    def count(frame, event: str, argument) -> None:
        if event in ("call", "c_call"):
            found[frame.f_code.co_name if event == "call" else argument.__name__] += 1

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        assert served.core.publish_waiting() == 1
    finally:
        sys.setprofile(before)
    return found


def test_frames_and_jacobians_are_computed_once_for_all_topics() -> None:
    served = Served("full_cart", rate_hz=1000.0)
    made = calls(served, *served.core.topics)
    assert (made["mj_jac"], made["mj_kinematics"]) == (4, 2)  # an arm; measured and at set-points
    assert not made["jacobian_body"] and not made["jacobian_spatial"]


def test_a_calibrated_arm_computes_its_jacobian_once_for_all_topics(skew_overlay, rng) -> None:
    served = Served("psm", world={"calibration": skew_overlay("psm", rng)}, rate_hz=1000.0)
    assert calls(served, *served.core.topics)["jacobian_spatial"] == 1


@pytest.mark.parametrize(
    ("topic", "computed"),
    [
        ("PSM1/measured_js", (0, 0)),
        ("PSM1/measured_cp", (0, 1)),
        ("PSM1/setpoint_cp", (0, 2)),  # the frames of poses are the measured ones
        ("PSM1/body/jacobian", (4, 1)),
    ],
)
def test_what_has_no_subscriber_is_not_computed(topic: str, computed: tuple[int, int]) -> None:
    made = calls(Served("full_cart", rate_hz=1000.0), topic)
    assert (made["mj_jac"], made["mj_kinematics"]) == computed


def test_a_message_that_cannot_be_made_ends_no_other(caplog) -> None:
    served = Served("psm", wanted=("PSM1/measured_js", "PSM1/measured_cp"))
    topic = served.core.topics["PSM1/measured_cp"]

    def fails(*_):
        raise InputError("no pose today")

    object.__setattr__(topic, "make", fails)
    served.run(0.05)
    assert served.messages("PSM1/measured_js")
    assert not served.messages("PSM1/measured_cp")
    assert caplog.text.count("cannot publish PSM1/measured_cp: no pose today") == 1


@pytest.mark.parametrize("name", ["PSM1/measured_js", "PSM1/measured_cp", "tf", "scene/time"])
def test_a_new_subscriber_gets_a_message_at_once(name: str) -> None:
    served = Served(wanted=())
    served.run(0.05)
    first = served.core.latched(name)
    assert first is not None
    served.transport.want(name)
    served.run(0.05)
    assert served.last(name).keys() == first.keys()
