"""The core on a transport in memory: what goes out, what is refused, what is computed at all."""

from __future__ import annotations

import gc

import numpy as np
import pytest

from tests.ros.served import Served, stamp_ns
from trocar.errors import InputError, UnknownNameError
from trocar.simulation.rate_limit import BURST


def test_only_what_is_wanted_is_computed_and_every_event_is_sent() -> None:
    served = Served(wanted=["PSM1/measured_js"])
    served.run(0.05)
    states = {
        n for n, m in served.transport.received.items() if served.core.topics[n].rate == "state"
    }
    assert states == {"PSM1/measured_js"}
    assert served.messages("PSM1/operating_state")


def test_states_come_at_their_rate_and_carry_one_stamp() -> None:
    served = Served(wanted=["PSM1/measured_js", "PSM1/measured_cp"])
    served.run(1.0)
    joints, poses = served.messages("PSM1/measured_js"), served.messages("PSM1/measured_cp")
    assert len(joints) == len(poses) == 221  # from the first tick to 1 s, both included
    assert [stamp_ns(m) for m in joints] == [stamp_ns(m) for m in poses]


def test_a_command_moves_the_arm() -> None:
    served = Served(wanted=["PSM1/setpoint_js"])
    goal = [0.1, 0.1, 0.12, 0.0, 0.0, 0.0]
    assert served.core.receive("PSM1/move_jp", {"position": goal})
    served.run(3.0)
    np.testing.assert_allclose(served.last("PSM1/setpoint_js")["position"], goal, atol=1e-9)


@pytest.mark.parametrize("name", ["PSM1/measured_js", "PSM9/servo_jp", "", "console/teleop/enable"])
def test_what_the_simulator_does_not_listen_to_is_refused_and_told(name: str) -> None:
    served = Served()
    assert not served.core.receive(name, {"data": 1})
    served.run(0.01)
    warnings = served.messages("PSM1/warning") + served.messages("system/warning")
    assert len(warnings) == 1
    assert "does not subscribe" in warnings[0]["data"]


def test_a_flood_of_refusals_is_counted_and_its_first_ones_are_reported() -> None:
    served = Served()
    for _ in range(1000):
        served.core.receive("PSM1/measured_js", {})
    served.run(0.1)
    assert served.core.refused == 1000
    assert len(served.messages("PSM1/warning")) == BURST


def test_a_service_that_is_none_is_refused() -> None:
    with pytest.raises(UnknownNameError):
        Served().core.call("PSM1/nothing", {})


@pytest.mark.parametrize("rate", [0.0, -1.0, 2000.0, float("nan")])
def test_a_rate_out_of_range_is_refused(rate: float) -> None:
    with pytest.raises(InputError, match="allowed: above 0 to 1000 Hz"):
        Served(rate_hz=rate)


def test_publishing_leaves_nothing_that_has_to_be_searched_for_garbage() -> None:
    """A search takes as long as ten periods of messages."""
    served = Served("full_cart_mtm")
    served.run(0.05)
    gc.collect()
    gc.disable()
    try:
        served.run(0.05)
        assert gc.collect() == 0
    finally:
        gc.enable()
