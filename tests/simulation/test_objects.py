"""Laws of what can be moved: it falls, rests, collides, is grasped, and its motion repeats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.errors import DivergedError, InputError, UnknownNameError
from trocar.geometry.rotations import matrix_from_rpy
from trocar.geometry.se3 import inverse, transform
from trocar.modeling import naming
from trocar.recording import record
from trocar.robot.follow.reproduce import repeat
from trocar.simulation import World

GRAVITY = 9.81

BALLS = """
[[prop]]
name = "one"
movable = true
mass_g = 2.0
xyz_m = [0.4, 0.4, 1.0]
shape = [{ kind = "sphere", center_mm = [0, 0, 0], radius_mm = 10 }]

[[prop]]
name = "two"
movable = true
mass_g = 6.0
xyz_m = [0.5, 0.405, 1.0]
shape = [{ kind = "sphere", center_mm = [0, 0, 0], radius_mm = 10 }]

[[prop]]
name = "rod"
movable = true
mass_g = 3.0
xyz_m = [-0.5, 0.0, 1.5]
rpy_deg = [20, 30, 40]
shape = [{ kind = "box", center_mm = [2, -3, 5], size_mm = [10, 30, 60] }]
"""


def rig_file(folder: Path, more: str = BALLS) -> Path:
    file = folder / "mine.toml"
    file.write_text(Path(load_rig("psm").file).read_text(encoding="utf-8") + more)
    return file


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(rig_file(tmp_path))


def free_velocity(world: World, name: str) -> np.ndarray:
    """Give a view of an object's velocity: linear in the world, angular in its own axes, (6,)."""
    return world.mj_data.joint(naming.free_joint(name)).qvel


def test_an_object_in_the_air_falls_as_galileo_says(world: World) -> None:
    ball = world.object("one")
    start = ball.measured_cp().matrix[:3, 3]
    world.step(200)
    t = world.time
    place, speed = ball.measured_cp().matrix[:3, 3] - start, ball.measured_cv().linear
    # Semi-implicit: after k periods of length h it has fallen g h^2 k (k + 1) / 2.
    fallen = 0.5 * GRAVITY * t * (t + world.timestep)
    assert np.allclose(place, [0.0, 0.0, -fallen], atol=1e-12)
    assert np.allclose(speed, [0.0, 0.0, -GRAVITY * t], atol=1e-12)


def test_the_velocity_of_a_turning_object_is_the_difference_of_its_poses(world: World) -> None:
    rod = world.object("rod")
    free_velocity(world, "rod")[:] = [0.3, -0.2, 1.0, 4.0, -3.0, 7.0]
    world.step(1)
    before, twist = rod.measured_cp().matrix, rod.measured_cv()
    world.step(1)
    after = rod.measured_cp().matrix
    h = world.timestep
    turn = (after[:3, :3] - before[:3, :3]) @ before[:3, :3].T / h
    spin = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    # First differences over 1 ms are off by half a period of acceleration.
    assert np.allclose(spin, twist.angular, atol=0.05)
    assert np.allclose((after - before)[:3, 3] / h, twist.linear, atol=0.05)
    assert twist.frame_id == rod.measured_cp().frame_id == "world"


def test_the_spin_of_a_free_body_keeps_its_angular_momentum(world: World) -> None:
    rod = world.object("rod")
    movable = rod.description.movable
    assert movable is not None

    def momentum() -> np.ndarray:
        R = rod.measured_cp().matrix[:3, :3]
        return R @ movable.inertia @ R.T @ rod.measured_cv().angular

    free_velocity(world, "rod")[3:] = [1.0, 2.0, 3.0]
    first = momentum()
    world.step(100)
    assert np.allclose(momentum(), first, rtol=2e-3, atol=1e-3 * np.linalg.norm(first))


def test_momentum_passes_from_one_ball_to_another(world: World) -> None:
    one, two = world.object("one"), world.object("two")
    free_velocity(world, "one")[0] = 2.0
    masses = np.array([one.mass, two.mass])

    def momentum() -> np.ndarray:
        return masses @ np.stack([b.measured_cv().linear for b in (one, two)])

    first = momentum()
    world.step(80)
    assert two.measured_cv().linear[0] > 0.3  # they met
    fallen = np.array([0.0, 0.0, -GRAVITY * world.time * masses.sum()])
    assert np.allclose(momentum(), first + fallen, atol=1e-12)


