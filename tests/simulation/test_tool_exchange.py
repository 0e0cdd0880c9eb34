"""Another tool while the world runs: the arm takes it, and nobody else notices."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_tool, names
from trocar.errors import InputError, UnknownNameError
from trocar.simulation import World
from trocar.simulation.jaw import Jaw
from trocar.simulation.journal import Entry, apply_command
from trocar.simulation.supervision import Supervision

MARYLAND = "MARYLAND_BIPOLAR_FORCEPS:400172"
PROGRASP = "PROGRASP_FORCEPS:420093"
FENESTRATED = "FENESTRATED_BIPOLAR_FORCEPS:400205"


def jaw_of(world: World, name: str = "PSM1") -> Jaw:
    jaw = world.arm(name).jaw
    assert jaw is not None
    return jaw


def busy_cart() -> World:
    """A cart in which everything that can be set is set, and much is under way."""
    world = World("full_cart", collisions=False)
    world.set_state("PSM3", np.array([0.1, -0.2, 0.1, 0.3, 0.2, -0.1, 0.4]), np.full(7, 0.1))
    world.arm("PSM2").joints.set_gains("yaw", p=111.0, i=3.0, d=7.0)
    world.arm("PSM2").joints.set_trajectory_ratio(0.5)
    world.arm("PSM2").move_to("work")
    jaw_of(world, "PSM2").open()
    world.arm("PSM3").joints.set_mode("effort", ["roll"])
    world.arm("PSM3").servo_jf([0.0, 0.0, 0.0, 0.02, 0.0, 0.0])
    world.arm("PSM3").joints.use_gravity_compensation(False)
    world.arm("ECM").joints.set_mode("set", ["insertion"])
    world.arm("SUJ_ECM").brakes.release()
    world.arm("SUJ_PSM2").disable()
    world.step(137)
    assert all(arm.operating_state().state != "FAULT" for arm in world.arms.values())
    return world


def physics_of(world: World, without: str) -> dict[str, list[float]]:
    """All that the physics holds of every joint and servo but one arm's, by name."""
    model, data = world.mj_model, world.mj_data
    found: dict[str, list[float]] = {"": [data.time, float(model.opt.disableactuator)]}
    for k in range(model.njnt):
        joint, at, dof = model.joint(k).name, model.jnt_qposadr[k], model.jnt_dofadr[k]
        if not joint.startswith(without):
            state = [data.qpos[at], data.qvel[dof], data.qacc_warmstart[dof]]
            law = [model.dof_damping[dof].tolist(), model.dof_frictionloss[dof]]
            found[joint] = [*state, *law]
    for k in np.flatnonzero(model.actuator_ctrlnum).tolist():
        servo = model.actuator(k).name
        if not servo.startswith(without):
            act = data.act[model.actuator_actadr[k]]
            setpoint = world.servos.setpoint[k].tolist()
            effort = [world.servos.commanded[k], world.servos.balanced[k]]
            gains = [*model.actuator_gainprm[k], *model.actuator_biasprm[k]]
            limits = [*model.actuator_forcerange[k], world.servos.servoed[k]]
            found[f"servo {servo}"] = [act, *setpoint, *effort, *gains, *limits]
    return found


def test_every_other_arm_keeps_its_state_bit_for_bit() -> None:
    world = busy_cart()
    before, physics = world.snapshot(), physics_of(world, "PSM1")
    states = {name: arm.operating_state() for name, arm in world.arms.items()}
    assert physics["servo PSM2/yaw"][0] != 0.0  # its integral
    world.exchange_tool("PSM1", PROGRASP)
    after = world.snapshot()
    assert physics_of(world, "PSM1") == physics
    assert after.time == before.time
    for name, arm in world.arms.items():
        assert arm.operating_state() == states[name]
        if name == "PSM1":
            continue
        old, new = before.arms[name], after.arms[name]
        for part in ("q", "qd", "effort", "setpoint"):
            np.testing.assert_array_equal(getattr(old, part), getattr(new, part), err_msg=name)
        for part in ("modes", "locked", "busy", "state", "homed", "warnings", "tool"):
            assert getattr(old, part) == getattr(new, part), (name, part)
    assert world.arm("PSM2").joints.gains("yaw") == (111.0, 3.0, 7.0)
    assert world.arm("PSM2").joints.trajectory_ratio == (0.5, 0.5)


