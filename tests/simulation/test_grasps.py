"""What jaws hold: it does not creep, and is let go where friction would let it go."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.grip import Grip, rig_text
from trocar.descriptions import load_rig
from trocar.descriptions.inertial import STANDARD_GRAVITY
from trocar.descriptions.sensors import WrenchReading
from trocar.errors import DescriptionError
from trocar.simulation import World
from trocar.simulation.journal import Entry

NOTHING = np.zeros(3)
WIRE, OUT = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


@pytest.fixture
def held() -> Grip:
    """A needle in the jaw of a PSM."""
    return Grip("friction+stick")


def events(world: World) -> list[tuple[str, object]]:
    """Return the list that events about grasps are added to from now on."""
    found: list[tuple[str, object]] = []

    def hear(entry: Entry) -> None:
        if entry.kind == "event" and entry.name in ("grasp/object", "grasp/slipped"):
            found.append((entry.name, entry.values["object"]))

    world.listen(hear)
    return found


def test_a_needle_that_is_carried_stays_where_it_is_held_and_creeps_by_friction_alone(
    held: Grip,
) -> None:
    far, turned = held.carry(3.0)
    crept, _ = Grip("friction").carry(3.0)
    assert far < 5e-6
    assert np.degrees(turned) < 0.01
    assert crept > 10.0 * far


@pytest.mark.parametrize("along", [WIRE, OUT, (WIRE + OUT) / np.sqrt(2.0)], ids=str)
def test_a_pull_frees_it_where_friction_of_both_pads_ends(held: Grip, along: np.ndarray) -> None:
    heard, limit = events(held.world), 2.0 * held.world.grasps()["PSM1"].force
    held.load(0.85 * limit * along, NOTHING)
    held.world.step(200)
    assert held.slip()[0] < 5e-5
    assert heard == []
    held.load(1.2 * limit * along, NOTHING)
    held.world.step(10)
    assert heard[:2] == [("grasp/object", ""), ("grasp/slipped", "needle")]


def test_a_torque_about_the_wire_frees_it_where_friction_does(held: Grip) -> None:
    stuck = held.lets_go(NOTHING, WIRE)
    assert stuck == pytest.approx(Grip("friction").lets_go(NOTHING, WIRE), rel=0.05)


def test_what_is_attached_stays_under_any_pull_until_the_jaw_opens() -> None:
    held = Grip("attach")
    heard = events(held.world)
    held.load(60.0 * WIRE, NOTHING)
    held.world.step(200)
    assert held.world.grasps()["PSM1"].load > 1.0
    assert heard == []
    held.load(NOTHING, NOTHING)
    assert held.arm.jaw is not None
    held.arm.jaw.open().wait(timeout_s=1.0)
    assert heard == [("grasp/object", "")]


def test_an_open_jaw_lets_go_and_does_not_hold_again_without_pressing(held: Grip) -> None:
    heard, needle = events(held.world), held.world.object("needle")
    assert held.arm.jaw is not None
    held.arm.jaw.open().wait(timeout_s=1.0)
    held.world.step(500)
    assert needle.measured_cp().matrix[2, 3] < held.jaw()[2, 3] - 0.1
    held.arm.jaw.close().wait(timeout_s=1.0)
    held.world.step(500)
    assert heard == [("grasp/object", "")]
    assert held.world.grasps()["PSM1"].object == ""


def test_grips_and_drops_are_events_with_force_and_height(held: Grip) -> None:
    found: list[Entry] = []
    held.world.listen(lambda entry: found.append(entry) if entry.kind == "event" else None)
    assert held.arm.jaw is not None
    held.arm.jaw.open().wait(timeout_s=1.0)
    held.world.step(200)
    let_go, dropped = (entry for entry in found if entry.name.startswith("grasp/"))
    assert let_go.values["force"] == pytest.approx(22.0, rel=0.3)
    assert (dropped.name, dropped.values["object"]) == ("grasp/dropped", "needle")
    assert dropped.values["height"] > 0.008
    assert dropped.time - let_go.time == pytest.approx(np.sqrt(2 * 0.008 / 9.81), abs=0.02)


def test_where_it_is_put_the_jaw_no_longer_holds_it(held: Grip) -> None:
    needle = held.world.object("needle")
    at = needle.measured_cp().matrix
    at[:3, 3] += [0.05, 0.05, 0.0]
    needle.set_cp(at)
    held.world.step(20)
    fallen = 0.5 * 9.81 * 0.02**2
    assert needle.measured_cp().matrix[2, 3] == pytest.approx(at[2, 3] - fallen, abs=2e-4)


def test_an_arm_that_is_put_elsewhere_leaves_what_it_held(held: Grip) -> None:
    heard = events(held.world)
    held.world.set_state("PSM1", np.array([-0.3, 0.1, 0.05, 0.0, 0.0, 0.0, 0.5]))
    assert heard == [("grasp/object", "")]
    held.world.step(20)
    assert held.slip()[0] > 0.02


def test_a_saved_world_goes_on_holding_to_the_last_bit(held: Grip, tmp_path: Path) -> None:
    file = tmp_path / "grip.toml"
    file.write_text(rig_text("friction+stick"), encoding="utf-8")
    other = World(file)
    other.load(held.world.save())
    for world in (held.world, other):
        world.arm("PSM1").move_jp([0.3, 0.0, 0.12, 0.2, 0.1, -0.1])
        world.step(700)
    assert other.grasps() == held.world.grasps()
    assert other.grasps()["PSM1"].object == "needle"
    assert np.array_equal(other.save().row, held.world.save().row)


def test_a_reset_leaves_nothing_of_a_hold(held: Grip) -> None:
    world, start = held.world, World(held.world.model)
    for one in (world, start):
        one.reset()
        one.step(300)
    assert np.array_equal(world.save().row, start.save().row)
    assert np.array_equal(world.mj_model.geom_condim, start.mj_model.geom_condim)


def test_motion_does_not_depend_on_how_many_steps_a_call_takes(held: Grip) -> None:
    state = held.world.save()
    rows = []
    for size in (7, 300):
        held.world.load(state)
        held.arm.move_jp([0.3, 0.0, 0.12, 0.2, 0.1, -0.1])
        for _ in range(2100 // size):
            held.world.step(size)
        rows.append(held.world.save().row)
    assert np.array_equal(*rows)


def test_another_arms_new_tool_leaves_what_is_held() -> None:
    from trocar.robot.verification.verb_costs import holding_a_block

    world = holding_a_block()
    assert world.grasps()["PSM1"].object == "block2"
    before = world.object("block2").measured_cp().matrix
    world.exchange_tool("PSM2", "PROGRASP_FORCEPS:420093")
    world.step(200)
    assert world.grasps()["PSM1"].object == "block2"
    assert np.abs(world.object("block2").measured_cp().matrix - before).max() < 1e-4
    world.exchange_tool("PSM1", "PROGRASP_FORCEPS:420093")
    assert world.grasps()["PSM1"].object == ""


def test_a_needle_with_a_friction_of_its_own_is_held_as_well(tmp_path: Path) -> None:
    file = tmp_path / "grip.toml"
    text = rig_text("friction+stick").replace("radius_mm = 0.5", "radius_mm = 0.5, friction = 0.4")
    file.write_text(text, encoding="utf-8")
    held = Grip(file)
    limit = 0.8 * held.world.grasps()["PSM1"].force
    heard = events(held.world)
    held.load(0.85 * limit * WIRE, NOTHING)
    held.world.step(200)
    assert held.slip()[0] < 5e-5
    assert heard == []
    held.load(1.2 * limit * WIRE, NOTHING)
    held.world.step(10)
    assert ("grasp/slipped", "needle") in heard


def test_an_unknown_kind_of_grasp_is_named_with_what_is_allowed(tmp_path: Path) -> None:
    file = tmp_path / "grip.toml"
    file.write_text(rig_text("glue"), encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"grasp: got 'glue'; allowed: friction\+stick"):
        load_rig(file)


def test_the_kind_of_grasp_tells_states_apart(tmp_path: Path) -> None:
    rigs = []
    for kind in ("friction", "friction+stick"):
        file = tmp_path / f"{len(kind)}.toml"
        file.write_text(rig_text(kind), encoding="utf-8")
        rigs.append(World(file).signature)
    assert rigs[0] != rigs[1]


def test_a_wrench_sensor_feels_what_pulls_at_what_the_jaw_holds(tmp_path: Path) -> None:
    file = tmp_path / "grip.toml"
    sensor = '[[sensor]]\nname = "wrist"\nkind = "tip_wrench"\narm = "PSM1"\nframe = "wrist_yaw"\n'
    file.write_text(rig_text("friction+stick") + sensor, encoding="utf-8")
    held = Grip(file)
    held.world.step(100)

    def felt() -> np.ndarray:
        reading = held.world.sensor("wrist")
        assert isinstance(reading, WrenchReading)
        return reading.force

    before = felt()
    held.world.mj_data.xfrc_applied[held.world.mj_model.body("needle").id, 2] = -3.0
    held.world.step(100)
    assert np.linalg.norm(felt() - before) == pytest.approx(3.0, rel=0.02)


def test_an_arm_carries_the_weight_of_what_its_jaw_holds_and_what_pulls_at_it(held: Grip) -> None:
    world = held.world
    needle = world.mj_model.body("needle")
    weight = STANDARD_GRAVITY * float(needle.mass[0])
    for pull in (0.0, 3.0):
        world.mj_data.xfrc_applied[needle.id, 0] = pull
        world.step(200)
        assert world.grasps()["PSM1"].object == "needle"
        found = world.contact_forces()["PSM1"]
        assert found == pytest.approx([pull, 0.0, -weight], abs=2e-4)


def test_contacts_of_what_is_held_are_the_pads_presses(held: Grip) -> None:
    reading = held.world.contact_table()
    force = held.world.grasps()["PSM1"].force
    pressed = np.abs(np.einsum("ij,ij->i", reading.forces, reading.normals)).sum()
    assert pressed == pytest.approx(2.0 * force, rel=0.02)


def test_what_a_jaw_holds_pulls_at_the_arm_where_nothing_touches(held: Grip) -> None:
    model, data = held.world.mj_model, held.world.mj_data
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    held.world.step(1)
    assert data.ncon == 0
    force, dof = held.world.contact_forces()["PSM1"], int(model.body("needle").dofadr[0])
    np.testing.assert_allclose(force, -data.qfrc_constraint[dof : dof + 3], atol=1e-12)
    assert np.linalg.norm(force) > 1e-3
