"""Pedals, sounds, tools by hand, setup joints and masters."""

from __future__ import annotations

import numpy as np
import pytest

from tests.ros.asking import joints, quaternion, setpoints, state
from tests.ros.served import Served
from trocar.errors import UnknownNameError


@pytest.fixture(scope="module")
def psm() -> Served:
    return Served(wanted=())


def test_nobody_presses_anything_when_the_simulator_starts(psm):
    psm.run(0.01)
    for name in ("console/operator_present", "footpedals/coag", "console/camera"):
        assert psm.core.latched(name)["buttons"] == [0]
    assert psm.core.latched("system/volume")["data"] == 0.5
    assert psm.core.latched("PSM1/IO/adapter")["buttons"] == [1]


@pytest.mark.parametrize(
    ("topic", "shown"),
    [
        ("console/emulate_operator_present", ["console/operator_present"]),
        ("console/emulate_clutch", ["console/clutch", "footpedals/clutch"]),
        ("console/emulate_camera", ["console/camera", "footpedals/camera"]),
        ("footpedals/emulate_clutch", ["console/clutch", "footpedals/clutch"]),
        ("footpedals/emulate_camera", ["console/camera", "footpedals/camera"]),
        *(
            (f"footpedals/emulate_{pedal}", [f"footpedals/{pedal}"])
            for pedal in ("coag", "bicoag", "mono", "cam_plus", "cam_minus")
        ),
    ],
)
def test_every_pedal_can_be_pressed(psm, topic, shown):
    for button in (1, 2, 0):
        assert psm.core.receive(topic, {"axes": [], "buttons": [button]})
        psm.run(0.01)
        for name in shown:
            assert psm.last(name)["buttons"] == [button]
            assert psm.last(name)["header"]["stamp"] > (0, 0)
    assert not psm.core.receive(topic, {"buttons": [7]})


def test_one_command_presses_a_pedal(psm):
    for pressed in (True, False):
        assert psm.core.press("coag", pressed)
        psm.run(0.01)
        assert psm.last("footpedals/coag")["buttons"] == [int(pressed)]
    with pytest.raises(UnknownNameError, match="bicoag"):
        psm.core.press("gas", True)


def test_sounds_are_checked_and_told(psm):
    assert psm.core.receive("system/set_volume", {"data": 0.3})
    assert psm.core.receive("system/beep", {"data": [0.1, 440.0, 0.5]})
    assert psm.core.receive("system/string_to_speech", {"data": "hello"})
    psm.run(0.01)
    assert psm.last("system/volume")["data"] == 0.3
    said = [m["data"] for m in psm.messages("system/status")]
    assert said == ["beep: duration 0.1, frequency 440, volume 0.5", "said: hello"]
    for name, message in (
        ("set_volume", {"data": 2.0}),
        ("beep", {"data": []}),
        ("beep", {"data": [1.0, -5.0]}),
        ("string_to_speech", {"data": "x" * 1000}),
    ):
        assert not psm.core.receive(f"system/{name}", message)


def test_a_tool_comes_off_and_the_same_one_goes_on_again():
    served = Served(wanted=())
    arm = served.world.arm("PSM1")
    assert served.core.receive("PSM1/set_tool_type", {"data": "PROGRASP_FORCEPS:420093[2]"})
    served.run(0.01)
    assert arm.description.tool == "PROGRASP_FORCEPS:420093"
    assert served.last("PSM1/tool_type")["data"] == "PROGRASP_FORCEPS:420093[..13]"
    for on, tool in ((False, ""), (False, ""), (True, "PROGRASP_FORCEPS:420093")):
        assert served.core.receive("PSM1/emulate_tool_present", {"data": on})
        served.run(0.01)
        assert arm.description.tool == tool
        assert served.last("PSM1/IO/tool")["buttons"] == [int(on)]
    said = [message["data"] for message in served.messages("PSM1/status")]
    assert [text for text in said if "tool" in text] == [
        "PSM1: no tool detected",
        "PSM1: tool detected",
    ]


@pytest.mark.parametrize("name", ["SCALPEL", "/etc/passwd", "../../tool.toml"])
def test_an_unknown_tool_is_an_error_and_the_next_one_is_mounted(name):
    served = Served(wanted=())
    served.run(0.01)
    assert served.core.latched("PSM1/tool_type") == {"data": "LARGE_NEEDLE_DRIVER:400006[..]"}
    assert served.core.receive("PSM1/set_tool_type", {"data": name})
    served.run(0.01)
    assert served.core.latched("PSM1/tool_type") == {"data": "ERROR"}
    (error,) = (message["data"] for message in served.messages("PSM1/error"))
    assert error.startswith("PSM1: tool type") and "allowed: FENESTRATED" in error
    for tool in ("LARGE_NEEDLE_DRIVER:400006", "MARYLAND_BIPOLAR_FORCEPS:400172"):
        assert served.core.receive("PSM1/set_tool_type", {"data": tool})
        served.run(0.01)
        assert served.core.latched("PSM1/tool_type") == {"data": f"{tool}[..]"}


