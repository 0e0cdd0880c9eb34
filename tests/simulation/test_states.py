"""Operating states: who may move, homing, faults."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.simulation import World
from trocar.simulation.arm import Arm
from trocar.simulation.operating_state import (
    NEAR_RAD,
    PATIENCE_S,
    STATE_COMMANDS,
    State,
)

HOME = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]
GOAL = [0.2, -0.1, 0.15, 0.3, 0.2, -0.1]


@pytest.fixture
def off() -> World:
    """A PSM as after power-on."""
    return World("psm", homed=False)


def state(arm: Arm) -> tuple[str, bool, bool]:
    now = arm.operating_state()
    return now.state, now.is_homed, now.is_busy


def reported_states(world: World) -> list[tuple[str, bool, bool]]:
    """What the world tells of operating states from now on."""
    found: list[tuple[str, bool, bool]] = []

    def keep(entry) -> None:
        if entry.name == "operating_state":
            found.append(tuple(entry.values[k] for k in ("state", "is_homed", "is_busy")))

    world.listen(keep)
    return found


def test_arms_begin_enabled_and_homed_unless_the_world_says_otherwise(off):
    assert state(World("psm").arm("PSM1")) == ("ENABLED", True, False)
    assert state(off.arm("PSM1")) == ("DISABLED", False, False)


def test_a_disabled_arm_is_held_where_it_is_and_exerts_nothing(off):
    arm = off.arm("PSM1")
    before = arm.measured_js().position
    off.step(2000)
    np.testing.assert_allclose(arm.measured_js().position, before, atol=1e-9)
    assert not arm.measured_js().effort.any()


VERBS = [
    lambda arm: arm.servo_jp(GOAL),
    lambda arm: arm.servo_jr([0.1, 0, 0, 0, 0, 0]),
    lambda arm: arm.servo_jf([1.0, 0, 0, 0, 0, 0]),
    lambda arm: arm.servo_cp(arm.setpoint_cp().matrix),
    lambda arm: arm.servo_cr(np.eye(4)),
    lambda arm: arm.body.servo_cf([0, 0, 5.0, 0, 0, 0]),
    lambda arm: arm.move_jp(GOAL).wait(1.0),
    lambda arm: arm.move_jr([0.1, 0, 0, 0, 0, 0]).wait(1.0),
    lambda arm: arm.move_cp(arm.setpoint_cp().matrix).wait(1.0),
    lambda arm: arm.free(),
    lambda arm: arm.jaw.move_jp([0.5]).wait(1.0),
    lambda arm: arm.jaw.servo_jp([0.5]),
    lambda arm: arm.jaw.servo_jf([0.1]),
]


@pytest.mark.parametrize("how", ["disabled", "not homed", "paused", "fault"])
def test_no_verb_moves_an_arm_that_is_not_ready(how):
    world = World("psm")
    arm = world.arm("PSM1")
    world.step(500)
    if how == "disabled":
        arm.disable()
    elif how == "not homed":
        arm.state_command("unhome")
    elif how == "paused":
        arm.state_command("pause")
    else:
        arm.runtime.states.fault("a test")
    before, state_before = arm.joints.readings()[0], state(arm)
    setpoint = arm.setpoint_js().position
    for count, verb in enumerate(VERBS, 1):
        assert not verb(arm)
        assert arm.rejections.count == count
        assert state(arm) == state_before
        world.step(20)
        np.testing.assert_array_equal(arm.setpoint_js().position, setpoint)
    np.testing.assert_allclose(arm.joints.readings()[0], before, atol=2e-4)


def test_homing_brings_an_enabled_arm_home_and_only_then_lets_it_move(off):
    """A7 to A9 of the recorded answers."""
    arm = off.arm("PSM1")
    states = reported_states(off)
    assert arm.enable()
    motion = arm.home()
    assert state(arm) == ("ENABLED", True, True)  # its position is known before it is home
    assert not arm.servo_jp(GOAL)
    assert motion.wait(10.0)
    assert state(arm) == ("ENABLED", True, False)
    np.testing.assert_allclose(arm.setpoint_js().position, HOME, atol=1e-12)
    assert np.abs(arm.measured_js().position - HOME).max() < NEAR_RAD
    assert arm.servo_jp(arm.setpoint_js().position)
    assert states == [
        ("ENABLED", False, False),
        ("ENABLED", True, True),
        ("ENABLED", True, False),
    ]


def test_an_arm_that_is_home_stays_where_it_is_and_goes_on_moving():
    world = World("psm")
    arm = world.arm("PSM1")
    motion = arm.move_jp(GOAL)
    world.step(50)
    assert arm.state_command("home")
    assert arm.home().goal_reached
    assert motion.wait()
    assert arm.move_to("home").wait()
    np.testing.assert_allclose(arm.setpoint_js().position, HOME, atol=1e-12)


def test_a_homing_takes_the_jaw_along_and_no_goal_is_reported(off):
    arm = off.arm("PSM1")
    off.set_state("PSM1", np.array([0.3, *HOME[1:], 0.5]))
    reached: list[bool] = []
    off.listen(lambda e: reached.append(e.values["reached"]) if e.name == "goal_reached" else None)
    assert arm.enable() and arm.home().wait()
    assert arm.jaw is not None and arm.jaw.setpoint_js().position == 0.0
    assert reached == []


def test_an_arm_that_does_not_arrive_home_is_in_fault_after_two_seconds(off, caplog):
    arm = off.arm("PSM1")
    off.set_state("PSM1", np.array([0.3, *HOME[1:], 0.0]))
    arm.joints.set_gains("yaw", p=0.1, d=0.0)
    arm.enable()
    motion = arm.home()
    arrived = None
    with caplog.at_level(logging.ERROR):
        for _ in range(20000):
            off.step()
            if arrived is None and arm.runtime.control.moves.profile is None:
                arrived = off.time
            if motion.done:
                break
    assert motion.done
    assert not motion.goal_reached
    assert state(arm) == ("FAULT", True, False)
    assert arrived is not None
    assert off.time - arrived == pytest.approx(PATIENCE_S, abs=0.01)
    assert "yaw" in caplog.text


def test_homing_that_is_disturbed_ends_without_a_home(off):
    arm = off.arm("PSM1")
    off.set_state("PSM1", np.array([0.3, *HOME[1:], 0.0]))
    arm.enable()
    motion = arm.home()
    off.step(100)
    arm.disable()
    assert motion.done
    assert not motion.goal_reached
    assert state(arm) == ("DISABLED", True, False)
    assert not arm.move_jp(GOAL).wait(0.1)


def test_a_homing_that_was_paused_begins_again(off):
    arm = off.arm("PSM1")
    off.set_state("PSM1", np.array([0.3, *HOME[1:], 0.0]))
    arm.enable()
    motion = arm.home()
    off.step(100)
    assert arm.state_command("pause")
    assert motion.done and not motion.goal_reached
    off.step(2000)
    assert arm.setpoint_js().position[0] > 0.1
    assert arm.state_command("resume")
    off.step(4000)
    assert state(arm) == ("ENABLED", True, False)
    np.testing.assert_allclose(arm.setpoint_js().position, HOME, atol=1e-12)


def test_a_paused_arm_holds_and_takes_commands_again_after_resume():
    world = World("psm")
    arm = world.arm("PSM1")
    motion = arm.move_jp(GOAL)
    world.step(200)
    assert arm.state_command("pause")
    assert motion.done
    assert not motion.goal_reached
    held = arm.setpoint_js().position
    world.step(500)
    np.testing.assert_array_equal(arm.setpoint_js().position, held)
    assert arm.state_command("resume")
    assert arm.move_jp(GOAL).wait(5.0)


#: {state: how a test leads a homed arm there}
LEADS: dict[State, Callable[[Arm], object]] = {
    "ENABLED": lambda arm: None,  # noqa: ARG005
    "DISABLED": lambda arm: arm.disable(),
    "PAUSED": lambda arm: arm.state_command("pause"),
    "FAULT": lambda arm: arm.runtime.states.fault("a test"),
}
#: Commands to a homed PSM in each state: desired state ("" where it is refused, "=" where nothing
#: is said), then the operating state and whether it is homed.
#: Source: the dVRK's own software (sawIntuitiveResearchKit 9e535e6, KINEMATIC), recorded: steps
#: A4 to A34 of `python -m benchmarks genuine`.
ANSWERS: dict[tuple[State, str], tuple[str, State, bool]] = {
    ("DISABLED", "enable"): ("ENABLED", "ENABLED", False),
    ("DISABLED", "disable"): ("DISABLED", "DISABLED", False),
    ("DISABLED", "home"): ("", "DISABLED", True),
    ("DISABLED", "unhome"): ("=", "DISABLED", False),
    ("DISABLED", "pause"): ("", "DISABLED", True),
    ("DISABLED", "resume"): ("", "DISABLED", True),
    ("ENABLED", "enable"): ("ENABLED", "ENABLED", True),
    ("ENABLED", "disable"): ("DISABLED", "DISABLED", True),
    ("ENABLED", "home"): ("HOMED", "ENABLED", True),
    ("ENABLED", "unhome"): ("=", "ENABLED", False),
    ("ENABLED", "pause"): ("PAUSED", "PAUSED", True),
    ("ENABLED", "resume"): ("", "ENABLED", True),
    ("PAUSED", "enable"): ("", "PAUSED", True),
    ("PAUSED", "disable"): ("DISABLED", "DISABLED", True),
    ("PAUSED", "home"): ("", "PAUSED", True),
    ("PAUSED", "unhome"): ("=", "PAUSED", False),
    ("PAUSED", "pause"): ("PAUSED", "PAUSED", True),
    ("PAUSED", "resume"): ("HOMED", "ENABLED", True),
    ("FAULT", "enable"): ("ENABLED", "FAULT", True),
    ("FAULT", "disable"): ("DISABLED", "DISABLED", True),
    ("FAULT", "home"): ("", "FAULT", True),
    ("FAULT", "unhome"): ("=", "FAULT", False),
    ("FAULT", "pause"): ("", "FAULT", True),
    ("FAULT", "resume"): ("", "FAULT", True),
}


@pytest.mark.parametrize("before", LEADS)
@pytest.mark.parametrize("verb", STATE_COMMANDS)
def test_every_command_in_every_state_is_answered_as_the_robot_answers(before, verb):
    world = World("psm")
    arm = world.arm("PSM1")
    LEADS[before](arm)
    desired: list[str] = []
    world.listen(lambda e: desired.append(e.values["state"]) if e.name == "desired_state" else None)
    wanted, then, homed = ANSWERS[before, verb]
    assert arm.state_command(verb) == (wanted != "")
    assert desired == ([] if wanted in ("", "=") else [wanted])
    assert state(arm) == (then, homed, False)
    if not wanted:
        assert f"{verb}: not supported in state {before}" in arm.rejections.last


def test_an_arm_that_was_unhomed_is_homed_after_disable_and_enable():
    """A20 to A25 of the recorded answers: home changes nothing before."""
    world = World("psm")
    arm = world.arm("PSM1")
    arm.state_command("unhome")
    assert not arm.home().wait(1.0)
    assert state(arm) == ("ENABLED", False, False)
    assert "disable and enable it first" in arm.rejections.last
    arm.disable()
    assert arm.enable()
    assert arm.home().wait()
    assert state(arm) == ("ENABLED", True, False)
    assert arm.move_jp(GOAL).wait()


def test_a_move_before_homing_is_refused_where_the_robot_would_hang():
    """A25, A27: the robot takes it, is busy for ever and never moves."""
    arm = World("psm").arm("PSM1")
    arm.disable()
    assert arm.enable()
    assert not arm.move_jp(GOAL).wait(1.0)
    assert "the robot would accept the command, stay busy and never move" in arm.rejections.last
    assert state(arm) == ("ENABLED", False, False)


def test_a_move_under_way_goes_on_when_the_arm_is_unhomed():
    world = World("psm")
    arm = world.arm("PSM1")
    motion = arm.move_jp(GOAL)
    world.step(100)
    assert arm.state_command("unhome")
    assert motion.wait()
    np.testing.assert_array_equal(arm.setpoint_js().position, GOAL)
    assert not arm.servo_jp(GOAL)


def test_an_unknown_state_command_lists_the_known_ones():
    arm = World("psm").arm("PSM1")
    assert not arm.state_command("dance")
    assert "'dance'" in arm.rejections.last
    assert "enable, disable, home, unhome, pause, resume" in arm.rejections.last


def test_a_tracking_error_is_a_fault_that_names_the_joint(caplog):
    world = World("psm")
    arm = world.arm("PSM1")
    errors: list[str] = []
    world.listen(lambda e: errors.append(e.values["text"]) if e.name == "error" else None)
    q = arm.setpoint_js().position
    with caplog.at_level(logging.ERROR):
        assert arm.servo_jp(q + np.array([0.0, 0.55, 0.0, 0.0, 0.0, 0.0]))
        world.step(21)
    assert state(arm) == ("FAULT", True, False)
    assert "pitch" in errors[0]
    assert "yaw" not in errors[0]
    assert "allowed 0.5" in errors[0]
    assert "PSM1: FAULT" in caplog.text


#: Steps of one joint's set-point, the largest without a fault and the least with one [rad or m].
#: Source: the dVRK's own software (sawIntuitiveResearchKit 9e535e6, KINEMATIC), recorded. Its
#: errors are those of the instrument's discs.
THRESHOLDS = {
    "yaw": (0.49, 0.51),
    "pitch": (0.49, 0.51),
    "insertion": (0.049, 0.051),
    "roll": (0.62, 1.0),
    "wrist_pitch": (0.58, 0.62),
    "wrist_yaw": (0.7, 0.9),
}


@pytest.mark.parametrize("joint", THRESHOLDS)
@pytest.mark.parametrize("phase", [0, 7, 13, 19])
def test_a_step_of_a_set_point_is_a_fault_from_where_it_is_on_the_robot(joint, phase):
    """Whenever it comes between two looks at tracking errors."""
    world = World("psm")
    arm = world.arm("PSM1")
    world.step(50 + phase)
    row = arm.joints.names.index(joint)
    for size, expected in zip(THRESHOLDS[joint], ("ENABLED", "FAULT"), strict=True):
        q = arm.setpoint_jp()
        q[row] += size if size == THRESHOLDS[joint][0] else -size
        assert arm.servo_jp(q)
        world.step(1000)
        assert arm.operating_state().state == expected, arm.rejections.last


def test_a_smaller_error_is_none_and_other_arms_go_on():
    world = World("two_psm_ecm")
    one, two = world.arm("PSM1"), world.arm("PSM2")
    two.servo_jp(two.setpoint_js().position + np.array([0.45, 0.0, 0.0, 0.0, 0.0, 0.0]))
    one.servo_jp(one.setpoint_js().position + np.array([0.55, 0.0, 0.0, 0.0, 0.0, 0.0]))
    world.step(41)
    assert one.operating_state().state == "FAULT"
    assert two.operating_state().state == "ENABLED"


@pytest.mark.parametrize("errors", ["perfect", "lab", "wide"])
def test_a_fault_names_an_error_beyond_what_is_allowed(errors: str):
    """The error that trips the arm, not that of a reading which is 20 ms late."""
    world = World("ecm", control="paper", gravity_compensation=False, errors=errors)
    arm = world.arm("ECM")
    while arm.operating_state().state == "ENABLED":
        world.step(20)
    found = re.search(r"insertion \(([\d.]+) m, allowed ([\d.]+)\)", arm.rejections.last)
    assert found is not None, arm.rejections.last
    assert float(found[1]) >= float(found[2]), arm.rejections.last


def test_in_effort_mode_there_is_no_tracking_error():
    world = World("psm")
    arm = world.arm("PSM1")
    arm.joints.use_gravity_compensation(False)
    assert arm.free()
    world.step(1500)
    assert np.abs(arm.measured_js().position - arm.setpoint_js().position).max() > 0.5
    assert arm.operating_state().state == "ENABLED"


def test_a_fault_ends_by_disabling_and_homing():
    world = World("psm")
    arm = world.arm("PSM1")
    world.step(200)
    arm.runtime.states.fault("a test")
    before = arm.measured_js().position
    world.step(100)
    assert arm.enable()  # accepted, and of no effect
    assert state(arm) == ("FAULT", True, False)
    assert "disable it first" in arm.rejections.last
    assert arm.disable() and arm.enable()
    np.testing.assert_allclose(arm.setpoint_js().position, before, atol=1e-6)
    assert arm.home().wait()
    assert arm.move_jp(GOAL).wait(5.0)


def test_busy_goes_up_and_down_for_every_move_also_of_no_length_and_of_the_jaw():
    world = World("psm")
    arm = world.arm("PSM1")
    assert arm.jaw is not None
    states = reported_states(world)
    assert arm.move_jp(arm.setpoint_js().position).wait(1.0)
    assert arm.jaw.move_jp(arm.jaw.setpoint_js().position).wait(1.0)
    assert [busy for _, _, busy in states] == [True, False, True, False]


def test_a_table_is_not_played_by_an_arm_that_is_not_ready():
    world = World("psm", homed=False)
    with pytest.raises(InputError, match="PSM1: the arm is DISABLED; enable and home it first"):
        world.play({"PSM1": np.tile([*HOME, 0.0], (3, 1))})


def test_a_table_that_is_rejected_leaves_a_free_arm_free():
    world = World("psm")
    arm = world.arm("PSM1")
    assert arm.free()
    for wrong in ({"PSM1": np.zeros((3, 2))}, {"PSM1": np.full((3, 7), np.nan)}):
        with pytest.raises(InputError):
            world.play(wrong)
    assert set(arm.runtime.snapshot(None).modes[:6]) == {"effort"}
    world.play({"PSM1": np.tile([*HOME, 0.0], (3, 1))})
    assert set(arm.runtime.snapshot(None).modes) == {"position"}


def test_a_reset_returns_to_the_states_that_the_world_began_in():
    world = World("psm")
    world.arm("PSM1").disable()
    world.reset()
    assert state(world.arm("PSM1")) == ("ENABLED", True, False)
    world.step(10)
    off = World("psm", homed=False)
    assert off.arm("PSM1").enable() and off.arm("PSM1").home().wait(10.0)
    off.reset()
    assert state(off.arm("PSM1")) == ("DISABLED", False, False)


def test_setup_joints_are_home_where_they_are_enabled_and_never_pause():
    """As recorded from the dVRK's own software."""
    world = World("suj_two_psm_ecm", homed=False)
    arm = world.arm("SUJ_PSM1")
    before = arm.measured_js().position
    assert arm.enable()
    assert state(arm) == ("ENABLED", True, False)
    assert arm.state_command("pause")
    assert not arm.state_command("resume")
    assert state(arm) == ("ENABLED", True, False)
    arm.state_command("unhome")
    assert arm.home().wait(1.0)
    np.testing.assert_allclose(arm.measured_js().position, before, atol=1e-9)
    assert state(arm) == ("ENABLED", True, False)
