"""How short the way is from a set-point to the input of its servo, and back to a measurement."""

from __future__ import annotations

import numpy as np
import pytest

from tests.calls import calls_of
from trocar.simulation import World

#: Source: our own choice, what a reader follows without losing the thread.
MOST_CALLS, MOST_FILES = 12, 6


@pytest.mark.parametrize("rig", ["psm", "full_cart"])
@pytest.mark.parametrize("verb", ["servo_jp", "measured_js"])
def test_a_set_point_and_a_measurement_take_few_calls(rig: str, verb: str) -> None:
    arm = World(rig).arm("PSM1")
    q = np.array([0.1, 0.1, 0.13, 0.1, 0.1, 0.1])
    actions = {"servo_jp": lambda: arm.servo_jp(q), "measured_js": arm.measured_js}
    actions[verb]()  # the first one reports the operating state, and fills buffers
    calls = calls_of(actions[verb])
    assert len(calls) <= MOST_CALLS, calls
    assert len({call.file for call in calls}) <= MOST_FILES, calls


def test_a_set_point_is_the_input_of_its_servo() -> None:
    world = World("psm")
    arm = world.arm("PSM1")
    q = np.array([0.1, 0.1, 0.13, 0.1, 0.1, 0.1])
    arm.servo_jp(q)
    np.testing.assert_array_equal(world.mj_data.ctrl[0:18:3], q)
