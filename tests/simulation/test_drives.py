"""Identified drivetrains in the simulation: pre-sliding friction, springs, rotors, biases."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trocar import Batch, World, build, load_rig
from trocar.descriptions.calibrated import as_overlay
from trocar.descriptions.catalogue import DATA
from trocar.descriptions.overlay import Overlay
from trocar.errors import DescriptionError, InputError
from trocar.modeling.options import ModelOptions
from trocar.simulation.drives import Drives, Drivetrains, Springs, spring_fields

Array = NDArray[np.float64]

TERMS = ("rotor", "coulomb", "viscous", "offset", "stops", "stiffness", "harmonic", "cable")


def overlay(name: str, *terms: str) -> Overlay:
    """Return shipped dynamics with these terms of their drivetrains alone."""
    found = as_overlay(name)
    assert found.dynamics is not None
    trains = {
        label: replace(
            train,
            terms={term: value for term, value in train.terms.items() if term in terms},
            stop_limits=train.stop_limits if "stops" in terms else (),
        )
        for label, train in found.dynamics.drivetrains.items()
    }
    return replace(found, dynamics=replace(found.dynamics, drivetrains=trains))


def drives(world: World) -> Drives:
    found = world.part(Drivetrains).drives
    assert found is not None
    return found


@pytest.mark.parametrize(("rig", "name"), [("psm", "psm"), ("mtm", "mtmr")])
def test_friction_never_gives_energy(rig: str, name: str, rng: np.random.Generator) -> None:
    world = World(rig, calibration=overlay(name, "stops"))
    bank = drives(world)
    fields = spring_fields(world.mj_model)
    springs = Springs(fields, np.zeros(bank.elements))
    qpos = world.mj_data.qpos.copy()
    bank.begin(qpos, springs)
    arm = next(iter(world.arms.values()))
    couple, rows = world.joints.couple, bank.coordinates
    work = 0.0
    for _ in range(2000):
        step = couple @ (0.02 * rng.standard_normal(len(world.joints)))
        qpos = qpos + step
        bank.renew(qpos, springs)
        stiffness, rest = bank.read(fields)
        force = stiffness * (rows @ qpos - rest)
        work += float(force @ (rows @ step))
        assert work > -1e-9, arm.name
    assert work > 0.1


def test_a_released_arm_in_motion_only_loses_energy_by_friction() -> None:
    """Kinetic energy and what the stop elements store; the sampled springs gain 2e-9 J at most."""
    world = World(
        "psm",
        calibration=overlay("psm", "rotor", "coulomb", "viscous", "stops"),
        gravity_compensation=False,
        collisions=False,
    )
    model, data, bank = world.mj_model, world.mj_data, drives(world)
    model.opt.gravity[:] = 0.0
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    world.arm("PSM1").joints.set_mode("effort")
    world.set_state(
        "PSM1", np.array([0, 0, 0.12, 0, 0, 0, 0.5]), np.array([0.5, 0.4, 0.05, 4, 3, 3, 0])
    )
    there = mujoco.MjData(model)
    found = []
    for _ in range(1800):
        world.step()
        there.qpos[:], there.qvel[:] = data.qpos, data.qvel
        mujoco.mj_forward(model, there)
        saved = world.save().parts["drives"]
        assert saved is not None
        found.append(there.energy[1] + bank.stored(data.qpos, saved[0]))
    energy = np.array(found)
    assert (np.diff(energy) < 1e-7).all()
    assert there.energy[1] < 1e-6 * energy[0]  # it stands still


def test_stop_elements_close_a_loop_of_their_own_width() -> None:
    world = World("psm", calibration=overlay("psm", "stops"))
    bank = drives(world)
    train = as_overlay("psm").dynamics.drivetrains["yaw"]  # type: ignore[union-attr]
    fields = spring_fields(world.mj_model)
    springs = Springs(fields, np.zeros(bank.elements))
    qpos = np.zeros(world.mj_model.nq)
    bank.begin(qpos, springs)
    yaw = world.joints.names.index("PSM1/yaw")
    forces = []
    for angle in [*np.linspace(0.0, 0.5, 300), *np.linspace(0.5, 0.0, 300)]:
        qpos = world.joints.couple[:, yaw] * angle
        bank.renew(qpos, springs)
        stiffness, rest = bank.read(fields)
        own = stiffness * (bank.coordinates @ qpos - rest)
        forces.append(float(own @ bank.coordinates @ world.joints.couple[:, yaw]))
    slipping = sum(
        k * limit for k, limit in zip(train.terms["stops"], train.stop_limits, strict=True)
    )
    assert forces[299] == pytest.approx(slipping, rel=1e-6)
    assert forces[-1] == pytest.approx(-slipping, rel=1e-6)


def test_a_released_arm_with_compensation_stays_where_it_is_put() -> None:
    world = World("psm", calibration="psm")
    arm = world.arm("PSM1")
    assert arm.joints.gravity_compensation
    for goal in ([0.3, 0.2, 0.14, 0.3, 0.3, 0.2], [-0.4, -0.3, 0.08, -0.4, 0.2, -0.3]):
        arm.move_jp(goal).wait()
        world.step(500)
        arm.free()
        put = arm.joints.positions()
        world.step(1500)
        rests = arm.joints.positions()
        world.step(3000)
        assert np.abs(rests - put).max() < 0.03  # what the cables give back
        assert np.abs(arm.joints.positions() - rests).max() < 2e-4


def test_without_compensation_it_falls_as_the_identified_model_says() -> None:
    world = World("psm", calibration=overlay("psm", *(set(TERMS) - {"stops", "coulomb"})))
    arm = world.arm("PSM1")
    q = np.array([0.4, 0.3, 0.14, 0.3, 0.0, 0.0, 0.0])
    world.set_state("PSM1", q)
    load = world.servos.holding.copy()
    arm.joints.use_gravity_compensation(False)
    arm.joints.set_mode("effort")
    world.step(15)
    gone = arm.joints.positions() - q
    heavy = np.abs(load[:4]) > 0.1 * np.abs(load[:4]).max() * np.array([1, 1, 1, 0.01])
    assert heavy.any()
    assert (np.sign(gone[:4]) == -np.sign(load[:4]))[heavy].all()


def test_states_and_batches_have_the_drives() -> None:
    first, second = World("psm", calibration="psm"), World("psm", calibration="psm")
    first.arm("PSM1").servo_jp([0.2, 0.1, 0.13, 0.2, 0.2, 0.1])
    first.step(133)
    second.load(first.save())
    batch = Batch(first, 2, threads=1)
    goal = np.array([0.1, 0.2, 0.12, 0.0, 0.3, 0.1, 0.2])
    for world in (first, second):
        arm = world.arm("PSM1")
        arm.servo_jp(goal[:6])
        assert arm.jaw is not None
        arm.jaw.servo_jp(goal[6:])
        world.step(171)
    assert np.array_equal(first.save().row, second.save().row)
    with pytest.raises(InputError, match="jnt_stiffness"):
        batch.expand("jnt_stiffness")


def test_worlds_of_a_batch_move_as_worlds_do() -> None:
    batch, world = (
        Batch(World("psm", calibration="psm"), 2, threads=1),
        World("psm", calibration="psm"),
    )
    goal = np.array([0.1, 0.2, 0.12, 0.0, 0.3, 0.1, 0.2])
    arm = world.arm("PSM1")
    assert arm.jaw is not None
    for size in (1.0, -0.5):
        q = goal * [size, size, 1.0, size, size, size, 1.0]
        batch.step(np.stack([q, 0.5 * q]), n=57)
        arm.servo_jp(q[:6])
        arm.jaw.servo_jp(q[6:])
        world.step(57)
    assert np.array_equal(batch.rows[0], world.save().row)
    batch.reset(np.array([True, False]))
    batch.step(np.stack([goal, goal]), n=57)
    world.reset()
    arm.servo_jp(goal[:6])
    arm.jaw.servo_jp(goal[6:])
    world.step(57)
    assert np.array_equal(batch.rows[0], world.save().row)


def test_identified_dynamics_are_those_of_arms_without_others() -> None:
    world = World("mtm")
    assert world.arm("MTMR").description.overlay is not None
    assert world.arm("MTML").description.overlay is None  # there is no recording of one
    assert World("psm", friction="paper").part(Drivetrains).drives is None
    own = World("psm", calibration=overlay("psm", "viscous"))
    assert drives(own).stored(np.zeros(13), np.zeros(0)) == 0.0
    with pytest.raises(InputError, match="dynamics: got 'urdf'; allowed: cad, identified"):
        World("psm", dynamics="urdf")  # type: ignore[arg-type]


def test_the_descriptions_dynamics_can_be_selected_by_argument_overlay_and_rig(
    tmp_path: Path,
) -> None:
    text = (DATA / "rigs" / "psm.toml").read_text(encoding="utf-8")
    file = tmp_path / "psm.toml"
    file.write_text(text.replace("schema = 1", 'schema = 1\ndynamics = "cad"'), encoding="utf-8")
    selected = World("psm", dynamics="cad")
    assert selected.part(Drivetrains).drives is None
    assert World("psm", calibration="cad").part(Drivetrains).drives is None
    assert World(load_rig("psm", ["cad"])).part(Drivetrains).drives is None
    assert World(selected.rig).part(Drivetrains).drives is None
    assert World(file).part(Drivetrains).drives is None
    assert World(file, dynamics="identified").part(Drivetrains).drives is not None
    file.write_text(text.replace("schema = 1", 'schema = 1\ndynamics = "urdf"'), encoding="utf-8")
    with pytest.raises(DescriptionError, match="dynamics: got 'urdf'; allowed: identified, cad"):
        World(file)


@pytest.mark.parametrize("finger", ["finger_left", "finger_right"])
def test_a_force_on_either_finger_leaves_both_coupled(finger: str) -> None:
    """The rotors are on tendons to one finger only; what follows it must not give way by itself."""
    world = World("psm")
    model, data = world.mj_model, world.mj_data
    dofs = [model.joint(f"PSM1/finger_{side}").dofadr[0] for side in ("left", "right")]
    assert world.arm("PSM1").jaw is not None
    world.arm("PSM1").jaw.servo_jp([0.5])  # type: ignore[union-attr]
    data.qfrc_applied[model.joint(f"PSM1/{finger}").dofadr] = 0.05  # 5 N on a pad
    world.step(500)
    assert abs(data.qpos[dofs].sum()) < 1e-6


def test_drives_need_identified_dynamics() -> None:
    assert World("psm", calibration="psm", friction="paper").part(Drivetrains).drives is None
    plain = build(load_rig("psm", "psm"), ModelOptions(standalone=True))
    assert plain.mj.ntendon == 0
    assert plain.mj.dof_frictionloss.max() > 0.05


def test_a_mounted_tool_keeps_the_state_of_other_arms() -> None:
    world = World("two_psm_ecm", calibration="psm")
    for name in ("PSM1", "PSM2"):
        world.arm(name).servo_jp([0.1, 0.1, 0.13, 0.2, 0.2, 0.1])
    world.step(200)
    other = World("two_psm_ecm", calibration="psm")
    other.load(world.save())
    world.exchange_tool("PSM1", "none")
    world.exchange_tool("PSM1", "LARGE_NEEDLE_DRIVER:400006")
    for one in (world, other):
        one.step(200)
    np.testing.assert_allclose(
        world.arm("PSM2").joints.positions(), other.arm("PSM2").joints.positions(), atol=1e-12
    )