def test_objects_at_rest_stay_where_they_are() -> None:
    world = World("pegs")
    world.step(200)
    before = world.object_states()
    world.step(3000)
    after = world.object_states()
    assert np.abs(after.positions - before.positions).max() < 1e-9
    assert np.abs(after.quaternions - before.quaternions).max() < 1e-9
    # What lies on the board weighs on it, and nothing else.
    table = world.contact_table()
    board = table.names.index("board")
    sign = np.where(table.bodies[:, 0] == board, 1.0, -1.0)
    load = sign @ table.forces
    weight = GRAVITY * sum(one.mass for one in world.objects.values())
    assert np.allclose(load, [0.0, 0.0, -weight], atol=1e-3 * weight)  # 0.1 mm/s is still


def test_what_lies_still_sleeps_until_it_is_touched() -> None:
    world = World("pegs")
    world.step(200)
    block = world.object("block2")
    place = block.measured_cp().matrix
    world.step(100)
    assert np.array_equal(block.measured_cp().matrix, place)  # to the last bit
    assert any("block2" in (c.body, c.other) for c in world.contacts().contacts)
    above = place @ transform(np.eye(3), np.array([0.002, 0.0, 0.03]))
    world.object("block1").set_cp(above)
    fastest = 0.0
    for _ in range(40):
        world.step(5)
        fastest = max(fastest, float(np.linalg.norm(block.measured_cv().angular)))
    assert fastest > 1e-3


def test_what_lay_on_an_object_that_is_put_elsewhere_falls() -> None:
    world = World("pegs")
    lower, upper = world.object("block2"), world.object("block1")
    upper.set_cp(lower.measured_cp().matrix @ transform(np.eye(3), np.array([0.0, 0.0, 0.01])))
    world.step(300)
    height = upper.measured_cp().matrix[2, 3]
    assert height == pytest.approx(lower.measured_cp().matrix[2, 3] + 0.01, abs=1e-5)
    away = lower.measured_cp().matrix @ transform(np.eye(3), np.array([0.012, 0.0, 0.0]))
    lower.set_cp(away)
    world.step(300)
    assert upper.measured_cp().matrix[2, 3] == pytest.approx(height - 0.01, abs=1e-5)


def test_the_table_of_contacts_is_the_list_of_contacts() -> None:
    world = World("pegs")
    world.step(50)
    listed, table = world.contacts().contacts, world.contact_table()
    assert len(listed) == len(table.points) > 20
    for row, contact in enumerate(listed):
        body, other = (table.names[k] for k in table.bodies[row])
        assert (body, other) == (contact.body, contact.other)
        for name in ("point", "normal", "force"):
            assert np.allclose(getattr(table, f"{name}s")[row], getattr(contact, name), atol=1e-12)
        assert table.depths[row] == pytest.approx(contact.depth, abs=1e-15)


def test_an_object_is_put_exactly_where_it_is_told(world: World) -> None:
    ball, other = world.object("one"), world.object("two").measured_cp().matrix
    T = transform(matrix_from_rpy(0.3, -1.2, 2.5), np.array([0.1, -0.7, 0.4]))
    world.step(50)
    ball.set_cp(T)
    assert np.abs(ball.measured_cp().matrix - T).max() < 1e-15
    assert np.array_equal(ball.measured_cv().linear, np.zeros(3))
    assert world.object("two").measured_cp().matrix[2, 3] < other[2, 3]  # that one falls on
    seen = world.snapshot()
    shape = next(s for s in world.shapes() if s.name.startswith("one/"))
    assert np.allclose(seen.positions[shape.body], T[:3, 3], atol=1e-15)


def test_reset_puts_objects_back(world: World) -> None:
    before = world.object_states()
    world.step(100)
    world.object("one").set_cp(np.eye(4))
    world.reset()
    after = world.object_states()
    assert np.array_equal(before.positions, after.positions)
    assert np.array_equal(before.quaternions, after.quaternions)
    assert not after.linear.any() and not after.spin.any()


