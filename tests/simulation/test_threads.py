"""Thread of links: weight, tension, energy, jaws that hold it, saved states, and bad input."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from trocar import load_scene
from trocar.descriptions import RigDescription, load_rig
from trocar.descriptions.props import read_props
from trocar.descriptions.table import parse_table
from trocar.errors import DescriptionError, InputError
from trocar.geometry.se3 import transform
from trocar.simulation import World
from trocar.simulation.journal import Entry
from trocar.simulation.threads import MOVE_M_S, TURN_RAD_S

GRAVITY = 9.81
SHELF = """
[[prop]]
name = "shelf"
xyz_mm = [0, 300, 200]
shape = [{ kind = "box", center_mm = [0, 0, -5], size_mm = [60, 60, 10] }]
"""
#: A block on the shelf that juts out, and a thread that hangs from its edge.
HANGING = (
    SHELF
    + """
[[prop]]
name = "block"
movable = true
mass_kg = 1
xyz_mm = [20, 300, 210]
shape = [{ kind = "box", center_mm = [0, 0, 0], size_mm = [50, 40, 20] }]

[[prop]]
name = "thread"
kind = "thread"
size = "usp_3_0"
length_mm = 80
xyz_mm = [44, 300, 199]
rpy_deg = [0, 90, 0]
joint = { kind = "ball", on = "block" }
"""
)
#: In the air, where the jaw of PSM1 is.
HELD = """
[[prop]]
name = "thread"
kind = "thread"
size = "usp_3_0"
friction = 0.05
length_mm = 60
"""


def rig(text: str) -> RigDescription:
    """Return the training rig with one instrument and further props."""
    base = load_rig("training")
    arms = tuple(arm for arm in base.arms if arm.name == "PSM1")
    start = {"start": {"PSM1": base.poses["start"]["PSM1"]}}
    props = (*base.props, *read_props(parse_table(text, "t.toml"), ["PSM1"]))
    return replace(base, arms=arms, props=props, poses=start, cameras=(), sensors=(), teleops=())


def pull(world: World, force: list[float]) -> None:
    """Let a force act on the middle of the last link from now on [N]."""
    links = world.threads["thread"].thread.links
    body = world.mj_model.body(f"thread/{links - 1}").id
    world.mj_data.xfrc_applied[body, :3] = force


def held_in_a_jaw(text: str = HELD) -> World:
    """Return a world in which PSM1 holds a thread by its sixth millimetre, which hangs."""
    world = World(rig(text))
    arm, thread = world.arms["PSM1"], world.objects["thread"]
    tip = world.true_state("PSM1").world
    middle = tip[:3, 3] + 8.5e-3 * tip[:3, 2]
    along = tip[:3, 0]  # across the pads' closing, in their faces
    turn = np.column_stack([along, tip[:3, 1], np.cross(along, tip[:3, 1])])
    thread.set_cp(transform(turn, middle - 6e-3 * along))
    q = arm.runtime.motors.position.copy()
    q[-1] = 0.05
    world.set_state("PSM1", q)
    assert arm.jaw is not None
    arm.jaw.servo_jp([-0.3])
    world.step(150)
    return world


def test_it_hangs_straight_and_each_link_carries_what_is_below_it() -> None:
    world = World(rig(HANGING))
    world.step(1500)
    thread = world.threads["thread"]
    points, count = thread.points(), thread.thread.links
    assert points[:, :2] == pytest.approx(np.tile(points[0, :2], (count + 1, 1)), abs=1e-5)
    below = GRAVITY * thread.thread.mass * np.arange(count - 1, 0, -1) / count
    assert thread.tension() == pytest.approx(below, rel=0.01)


@pytest.mark.parametrize("force", [1.0, 5.0])
def test_it_bears_the_tension_of_its_description_and_does_not_stretch(force: float) -> None:
    """A sudden load, and a nudge to the side while it acts."""
    world = World(rig(HANGING))
    pull(world, [0.0, 0.0, -force])
    world.step(200)
    pull(world, [0.2 * force, 0.0, -force])
    world.step(20)
    pull(world, [0.0, 0.0, -force])
    world.step(1000)
    points = world.threads["thread"].points()
    assert np.linalg.norm(points[-1] - points[0]) == pytest.approx(0.08, rel=0.01)
    assert world.engine_warnings() == {}
    found = list[float]()
    for _ in range(50):
        world.step(5)
        found.append(float(world.threads["thread"].tension()[0]))
    assert np.mean(found) == pytest.approx(force, rel=0.05)  # it still swings


def test_energy_only_falls_in_the_air() -> None:
    world = World(rig(HELD + "xyz_mm = [0, 400, 500]\n"))
    model, data = world.mj_model, world.mj_data
    first = int(model.joint("thread/1/y").qposadr[0])
    data.qpos[first : first + 28] = np.random.default_rng(0).normal(0.0, 0.3, 28)

    def energy() -> float:
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        return float(data.energy.sum())

    found = [energy()]
    for _ in range(200):
        world.step()
        found.append(energy())
    fall = np.diff(found)
    assert fall.max() < 0.02 * -fall.sum()
    assert fall[:20].sum() < 0.0


def test_a_jaw_holds_it_until_it_is_pulled_harder_than_friction_of_both_pads_and_says_so() -> None:
    world = held_in_a_jaw()
    thread, heard = world.threads["thread"], list[Entry]()
    world.listen(lambda entry: heard.append(entry) if entry.name == "grasp/slipped" else None)
    along = world.true_state("PSM1").world[:3, 0]  # in the pads, as the thread leaves the jaw
    last, before = -1.0, thread.points()[0]
    for share in np.arange(0.1, 2.0, 0.05):
        grasp = world.grasps()["PSM1"]
        assert grasp.object == "thread" and grasp.force > 10.0
        pull(world, (share * 2.0 * 0.05 * grasp.force * along).tolist())
        world.step(100)
        if heard:
            last = share
            break
        moved = np.linalg.norm(thread.points()[0] - before)
        assert moved < 5e-5 or not 0.22 < share < 0.9
        before = thread.points()[0]
    assert last == pytest.approx(1.0, abs=0.15)
    world.step(25)
    assert np.linalg.norm(thread.points()[0] - before) > 1e-3
    assert [entry.values["object"] for entry in heard] == ["thread"]


def test_it_slips_out_of_a_jaw_before_it_is_pulled_harder_than_it_can_be_simulated() -> None:
    """At twice the tension that it bears, although friction of these pads carries 37 N."""
    world = held_in_a_jaw(HELD.replace("0.05", "1.0"))
    thread, heard = world.threads["thread"], list[Entry]()
    world.listen(lambda entry: heard.append(entry) if entry.name == "grasp/slipped" else None)
    along = world.true_state("PSM1").world[:3, 0]
    for share in (0.5, 1.0, 1.5, 1.9):
        pull(world, (share * thread.thread.tension * along).tolist())
        world.step(100)
    assert not heard and world.grasps()["PSM1"].object == "thread"
    before = thread.points()[0]
    pull(world, (2.1 * thread.thread.tension * along).tolist())
    world.step(40)
    assert [entry.values["object"] for entry in heard] == ["thread"]
    assert np.linalg.norm(thread.points()[0] - before) > 0.05
    assert not any(world.engine_warnings().values())


def test_a_held_thread_goes_on_from_a_saved_state_to_the_last_bit() -> None:
    world = held_in_a_jaw()
    saved = world.save()
    world.step(100)
    row = world.save().row
    other = held_in_a_jaw()
    for _ in range(10):  # whoever looks does not change it
        other.step(10)
        other.snapshot()
        assert other.threads["thread"].tension().shape == (14,)
    assert np.array_equal(other.save().row, row)
    other.reset()
    other.load(saved)
    other.step(100)
    assert other.grasps()["PSM1"].object == "thread"
    assert np.array_equal(other.save().row, row)


def test_where_it_is_put_it_lies_straight() -> None:
    world = held_in_a_jaw()
    world.objects["thread"].set_cp(transform(np.eye(3), np.array([0.0, 0.03, 0.05])))
    points = world.threads["thread"].points()
    assert points[-1] - points[0] == pytest.approx([0.06, 0.0, 0.0], abs=1e-9)
    world.step()
    assert world.grasps()["PSM1"].object == ""


def test_it_falls_onto_a_bar_and_hangs_over_it() -> None:
    bar = """
