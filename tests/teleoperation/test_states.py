"""States of components, over the topics that clients use: what is asked, told and refused."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from trocar.live import Loop
from trocar.ros import Core
from trocar.ros.transports.memory import MemoryTransport
from trocar.simulation import World
from trocar.simulation.journal import Entry
from trocar.teleoperation import Teleoperation, component

NAME = "MTMR_PSM1"
RECORDED = Path(__file__).parents[1] / "genuine" / "recorded" / "teleoperation.json.gz"


class Served:
    """A world with its teleoperation behind a core, in the thread of the test."""

    def __init__(self) -> None:
        self.world = World("full_cart_mtm", setup_joints="locked")
        self.loop = Loop(self.world, tick_s=0.001, speed="max")
        self.engine = Teleoperation(self.loop)
        self.core = Core(self.loop, components=(component(self.engine),), clock="sim")
        self.transport = MemoryTransport([*self.names(), "system/warning"])
        self.core.attach(self.transport)
        self.core.begin()
        self.run(0.01)

    def names(self) -> list[str]:
        return [
            t for t in self.core.topics if t.startswith(("MTMR_", "MTML_", "console", "footpedals"))
        ]

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.001)):
            self.loop.tick()
        self.core.publish_waiting()

    def send(self, topic: str, **fields: object) -> bool:
        accepted = self.core.receive(topic, fields)
        self.run(0.01)
        return accepted

    def published(self, topic: str) -> list[object]:
        return [m["data"] for m in self.transport.received.get(topic, [])]

    def follow(self) -> None:
        """Enable, and let a hand pinch."""
        assert self.send(f"{NAME}/state_command", string="enable")
        self.run(1.2)
        for opening in (0.2, 1.0):
            self.send("MTMR/gripper/servo_jp", position=[opening])
            self.run(0.3)
        assert self.published(f"{NAME}/following")[-1] is True


@pytest.fixture(scope="module")
def served() -> Served:
    return Served()


def test_every_row_of_teleoperation_is_served_where_a_rig_has_masters(served: Served) -> None:
    rows = [t for name, t in served.core.topics.items() if "teleop" in name or NAME in name]
    assert len(rows) == 29
    assert not any(row.later for row in served.core.topics.values())
    for row in rows:
        if row.direction == "sub":
            assert row.read is not None


def test_arms_poses_are_also_topics_of_the_components_that_use_them(served: Served) -> None:
    pairs = {
        f"{NAME}/MTM/measured_cp": "MTMR/measured_cp",
        f"{NAME}/MTM/measured_cv": "MTMR/measured_cv",
        f"{NAME}/PSM/setpoint_cp": "PSM1/setpoint_cp",
        "MTML_MTMR_ECM/MTML/measured_cp": "MTML/measured_cp",
        "MTML_MTMR_ECM/MTMR/measured_cp": "MTMR/measured_cp",
        "MTML_MTMR_ECM/ECM/measured_cp": "ECM/setpoint_cp",  # so the dVRK names it
    }
    transport = MemoryTransport([*pairs, *pairs.values()])
    served.core.attach(transport)
    served.run(0.02)
    for ours, arms in pairs.items():
        assert transport.last(ours) == transport.last(arms)


def test_what_stands_is_told_when_it_begins(served: Served) -> None:
    assert served.published(f"{NAME}/current_state")[0] == "DISABLED"
    assert served.published(f"{NAME}/scale")[0] == 0.2
    assert served.published("console/teleop/selected")[:3] == [
        "MTMR_PSM1", "MTML_PSM2", "MTML_MTMR_ECM",
    ]  # fmt: skip
    assert served.published("console/teleop/unselected")[0] == "MTML_PSM3"
    offset = served.transport.last(f"{NAME}/alignment_offset")["quaternion"]
    assert np.linalg.norm(list(offset.values())) == pytest.approx(1.0)


def test_a_component_goes_through_its_states_and_back() -> None:
    served = Served()
    served.follow()
    assert served.published(f"{NAME}/current_state") == [
        "DISABLED", "SETTING_ARMS_STATE", "ALIGNING_MTM", "ENABLED",
    ]  # fmt: skip
    assert served.send(f"{NAME}/set_scale", data=0.5)
    assert served.published(f"{NAME}/scale")[-1] == 0.5
    assert served.send(f"{NAME}/lock_rotation", data=True)
    assert served.world.arm("MTMR").forces.orientation_locked
    assert served.send(f"{NAME}/lock_translation", data=True)
    assert served.transport.last(f"{NAME}/translation_locked")["buttons"] == [1]
    assert served.send(f"{NAME}/state_command", string="disable")
    assert served.published(f"{NAME}/following")[-1] is False
    assert served.published(f"{NAME}/current_state")[-1] == "DISABLED"


@pytest.mark.parametrize(
    ("topic", "fields", "says"),
    [
        (f"{NAME}/state_command", {"string": "fly"}, "allowed: enable, disable, align_MTM"),
        (f"{NAME}/set_scale", {"data": float("nan")}, "finite"),
        ("MTML_MTMR_ECM/state_command", {"string": "align_MTM"}, "allowed: enable, disable"),
        (f"{NAME}/lock_rotation", {"data": 3}, "true or false"),
        ("console/teleop/select", {"data": "MTMX"}, "allowed: MTMR_PSM1"),
        ("console/teleop/set_scale", {"data": float("nan")}, "finite"),
    ],
)
def test_what_cannot_be_obeyed_is_refused(
    served: Served, topic: str, fields: dict[str, object], says: str
) -> None:
    served.core.forget_refusals()
    assert not served.send(topic, **fields)
    component = topic.partition("/")[0]
    warner = "system" if component == "console" else component
    assert says in str(served.published(f"{warner}/warning")[-1])


def test_the_console_enables_what_is_selected_while_an_operator_is_there() -> None:
    served = Served()
    states = served.engine.components
    served.send("console/teleop/enable", data=True)
    assert served.published("console/teleop/enabled")[-1] is True
    assert states[NAME].desired == "ALIGNING_MTM"
    assert states["MTML_MTMR_ECM"].desired == "DISABLED"
    served.send("console/emulate_operator_present", buttons=[1])
    assert states[NAME].desired == states["MTML_PSM2"].desired == "ENABLED"
    served.send("console/emulate_camera", buttons=[1])
    assert states[NAME].desired == "DISABLED"
    assert states["MTML_MTMR_ECM"].current == "ENABLED"
    served.send("console/emulate_camera", buttons=[0])
    assert states["MTML_MTMR_ECM"].current == "DISABLED"
    served.send("console/teleop/unselect", data="MTML_PSM2")
    assert states["MTML_PSM2"].current == "DISABLED"
    assert states[NAME].desired == "ENABLED"
    served.send("console/teleop/enable", data=False)
    assert {one.current for one in states.values()} == {"DISABLED"}


def test_pedals_and_switch_publish_the_desired_states_that_were_recorded() -> None:
    """Also DISABLED once more when an operator leaves before teleoperation is switched on."""
    served = Served()
    robot = {each["step"]: each["events"] for each in json.loads(gzip.decompress(
        RECORDED.read_bytes()))["steps"]}  # fmt: skip
    present, enable = "console/emulate_operator_present", "console/teleop/enable"
    for step, topic, fields in (
        ("L3 operator away", present, {"buttons": [0]}),
        ("L4 teleop/enable", enable, {"data": True}),
        ("L5 operator present", present, {"buttons": [1]}),
        ("L18 operator leaves", present, {"buttons": [0]}),
        ("L20 operator back", present, {"buttons": [1]}),
        ("L21 teleop/disable", enable, {"data": False}),
    ):
        before = len(served.published(f"{NAME}/desired_state"))
        served.send(topic, **fields)
        found = served.published(f"{NAME}/desired_state")[before:]
        recorded = [value for _, name, value in robot[step] if name == f"/{NAME}/desired_state"]
        assert found == recorded, step


@pytest.mark.parametrize("topic", ["system/power_off", "console/power_off"])
def test_power_off_switches_teleoperation_off(topic: str) -> None:
    served = Served()
    served.send("console/teleop/enable", data=True)
    served.send(topic)
    assert served.published("console/teleop/enabled")[-1] is False
    assert served.world.arm("PSM1").operating_state().state == "DISABLED"


def test_the_camera_pedal_moves_the_endoscope_without_an_operator_too() -> None:
    served = Served()
    states = served.engine.components
    served.send("console/teleop/enable", data=True)
    served.send("console/emulate_camera", buttons=[1])
    assert states["MTML_MTMR_ECM"].desired == "ENABLED"
    assert states[NAME].desired == "DISABLED"


@pytest.mark.parametrize("word", ["align_MTM", "align_mtm"])
def test_a_master_aligns_without_moving_the_tool(word: str) -> None:
    served = Served()
    assert served.send(f"{NAME}/state_command", string=word)
    served.run(2.0)
    served.send("MTMR/gripper/servo_jp", position=[0.2])
    served.run(0.3)
    assert served.published(f"{NAME}/desired_state")[-1] == "ALIGNING_MTM"
    assert served.published(f"{NAME}/current_state")[-1] == "ALIGNING_MTM"
    assert not any(served.published(f"{NAME}/following"))


def test_a_change_of_alignment_passes_through_disabled_with_the_hand_remembered() -> None:
    """As recorded of sawIntuitiveResearchKit 9e535e6: also for lock_rotation false."""
    served = Served()
    served.follow()
    for topic, on in (("set_align_MTM", False), ("set_align_MTM", True), ("lock_rotation", False)):
        before = len(served.published(f"{NAME}/current_state"))
        served.send(f"{NAME}/{topic}", data=on)
        served.run(1.5)
        assert served.published(f"{NAME}/current_state")[before:] == [
            "DISABLED", "SETTING_ARMS_STATE", "ALIGNING_MTM", "ENABLED",
        ]  # fmt: skip
        assert served.published(f"{NAME}/following")[-2:] == [False, True]


def test_status_tells_of_each_change_of_state() -> None:
    served = Served()
    served.send(f"{NAME}/state_command", string="enable")
    assert served.published(f"{NAME}/status")[:2] == [
        f"{NAME}: set desired state to ENABLED", f"{NAME}: current state is SETTING_ARMS_STATE",
    ]  # fmt: skip


def test_a_wrench_acts_on_the_hand_while_the_tool_follows_and_no_longer() -> None:
    served = Served()
    exerted: list[list[float]] = []

    def hear(entry: Entry) -> None:
        if entry.source == "MTMR" and entry.name == "servo_cf":
            exerted.append(np.asarray(entry.values["wrench"]).tolist())

    served.world.listen(hear)
    topic = f"{NAME}/following/mtm/body/servo_cf"
    push = {"force": {"x": 0.1, "y": 0.0, "z": -0.2}, "torque": {"x": 0.0, "y": 0.01, "z": 0.0}}
    wrench = [0.1, 0.0, -0.2, 0.0, 0.01, 0.0]
    assert served.send(topic, wrench=push)
    served.follow()
    assert wrench not in exerted  # nothing followed when it came
    assert served.send(topic, wrench=push)
    assert exerted[-5:] == [wrench] * 5  # in each tick
    served.send("console/emulate_clutch", buttons=[1])
    assert exerted[-1] == [0.0] * 6
    served.send("console/emulate_clutch", buttons=[0])
    served.run(1.5)
    assert served.published(f"{NAME}/following")[-1] is True
    assert exerted[-1] == [0.0] * 6


def test_an_arm_that_fails_disables_teleoperation_and_it_is_said() -> None:
    served = Served()
    served.follow()
    commanded = served.published(f"{NAME}/desired_state")
    before = served.world.arm("PSM1").joints.setpoints()
    served.send("MTMR/state_command", string="disable")
    assert served.published(f"{NAME}/current_state")[-1] == "DISABLED"
    assert "MTMR is not in state" in str(served.published(f"{NAME}/error")[-1])
    assert served.published(f"{NAME}/desired_state") == commanded  # it was no command
    served.run(0.1)
    np.testing.assert_allclose(served.world.arm("PSM1").joints.setpoints(), before, atol=1e-3)


def test_arms_without_power_are_enabled_and_homed_first() -> None:
    served = Served()
    served.send("PSM1/state_command", string="disable")
    assert served.send(f"{NAME}/state_command", string="enable")
    assert served.published(f"{NAME}/current_state")[-1] in ("SETTING_ARMS_STATE", "ALIGNING_MTM")
    served.run(3.0)
    assert served.published(f"{NAME}/current_state")[-1] == "ALIGNING_MTM"


def test_a_reset_begins_anew() -> None:
    served = Served()
    served.follow()
    served.send("scene/reset")
    assert served.published(f"{NAME}/following")[-1] is False
    served.run(1.5)
    assert served.published(f"{NAME}/current_state")[-1] == "ALIGNING_MTM"  # until a hand is there


def test_pedals_of_the_page_are_published_and_act() -> None:
    served = Served()
    pedals = served.engine.pedals
    assert pedals.names[:4] == ["clutch", "camera", "coag", "bicoag"]
    for name in pedals.names:
        pedals.press(name, True)
        served.run(0.01)
        assert name in pedals.pressed
        topic = "console/" if name == "operator_present" else "footpedals/"
        assert served.transport.last(topic + name)["buttons"] == [1]
    console = served.engine.console
    assert console.present and console.camera
    assert served.engine.components[NAME].clutched
    served.send("console/emulate_clutch", buttons=[0])
    assert "clutch" not in pedals.pressed and not served.engine.components[NAME].clutched