@pytest.mark.parametrize(
    ("pose", "problem"),
    [
        (np.eye(3), r"one: pose: expected shape \(..., 4, 4\)"),
        (np.stack([np.eye(4)] * 2), r"got a pose of shape \(2, 4, 4\)"),
        (np.full((4, 4), np.nan), "expected finite numbers"),
        (2.0 * np.eye(4), "last row"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "a reflection"),
        ("here", "one: got the pose 'here'"),
        (transform(np.eye(3), np.array([0.0, 2e3, 0.0])), "allowed: up to 1000 m away"),
    ],
)
def test_a_pose_that_is_none_is_rejected_and_nothing_moves(
    world: World, pose: object, problem: str
) -> None:
    before = world.object("one").measured_cp().matrix
    with pytest.raises(InputError, match=problem):
        world.object("one").set_cp(pose)  # type: ignore[arg-type]
    assert np.array_equal(world.object("one").measured_cp().matrix, before)


def test_an_unknown_object_is_told_with_the_known_ones(world: World) -> None:
    assert list(world.objects) == ["one", "two", "rod"]
    with pytest.raises(UnknownNameError, match=r"unknown object 'onee'.*known: one, two, rod"):
        world.object("onee")


@pytest.mark.parametrize(("field", "what"), [("_qpos", "position"), ("_qvel", "velocity")])
def test_an_object_that_diverges_is_named(world: World, field: str, what: str) -> None:
    getattr(world.object("two"), field)[1] = 1e11
    with pytest.raises(DivergedError, match=f"in joint two .*the {what} of the object") as caught:
        world.step(5)
    assert caught.value.joint == "two"


def test_a_recording_with_objects_repeats_to_the_last_bit(tmp_path: Path) -> None:
    world, file = World("pegs"), tmp_path / "run.mcap"
    T = transform(matrix_from_rpy(0.5, 0.2, 0.1), np.array([0.07, 0.085, 0.16]))
    world.object("ring2").set_cp(T)
    with record(world, file):
        world.step(150)
        world.object("ring1").set_cp(T @ transform(np.eye(3), np.array([0.001, 0.0, 0.03])))
        world.step(300)
    report = repeat(file)
    assert report.identical and report.commands == 1  # and one before it began
    other = World("pegs")
    other.object("ring2").set_cp(T)
    other.step(150)
    other.object("ring1").set_cp(T @ transform(np.eye(3), np.array([0.001, 0.0, 0.03])))
    other.step(300)
    assert np.array_equal(world.object_states().positions, other.object_states().positions)


def test_the_jaw_grasps_a_block_and_lifts_it() -> None:
    world = World("pegs")
    arm, block = world.arm("PSM1"), world.object("block2")
    at = block.measured_cp().matrix[:3, 3]
    cart = world.reference_pose("PSM1")
    down = (cart @ arm.local.measured_cp().matrix)[:3, :3]

    def go(height: float) -> None:
        T = transform(down, at + np.array([0.0, 0.0, height]))
        assert arm.move_cp(arm.local.base_frame()[0] @ inverse(cart) @ T).wait(timeout_s=4.0)

    assert arm.jaw is not None
    arm.jaw.move_jp([0.6]).wait(timeout_s=2.0)
    go(0.03)
    go(0.012)  # the jaw's axis is some 10 mm behind the ends of the fingers
    arm.jaw.close().wait(timeout_s=2.0)
    touching = [c.other + c.body for c in world.contacts().contacts]
    assert any("finger_left" in pair and "block2" in pair for pair in touching)
    go(0.03)
    world.step(1000)
    height = block.measured_cp().matrix[2, 3] - at[2]
    assert height == pytest.approx(0.018, abs=1e-3)
    others = {"board", "table"} & {n for c in world.contacts().contacts if "block2" in
                                   (c.body, c.other) for n in (c.body, c.other)}  # fmt: skip
    assert not others
    arm.jaw.open().wait(timeout_s=2.0)
    world.step(500)
    assert block.measured_cp().matrix[2, 3] < at[2] + 0.005


def test_an_exchange_of_a_tool_leaves_objects_where_they_are(world: World) -> None:
    world.step(30)
    before = world.object_states()
    world.exchange_tool("PSM1", "PROGRASP_FORCEPS:420093")
    after = world.object_states()
    assert np.array_equal(before.positions, after.positions)
    assert np.array_equal(before.linear, after.linear)
    world.step(10)
    assert (world.object_states().positions[:, 2] < before.positions[:, 2]).all()
    world.object("one").set_cp(np.eye(4))
    assert np.array_equal(world.object("one").measured_cp().matrix, np.eye(4))