def test_without_an_adapter_no_tool_holds():
    served = Served(wanted=())
    arm = served.world.arm("PSM1")
    served.core.receive("PSM1/emulate_adapter_present", {"data": False})
    served.core.receive("PSM1/emulate_tool_present", {"data": True})
    served.run(0.01)
    assert arm.description.tool == ""
    assert "adapter" in served.last("PSM1/warning")["data"]
    assert served.last("PSM1/IO/adapter")["buttons"] == [0]
    assert not served.core.receive("PSM1/jaw/move_jp", joints(0.1))
    assert served.core.receive("PSM1/move_jp", joints(0.1, 0.0, 0.12))  # a bare arm has three
    served.core.receive("PSM1/emulate_adapter_present", {"data": True})
    served.core.receive("PSM1/emulate_tool_present", {"data": True})
    served.run(0.01)
    assert arm.description.tool == "LARGE_NEEDLE_DRIVER:400006"


def test_a_tool_that_nobody_knows_is_asked_for():
    served = Served(wanted=())
    served.core.receive("PSM1/set_tool_type", {"data": "none"})
    served.core.receive("PSM1/emulate_tool_present", {"data": True})
    served.run(0.01)
    assert served.world.arm("PSM1").description.tool == ""
    assert len(served.messages("PSM1/tool_type_request")) == 1


def test_setup_joints_move_as_in_the_dvrks_simulation_and_hold_again():
    served = Served("full_cart", wanted=())
    arm = served.world.arm("SUJ_PSM1")
    goal = arm.setpoint_js().position + 0.05
    assert served.core.receive("SUJ/PSM1/move_jp", joints(*goal))
    served.run(0.1)
    assert not any(arm.brakes.values())
    served.run(4.0)
    assert all(arm.brakes.values())
    np.testing.assert_allclose(arm.measured_js().position, goal, atol=5e-3)
    told = [m["is_busy"] for m in served.messages("SUJ/PSM1/operating_state")]
    assert True in told
    assert not told[-1]
    assert served.core.receive("SUJ/PSM1/lock_brakes", {"data": False})
    served.run(2.0)
    assert not any(arm.brakes.values())  # whoever released them locks them
    served.core.receive("SUJ/PSM1/state_command", state("disable"))
    served.core.receive("SUJ/PSM1/lock_brakes", {"data": True})
    served.core.receive("SUJ/PSM1/move_jp", joints(*(goal + 0.05)))
    served.run(0.05)
    assert all(arm.brakes.values())
    assert "enable and home it first" in served.last("SUJ/PSM1/warning")["data"]


def test_a_masters_orientation_is_locked_by_a_quaternion():
    served = Served("mtm", wanted=())
    arm = served.world.arm("MTML")
    assert not served.core.receive("MTML/lock_orientation", quaternion(w=0.0))
    assert served.core.receive("MTML/lock_orientation", quaternion())
    served.run(0.01)
    assert arm.forces.orientation_locked
    assert served.last("MTML/orientation_locked")["data"]
    assert served.core.receive("MTML/unlock_orientation", {})
    served.run(0.01)
    assert not arm.forces.orientation_locked


def test_an_endoscope_is_named():
    served = Served("ecm", wanted=())
    assert served.core.receive("ECM/set_endoscope_type", {"data": "Classic_HD_UP"})
    served.run(0.01)
    assert served.last("ECM/endoscope_type")["data"] == "Classic_HD_UP"
    assert served.core.receive("ECM/set_endoscope_type", {"data": "TELESCOPE"})
    served.run(0.01)
    assert served.last("ECM/endoscope_type")["data"] == "ERROR"
    assert "Classic_HD_UP" in served.last("ECM/error")["data"]


def test_a_base_frame_is_taken_with_its_name():
    from tests.ros.asking import pose, xyz

    served = Served(wanted=["PSM1/measured_cp"])
    before = served.world.arm("PSM1").measured_cp().matrix
    assert served.core.receive(
        "PSM1/set_base_frame", pose(xyz(1.0, 2.0, 3.0), quaternion(), "table")
    )
    served.run(0.02)
    last = served.last("PSM1/measured_cp")
    assert last["header"]["frame_id"] == "table"
    assert last["pose"]["position"]["x"] == pytest.approx(before[0, 3] + 1.0, abs=1e-6)
    assert setpoints(served).shape == (6,)
