"""Joint messages are taken as the dVRK's own software takes them: by position, with a warning.

Sizes: recorded answers of that software, steps B9 to B13, E14 and E15.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.ros.asking import HOME, joints, pose, quaternion, setpoints, xyz
from tests.ros.served import Served

PSM = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
FAR = [0.1, *HOME[1:]]


def warnings(served: Served) -> list[str]:
    return [message["data"] for message in served.messages("PSM1/warning")]


def test_a_program_of_cisst_moves_the_arm_and_its_jaw_without_a_warning() -> None:
    served = Served(wanted=())
    numbers = tuple(map(str, range(6)))
    assert served.core.receive("PSM1/servo_jp", joints(*FAR, name=numbers))
    assert served.core.receive("PSM1/jaw/servo_jp", joints(0.3, name=("0",)))
    served.run()
    jaw = served.world.arm("PSM1").jaw
    assert jaw is not None
    np.testing.assert_allclose(setpoints(served), FAR)
    np.testing.assert_allclose(jaw.setpoint_js().position, 0.3)
    assert warnings(served) == []


def test_names_in_another_order_are_ignored_with_one_warning() -> None:
    served = Served(wanted=())
    for _ in range(300):
        served.core.receive("PSM1/servo_jp", joints(*FAR, name=reversed(PSM)), "/me")
        served.run(0.01)
    np.testing.assert_allclose(setpoints(served), FAR)
    (warning,) = warnings(served)
    assert "names are ignored" in warning and served.core.refused == 0


@pytest.mark.parametrize(("verb", "seconds"), [("servo_jp", 0.0), ("move_jp", 1.0)])
def test_of_seven_numbers_the_first_six_are_used(verb: str, seconds: float) -> None:
    served = Served(wanted=())
    seven = joints(*FAR, 0.3, velocity=[0.0] * 7 if verb == "servo_jp" else ())
    assert served.core.receive(f"PSM1/{verb}", seven)
    served.run(seconds + 0.01)
    np.testing.assert_allclose(setpoints(served), FAR, atol=1e-12)
    (warning,) = warnings(served)
    assert "used: the first 6" in warning


@pytest.mark.parametrize("topic", ["move_jp", "jaw/move_jp"])
@pytest.mark.parametrize("position", [(), tuple(FAR[:5])])
def test_a_move_with_too_few_numbers_goes_to_the_goal_of_the_last_move(topic, position) -> None:
    """M6 of the recorded answers of masters and ECM, B9, B11 and E14 of a PSM."""
    if topic == "jaw/move_jp" and position:
        position = ()
    served = Served(wanted=())
    assert served.core.receive("PSM1/servo_jp", joints(0.02, *HOME[1:]))
    served.run(0.02)
    busy = len(served.messages("PSM1/operating_state"))
    assert served.core.receive(f"PSM1/{topic}", joints(*position))
    served.run(0.3)
    np.testing.assert_allclose(setpoints(served), HOME, atol=1e-12)
    assert [m["data"] for m in served.messages("PSM1/goal_reached")] == [True]
    states = [m["is_busy"] for m in served.messages("PSM1/operating_state")[busy:]]
    assert states[0] and not states[-1]
    (warning,) = warnings(served)
    assert "the goal of the last move stays" in warning


def test_a_jaw_takes_the_first_of_two_numbers() -> None:
    served = Served(wanted=())
    assert served.core.receive("PSM1/jaw/move_jp", joints(0.4, 0.1))
    served.run(1.0)
    jaw = served.world.arm("PSM1").jaw
    assert jaw is not None
    np.testing.assert_allclose(jaw.setpoint_js().position, 0.4, atol=1e-12)


@pytest.mark.parametrize("norm", [0.5, 2.0])
def test_a_pose_with_a_quaternion_of_any_norm_is_followed(norm: float) -> None:
    plain, other = (Served(wanted=()) for _ in range(2))
    for served, scale in ((plain, 1.0), (other, norm)):
        turn = quaternion(x=0.6 * scale, y=0.8 * scale, w=0.0)
        assert served.core.receive("PSM1/set_base_frame", pose(xyz(0.1, 0.2, 0.3), turn, "world"))
        served.run()
    bases = [served.world.arm("PSM1").local.base_frame()[0] for served in (plain, other)]
    np.testing.assert_allclose(bases[1], bases[0], atol=1e-12)
