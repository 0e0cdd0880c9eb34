"""Objects, contacts, sensors and time as topics: what is told, and what is obeyed."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from tests.ros.served import Served, stamp_ns
from trocar.descriptions import load_rig
from trocar.descriptions.sensor_records import Physics, SensorReading, Values
from trocar.descriptions.sensors import KINDS, PlacedSensor
from trocar.messages import message_type, ros1_encode
from trocar.ros.core import topic_table
from trocar.simulation import EffortReading, TwistReading

PROPS = Path(__file__).parents[2] / "examples" / "props"
SENSORS = """
[[sensor]]
name = "motor"
kind = "joint_effort"
arm = "PSM1"
joint = "insertion"

[[sensor]]
name = "tip"
kind = "tip_wrench"
arm = "PSM1"

[[sensor]]
name = "touch"
kind = "contacts"

[[sensor]]
name = "between"
kind = "proximity"
arm = "PSM1"
xyz_mm = [0, -8, 0]

[[sensor]]
name = "imu 1"
kind = "imu"
arm = "PSM1"
frame = "insertion"
rate_hz = 50.0
noise_rad_s = 0.01
noise_m_s2 = 0.1

[[sensor]]
name = "speed"
kind = "twist"
arm = "PSM1"
frame = "tip"
"""


def point(message: dict) -> list[float]:
    return [message[axis] for axis in "xyz"]


def pose_message(at: tuple[float, float, float], frame: str = "") -> dict:
    return {
        "header": {"stamp": (0, 0), "frame_id": frame},
        "pose": {
            "position": dict(zip("xyz", at, strict=True)),
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8},
        },
    }


def test_every_message_of_a_scene_can_be_written(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(Path(load_rig("pegs").file).read_text(encoding="utf-8") + SENSORS)
    served = Served(str(file))
    served.run(0.05)
    rows = [t for t in topic_table(served.world.rig) if t.name.startswith(("scene/", "sensors/"))]
    told = [t for t in rows if t.direction == "pub"]
    assert {t.name for t in told if t.name.startswith("sensors/")} == {
        "sensors/motor", "sensors/tip", "sensors/touch", "sensors/between", "sensors/imu_1",
        "sensors/speed",
    }  # fmt: skip
    assert {sensor.kind for sensor in served.world.rig.sensors} == set(KINDS) - {"tension"}
    for topic in told:
        assert ros1_encode(message_type(topic.type), served.last(topic.name)) is not None, topic


def test_objects_are_told_where_the_world_has_them() -> None:
    served = Served("pegs")
    aloft = served.world.object("ring1").measured_cp().matrix.copy()
    aloft[2, 3] += 0.1
    served.world.object("ring1").set_cp(aloft)
    served.run(0.05)
    told, speed = (served.last(f"scene/ring1/measured_{what}") for what in ("cp", "cv"))
    assert told["header"] == speed["header"] and told["header"]["frame_id"] == "world"
    assert told["header"]["stamp"] == served.last("PSM1/measured_js")["header"]["stamp"]
    at = served.world.object("ring1").measured_cp().matrix
    assert np.allclose(point(told["pose"]["position"]), at[:3, 3], atol=2e-3)
    fall = -9.81 * served.world.time
    assert np.allclose(point(speed["twist"]["linear"]), [0.0, 0.0, fall], atol=0.02)
    frames = {t["child_frame_id"] for t in served.last("tf")["transforms"]}
    assert {"ring1", "block3"} <= frames


def test_contacts_carry_the_weight_of_what_lies_there() -> None:
    served = Served("pegs")
    served.run(0.1)
    load = np.zeros(3)
    for contact in served.last("scene/contacts")["contacts"]:
        assert {contact["first"], contact["second"]} - {"board"}
        sign = 1.0 if contact["second"] == "board" else -1.0
        load += sign * np.array(point(contact["force"]))
    weight = 9.81 * sum(one.mass for one in served.world.objects.values())
    assert np.allclose(load, [0.0, 0.0, -weight], atol=1e-5)


def test_contacts_and_sensors_cost_nothing_while_nobody_asks(monkeypatch) -> None:
    served = Served("pegs", wanted=["scene/ring1/measured_cp"])
    monkeypatch.setattr(served.world, "contact_table", lambda: pytest.fail("was looked at"))
    served.run(0.05)
    assert len(served.messages("scene/ring1/measured_cp")) > 5


def test_an_object_is_put_where_a_message_says() -> None:
    served = Served("pegs")
    assert served.core.receive("scene/ring2/set_cp", pose_message((0.07, 0.08, 0.3), "world"))
    served.run(0.001)
    at = served.world.object("ring2").measured_cp().matrix
    assert np.allclose(at[:3, 3], [0.07, 0.08, 0.3], atol=1e-4)  # it falls since
    assert np.allclose(at[:2, 0], [0.28, 0.96], atol=1e-12)


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        (pose_message((0.0, 0.0, 0.3), "ECM"), "got the frame 'ECM'; allowed: world, or none"),
        (pose_message((0.0, float("nan"), 0.3)), "pose.position.y"),
        ({"pose": pose_message((0.0, 0.0, 0.0))["pose"]}, "header"),
        (pose_message((0.0, 5e3, 0.3)), "allowed: up to 1000 m away"),
    ],
)
def test_a_pose_that_is_none_is_refused_with_a_warning(message: dict, problem: str) -> None:
    served = Served("pegs")
    before = served.world.object("ring1").measured_cp().matrix
    served.core.receive("scene/ring1/set_cp", message)
    served.run(0.006)
    assert np.allclose(
        served.world.object("ring1").measured_cp().matrix, before, atol=2e-5
    )  # it settles
    assert any(problem in m["data"] for m in served.messages("system/warning"))


def test_forces_joints_tensions_and_scripts_of_props_are_topics(tmp_path: Path) -> None:
    folder = tmp_path / "props"
    shutil.copytree(PROPS, folder)
    (folder / "shake.py").write_text("def before_step(slider, world):\n    world.nothing()\n")
    served = Served(str(folder / "play.toml"))
    served.run(0.05)
    assert "line 2: AttributeError" in served.last("scene/slider/error")["data"]
    joint = served.world.object("pendulum").measured_js()
    told = served.last("scene/pendulum/measured_js")
    assert told["name"] == ["pendulum"]
    assert told["position"][0] == pytest.approx(joint.position[0], abs=0.05)
    pull = served.last("sensors/pull")
    assert pull["name"] == ["rubber"] and pull["effort"][0] > 0.0
    force = {"force": {"x": 0.5, "y": 0.0, "z": 0.0}, "torque": dict.fromkeys("xyz", 0.0)}
    header = {"stamp": (0, 0), "frame_id": ""}
    wrench = {"header": header, "wrench": force}
    assert served.core.receive("scene/weight/servo_cf", wrench)
    put = {"header": header, "name": [], "position": [-1.0], "velocity": [], "effort": []}
    assert served.core.receive("scene/pendulum/set_jp", put)
    served.run(0.02)
    assert served.world.object("weight").measured_cv().linear[0] > 0.01
    assert served.last("scene/pendulum/measured_js")["position"][0] == pytest.approx(-1.0, abs=0.1)
    names = {topic.name for topic in topic_table(served.world.rig)}
    assert "scene/pendulum/set_cp" not in names and "scene/ball1/set_cp" in names


def test_time_stands_still_steps_and_flows_again() -> None:
    served = Served("pegs", clock="sim")
    served.run(0.01)
    assert served.last("scene/paused") == {"data": False}
    assert served.core.receive("scene/pause", {})
    served.run(0.02)
    time, stamp = served.world.time, stamp_ns(served.last("PSM1/measured_js"))
    assert served.last("scene/paused") == {"data": True}
    for periods in (1, 1, 7, 100):
        before = len(served.messages("scene/time"))
        assert served.core.receive("scene/step", {"data": periods})
        served.run(0.001)
        time += 0.001 * periods
        assert served.world.time == pytest.approx(time, abs=1e-9)
        assert len(served.messages("scene/time")) == before + 1  # at once, whatever the rate
        assert served.last("scene/time")["data"] == pytest.approx(time, abs=1e-9)
        later = stamp_ns(served.last("PSM1/measured_js"))
        assert later - stamp == pytest.approx(1_000_000 * periods, abs=1000)
        stamp = later
    assert served.core.receive("scene/resume", {})
    served.run(0.01)
    assert served.world.time == pytest.approx(time + 0.01, abs=2e-3)
    assert served.last("scene/paused") == {"data": False}
    assert stamp_ns(served.last("PSM1/measured_js")) > stamp


def test_a_step_while_time_flows_or_of_no_periods_is_refused() -> None:
    served = Served("pegs")
    assert served.core.receive("scene/step", {"data": 5})
    served.run(0.01)
    assert served.world.time == pytest.approx(0.01)
    served.core.receive("scene/pause", {})
    for periods in (0, -3, 10_001):
        served.core.receive("scene/step", {"data": periods})
    for wrong in (1.5, "2", True, None):
        assert not served.core.receive("scene/step", {"data": wrong})
    time = served.world.time
    served.run(0.01)
    assert served.world.time == time
    said = " ".join(m["data"] for m in served.messages("system/warning"))
    assert (
        "the simulation is running" in said
        and "allowed: 1 to 10000" in said
        and "an integer" in said
    )


def test_a_reset_puts_everything_back_and_turns_no_clock_back() -> None:
    served = Served("pegs")
    served.run(0.02)
    stamp = stamp_ns(served.last("scene/ring1/measured_cp"))
    served.core.receive("scene/ring1/set_cp", pose_message((0.07, 0.08, 0.3)))
    served.run(0.02)
    served.core.receive("scene/reset", {})
    served.run(0.01)
    start = next(p for p in served.world.rig.objects if p.name == "ring1").pose
    assert np.allclose(
        served.world.object("ring1").measured_cp().matrix, start, atol=2e-5
    )  # it settles
    assert served.world.time < 0.02
    assert stamp_ns(served.last("scene/ring1/measured_cp")) > stamp


def test_sensors_are_told_as_the_world_reads_them(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(Path(load_rig("pegs").file).read_text(encoding="utf-8") + SENSORS)
    served = Served(str(file))
    served.run(0.1)
    served.world.arm("PSM1").move_jp([0.2, 0.0, 0.12, 0.0, 0.0, 0.0])
    served.run(0.1)
    motor = served.last("sensors/motor")
    assert motor["name"] == ["insertion"]
    exerted = served.world.sensor("motor")
    assert isinstance(exerted, EffortReading)
    assert motor["effort"][0] == pytest.approx(exerted.effort, rel=0.05)
    assert len(served.messages("sensors/imu_1")) == pytest.approx(10, abs=1)  # 50 Hz for 0.2 s
    imu = served.last("sensors/imu_1")
    assert np.linalg.norm(point(imu["linear_acceleration"])) == pytest.approx(9.81, abs=1.0)
    assert imu["angular_velocity_covariance"][0] == pytest.approx(1e-4)
    assert imu["orientation_covariance"][0] == -1.0
    assert served.last("sensors/between")["name"] == ["distance", "gap"]
    assert served.last("sensors/tip")["header"]["frame_id"] == "tip"
    speed, seen = served.last("sensors/speed"), served.world.sensor("speed")
    assert speed["header"]["frame_id"] == "speed"
    assert isinstance(seen, TwistReading)
    for told, exact in (("linear", seen.linear), ("angular", seen.angular)):
        assert np.allclose(point(speed["twist"][told]), exact, atol=0.05 * np.abs(exact).max())
    assert len(served.last("sensors/touch")["contacts"]) > 20


@dataclass(frozen=True, eq=False)
class MotionReading(SensorReading):
    """Speed and velocity of a place."""

    speed: float
    velocity: np.ndarray


@dataclass(frozen=True, eq=False)
class MotionSensor(PlacedSensor):
    """The motion of a place on a link."""

    kind = "motion"
    reading = MotionReading
    values: ClassVar[Values] = dict.fromkeys(("speed", "velocity"), ("linear velocity", "m/s"))

    def measure(self, physics: Physics) -> dict[str, object]:
        linear = physics.motion(self.place).linear
        return {"speed": float(np.linalg.norm(linear)), "velocity": linear}


def test_a_sensor_of_a_new_kind_has_a_topic_without_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(KINDS, "motion", MotionSensor)
    file = tmp_path / "mine.toml"
    text = '\n[[sensor]]\nname = "fast"\nkind = "motion"\narm = "PSM1"\nframe = "tip"\n'
    file.write_text(Path(load_rig("psm").file).read_text(encoding="utf-8") + text)
    served = Served(str(file))
    (row,) = (t for t in topic_table(served.world.rig) if t.name == "sensors/fast")
    assert (row.type, row.unit) == ("sensor_msgs/JointState", "m/s")
    assert row.help == "position: the motion of a place on a link"
    served.world.arm("PSM1").move_jp([0.2, 0.0, 0.12, 0.0, 0.0, 0.0])
    served.run(0.2)
    told = served.last("sensors/fast")
    assert told["name"] == ["speed", "velocity[0]", "velocity[1]", "velocity[2]"]
    assert told["header"]["frame_id"] == "fast"
    speed, *velocity = told["position"]
    assert speed == pytest.approx(np.linalg.norm(velocity)) and speed > 0.01
