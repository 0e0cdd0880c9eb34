"""Props that scenes need: joints, bands, soft pads, forces and scripts, by their laws."""

from __future__ import annotations

import logging
import pickle
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.laws import laws
from trocar.descriptions import load_rig
from trocar.errors import DescriptionError, InputError, LogError
from trocar.formats.folder import left_out
from trocar.formats.meshes import obj
from trocar.formats.mjcf import POSITION, mjcf_document
from trocar.recording import record
from trocar.robot.follow.reproduce import repeat
from trocar.simulation import Batch, ContactsReading, ProximityReading, World
from trocar.simulation.scripts import FUNCTION

EXAMPLE = Path(__file__).parents[2] / "examples" / "props" / "play.toml"
GRAVITY = 9.81


@pytest.fixture
def world() -> World:
    return World(EXAMPLE)


def rig_with(folder: Path, more: str) -> Path:
    text = Path(load_rig("ecm").file).read_text(encoding="utf-8")
    (folder / "mine.toml").write_text(text + more, encoding="utf-8")
    return folder / "mine.toml"


def scripted(folder: Path, source: str) -> Path:
    (folder / "script.py").write_text(source)
    prop = (
        '\n[[prop]]\nname = "thing"\nmovable = true\nmass_g = 4\nxyz_m = [2, 2, 2]\n'
        'before_step = "script.py"\n'
        'shape = [{ kind = "sphere", center_mm = [0, 0, 0], radius_mm = 10 }]\n'
    )
    return rig_with(folder, prop)


def test_momentum_friction_soft_pads_and_bands_keep_their_laws() -> None:
    for figure in laws():
        assert figure.met, figure


def test_poses_and_velocities_on_joints_are_those_of_mujoco(world: World) -> None:
    world.object("tray").servo_cf([0, 0, 0, 0.02, 0.01, 0.005])
    world.step(150)
    states, model, data = world.object_states(), world.mj_model, mujoco.MjData(world.mj_model)
    data.qpos[:], data.qvel[:] = world.mj_data.qpos, world.mj_data.qvel
    mujoco.mj_forward(model, data)
    for k, name in enumerate(states.names):
        body, expected = model.body(name).id, np.zeros(6)
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(model, data, kind, body, expected, 0)
        np.testing.assert_allclose(states.positions[k], data.xpos[body], atol=1e-12)
        np.testing.assert_allclose(states.linear[k], expected[3:], atol=1e-9)
        np.testing.assert_allclose(states.angular[k], expected[:3], atol=1e-9)
        turn = world.object(name).measured_cp().matrix[:3, :3]
        np.testing.assert_allclose(turn, data.xmat[body].reshape(3, 3), atol=1e-12)


def test_a_pendulum_swings_with_its_period(tmp_path: Path) -> None:
    length = 0.3
    file = rig_with(
        tmp_path,
        '\n[[prop]]\nname = "bob"\nmovable = true\nmass_g = 50\nxyz_m = [2, 2, 2]\n'
        'joint = { kind = "hinge", axis = [0, 1, 0] }\n'
        f"shape = [{{ kind = 'sphere', center_m = [0, 0, -{length}], radius_mm = 5 }}]\n",
    )
    world = World(file)
    bob = world.object("bob")
    bob.set_jp(0.05)
    times: list[float] = []
    last = 0.05
    while len(times) < 3:
        world.step()
        now = float(bob.measured_js().position[0])
        if last * now < 0.0:
            times.append(world.time - world.timestep * now / (now - last))
        last = now
    inertia = length**2 + 0.4 * 0.005**2
    period = 2.0 * np.pi * np.sqrt(inertia / (GRAVITY * length)) * (1.0 + 0.05**2 / 16.0)
    assert times[2] - times[0] == pytest.approx(period, rel=1e-3)


def test_a_limit_stops_a_joint(world: World) -> None:
    pendulum = world.object("pendulum")
    pendulum.servo_cf([-1.0, 0, 0, 0, 0, 0])
    swung: list[float] = []
    for _ in range(300):
        world.step()
        swung.append(float(pendulum.measured_js().position[0]))
    assert max(swung) == pytest.approx(np.deg2rad(50), abs=0.03)


def test_a_force_accelerates_an_object_by_newton_until_a_reset(tmp_path: Path) -> None:
    world = World(scripted(tmp_path, "def before_step(object, world): pass\n"))
    thing = world.object("thing")
    thing.servo_cf([0.004, 0.0, 0.004 * GRAVITY, 0.0, 0.0, 0.0])
    world.step(100)
    np.testing.assert_allclose(thing.measured_cv().linear, [0.1, 0.0, 0.0], atol=1e-12)
    world.reset()
    world.step(100)
    np.testing.assert_allclose(thing.measured_cv().linear, [0, 0, -0.1 * GRAVITY], atol=1e-12)


