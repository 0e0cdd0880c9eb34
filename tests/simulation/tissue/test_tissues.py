"""Soft tissue: the condensed mesh, its motion, tearing, saved states, plans and bad input."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.needles import needle_sizes
from trocar.descriptions.table import parse_table
from trocar.descriptions.tissues import Tissue, read_tissue
from trocar.errors import DescriptionError, InputError
from trocar.geometry.rotations import quaternion_from_matrix, rotation_z
from trocar.geometry.se3 import inverse, transform
from trocar.simulation import World
from trocar.simulation.batch import Batch
from trocar.simulation.journal import Entry, Journal
from trocar.simulation.records import DrawnCurve, DrawnSurface
from trocar.simulation.tissue.elastic import ElasticPad
from trocar.simulation.tissue.tissues import RISE, SoftTissue, default_plan, stitch_points

TEXT = """
length_mm = 20
width_mm = 12
depth_mm = 6
gap_mm = 2
modulus_kpa = 200
element_mm = 1.5
puncture_n = 0.5
drag_n = 0.06
tear_n = 15
needle = "needle"
thread = { length_mm = 60, knot_mm = 4, friction_n = 0.04, radius_mm = 0.1 }
"""


def described(text: str = TEXT) -> Tissue:
    """Return the tissue of a description."""
    return read_tissue(parse_table(text, "t.toml"), {"needle": needle_sizes()["half_26"]})


@pytest.fixture(scope="module")
def world() -> World:
    """The scene's rig with a coarse tissue, and nothing that moves."""
    rig = load_scene("suturing").rig
    props = [
        replace(p, tissue=replace(p.tissue, element=1.5e-3)) if p.tissue else p for p in rig.props
    ]
    return World(replace(rig, props=tuple(props)))


def push(world: World, force: NDArray[np.float64], place: str = "entry") -> None:
    """Let a force act on a place of the tissue from now on [N]."""
    world.mj_data.xfrc_applied[world.mj_model.body(f"pad/0/{place}").id, :3] = force


def pad_of(world: World) -> SoftTissue:
    """Return the tissue after a reset."""
    world.reset()
    return world.tissues["pad"]


def test_a_rigid_motion_of_the_mesh_takes_no_force() -> None:
    pad = ElasticPad(described())
    about = np.array([0.1, 0.2, 0.3]) + np.cross([0.3, -0.2, 1.0], pad.nodes)
    assert np.abs(pad.matrix @ about.ravel()).max() < 1e-11 * np.abs(pad.matrix.data).max()


def test_a_uniform_strain_gives_the_stress_of_elasticity_inside() -> None:
    """The patch test: no inner node takes a force; the top takes the confined modulus."""
    tissue = described()
    pad = ElasticPad(tissue)
    moved = np.zeros_like(pad.nodes)
    moved[:, 2] = 0.01 * pad.nodes[:, 2]
    forces = (pad.matrix @ moved.ravel()).reshape(-1, 3)
    nu = tissue.poisson
    confined = tissue.modulus * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))
    top = np.isclose(pad.nodes[:, 2], 0.0)
    area = 2.0 * tissue.length * tissue.width
    assert forces[top, 2].sum() == pytest.approx(0.01 * confined * area, rel=1e-9)
    inner = ~top & ~np.isclose(pad.nodes[:, 2], -tissue.depth)
    assert np.abs(forces[inner, 2]).max() < 1e-9


def test_a_place_yields_to_a_force_as_the_whole_mesh_does(world: World) -> None:
    tissue, force = pad_of(world), np.array([0.02, 0.1, -0.1])
    push(world, force)
    world.step(1500)
    push(world, np.zeros(3))
    pad, weights = tissue.pad, tissue.pad.weights(tissue.plan[0, 0])
    nodes = pad.solve((weights[:, None] * force).ravel()).reshape(-1, 3)
    assert tissue.read().displacements[0, 0] == pytest.approx(weights @ nodes, rel=5e-3)
    assert tissue.displacements() == pytest.approx(nodes, abs=2e-3 * np.abs(nodes).max())


