"""What is published against what the World's own arms say of the same period."""

from __future__ import annotations

from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

from tests.ros.served import Served
from trocar.descriptions import names
from trocar.descriptions.catalogue import DATA
from trocar.geometry import matrix_from_quaternion
from trocar.geometry.se3 import transform

#: Computed along two ways that share the readings; numbers are of about 1 (efforts: 100).
ROUNDING = 1e-12
EFFORTS = 1e-9


def close(got, expected, atol=ROUNDING) -> None:
    np.testing.assert_allclose(got, expected, rtol=0.0, atol=atol)


def vector(value) -> list[float]:
    return [value["x"], value["y"], value["z"]]


def pose_of(message):
    x, y, z, w = (message["pose"]["orientation"][k] for k in "xyzw")
    R = matrix_from_quaternion(np.array([w, x, y, z]))
    return transform(R, np.array(vector(message["pose"]["position"])))


def scatter(served: Served, rng: np.random.Generator) -> None:
    """Put every arm somewhere, at some speed."""
    for name, arm in served.world.arms.items():
        q = rng.uniform(arm.joints.lower, arm.joints.upper)
        served.world.set_state(name, q, 0.1 * rng.standard_normal(len(q)))


def check_joints(arm, before: str, served: Served) -> None:
    for key, state in (("measured_js", arm.measured_js()), ("setpoint_js", arm.setpoint_js())):
        if f"{before}/{key}" not in served.core.topics:
            continue
        message = served.last(f"{before}/{key}")
        setup = tuple(f"SUJ_{before[4:]}_J{k}" for k in range(len(state.name)))
        assert tuple(message["name"]) == (setup if before.startswith("SUJ/") else state.name)
        close(message["position"], state.position)
        close(message["velocity"], state.velocity)
        close(message["effort"], state.effort, EFFORTS)


def check_poses(arm, before: str, served: Served) -> None:
    for key in ("measured_cp", "setpoint_cp"):
        if f"{before}/{key}" not in served.core.topics:
            continue
        message, expected = served.last(f"{before}/{key}"), getattr(arm, key)()
        close(pose_of(message), expected.matrix)
        assert message["header"]["frame_id"] == expected.frame_id
        local = served.last(f"{before}/local/{key}")
        close(pose_of(local), getattr(arm.local, key)().matrix)


def check_motion_and_force(arm, before: str, served: Served) -> None:
    R = arm.local.measured_cp().matrix[:3, :3]
    for key, turn in (("measured_cv", np.eye(3)), ("local/measured_cv", R.T)):
        twist, expected = served.last(f"{before}/{key}"), attrgetter(key.replace("/", "."))(arm)()
        close(vector(twist["twist"]["linear"]), turn @ expected.linear)
        close(vector(twist["twist"]["angular"]), turn @ expected.angular)
        assert twist["header"]["frame_id"] == f"{before}_base"
    for frame in ("body", "spatial"):
        message = served.last(f"{before}/{frame}/measured_cf")
        assert message["header"]["frame_id"] == ""
        wrench = message["wrench"]
        expected = getattr(arm, frame).measured_cf()
        scale = max(1.0, np.abs(expected.force).max(), np.abs(expected.torque).max())
        close(vector(wrench["force"]), expected.force, 1e-8 * scale)
        close(vector(wrench["torque"]), expected.torque, 1e-8 * scale)
        matrix = served.last(f"{before}/{frame}/jacobian")
        shape = [d["size"] for d in matrix["layout"]["dim"]]
        assert [d["stride"] for d in matrix["layout"]["dim"]] == [1, 6]
        close(np.reshape(matrix["data"], shape), getattr(arm, frame).jacobian())


@pytest.mark.parametrize("rig", names("rigs"))
def test_every_value_is_the_arms_own(rig: str, rng: np.random.Generator) -> None:
    served = Served(rig, world={"collisions": False}, rate_hz=1000.0)
    for _ in range(3):
        scatter(served, rng)
        served.run()
        for name, arm in served.world.arms.items():
            before = served.core.prefixes[name]
            check_joints(arm, before, served)
            check_poses(arm, before, served)
            if arm.description.type != "SUJ":
                check_motion_and_force(arm, before, served)


def test_setup_joints_that_are_welded_have_their_values_too() -> None:
    served = Served("full_cart", world={"setup_joints": "locked"}, rate_hz=1000.0)
    served.run()
    for name, arm in served.world.arms.items():
        check_joints(arm, served.core.prefixes[name], served)
        check_poses(arm, served.core.prefixes[name], served)