def test_the_moves_of_other_arms_go_on_as_if_nothing_had_happened() -> None:
    worlds = [World("three_psm", dynamics="cad") for _ in range(2)]
    motions = [world.arm("PSM2").move_to("work") for world in worlds]
    for world in worlds:
        world.step(100)
    worlds[0].exchange_tool("PSM1", MARYLAND)
    while not motions[1].done:
        for world in worlds:
            world.step()
        setpoints = [world.arm("PSM2").setpoint_js() for world in worlds]
        np.testing.assert_array_equal(setpoints[0].position, setpoints[1].position)
        here = [world.arm("PSM2").measured_js().position for world in worlds]
        np.testing.assert_allclose(here[0], here[1], rtol=0, atol=1e-6)  # one solver for all
    assert motions[0].done and motions[0].goal_reached
    assert worlds[0].time == worlds[1].time


def test_the_arm_keeps_its_place_and_its_new_wrist_is_straight() -> None:
    world = World("psm")
    arm, jaw = world.arm("PSM1"), jaw_of(world)
    arm.move_to("work").wait(5.0)
    motion = arm.move_jp([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    world.step(50)
    before, setpoint_before = arm.joints.readings()[0], arm.setpoint_js().position
    world.exchange_tool("PSM1", MARYLAND)
    q, qd, _ = arm.joints.readings()
    setpoint = arm.setpoint_js().position
    np.testing.assert_array_equal(q[:4], before[:4])
    assert q[4:].tolist() == [0.0, 0.0, 0.0] and not qd.any()
    np.testing.assert_array_equal(setpoint[:4], setpoint_before[:4])
    assert motion.done and not motion.goal_reached
    assert world.arm("PSM1") is arm and arm.jaw is jaw
    assert arm.description.tool == MARYLAND == world.rig.arm("PSM1").arm.tool
    np.testing.assert_allclose(arm.joints.upper[3:6], [4.4506, 1.2217, np.pi / 2])
    tip = arm.local.measured_cp().matrix
    assert tip[:3, 3] == pytest.approx(arm.forward_kinematics(q[:6]).matrix[:3, 3])
    world.step(500)
    assert np.abs(arm.joints.readings()[0][:6] - setpoint).max() < 2e-3
    assert arm.move_to("work").wait(5.0) and arm.rejections.count == 0


def test_a_roll_beyond_the_new_limit_is_clipped_with_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    world = World("psm")
    world.set_state("PSM1", np.array([0.0, 0.0, 0.12, 4.5, 0.0, 0.0, 0.0]))
    world.exchange_tool("PSM1", MARYLAND)
    assert world.arm("PSM1").joints.readings()[0][3] == 4.4506
    assert f"PSM1: roll clipped from 4.5 to 4.4506, the limit of {MARYLAND}" in caplog.messages


def test_the_jaw_has_the_new_limits() -> None:
    world = World("psm")
    jaw = jaw_of(world)
    jaw.servo_jp([-0.6])
    assert jaw.setpoint_js().position[0] == -0.6
    world.exchange_tool("PSM1", PROGRASP)
    jaw.servo_jp([-0.6])
    assert jaw.setpoint_js().position[0] == -0.349066
    assert jaw.close().wait(2.0) and jaw.open().wait(2.0)
    assert world.arm("PSM1").joints.effort_limit[6] == 0.16
    world.exchange_tool("PSM1", FENESTRATED)
    assert world.arm("PSM1").joints.effort_limit[6] == 0.19


def test_what_was_set_of_the_arm_stays_and_the_tool_brings_its_own() -> None:
    world = World("psm")
    arm = world.arm("PSM1")
    arm.joints.set_gains("pitch", p=99.0)
    arm.joints.set_gains("roll", p=1.5)
    arm.joints.use_gravity_compensation(False)
    arm.joints.set_trajectory_ratio(0.25)
    arm.joints.use_strict_limits(True)
    arm.local.set_base_frame(np.eye(4), "table")
    arm.joints.set_mode("effort", ["yaw", "roll"])
    arm.servo_jp([np.nan] * 6)
    rejected = arm.rejections.count
    arm.runtime.set_tool_type(PROGRASP)
    assert arm.joints.gains("pitch") == (99.0, 0.0, 5.0) and arm.joints.gains("roll") == (
        6.0,
        0.0,
        0.09,
    )
    assert arm.joints.mode("yaw") == "effort" and arm.joints.mode("roll") == "position"
    assert not arm.joints.gravity_compensation and arm.joints.strict_limits
    assert arm.joints.trajectory_ratio == (0.25, 0.25)
    assert arm.measured_cp().frame_id == "table"
    assert arm.rejections.count == rejected == 1
    assert "nan" in arm.rejections.last


@pytest.mark.parametrize("verbs", [("disable",), ("pause",), ("unhome",), ("disable", "unhome")])
def test_an_arm_that_may_not_move_stays_so(verbs: tuple[str, ...]) -> None:
    world = World("psm")
    arm = world.arm("PSM1")
    for verb in verbs:
        arm.state_command(verb)
    before, q = arm.operating_state(), arm.joints.readings()[0]
    world.exchange_tool("PSM1", PROGRASP)
    assert arm.operating_state() == before
    assert arm.joints.readings()[2].any() == ("disable" not in verbs)
    world.step(300)
    assert np.abs(arm.joints.readings()[0] - q).max() < 1e-3
    assert arm.move_jp([0.1, 0, 0.12, 0, 0, 0]).done


def test_gravity_is_compensated_for_the_new_weight_at_once() -> None:
    world = World("psm", dynamics="cad")
    world.arm("PSM1").move_to("work").wait(5.0)
    world.exchange_tool("PSM1", PROGRASP)
    fed = world.servos.setpoint[:, 2].copy()
    np.testing.assert_allclose(
        fed, world.part(Supervision).holding_efforts(np.zeros(len(fed))), rtol=0, atol=1e-12
    )


def test_reset_keeps_the_tool_and_goes_to_the_rig_s_pose() -> None:
    world = World("psm")
    world.exchange_tool("PSM1", MARYLAND)
    world.arm("PSM1").move_to("work").wait(5.0)
    world.reset()
    assert world.arm("PSM1").description.tool == MARYLAND
    np.testing.assert_array_equal(world.arm("PSM1").joints.readings()[0], [0, 0, 0.12, 0, 0, 0, 0])


def test_all_that_looks_into_the_physics_looks_into_the_new_one() -> None:
    world = World("two_psm_ecm", tip_load_n=2.0)
    world.exchange_tool("PSM2", PROGRASP)
    table = np.tile(world.arm("PSM2").joints.poses["start"], (50, 1))
    table[:, 0] += np.linspace(0.0, 0.02, 50)
    played = world.play({"PSM2": table})
    assert np.abs(played.positions["PSM2"][-1] - table[-1]).max() < 0.02
    assert world.health().per_arm["PSM2"].loop_gap_m < 1e-6
    assert world.snapshot().arms["PSM2"].q[0] == played.positions["PSM2"][-1, 0]
    drawn = [shape for shape in world.shapes() if shape.name.startswith("PSM2/finger_left")]
    assert {shape.name.split("/")[2] for shape in drawn} == {PROGRASP}
    build = world.snapshot().build
    world.exchange_tool("PSM2", MARYLAND)
    assert world.snapshot().build == build + 1


def test_a_tool_without_a_jaw_takes_it_away_and_another_gives_it_back() -> None:
    world = World("psm")
    arm, jaw = world.arm("PSM1"), jaw_of(world)
    world.exchange_tool("PSM1", "none")
    assert (arm.jaw, arm.description.tool) == (None, "")
    assert arm.joints.names == ("yaw", "pitch", "insertion")
    with pytest.raises(InputError, match="PSM1 has no jaw with this tool"):
        jaw.open()
    assert arm.move_jp([0.1, 0.0, 0.1]).wait(3.0)
    world.exchange_tool("PSM1", PROGRASP)
    assert arm.jaw is jaw and jaw.open().wait(3.0)
    np.testing.assert_allclose(arm.measured_js().position[:3], [0.1, 0.0, 0.1], atol=1e-3)


@pytest.mark.parametrize(
    ("arm", "tool", "error", "message"),
    [
        ("PSM1", "SPOON", UnknownNameError, r"unknown tool 'SPOON'; known: .*PROGRASP"),
        ("PSM9", PROGRASP, UnknownNameError, r"unknown arm 'PSM9'.*known: .*PSM1"),
        ("ECM", PROGRASP, InputError, r"ECM: ecm: takes no tool"),
        ("PSM1", "si.toml", InputError, r"PSM1: .*does not fit psm.*Classic; it fits Si$"),
        ("PSM1", "broken.toml", InputError, r"broken.toml: tip: is missing"),
        ("PSM1", "gone.toml", InputError, r"gone.toml: there is no such file"),
    ],
)
def test_a_tool_that_cannot_be_mounted_changes_nothing(
    arm: str,
    tool: str,
    error: type[Exception],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    text = Path(load_tool(PROGRASP).file).read_text(encoding="utf-8")
    si = text.replace('fits = ["Classic", "S", "Si"]', 'fits = ["Si"]')
    (tmp_path / "si.toml").write_text(si, encoding="utf-8")
    broken = text.replace("schema = 1", 'schema = 1\ndrop = ["tip"]')
    (tmp_path / "broken.toml").write_text(broken, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    world = World("two_psm_ecm")
    motion = world.arm("PSM1").move_to("work")
    world.step(20)
    before, model = world.snapshot(), world.mj_model
    with pytest.raises(error, match=message):
        world.exchange_tool(arm, tool)
    after = world.snapshot()
    assert world.mj_model is model and not motion.done
    np.testing.assert_array_equal(after.arms["PSM1"].q, before.arms["PSM1"].q)
    assert world.arm("PSM1").description.tool == "LARGE_NEEDLE_DRIVER:400006"


def test_an_exchange_is_one_command_and_its_repetition_the_same_motion() -> None:
    first, entries = World("three_psm"), list[Entry]()
    first.listen(entries.append)
    first.arm("PSM1").move_to("work")
    first.step(100)
    first.arm("PSM1").runtime.set_tool_type(MARYLAND)
    first.step(50)
    first.exchange_tool("PSM2", PROGRASP)
    first.arm("PSM2").move_jp([0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
    first.step(200)
    commands = [entry for entry in entries if entry.kind == "command"]
    assert [entry.name for entry in commands] == [
        "move_to", "set_tool_type", "exchange_tool", "move_jp",
    ]  # fmt: skip
    assert dict(commands[2].values) == {"name": "PSM2", "tool": PROGRASP}
    events = [(e.source, e.values["tool"]) for e in entries if e.name == "tool_type"]
    assert events == [("PSM1", MARYLAND), ("PSM2", PROGRASP)]
    second = World("three_psm")
    for entry in commands:
        if entry.period > second.periods:
            second.step(entry.period - second.periods)
        apply_command(second, entry)
    second.step(first.periods - second.periods)
    for name, arm in first.arms.items():
        again = second.arm(name).joints.readings()
        for one, other in zip(arm.joints.readings(), again, strict=True):
            np.testing.assert_array_equal(one, other)


def test_every_tool_takes_the_place_of_every_other_without_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    world = World("psm")
    arm = world.arm("PSM1")
    with caplog.at_level(logging.WARNING):
        for tool in names("tools"):
            arm.runtime.set_tool_type(tool)
            world.step(50)
            assert arm.move_jp([0.05, 0.05, 0.13, 0.2, 0.2, 0.2]).wait(3.0)
            world.step(100)
            assert world.health().branch_ok
    assert not caplog.records