[[prop]]
name = "bar"
shape = [{ kind = "capsule", from_mm = [-20, 300, 200], to_mm = [20, 300, 200], radius_mm = 3 }]
"""
    text = HELD.replace("0.05", "0.5") + "xyz_mm = [0, 270, 204]\nrpy_deg = [0, 0, 90]\n"
    world = World(rig(bar + text))
    deepest = 0.0
    for _ in range(100):
        world.step(10)
        deepest = min(deepest, float(world.mj_data.contact.dist.min(initial=0.0)))
    points = world.threads["thread"].points()
    assert deepest > -5e-5
    assert (np.hypot(points[:, 1] - 0.3, points[:, 2] - 0.2) > 0.003).all()
    assert points[:, 2].max() > 0.203 and points[[0, -1], 2].max() < 0.19


def overhand_knot() -> np.ndarray:
    """Return points of an open overhand knot, 150 mm long (Shastri's polynomial trefoil) [m]."""
    t = np.linspace(-2.2, 2.2, 2000)
    return np.column_stack([3.3 * (t**3 - 3 * t), 3.3 * (t**4 - 4 * t**2), 1.2 * (t**5 - 10 * t)])


def test_it_lies_along_a_curve_and_a_knot_holds_what_a_thread_that_passes_itself_loses() -> None:
    """A newton at both ends; without contacts of the thread with itself it comes out straight."""
    far: list[float] = []
    for knots in ("true", "false"):
        text = f"{HELD}length_mm = 150\nlink_mm = 2.5\nknots = {knots}\n"
        world = World(rig(text.replace("length_mm = 60\n", "").replace("0.05", "0.2")))
        curve = 1e-3 * overhand_knot() + [0.0, 0.4, 2.0]
        world.objects["thread"].set_curve(curve)
        thread = world.threads["thread"]
        for point in thread.points():  # on chords of 0.4 mm of the curve
            assert np.linalg.norm(curve - point, axis=1).min() < 4e-4
        ends = [world.mj_model.body(name) for name in ("thread", "thread/59")]
        points = thread.points()
        for k in range(60):
            points = thread.points()
            way = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
            force = min(1.0, k / 50.0) ** 2 * way
            for end, sign in zip(ends, (-1.0, 1.0), strict=True):
                world.mj_data.xfrc_applied[end.id, :3] = sign * force
            world.step(20)
        assert world.engine_warnings() == {}
        far.append(float(np.linalg.norm(points[-1] - points[0])))
    assert far[0] < 0.14
    assert far[1] > 0.149


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([[0, 0, 0]], "allowed: \\(n, 3\\), n > 1"),
        ([[0, 0, 0], [1e300, 0, 0]], "up to 1000 m away"),
        ([[0, 0, 0], [float("nan"), 0, 0]], "up to 1000 m away"),
        ([[0, 0, 0], [0.05, 0, 0]], "48.0 mm of thread; needed: 60.0 mm"),
        ([[0, 0, 0], [0.01, 0, 0], [-0.1, 0, 0]], "allowed: up to 1.3 rad"),
    ],
)
def test_a_curve_that_it_cannot_follow_is_refused(points: list[list[float]], words: str) -> None:
    with pytest.raises(InputError, match=words):
        World(rig(HELD)).objects["thread"].set_curve(points)