def test_a_force_wakes_an_object_that_sleeps(world: World) -> None:
    world.step(1500)
    weight = world.object("weight")
    tree = world.mj_model.body_treeid[world.mj_model.body("weight").id]
    assert world.mj_data.tree_asleep[tree] >= 0
    weight.servo_cf([1.0, 0, 0, 0, 0, 0])
    world.step(20)
    assert weight.measured_cv().linear[0] > 0.1


@pytest.mark.parametrize(
    ("name", "verb", "value", "problem"),
    [
        ("pendulum", "set_cp", np.eye(4), "set_cp: the object is on a hinge; allowed: set_jp"),
        ("ball1", "set_jp", [0.1], "ball1: set_jp: the object is free; allowed: set_cp"),
        ("pendulum", "set_jp", [3.0], "set_jp: got 3; allowed: -2.26893 to 0.872665"),
        ("tray", "set_jp", [1.0, 0.0, 0.0, 1.0], "allowed: a unit quaternion"),
        ("ball1", "servo_cf", [1.0, 2.0], "allowed: 6 finite numbers"),
        ("ball1", "servo_cf", [1e9, 0, 0, 0, 0, 0], "allowed: up to 4.08 N and 0.000408 N m"),
    ],
)
def test_what_an_object_cannot_do_is_rejected_and_nothing_changes(
    world: World, name: str, verb: str, value: object, problem: str
) -> None:
    before = world.save().row
    with pytest.raises(InputError, match=problem):
        getattr(world.object(name), verb)(value)
    assert np.array_equal(world.save().row, before)


def test_a_saved_state_goes_on_to_the_last_bit_with_scripts_and_bands(world: World) -> None:
    world.object("ball2").servo_cf([0.001, 0, 0, 0, 0, 0])
    world.step(120)
    state = pickle.loads(pickle.dumps(world.save()))
    world.step(200)
    expected = world.save().row
    other = World(EXAMPLE)
    other.load(state)
    other.step(200)
    assert np.array_equal(other.save().row, expected)


def test_a_recording_of_scripted_and_jointed_objects_repeats_to_the_last_bit(
    world: World, tmp_path: Path
) -> None:
    heard: list[str] = []
    world.listen(lambda entry: heard.append(entry.name))
    with record(world, tmp_path / "play.mcap"):
        world.step(60)
        world.object("pendulum").set_jp([-1.0])
        world.step(60)
    report = repeat(tmp_path / "play.mcap")
    assert report.identical, report.difference
    assert heard == ["set_jp"]  # what the script commands is commanded again by the script


SCRIPT = """
calls = 0
def before_step(object, world):
    global calls
    calls += 1
    object.servo_cf([0.0, 0.0, 0.01 * (calls % 7), 0.0, 0.0, 0.0])
"""


def test_a_load_with_scripts_is_repeated_from_before_it_or_from_after_a_reset(
    tmp_path: Path,
) -> None:
    """A script's own memory is in no state."""
    world = World(scripted(tmp_path, SCRIPT))
    world.step(5)
    with record(world, tmp_path / "before.mcap"):
        state = world.save()
        world.step(31)
        world.load(state)
        world.step(31)
    assert repeat(tmp_path / "before.mcap").identical
    with record(world, tmp_path / "after.mcap"):
        world.step(5)
    with pytest.raises(LogError, match="cannot be repeated: it began after a saved state"):
        repeat(tmp_path / "after.mcap")
    world.reset()
    with record(world, tmp_path / "reset.mcap"):
        world.step(5)
    assert repeat(tmp_path / "reset.mcap").identical


def test_a_script_that_raises_is_named_and_the_simulation_goes_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = (
        "def before_step(object, world):\n"
        "    object.servo_cf([0.0] * 6)\n"
        "    if world.time > 0.01:\n"
        "        raise RuntimeError('enough')\n"
    )
    world = World(scripted(tmp_path, source))
    heard: list[str] = []
    world.listen(lambda entry: heard.append(f"{entry.source} {entry.values.get('text', '')}"))
    with caplog.at_level(logging.WARNING):
        world.step(50)
    said = "line 4: RuntimeError: enough; thing is scripted no longer"
    expected = f"{tmp_path / 'script.py'}: {said}"
    assert heard == [f"thing {expected}"] and expected in caplog.text
    assert world.time == pytest.approx(0.05) and world.save().parts["scripts"] == ()
    world.reset()
    assert world.save().parts["scripts"] == ("thing",)


@pytest.mark.parametrize(
    ("source", "problem"),
    [
        ("def before_step(object, world:\n", "script.py: line 1: is no Python"),
        (
            "def after_step(object, world): pass\n",
            f"functions after_step; allowed: with {FUNCTION}",
        ),
        ("import nothing_of_this_name\n", "line 1: ModuleNotFoundError"),
    ],
)
def test_a_script_that_is_none_is_an_error_of_the_rig(
    source: str, problem: str, tmp_path: Path
) -> None:
    with pytest.raises(DescriptionError, match=problem):
        World(scripted(tmp_path, source))


