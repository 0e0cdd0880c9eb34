"""A recording is repeated bit by bit, and what is not the same is found."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.errors import LogError
from trocar.recording import open_recording, record
from trocar.robot.follow import repeat
from trocar.simulation import World
from trocar.simulation.controllers import CartesianImpedance, HalfPlaneGains

pytest.importorskip("mcap")
GOAL = [0.3, 0.2, 0.15, 0.4, 0.2, -0.3]


def test_the_motion_is_identical_when_the_commands_are_repeated(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    world = World("psm", tip_load_n=2.0)
    arm = world.arm("PSM1")
    with record(world, file):
        arm.move_jp(GOAL)
        world.step(150)
        arm.joints.set_gains("pitch", p=20.0)
        assert arm.jaw is not None
        arm.jaw.open().wait()
        arm.servo_jp(np.array(GOAL) + 0.01)
        world.step(333)
        arm.joints.set_mode("effort", ["roll"])
        arm.joints.use_gravity_compensation(False)
        world.step(50)
        world.reset()
        world.step(100)
        arm.move_to("home")
        world.step(77)
    report = repeat(file)
    assert report.identical and report.difference is None
    assert report.periods == open_recording(file).rows
    assert (report.warnings, report.problem) == ((), "")


def test_a_recording_that_begins_in_the_middle_of_a_move_is_repeated_too(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    world = World("psm")
    arm = world.arm("PSM1")
    arm.joints.set_gains("yaw", p=33.0)
    world.step(10)
    world.reset()
    arm.move_jp(GOAL)
    world.step(123)
    with record(world, file):
        world.step(200)
        arm.hold()
        world.step(20)
    assert repeat(file).identical


def test_states_faults_and_periodic_laws_are_repeated(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    world = World("psm", homed=False)
    arm = world.arm("PSM1")
    with record(world, file):
        world.step(13)
        arm.enable()
        arm.home().wait()
        springs = HalfPlaneGains(p=np.full(3, -200.0), d=np.full(3, -5.0))
        here = arm.measured_cp().matrix
        arm.forces.servo_ci(
            CartesianImpedance(
                here[:3, 3] + 0.01,
                torque_orientation=here[:3, :3],
                position_positive=springs,
                position_negative=springs,
            )
        )
        world.step(200)
        arm.body.servo_cf([0.5, 0.0, 0.2, 0.0, 0.0, 0.0])
        world.step(200)
        arm.servo_jp(arm.measured_js().position)
        world.step(100)
        arm.disable()
        world.step(100)
    assert repeat(file).identical


def test_tools_that_are_exchanged_before_and_meanwhile_are_repeated(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    world = World("two_psm_ecm")
    arm, other = world.arm("PSM1"), world.arm("PSM2")
    world.exchange_tool("PSM1", "PROGRASP_FORCEPS:420093")
    arm.move_jp(GOAL)
    world.step(50)
    with record(world, file):
        world.step(100)
        world.exchange_tool("PSM1", "none")
        other.move_jp(GOAL)
        world.step(450)
        world.exchange_tool("PSM1", "LARGE_NEEDLE_DRIVER:420006")
        world.step(100)
        last = other.measured_js().position
    assert repeat(file).identical
    recorded = open_recording(file)
    assert (len(recorded.layouts), recorded.rows) == (3, 651)
    columns = recorded.columns("PSM2")
    assert columns is not None
    states = recorded.states(columns)
    assert len(states.time) == 651
    np.testing.assert_allclose(states.position[-1, :6], last, atol=1e-6)


def test_played_tables_are_repeated(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    world = World("psm")
    table = 0.1 * np.sin(np.linspace(0.0, 3.0, 100))[:, None] * np.ones(7) + [0, 0, 0.1, 0, 0, 0, 0]
    with record(world, file):
        world.play({"PSM1": table}, every=5)
        world.step(3)
    assert repeat(file).identical


def test_what_moved_the_arm_behind_the_journals_back_is_found(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    world = World("psm")
    with record(world, file):
        world.step(530)
        world.servos.setpoint[2, 0] += 0.01
        world.step(500)
    report = repeat(file)
    assert not report.identical
    assert report.difference is not None
    assert report.difference.time == pytest.approx(0.5)
    assert report.difference.joint.startswith("PSM1/insertion")
    assert report.difference.largest > 0.001


def test_one_bit_is_a_difference(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    world = World("psm")
    with record(world, file):
        world.step(10)
        world.mj_data.qvel[0] = np.nextafter(world.mj_data.qvel[0], 1.0)
        world.step(10)
    assert not repeat(file).identical


def test_a_truncated_recording_is_repeated_as_far_as_it_goes(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    world = World("psm")
    with record(world, file):
        world.arm("PSM1").move_jp(GOAL)
        world.step(1500)
    file.write_bytes(file.read_bytes()[:-60_000])
    report = repeat(file)
    assert report.identical and "breaks off" in report.problem
    assert report.periods in (400, 800, 1200)


def test_another_description_of_the_rig_is_refused(tmp_path: Path) -> None:
    data = Path(load_rig("psm").file).parent
    for folder in ("arms", "tools", "rigs"):
        shutil.copytree(data.parent / folder, tmp_path / folder)
    rig, file = tmp_path / "rigs" / "psm.toml", tmp_path / "run.mcap"
    own = tmp_path / "rigs" / "own.toml"
    text = rig.read_text().replace('description = "psm"', 'description = "../arms/psm.toml"')
    own.write_text(text.replace('name = "psm"', 'name = "own"', 1))
    world = World(own, dynamics="cad")
    with record(world, file):
        world.step(5)
    assert repeat(file).identical
    assert repeat(file, rig=str(own)).identical
    arm = tmp_path / "arms" / "psm.toml"
    arm.write_text(arm.read_text().replace("mass_kg = 1.47", "mass_kg = 1.48"))
    with pytest.raises(LogError, match=r"is a recording of rig 'own'.*here rig 'own' has"):
        repeat(file)
    with pytest.raises(LogError, match=r"is a recording of rig 'own'.*here rig 'psm' has"):
        repeat(file, rig="psm")


def test_another_version_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "run.mcap"
    with monkeypatch.context() as older:
        older.setattr("trocar.recording.metadata.__version__", "0.0.9")
        world = World("psm")
        with record(world, file):
            world.step(5)
    report = repeat(file)
    assert report.identical
    assert any("recorded with trocar 0.0.9, repeated with" in text for text in report.warnings)


def test_a_rig_that_was_built_in_python_is_handed_over(tmp_path: Path) -> None:
    file, rig = tmp_path / "run.mcap", load_rig("psm")
    world = World(rig)
    with record(world, file):
        world.step(5)
    with pytest.raises(LogError, match="was built in Python, not read from a file"):
        repeat(file)
    assert repeat(file, rig=rig).identical


def test_too_long_a_past_cannot_be_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trocar.simulation.journal.MOST_COMMANDS", 3)
    world, file = World("psm"), tmp_path / "run.mcap"
    for _ in range(5):
        world.arm("PSM1").servo_jp([0, 0, 0.1, 0, 0, 0])
    with record(world, file):
        world.step(5)
    with pytest.raises(LogError, match="cannot be repeated: it began after more than 3 commands"):
        repeat(file)
    assert open_recording(file).rows == 6


def test_an_exchange_of_tools_is_recorded_and_repeated(tmp_path: Path) -> None:
    """One before the recording, one in it, one to a tool with fewer joints."""
    file = tmp_path / "run.mcap"
    world = World("three_psm")
    arm = world.arm("PSM1")
    world.exchange_tool("PSM1", "PROGRASP_FORCEPS:420093")
    world.reset()
    with record(world, file):
        arm.move_jp(GOAL)
        world.arm("PSM2").move_to("work")
        world.step(150)
        arm.runtime.set_tool_type("MARYLAND_BIPOLAR_FORCEPS:400172")
        world.step(150)
        assert arm.jaw is not None
        arm.jaw.open()
        world.step(100)
        world.exchange_tool("PSM2", "none")
        world.step(100)
    report = repeat(file)
    assert report.identical and report.difference is None
    assert report.periods == open_recording(file).rows == 501