def test_it_is_laid_two_millimetres_deep_in_others_at_most_and_pushed_out_gently() -> None:
    world = World(rig(SHELF + HELD))
    line, thread = np.linspace(-0.035, 0.035, 30), world.objects["thread"]
    curve = np.column_stack([line, np.full(30, 0.3), np.full(30, 0.197)])
    before = world.save().row
    with pytest.raises(InputError, match=r"thread: would lie 3\.1 mm deep in shelf; allowed: up"):
        thread.set_curve(curve)
    with pytest.raises(InputError, match="deep in shelf"):
        thread.set_cp(transform(np.eye(3), curve[0]))
    assert np.array_equal(world.save().row, before)
    thread.set_curve(curve + np.array([0.0, 0.0, 0.0015]))
    for _ in range(50):
        world.step()
        assert np.linalg.norm(world.object_states().linear) < 1.0
    assert world.threads["thread"].points()[:, 2].min() > 0.2


def test_it_begins_at_the_end_of_a_needle_that_it_is_tied_to_and_follows_it() -> None:
    text = """
[[prop]]
name = "needle"
kind = "needle"
size = "half_26"
movable = true
xyz_mm = [0, 300, 300]

[[prop]]
name = "thread"
kind = "thread"
size = "usp_3_0"
length_mm = 60
joint = { kind = "ball", on = "needle" }
"""
    world = World(rig(text))
    wire = next(prop.needle for prop in world.rig.props if prop.needle)
    for _ in range(2):
        T = world.objects["needle"].measured_cp().matrix
        points = world.threads["thread"].points()
        assert points[0] == pytest.approx((T @ wire.swage)[:3, 3], abs=1e-9)
        away = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
        assert away == pytest.approx(-(T @ wire.swage)[:3, 1], abs=1e-6)
        world.objects["needle"].set_cp(transform(np.diag([-1.0, -1.0, 1.0]), np.full(3, 0.3)))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"usp_3_0"', '"usp_9"', "usp_9"),
        ("length_mm = 60", "length_mm = 600", "150 links; allowed: 2 to 60"),
        ("length_mm = 60", "length_mm = 60\nlink_mm = 0.4", "allowed: 2 to 60"),
        ("length_mm = 60", "length_mm = 6\nlink_mm = 0.4", "above twice the diameter, 0.45 mm"),
        ("length_mm = 60", "length_mm = 60\ndiameter_mm = 1", "contradicts the size"),
        ("friction = 0.05", "friction = -1", "got -1; allowed: 0 or more"),
        ("friction = 0.05", "tension_n = 0", "tension"),
        ("friction = 0.05", "movable = false", "nothing else moves a thread"),
        ("friction = 0.05", 'joint = { kind = "ball" }', "a ball on a free prop"),
    ],
)
def test_impossible_thread_is_refused(old: str, new: str, words: str) -> None:
    assert old in HELD
    with pytest.raises(DescriptionError, match=words):
        read_props(parse_table(HELD.replace(old, new), "t.toml"), [])