def test_jaws_and_grippers_have_their_own_topics(rng: np.random.Generator) -> None:
    served = Served("full_cart_mtm", rate_hz=1000.0)
    scatter(served, rng)
    served.run()
    for name, arm in served.world.arms.items():
        parts = {"jaw/measured_js": "jaw", "gripper/measured_js": "gripper"}
        for key, part in parts.items():
            if getattr(arm, part) is None:
                assert f"{name}/{key}" not in served.core.topics
                continue
            state = getattr(arm, part).measured_js()
            message = served.last(f"{name}/{key}")
            assert tuple(message["name"]) == (part,)
            close(message["position"], state.position)
            if part == "gripper":
                assert not len(message["velocity"]) and not len(message["effort"])
                continue
            close(message["velocity"], state.velocity)
            close(message["effort"], state.effort, EFFORTS)
            assert arm.jaw is not None
            setpoint, state = served.last(f"{name}/jaw/setpoint_js"), arm.jaw.setpoint_js()
            close(setpoint["position"], state.position)
            close(setpoint["effort"], state.effort, EFFORTS)
            assert not len(setpoint["velocity"])


def test_gravity_compensation_tells_its_efforts_and_none_when_it_is_off() -> None:
    served = Served("psm")
    arm = served.world.arm("PSM1")
    arm.joints.use_gravity_compensation(True)
    served.run(0.1)
    topic = "PSM1/gravity_compensation/setpoint_js"
    assert np.abs(served.last(topic)["effort"]).max() > 0.01
    arm.joints.use_gravity_compensation(False)
    served.run(0.1)
    assert not np.any(served.last(topic)["effort"])


def test_a_base_frame_that_was_set_is_that_of_the_messages() -> None:
    served = Served("psm")
    T = transform(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1.0, 2.0, 3.0]))
    served.world.arm("PSM1").local.set_base_frame(T, "table")
    served.run(0.05)
    message = served.last("PSM1/measured_cp")
    assert message["header"]["frame_id"] == "table"
    close(pose_of(message), T @ pose_of(served.last("PSM1/local/measured_cp")))


def test_the_base_frame_of_a_rig_is_that_of_messages_and_verbs(tmp_path: Path) -> None:
    text = (DATA / "rigs" / "two_psm_ecm.toml").read_text(encoding="utf-8")
    told = 'base_frame = { name = "table", xyz_m = [1, 2, 3], rpy_deg = [0, 0, 90] }'
    (tmp_path / "rig.toml").write_text(text.replace('"PSM1"\n', f'"PSM1"\n{told}\n', 1))
    served = Served(str(tmp_path / "rig.toml"))
    T = transform(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1.0, 2.0, 3.0]))
    served.run(0.05)
    message, arm = served.last("PSM1/measured_cp"), served.world.arm("PSM1")
    assert message["header"]["frame_id"] == arm.measured_cp().frame_id == "table"
    close(pose_of(message), T @ pose_of(served.last("PSM1/local/measured_cp")))
    close(arm.measured_cp().matrix, T @ arm.local.measured_cp().matrix)
    assert served.last("PSM2/measured_cp")["header"]["frame_id"] == "ECM"


def test_poses_of_a_calibrated_robot_are_its_own(skew_overlay, rng) -> None:
    served = Served("psm", world={"calibration": skew_overlay("psm", rng)}, rate_hz=1000.0)
    served.run(0.01)
    close(
        pose_of(served.last("PSM1/measured_cp")),
        served.world.arm("PSM1").measured_cp().matrix,
        1e-9,
    )


def frames_of(served: Served) -> list[dict]:
    """Return what tf and tf_static tell together."""
    served.run(0.05)
    return [*served.last("tf")["transforms"], *served.last("tf_static")["transforms"]]


@pytest.mark.parametrize("rig", names("rigs"))
def test_the_frames_of_tf_hang_together_in_one_tree(rig: str) -> None:
    served = Served(rig, wanted=["tf"])
    parents: dict[str, str] = {}
    for each in frames_of(served):
        assert each["child_frame_id"] not in parents
        parents[each["child_frame_id"]] = each["header"]["frame_id"]
    for name, arm in served.world.arms.items():
        base = "Cart" if arm.description.type == "SUJ" else f"{name}_base"
        assert {name, base, arm.measured_cp().frame_id} <= parents.keys()
    for frame in parents:
        while frame in parents:
            frame = parents[frame]
        assert frame == "world"


def test_poses_along_tf_are_those_in_the_world() -> None:
    served = Served("full_cart_mtm", wanted=["tf"])
    links = {}
    for each in frames_of(served):
        turn, p = each["transform"]["rotation"], each["transform"]["translation"]
        R = matrix_from_quaternion(np.array([turn[k] for k in "wxyz"]))
        T = transform(R, np.array(vector(p)))
        links[each["child_frame_id"]] = each["header"]["frame_id"], T
    for name, arm in served.world.arms.items():
        frame, T = name, np.eye(4)
        while frame != "world":
            frame, step = links[frame]
            T = step @ T
        expected = served.world.reference_pose(name) @ arm.local.measured_cp().matrix
        close(T, expected, 1e-6)  # of the tick before