def test_a_script_must_not_step_or_reset_the_world(tmp_path: Path) -> None:
    world = World(scripted(tmp_path, "def before_step(object, world): world.step()\n"))
    heard: list[str] = []
    world.listen(lambda entry: heard.append(str(entry.values)))
    world.step(3)
    assert len(heard) == 1 and "got a call by the script of thing; allowed: outside" in heard[0]
    assert world.periods == 3


def test_a_batch_rejects_scripts_and_reads_objects_on_joints(tmp_path: Path, world: World) -> None:
    with pytest.raises(InputError, match="slider has a before_step script"):
        Batch(world, 2)
    file = tmp_path / "bare.toml"
    text = EXAMPLE.read_text(encoding="utf-8").replace('before_step = "shake.py"\n', "")
    file.write_text(text)
    one = World(file)
    batch = Batch(one, 2)
    readings = batch.step(n=100)
    one.step(100)
    states = one.object_states()
    for k, name in enumerate(states.names):
        expected = [*states.positions[k], *states.quaternions[k]]
        np.testing.assert_array_equal(readings.objects[name], [expected, expected])


def test_a_rig_s_own_file_adds_to_the_model(tmp_path: Path) -> None:
    (tmp_path / "more.py").write_text(
        "def extend_spec(spec):\n"
        "    body = spec.worldbody.add_body(name='extra', pos=[2, 2, 2])\n"
        "    body.add_freejoint()\n"
        "    body.add_geom(size=[0.01, 0, 0], mass=0.01)\n"
    )
    file = rig_with(tmp_path, "")
    file.write_text('extend_spec = "more.py"\n' + file.read_text(encoding="utf-8"))
    world = World(file)
    world.step(100)
    joint = world.mj_model.body("extra").jntadr[0]
    fallen = float(world.mj_data.qpos[world.mj_model.jnt_qposadr[joint] + 2])
    assert fallen == pytest.approx(2.0 - 0.5 * GRAVITY * 0.1 * 0.101, rel=1e-9)
    for source, problem in (
        ("def extend_spec(spec): spec.nothing()\n", "more.py: line 1: AttributeError"),
        ("def extend_spec(spec): spec.add_key(name='k')\n", "added an actuator or a keyframe"),
        ("x = 1\n", "got the functions none; allowed: with extend_spec"),
    ):
        (tmp_path / "more.py").write_text(source)
        with pytest.raises(DescriptionError, match=problem):
            World(file)


def test_sensors_on_props_see_what_is_there(world: World) -> None:
    world.step(1000)
    reading = world.sensor("scale")
    assert isinstance(reading, ContactsReading)
    scale = reading.contacts
    assert {c.other for c in scale} == {"weight"}
    load = sum(c.force for c in scale)
    np.testing.assert_allclose(load, [0, 0, -GRAVITY * world.object("weight").mass], atol=1e-3)
    T = world.object("tray").measured_cp().matrix
    world.object("ball1").set_cp(
        T @ np.block([[np.eye(3), np.array([[0], [0], [0.005]])], [0, 0, 0, 1]])
    )
    gate = world.sensor("gate")
    assert isinstance(gate, ProximityReading) and gate.body == "ball1"
    assert gate.distance == pytest.approx(0.034 - 0.0049, abs=2e-4)


def test_mjcf_keeps_joints_bands_and_softness_and_other_files_say_what_they_lack() -> None:
    rig = load_rig(EXAMPLE)
    text, meshes = mjcf_document(rig, POSITION)
    assets = {f"{name}.obj": obj(mesh) for name, mesh in meshes.items()}
    model = mujoco.MjModel.from_xml_string(text.decode(), assets)
    ours = World(EXAMPLE, dynamics="cad").mj_model
    for field in ("ntendon", "nexclude", "njnt"):
        assert getattr(model, field) == getattr(ours, field), field
    soft = [ours.pair(k).name.startswith("soft") for k in range(ours.npair)]
    np.testing.assert_allclose(model.tendon_stiffness, ours.tendon_stiffness)
    np.testing.assert_allclose(model.pair_solref, ours.pair_solref[soft], rtol=1e-9)
    np.testing.assert_allclose(
        model.jnt_range[model.joint("pendulum_hinge").id], np.deg2rad([-130, 50])
    )
    said = " ".join(left_out(rig))
    for lost in ("pendulum", "rubber", "pad", "slider", "shake.py"):
        assert lost in said, lost


def test_bands_are_drawn_from_point_to_point(world: World) -> None:
    rods = [shape for shape in world.shapes() if shape.name.startswith("rubber/")]
    snapshot = world.snapshot(arms=False)
    at = snapshot.positions[[rod.body for rod in rods]]
    ends = [np.array([0.06, -0.06, 0.038]), np.array([0.026, -0.06, 0.005])]
    half = rods[0].size[1]
    for end, rod in ((ends[0], at[0]), (ends[1], at[-1])):
        assert np.linalg.norm(rod - end) == pytest.approx(half, rel=1e-6)