def test_energy_only_falls_when_nothing_is_driven(world: World) -> None:
    tissue = pad_of(world)
    push(world, np.array([0.0, 0.5, -0.5]), "inner_in")
    world.step(500)
    push(world, np.zeros(3), "inner_in")
    rows = [world.mj_model.joint(f"pad/0/{p}/x").dofadr[0] for p in ("entry", "edge_out")]
    rows = slice(int(rows[0]), int(rows[1]) + 3)
    energies: list[float] = []
    for _ in range(60):
        read = tissue.read()
        elastic = -0.5 * float(np.vdot(read.forces, read.displacements))
        v = world.mj_data.qvel[rows]
        energies.append(elastic + 0.5 * float(world.mj_model.dof_M0[rows] @ v**2))
        world.step(1)
    falls = np.diff(energies)
    assert (falls < 1e-2 * energies[0]).all()  # symplectic steps swing by a share of it
    assert energies[-1] < 0.05 * energies[0]


def test_drag_and_thread_have_the_forces_of_the_description(world: World) -> None:
    """A needle is turned through tissue as a heavy hand would, and pulled by known forces.

    Drag along a channel is its setting to 10 %, as soon as the channel has found its place; the
    thread stretches by less than 1 % at 1 N, and is less than 0.5 mm too long at 3 N.
    """
    tissue, model, data = pad_of(world), world.mj_model, world.mj_data
    wire, joint, body = tissue.tissue.wire, model.joint("needle/free"), model.body("needle").id
    rows, turns = int(joint.dofadr[0]), slice(int(joint.qposadr[0]) + 3, int(joint.qposadr[0]) + 7)
    # of a needle whose swage is towards +y, its axis along the wound
    lying = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = lying, tissue.pose[:3, 3] + [0.0, 0.0, RISE * wire.radius]
    rate, angle = 3.0, np.radians(20.0) - wire.arc
    model.dof_armature[rows : rows + 6] = [1.0] * 3 + [1e-3] * 3
    drags: list[NDArray[np.float64]] = []
    world.objects["needle"].set_cp(pose)
    while not tissue.left[0].all():
        angle += rate * world.timestep
        data.qpos[turns] = quaternion_from_matrix(lying @ rotation_z(angle))
        data.qpos[turns.start - 3 : turns.start] = pose[:3, 3]
        data.qvel[rows : rows + 6] = [0.0] * 5 + [rate]
        world.step(1)
        if tissue.passed[0].all() and not tissue.left[0].any():
            read = tissue.read()
            along = np.cross(lying[:, 2], read.points[0] - pose[:3, 3])
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            forces = read.forces[0, :4] @ tissue.pose[:3, :3].T
            drags.append(np.abs((forces * along).sum(axis=1)))
    settled = np.array(drags)[-len(drags) // 3 :].mean(axis=0)
    assert settled == pytest.approx(tissue.tissue.drag, rel=0.1)
    model.dof_armature[rows : rows + 6] = [0.05] * 3 + [1e-4] * 3
    for newton, steps in ((1.0, 800), (3.0, 1200)):
        before = float(np.linalg.norm(data.xfrc_applied[body]))
        for k in range(steps):
            now = before + (newton - before) * min(1.0, 2.0 * k / steps)
            data.xfrc_applied[body, :3] = [0.0, -0.5 * now, 0.866 * now]
            data.qvel[rows : rows + 3] *= 0.98
            world.step(1)
        read = tissue.read()
        swage, _, points, fed = tissue.threaded()
        length = fed + float(np.linalg.norm(swage - points[0]))
        assert read.tension == pytest.approx(newton, rel=0.1)
        assert read.excess < min(0.01 * length, 5e-4)
    data.xfrc_applied[body] = model.dof_armature[rows : rows + 6] = 0.0


def test_a_tip_that_goes_in_beside_the_plan_is_reported_once(world: World) -> None:
    tissue, heard = pad_of(world), list[Entry]()
    wire, pose = tissue.tissue.wire, np.eye(4)
    stop = world.listen(heard.append)
    for deep in (0.0, 2e-3, 2.5e-3):  # the tip points down, 4.5 mm along the wound from the plan
        pose[:3, :3] = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
        pose[:3, :3] = pose[:3, :3] @ rotation_z(0.5 * np.pi)
        tip = pose[:3, :3] @ wire.tip[:3, 3]
        entry = tissue.pose[:3, 3] + tissue.plan[0, 0] + [4.5e-3, 0.0, -deep]
        pose[:3, 3] = entry - tip
        world.objects["needle"].set_cp(pose)
        world.step(5)
    stop()
    (astray,) = [entry for entry in heard if entry.name == "astray"]
    assert np.array(astray.values["offset"])[0] == pytest.approx(4.5e-3, abs=3e-4)
    assert tissue.astray
    assert not tissue.passed.any()


def test_what_tears_out_is_reported_and_no_longer_held(world: World) -> None:
    tissue, heard = pad_of(world), list[Entry]()
    stop = world.listen(heard.append)
    push(world, np.array([0.0, 0.0, 20.0]), "exit")
    while world.time < 0.2 and not tissue.torn.any():
        world.step(5)
    stop()
    push(world, np.zeros(3), "exit")
    tears = [entry for entry in heard if entry.name == "tear"]
    assert [entry.values["place"] for entry in tears] == ["exit"]
    read = tissue.read()
    assert read.torn[0].tolist() == [False, False, False, True, *[False] * 4]
    assert not read.forces[0, 3].any()


def test_a_tissue_stands_where_it_was_put_and_a_saved_state_brings_it_back(world: World) -> None:
    tissue, pose = pad_of(world), np.eye(4)
    pose[:3, 3] = 0.01, -0.01, 0.012
    before = world.save()
    tissue.set_cp(pose, stiffness=2.0)
    world.step(5)
    skin = {one.name: one for one in world.snapshot(arms=False).drawings}["pad_skin"]
    assert isinstance(skin, DrawnSurface)
    assert skin.vertices[:, 2].max() == pytest.approx(0.012, abs=1e-6)
    body = world.mj_model.body("pad").id
    assert world.snapshot(arms=False).positions[body] == pytest.approx(pose[:3, 3])
    world.load(before)
    assert tissue.stiffness == 1.0
    assert world.snapshot(arms=False).positions[body] == pytest.approx([0.0, 0.0, 0.01])


def test_the_thread_is_drawn_with_its_length_from_the_needle_on(world: World) -> None:
    tissue = pad_of(world)
    world.step(20)
    curve = {one.name: one for one in world.snapshot(arms=False).drawings}["pad_thread"]
    assert isinstance(curve, DrawnCurve)
    long = np.linalg.norm(np.diff(curve.points, axis=0), axis=1).sum()
    assert long == pytest.approx(tissue.tissue.thread.length, rel=0.05)
    swage = world.objects["needle"].measured_cp().matrix @ [*tissue.tissue.wire.swage[:3, 3], 1.0]
    assert curve.points[0] == pytest.approx(swage[:3], abs=2e-4)


def inside(world: World, points: NDArray[np.float64]) -> list[str]:
    """Return the boxes and capsules of jaws, needle and ground that points are in."""
    model, data, found = world.mj_model, world.mj_data, list[str]()
    for geom in np.flatnonzero(model.geom_conaffinity):
        local = (points - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
        size = model.geom_size[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            within = (np.abs(local) < size).all(axis=1)
        elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE:
            local[:, 2] -= np.clip(local[:, 2], -size[1], size[1])
            within = np.linalg.norm(local, axis=1) < size[0]
        else:
            continue
        found += [model.geom(int(geom)).name] * int(within.sum())
    return found


def drawn_thread(world: World) -> NDArray[np.float64]:
    """Return the points of the thread as it is drawn now."""
    curve = {one.name: one for one in world.snapshot(arms=False).drawings}["pad_thread"]
    assert isinstance(curve, DrawnCurve)
    return curve.points


def test_the_drawn_thread_stays_outside_of_jaws_and_needle(world: World) -> None:
    """Two points are left out: the thread begins in the needle. The jaw shuts on the thread."""

    def run() -> tuple[NDArray[np.float64], float]:
        pad_of(world)
        arm, moved = world.arms["PSM1"], 0.0
        last = drawn_thread(world)
        down = transform(np.diag([1.0, -1.0, -1.0]), last[30] + np.array([0.0, 0.0, 0.0095]))
        local = inverse(world.reference_pose("PSM1")) @ down
        at = arm.local.inverse_kinematics(local, arm.runtime.motors.position[:-1])
        for opening in (0.6, 0.4, 0.2, 0.0):
            world.set_state("PSM1", np.append(at, opening))
            for _ in range(5):
                world.step(4)
                points = drawn_thread(world)
                assert inside(world, points[2:]) == []
                moved = max(moved, float(np.abs(points - last).max()))
                last = points
        return last, moved

    points, moved = run()
    assert moved > 1e-3  # the jaw pushed it aside
    assert np.array_equal(run()[0], points)


def test_the_drawn_thread_lies_on_the_tissue_as_it_bulges(world: World) -> None:
    tissue = pad_of(world)
    push(world, np.array([0.0, 0.0, 0.5]))
    above, points = transform(np.eye(3), np.array([0.0, 0.0, 0.016])), np.zeros((0, 3))
    for _ in range(40):
        world.objects["needle"].set_cp(above)
        world.step(20)
        points = drawn_thread(world)
    push(world, np.zeros(3))
    upper = np.isclose(tissue.pad.nodes[:, 2], 0.0)
    top = (tissue.pad.nodes + tissue.displacements())[upper] + tissue.pose[:3, 3]
    radius = tissue.tissue.thread.radius
    over = points[2:][(np.abs(points[2:, :2]) < [0.014, 0.016]).all(axis=1)]
    assert len(over) > 10 and top[:, 2].max() > 0.0105
    nearest = np.linalg.norm(over[:, None, :2] - top[:, :2], axis=2).argmin(axis=1)
    assert (over[:, 2] > top[nearest, 2] + 0.5 * radius).all()
    assert over[:, 2].min() < 0.011  # it lies there


def test_a_plan_outside_of_the_tissue_is_refused(world: World) -> None:
    tissue = pad_of(world)
    good = default_plan(tissue.tissue)
    for change, words in (
        ([0.02, 0.0, 0.0], "leaves the tissue"),
        ([0.0, 0.0, -0.004], "leaves the tissue"),
        ([0.0, 0.0025, 0.0], "in order"),
    ):
        with pytest.raises(InputError, match=words):
            tissue.set_plan(good + change)
    with pytest.raises(InputError, match="shape"):
        tissue.set_plan(np.zeros((2, 4, 3)))
    for wild in (np.nan, 1.7e308):
        with pytest.raises(InputError, match="up to 1000 m away"):
            tissue.set_plan(good + wild)
    for stitch in (0, -1, 0.5, "", None):
        with pytest.raises(InputError, match="allowed: one that the needle has left"):
            tissue.lock(stitch)  # type: ignore[arg-type]
    assert np.array_equal(tissue.plan, good)


def test_thread_shorter_than_the_path_is_refused(world: World) -> None:
    prop = next(prop for prop in world.rig.props if prop.tissue is not None)
    tissue = pad_of(world).tissue
    short = replace(tissue, thread=replace(tissue.thread, length=0.018))
    made = SoftTissue(replace(prop, tissue=short), 3, 1e-3, Journal())
    with pytest.raises(InputError, match="mm of thread before its knot; needed"):
        made.set_plan([stitch_points(short, 0.0, 0.00828, 0.005)])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("modulus_kpa = 200", "modulus_kpa = 0.1", "kPa; allowed: 1 to 10000 kPa"),
        ("element_mm = 1.5", "element_mm = 0.2", "nodes; allowed: up to 20000"),
        ("depth_mm = 6", "depth_mm = 2", "two elements"),
        ('needle = "needle"', 'needle = "pin"', "got 'pin'; allowed: needle"),
        ("knot_mm = 4", "knot_mm = 80", "less than the thread's length"),
        ("tear_n = 15", "tear_n = 0", "allowed: above 0"),
        ("gap_mm = 2", "gap_mm = 2\npoisson = 0.5", "allowed: 0 to 0.49"),
        ("gap_mm = 2", "gap_mm = 2\nstitches = 20", "allowed: 1 to 8"),
    ],
)
def test_impossible_tissue_is_refused(old: str, new: str, words: str) -> None:
    with pytest.raises(DescriptionError, match=words):
        described(TEXT.replace(old, new))


def test_tools_are_not_exchanged_and_no_batches_made_of_a_rig_with_tissue(world: World) -> None:
    with pytest.raises(InputError, match="tissue"):
        world.exchange_tool("PSM1", "none")
    with pytest.raises(InputError, match="soft tissue, pad"):
        Batch(world, 2)