@pytest.mark.parametrize("place", ["before", "behind"])
def test_on_a_large_soft_box_every_second_link_touches_and_friction_is_that_of_its_weight(
    place: str,
) -> None:
    """Coulomb's law: what pulls a thread along a pad slowly is friction times weight."""
    pad = """
[[prop]]
name = "pad"
xyz_mm = [0, 300, 200]
shape = [{ kind = "box", center_mm = [0, 0, 0], size_mm = [300, 60, 5], stiffness_n_per_m = 150 }]
"""
    thread = HELD.replace("0.05", "0.4") + "mass_kg = 0.0006\nxyz_mm = [-60, 300, 202.62]\n"
    world = World(rig(pad + thread if place == "before" else thread + pad))
    data, model, touching = world.mj_data, world.mj_model, set[str]()
    for _ in range(60):  # until it sleeps
        world.step(5)
        bodies = model.geom_bodyid[data.contact.geom].ravel()
        touching |= {model.body(body).name for body in bodies} - {"pad"}
    assert touching == {"thread"} | {f"thread/{k}" for k in (2, 4, 6, 8, 10, 12, 14)}
    points, weight = world.threads["thread"].points(), 0.0006 * GRAVITY
    assert points[:, 2] == pytest.approx(np.full(16, points[0, 2]), abs=2e-4)
    for share, moves in ((0.9, False), (1.1, True)):
        before = world.threads["thread"].points()[0, 0]
        pull(world, [share * 0.4 * weight, 0.0, 0.0])
        world.step(200)
        moved = world.threads["thread"].points()[0, 0] - before
        assert (moved > 5e-3) == moves


def test_a_narrow_soft_box_is_touched_by_whole_links() -> None:
    """A thread falls across a soft beam that is thinner than the distance of its spheres."""
    beam = """
[[prop]]
name = "beam"
xyz_mm = [0, 300, 200]
shape = [{ kind = "box", center_mm = [0, 0, 0], size_mm = [60, 2, 2], stiffness_n_per_m = 150 }]
"""
    text = HELD.replace("0.05", "1.0") + "xyz_mm = [0, 270, 202]\nrpy_deg = [0, 0, 90]\n"
    world = World(rig(beam + text))
    lowest = np.inf
    for _ in range(40):
        world.step(5)
        points = world.threads["thread"].points()
        lowest = min(lowest, float(points[:, 2].max()))
    assert lowest > 0.2005


def test_what_an_arm_that_jumps_presses_out_of_it_does_not_tear_the_numbers_apart(
    rng: np.random.Generator,
) -> None:
    scene = load_scene("thread-handover")
    world = World(scene.rig, homed=True, welded=scene.welded)
    arm = world.arm("PSM2")
    arm.joints.set_mode("set")
    middle = world.threads["thread"].points().mean(axis=0)
    for _ in range(40):
        T = arm.measured_cp("world").matrix
        T[:3, 3] = middle + rng.uniform(-0.01, 0.01, 3)
        arm.servo_cp(T, frame="world")
        world.step(5)
    assert np.isfinite(world.mj_data.qpos).all()


def test_its_beginning_is_never_faster_than_its_limits() -> None:
    world = World(rig(SHELF + HELD))
    start = world.mj_data.joint("thread/free")
    start.qvel[:] = [0.0, 0.0, 3.0 * MOVE_M_S, 3.0 * TURN_RAD_S, 0.0, 0.0]
    world.step()
    assert start.qvel[2] == MOVE_M_S
    assert start.qvel[3] == TURN_RAD_S
