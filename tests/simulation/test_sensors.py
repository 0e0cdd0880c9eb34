"""Sensors obey the laws of what they measure, and looking at them changes nothing."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions.catalogue import DATA
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.rotations import matrix_from_quaternion, matrix_from_rpy
from trocar.geometry.se3 import adjoint, transform
from trocar.kinematics import jacobian_body, pose
from trocar.simulation import (
    ContactsReading,
    EffortReading,
    ImuReading,
    ProximityReading,
    TwistReading,
    World,
    WrenchReading,
)
from trocar.simulation.tip_load import load_direction

Array = NDArray[np.float64]

G = 9.81
POSES = (
    [0.4, -0.5, 0.15, 0.6, 0.4, -0.3, 0.6],
    [-0.6, 0.4, 0.21, -1.2, -0.7, 0.5, 0.2],
    [0.1, 0.7, 0.08, 2.0, 0.2, 0.9, 0.4],
)
TIP = '[[sensor]]\nname = "tip"\nkind = "tip_wrench"\narm = "PSM1"\n'
TOUCH = '[[sensor]]\nname = "touch"\nkind = "contacts"\narm = "PSM1"\n'
NEAR = '[[sensor]]\nname = "near"\nkind = "proximity"\narm = "PSM1"\nxyz_mm = [0.0, -8.0, 0.0]\n'
MOTORS = "".join(
    f'[[sensor]]\nname = "{joint}"\nkind = "joint_effort"\narm = "PSM1"\njoint = "{joint}"\n'
    for joint in ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw")
)


def imu(frame: str, arm: str = "PSM1", more: str = "") -> str:
    return f'[[sensor]]\nname = "imu"\nkind = "imu"\narm = "{arm}"\nframe = "{frame}"\n{more}\n'


def rig_with(folder: Path, sensors: str, rig: str = "psm") -> Path:
    """Write a built-in rig with sensors."""
    text = (DATA / "rigs" / f"{rig}.toml").read_text(encoding="utf-8")
    path = folder / "rig.toml"
    path.write_text(text + "\n" + sensors, encoding="utf-8")
    return path


def wrench(world: World, name: str = "tip") -> WrenchReading:
    reading = world.sensor(name)
    assert isinstance(reading, WrenchReading)
    return reading


def inertial(world: World) -> ImuReading:
    reading = world.sensor("imu")
    assert isinstance(reading, ImuReading)
    return reading


def near(world: World) -> ProximityReading:
    reading = world.sensor("near")
    assert isinstance(reading, ProximityReading)
    return reading


def touching(world: World, name: str = "touch") -> ContactsReading:
    reading = world.sensor(name)
    assert isinstance(reading, ContactsReading)
    return reading


def efforts(world: World) -> Array:
    readings = [world.sensor(name) for name in world.arm("PSM1").joints.names]
    return np.array([r.effort for r in readings if isinstance(r, EffortReading)])


def frame_in_world(world: World, frame: str, q: Array | list[float], arm: str = "PSM1") -> Array:
    """Where a frame is by the analytic kinematics, which know nothing of MuJoCo, (4, 4)."""
    rig_arm = world.rig.arm(arm)
    return rig_arm.pose @ pose(rig_arm.arm.mechanism, q, frame, rig_arm.arm.root)


def gravity_efforts(world: World, q: Array) -> Array:
    """D V / d q of the bodies' weights, by central differences, (n,) [N m or N]."""
    bodies = world.rig.arm("PSM1").arm.bodies

    def potential(at: Array) -> float:
        places = [(b, frame_in_world(world, b.frame, at)) for b in bodies]
        return sum(b.mass * G * float((T[:3, :3] @ b.com + T[:3, 3])[2]) for b, T in places)

    step = 1e-5 * np.eye(len(q))
    return np.array([(potential(q + d) - potential(q - d)) / 2e-5 for d in step])


def hold(world: World, q: list[float], periods: int) -> Array:
    """Put the arm at rest at a pose and let it settle; its positions with the jaw."""
    arm = world.arm("PSM1")
    world.set_state("PSM1", np.array(q))
    world.step(periods)
    return arm.joints.readings()[0]


def state(world: World) -> Array:
    return np.concatenate([world.mj_data.qpos, world.mj_data.qvel, world.mj_data.act])


# ------------------------------------------------------------------ joint_effort


@pytest.mark.parametrize("q", POSES)
def test_the_motors_of_an_arm_held_still_carry_its_weight(q: list[float], tmp_path: Path) -> None:
    """Only damping as friction, so nothing sticks; the motors' servos do it all."""
    world = World(rig_with(tmp_path, MOTORS), friction="paper", gravity_compensation=False)
    at = hold(world, q, 4000)
    # What is left of settling: damping 0.1 N m s at a few um a second.
    np.testing.assert_allclose(efforts(world), gravity_efforts(world, at), atol=1e-4)


def test_an_effort_says_whose_it_is_and_in_which_unit(tmp_path: Path) -> None:
    world = World(rig_with(tmp_path, MOTORS))
    yaw, slide = world.sensor("yaw"), world.sensor("insertion")
    assert (yaw.kind, yaw.frame_id, yaw.units) == ("joint_effort", "PSM1/yaw", {"effort": "N m"})
    assert slide.units == {"effort": "N"}
    world.step(20)
    assert world.sensor("yaw").time == world.time
    np.testing.assert_array_equal(efforts(world), world.arm("PSM1").joints.readings()[2])


# ------------------------------------------------------------------ tip_wrench


@pytest.mark.parametrize("q", POSES)
@pytest.mark.parametrize("body", ["wrist_yaw", "finger_left"])
def test_a_known_force_at_the_tip_is_read_in_the_tips_own_axes(
    q: list[float], body: str, tmp_path: Path
) -> None:
    """Within 1 %: what is left is how far the arm has yielded since the period began."""
    world = World(rig_with(tmp_path, TIP))
    world.set_state("PSM1", np.array(q))
    force, torque = np.array([0.3, -0.5, 0.4]), np.array([2e-3, -1e-3, 3e-3])
    number = world.mj_model.body(f"PSM1/{body}").id
    world.mj_data.xfrc_applied[number] = [*force, *torque]
    world.step(50)
    at = world.arm("PSM1").joints.readings()[0]
    tip = frame_in_world(world, "tip", at)
    massed = next(b for b in world.rig.arm("PSM1").arm.bodies if b.frame == body)
    centre = frame_in_world(world, body, at) @ [*massed.com, 1.0]
    reading = wrench(world)
    moved = np.cross(centre[:3] - tip[:3, 3], force) + torque
    np.testing.assert_allclose(reading.force, tip[:3, :3].T @ force, atol=0.01 * 0.7)
    np.testing.assert_allclose(reading.torque, tip[:3, :3].T @ moved, atol=0.01 * 4e-3)
    assert reading.frame_id == "tip"


def test_the_worlds_own_tip_load_is_read_while_the_arm_moves(tmp_path: Path) -> None:
    """On an arm whose base is turned in the world."""
    path = rig_with(tmp_path, TIP.replace("PSM1", "PSM2"), "two_psm_ecm")
    world = World(path, tip_load_n=5.0)
    assert not wrench(world).force.any()  # it begins with the first period
    arm = world.arm("PSM2")
    arm.move_jp(POSES[0][:6])
    for _ in range(40):
        world.step(10)
        root = frame_in_world(world, "base", POSES[0], "PSM2")
        tip = frame_in_world(world, "tip", arm.joints.readings()[0], "PSM2")
        # The load is renewed every 5 ms, in the pose at its period's beginning.
        applied = root[:3, :3] @ (5.0 * load_direction(world.time - 0.005))
        reading = wrench(world)
        np.testing.assert_allclose(reading.force, tip[:3, :3].T @ applied, atol=0.01 * 5.0)
        np.testing.assert_allclose(reading.torque, 0.0, atol=1e-12)
    world.reset()
    assert not wrench(world).force.any()


def test_inertia_and_weight_are_no_wrench(tmp_path: Path) -> None:
    world = World(rig_with(tmp_path, TIP))
    world.arm("PSM1").move_jp(POSES[2][:6])
    for _ in range(50):
        world.step(7)
        reading = wrench(world)
        assert not reading.force.any()
        assert not reading.torque.any()


def test_motors_that_press_a_tool_on_the_table_balance_weight_and_wrench(tmp_path: Path) -> None:
    """By virtual work tau = dV/dq - J^T w, with the analytic J; w has the table's friction."""
    path = rig_with(tmp_path, TIP + MOTORS)
    world = World(path, friction="paper", gravity_compensation=False)
    arm = world.arm("PSM1")
    arm.move_jp([0.1, -0.15, 0.205, 0.4, 0.2, -0.1]).wait(5.0)
    arm.move_jp([0.1, -0.15, 0.240, 0.4, 0.2, -0.1]).wait(5.0)
    world.step(4000)
    at = arm.joints.readings()[0]
    reading = wrench(world)
    assert np.linalg.norm(reading.force) > 3.0
    jacobian = jacobian_body(arm.description.mechanism, at)
    load = jacobian.T @ [*reading.force, *reading.torque]
    measured = gravity_efforts(world, at) - efforts(world)
    # 1 % of the largest torque; the jaw's motor sees single fingers, not their sum.
    np.testing.assert_allclose(measured[:6], load[:6], atol=0.01 * np.abs(load[:2]).max())
    assert measured[2] == pytest.approx(load[2], rel=0.01)


def test_a_wrench_is_moved_to_where_the_sensor_stands(tmp_path: Path) -> None:
    """Another origin and other axes, the same wrench: w_a = Ad(T_ba)^T w_b."""
    turn, shift = [0.3, -0.2, 0.5], [0.01, 0.0, -0.02]
    moved = TIP.replace('"tip"', '"moved"', 1) + f"xyz_m = {shift}\nrpy_rad = {turn}\n"
    world = World(rig_with(tmp_path, TIP + moved))
    world.mj_data.xfrc_applied[world.mj_model.body("PSM1/finger_left").id, :3] = [0.2, 0.1, -0.3]
    world.step(20)
    there, here = wrench(world, "moved"), wrench(world)
    change = adjoint(transform(matrix_from_rpy(*turn), np.array(shift))).T
    expected = change @ [*here.force, *here.torque]
    np.testing.assert_allclose([*there.force, *there.torque], expected, atol=1e-12)


def test_only_what_lies_beyond_is_counted(tmp_path: Path) -> None:
    finger = TIP.replace('"tip"', '"finger"', 1) + 'beyond = "finger_left"\n'
    shaft = TIP.replace('"tip"', '"shaft"', 1) + 'beyond = "roll"\n'
    world = World(rig_with(tmp_path, TIP + finger + shaft))
    for body, counted in (
        ("finger_left", {"tip", "finger", "shaft"}),
        ("finger_right", {"tip", "shaft"}),
        ("wrist_pitch", {"shaft"}),
        ("insertion", set[str]()),
    ):
        world.reset()
        world.mj_data.xfrc_applied[world.mj_model.body(f"PSM1/{body}").id, 2] = 0.1
        world.step(2)
        assert {n for n in world.sensors if wrench(world, n).force.any()} == counted


# ------------------------------------------------------------------ contacts


def test_the_table_pushes_up_within_its_friction_and_as_hard_as_the_tool_presses(
    tmp_path: Path,
) -> None:
    world = World(rig_with(tmp_path, TIP + TOUCH), dynamics="cad")
    assert touching(world).contacts == ()
    arm = world.arm("PSM1")
    arm.move_jp([0.0, 0.0, 0.24, 0.0, 0.0, 0.0]).wait(5.0)
    world.step(1000)
    reading = touching(world)
    assert reading.frame_id == "world"
    assert {c.body for c in reading.contacts} == {"PSM1/finger_left", "PSM1/finger_right"}
    for contact in reading.contacts:
        assert contact.other == contact.other_shape.rpartition("/")[0] == "table"
        assert contact.shape.startswith(f"{contact.body}/")
        np.testing.assert_allclose(contact.normal, [0.0, 0.0, 1.0], atol=1e-12)
        assert contact.point[2] == pytest.approx(0.08, abs=1e-6)  # the table of rig psm
        assert 0.0 <= contact.depth < 1e-6
        assert contact.force[2] > 0.0
        assert np.linalg.norm(contact.force[:2]) <= 1.0 * contact.force[2]  # CONTACT_FRICTION
    total = sum((c.force for c in reading.contacts), np.zeros(3))
    tip = frame_in_world(world, "tip", arm.joints.readings()[0])
    np.testing.assert_allclose(total, tip[:3, :3] @ wrench(world).force, atol=1e-3)
    pressed = arm.measured_js().effort[2]  # along the vertical shaft, gravity compensated
    assert total[2] == pytest.approx(pressed, rel=0.01)


def test_what_one_arm_does_to_another_the_other_does_to_it(tmp_path: Path) -> None:
    sensors = "".join(
        f'[[sensor]]\nname = "{arm}"\nkind = "contacts"\narm = "{arm}"\n' for arm in ("PSM2", "ECM")
    )
    everything = '[[sensor]]\nname = "all"\nkind = "contacts"\n'
    world = World(rig_with(tmp_path, sensors + everything, "two_psm_ecm"))
    world.arm("PSM2").move_jp([1.2, 0.0, 0.2, 0.0, 0.0, 0.0])
    world.step(1000)
    met = 0
    for _ in range(200):  # they hammer on each other
        world.step()
        mine, theirs = touching(world, "PSM2").contacts, touching(world, "ECM").contacts
        met += len(mine)
        assert len(mine) == len(theirs) == len(touching(world, "all").contacts)
        for a, b in zip(mine, theirs, strict=True):
            assert (a.body, a.other) == (b.other, b.body)
            assert a.body.startswith("PSM2/")
            np.testing.assert_array_equal(a.force, -b.force)
            np.testing.assert_array_equal(a.normal, -b.normal)
            np.testing.assert_array_equal(a.point, b.point)
            assert a.force @ a.normal >= 0.0  # they push, they never pull
    assert met > 10


def test_contacts_can_be_those_of_one_frame_and_what_hangs_on_it(tmp_path: Path) -> None:
    one = TOUCH.replace('"touch"', '"one"') + 'frame = "finger_left"\n'
    world = World(rig_with(tmp_path, TOUCH + one))
    world.arm("PSM1").move_jp([0.0, 0.0, 0.24, 0.0, 0.0, 0.0]).wait(5.0)
    chosen = touching(world, "one").contacts
    assert {c.body for c in chosen} == {"PSM1/finger_left"}
    assert len(touching(world).contacts) > len(chosen)


# ------------------------------------------------------------------ proximity


def rig_with_thing(folder: Path, shape: str) -> Path:
    """A PSM with something 8 mm below the hinge of its fingers."""
    world = World(rig_with(folder, NEAR))
    hinge = frame_in_world(world, "wrist_yaw", world.rig.poses["start"]["PSM1"])[:3, 3]
    at = [float(v) for v in hinge - [0.0, 0.0, 0.008]]
    prop = f'[[prop]]\nname = "thing"\nxyz_m = {at}\nshape = [{shape}]\n'
    return rig_with(folder, NEAR + prop)


@pytest.mark.parametrize("opening", [0.6, 0.9, 1.2])
@pytest.mark.parametrize("shift_mm", [-0.7, 0.0, 0.4])
def test_the_ray_between_the_pads_ends_at_a_box(
    opening: float, shift_mm: float, tmp_path: Path
) -> None:
    """The pads lie on a level line; from the left one to the box's near side is geometry."""
    shape = f'{{ kind = "box", center_mm = [{shift_mm}, 0, 0], size_mm = [1, 2, 4] }}'
    world = World(rig_with_thing(tmp_path, shape))
    q = np.array([*world.rig.poses["start"]["PSM1"][:6], opening])
    world.set_state("PSM1", q)
    pads = [
        (frame_in_world(world, finger, q) @ [0.0, -0.008, 0.0, 1.0])[:3]
        for finger in ("finger_left", "finger_right")
    ]
    span = float(np.linalg.norm(pads[1] - pads[0]))
    assert span == pytest.approx(2 * 0.008 * np.sin(0.5 * opening), abs=1e-9)
    side = np.sign(pads[0][0])
    expected = abs(pads[0][0] - (1e-3 * shift_mm + side * 0.5e-3))
    reading = near(world)
    assert reading.gap == pytest.approx(span, abs=1e-9)
    assert reading.distance == pytest.approx(expected, abs=1e-9)


def test_what_lies_beyond_the_end_of_a_ray_is_not_seen(tmp_path: Path) -> None:
    """The box's near side is 1.92 mm from the pad, square to which the ray leaves."""
    path = rig_with_thing(tmp_path, '{ kind = "box", center_mm = [0, 0, 0], size_mm = [1, 2, 9] }')
    ray = NEAR + 'frame = "finger_left"\nto_frame = "finger_left"\n'
    text = path.read_text(encoding="utf-8")
    start = np.array([*World(path).rig.poses["start"]["PSM1"][:6], 0.6])
    for length, seen in ((1.0, False), (3.0, True)):
        path.write_text(text.replace(NEAR, f"{ray}to_xyz_mm = [{-length}, -8.0, 0.0]\n"))
        world = World(path)
        world.set_state("PSM1", start)
        assert np.isfinite(near(world).distance) == seen
        assert near(world).gap == pytest.approx(1e-3 * length)


def test_nothing_between_the_pads_is_infinitely_far(tmp_path: Path) -> None:
    world = World(rig_with(tmp_path, NEAR))
    assert (near(world).distance, near(world).gap) == (np.inf, pytest.approx(0.0, abs=1e-12))
    world.set_state("PSM1", np.array(POSES[0]))  # open; the table lies beyond the pads
    assert near(world).distance == np.inf
    assert near(world).gap > 1e-3


def test_what_is_held_is_at_no_distance_even_where_it_is_pressed_in(tmp_path: Path) -> None:
    """A ball of 1 mm on the middle line touches pads that open by 2 asin(1 / 8)."""
    shape = '{ kind = "sphere", center_mm = [0, 0, 0], radius_mm = 1.0 }'
    path = rig_with_thing(tmp_path, shape)
    touch = np.sqrt(8.0**2 - 1.0)  # where the pads touch it, from their hinge [mm]
    text = path.read_text(encoding="utf-8").replace("[0.0, -8.0, 0.0]", f"[0.0, {-touch}, 0.0]")
    path.write_text(text, encoding="utf-8")
    world = World(path)
    start = world.rig.poses["start"]["PSM1"]
    for off, expected in ((0.0, 0.0), (-0.04, 0.0), (0.04, touch * 1e-3 * 0.02)):
        world.set_state("PSM1", np.array([*start[:6], 2 * np.arcsin(1 / 8) + off]))
        assert near(world).distance == pytest.approx(expected, abs=5e-6)  # the pads tilt by 0.02


# ------------------------------------------------------------------ imu


@pytest.mark.parametrize("q", POSES)
@pytest.mark.parametrize("frame", ["pitch_end", "roll", "tip", "counterweight"])
def test_at_rest_an_imu_reads_g_upward_in_its_own_axes(
    q: list[float], frame: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    rpy = [float(v) for v in rng.uniform(-3.0, 3.0, 3)]
    more = f"xyz_mm = [10.0, -20.0, 30.0]\nrpy_rad = {rpy}"
    world = World(rig_with(tmp_path, imu(frame, more=more)), friction="paper")
    at = hold(world, q, 3000)
    axes = frame_in_world(world, frame, at)[:3, :3] @ matrix_from_rpy(*rpy)
    reading = inertial(world)
    np.testing.assert_allclose(reading.linear_acceleration, axes.T @ [0.0, 0.0, G], atol=1e-3)
    np.testing.assert_allclose(reading.angular_velocity, 0.0, atol=1e-4)


def test_a_turning_shaft_pulls_inward_by_omega_squared_r(tmp_path: Path) -> None:
    """The shaft hangs down, so gravity lies along its axis."""
    world = World(rig_with(tmp_path, imu("roll", more="xyz_mm = [30.0, 0.0, 0.0]")))
    omega, time = 8.0, 0.005 * np.arange(60)
    q = np.tile(world.rig.poses["start"]["PSM1"], (60, 1))
    q[:, 3] = omega * time - 1.0
    v = np.zeros_like(q)
    v[:, 3] = omega
    world.set_state("PSM1", q[0], v[0])
    world.play({"PSM1": q[1:]}, {"PSM1": v[1:]}, every=5)
    reading = inertial(world)
    spin = world.arm("PSM1").joints.readings()[1][3]
    assert spin > 5.0
    assert abs(reading.angular_velocity[2]) == pytest.approx(spin, rel=1e-3)
    assert reading.linear_acceleration[0] == pytest.approx(-(spin**2) * 0.03, rel=0.01)
    assert abs(reading.linear_acceleration[2]) == pytest.approx(G, rel=0.01)


def test_a_moving_imu_reads_the_second_derivative_of_where_it_is(tmp_path: Path) -> None:
    """Positions twice differenced over 20 ms against the readings of that time."""
    place = np.array([0.02, -0.01, 0.05])
    more = f"xyz_m = {[float(v) for v in place]}"
    world = World(rig_with(tmp_path, imu("insertion", more=more)))
    arm = world.arm("PSM1")
    arm.move_jp([0.8, -0.6, 0.2, 0.5, 0.2, -0.2])
    world.step(100)
    body = world.mj_model.body("PSM1/insertion").id
    readings: list[ImuReading] = []
    at: list[Array] = []
    for _ in range(300):
        world.step()
        readings.append(inertial(world))
        seen = world.snapshot()
        turn = matrix_from_quaternion(seen.quaternions[body])
        at.append(transform(turn, seen.positions[body]))
    points = np.array([T[:3, :3] @ place + T[:3, 3] for T in at])
    step, span = world.timestep, 20
    biggest = 0.0
    for k in range(span, len(at) - span):
        second = (points[k + span] - 2 * points[k] + points[k - span]) / (span * step) ** 2
        mean = np.zeros(3)
        for j in range(-span + 1, span):  # the weights of a second difference over 2 span periods
            felt = readings[k + j + 1].linear_acceleration
            mean += (span - abs(j)) / span**2 * (at[k + j + 1][:3, :3] @ felt)
        mean[2] -= G
        np.testing.assert_allclose(mean, second, atol=1e-3)  # the arm turns within a period
        biggest = max(biggest, float(np.linalg.norm(second)))
    assert biggest > 0.1


def test_an_imu_stands_on_a_welded_setup_joint_too(tmp_path: Path) -> None:
    sensors = imu("mount", "SUJ_PSM1") + (
        '[[sensor]]\nname = "held"\nkind = "joint_effort"\narm = "SUJ_PSM1"\njoint = "{}"\n'
    )
    for setup in ("locked", "braked"):
        world = World("suj_two_psm_ecm", setup_joints=setup)
        joint = world.arm("SUJ_PSM1").joints.names[0]
        path = rig_with(tmp_path, sensors.format(joint), "suj_two_psm_ecm")
        world = World(path, setup_joints=setup)
        world.step(5)
        reading = inertial(world)
        assert np.linalg.norm(reading.linear_acceleration) == pytest.approx(G, abs=1e-3)
        held = world.sensor("held")
        assert isinstance(held, EffortReading)
        assert setup == "braked" or held.effort == 0.0


# ------------------------------------------------------------------ twist


def twist(frame: str, more: str = "", arm: str = "PSM1") -> str:
    return imu(frame, arm, more).replace("imu", "twist")


def velocity(world: World) -> TwistReading:
    reading = world.sensor("twist")
    assert isinstance(reading, TwistReading)
    return reading


@pytest.mark.parametrize("frame", ["pitch_back", "roll", "tip"])
def test_a_twist_is_the_first_difference_of_a_pose_in_its_own_axes(
    frame: str, tmp_path: Path
) -> None:
    rpy, place = [0.5, -1.1, 2.0], [0.02, -0.05, 0.1]
    world = World(rig_with(tmp_path, twist(frame, f"xyz_m = {place}\nrpy_rad = {rpy}")))
    at = transform(matrix_from_rpy(*rpy), np.array(place))
    world.arm("PSM1").move_jp([0.8, -0.6, 0.2, 0.5, 0.0, 0.0])
    world.step(300)

    def seen() -> Array:
        snapshot = world.snapshot()
        body, fixed = world.joints.arms["PSM1"].carrier(world.rig.arm("PSM1"), frame)
        turn = matrix_from_quaternion(snapshot.quaternions[body])
        return transform(turn, snapshot.positions[body]) @ fixed @ at

    before = seen()
    world.step()
    reading, now = velocity(world), seen()
    change = now[:3, :3].T @ (now - before)[:3] / world.timestep
    spin = (change[:, :3] - change[:, :3].T) / 2.0
    assert np.linalg.norm(reading.linear) > 0.01
    # A period ends with the velocity that it moved by. Axes that turn by half a period at 1 rad/s,
    # 0.5 mrad, change 0.2 m/s by 0.1 mm/s and 0.6 rad/s by 0.3 mrad/s.
    np.testing.assert_allclose(reading.linear, change[:, 3], atol=1e-4)
    np.testing.assert_allclose(reading.angular, [spin[2, 1], spin[0, 2], spin[1, 0]], atol=3e-4)


def test_a_twist_at_the_tip_is_the_measured_velocity(tmp_path: Path) -> None:
    world = World(rig_with(tmp_path, twist("tip")))
    arm = world.arm("PSM1")
    arm.move_jp([0.3, 0.2, 0.16, 0.4, 0.3, -0.2])
    world.step(300)
    reading, public, turn = velocity(world), arm.measured_cv(), arm.measured_cp().matrix[:3, :3]
    np.testing.assert_allclose(reading.linear, turn.T @ public.linear, atol=1e-3)
    np.testing.assert_allclose(reading.angular, turn.T @ public.angular, atol=1e-2)


# ------------------------------------------------------------------ all of them

ALL = TIP + TOUCH + NEAR + MOTORS + imu("tip") + twist("roll")


def test_reading_changes_no_bit_of_the_motion(tmp_path: Path) -> None:
    noisy = ALL.replace('kind = "tip_wrench"', 'kind = "tip_wrench"\nnoise_n = 0.1')
    path = rig_with(tmp_path, noisy)
    watched, alone = World(path), World(path)
    for world in (watched, alone):
        for _ in range(2):
            world.arm("PSM1").move_jp([0.1, 0.0, 0.24, 0.3, 0.0, 0.0])
            for _ in range(700):
                world.step()
                if world is watched:
                    for name in world.sensors:
                        world.sensor(name)
            world.set_state("PSM1", np.array(POSES[0]))
            if world is watched:
                for name in world.sensors:
                    world.sensor(name)
    np.testing.assert_array_equal(state(watched), state(alone))


def test_sensors_are_no_part_of_the_physics(tmp_path: Path) -> None:
    """The same model to the last byte, so that a step costs the same."""
    models = [World(rig).mj_model for rig in (rig_with(tmp_path, ALL), "psm")]
    sizes = [mujoco.mj_sizeModel(model) for model in models]
    assert sizes[0] == sizes[1]
    buffers = [np.zeros(size, dtype=np.uint8) for size in sizes]
    for model, buffer in zip(models, buffers, strict=True):
        mujoco.mj_saveModel(model, None, buffer)
    np.testing.assert_array_equal(buffers[0], buffers[1])


def test_the_mark_of_an_arm_that_was_put_somewhere_changes_no_bit_of_the_motion() -> None:
    marked, bare = World("psm"), World("psm")
    for world in (marked, bare):
        world.set_state("PSM1", np.array(POSES[1]))
        assert np.isnan(world.mj_data.qacc).any()
    bare.mj_data.qacc[:] = 0.0
    for world in (marked, bare):
        world.step(100)
    np.testing.assert_array_equal(state(marked), state(bare))


def test_a_reading_right_after_an_arm_was_put_somewhere_is_of_there(tmp_path: Path) -> None:
    world = World(rig_with(tmp_path, ALL))
    start = world.rig.poses["start"]["PSM1"]
    pressed = np.array([0.0, 0.0, 0.2274, 0.0, 0.0, 0.0, 0.0])
    assert touching(world).contacts == ()
    world.set_state("PSM1", pressed)  # 1 mm and more in the table
    assert touching(world).contacts
    assert wrench(world).force.any()
    world.set_state("PSM1", start)
    assert touching(world).contacts == ()
    assert not wrench(world).force.any()


def test_a_reading_at_the_start_is_what_the_first_period_feels(tmp_path: Path) -> None:
    world = World(rig_with(tmp_path, imu("tip")))
    for _ in range(2):
        foreseen = inertial(world).linear_acceleration
        world.step()
        felt = inertial(world).linear_acceleration
        np.testing.assert_allclose(foreseen, felt, atol=1e-4)  # it moved by less than 1 um
        world.reset()


def test_an_unknown_sensor_is_rejected_and_the_known_ones_listed(tmp_path: Path) -> None:
    world = World(rig_with(tmp_path, TIP + TOUCH))
    assert list(world.sensors) == ["tip", "touch"]
    with pytest.raises(UnknownNameError, match=r"sensor 'tpi' .*'tip'.*known: tip, touch"):
        world.sensor("tpi")
    with pytest.raises(UnknownNameError, match="known: none"):
        World("psm").sensor("tip")


def test_a_reading_is_frozen(tmp_path: Path) -> None:
    reading = wrench(World(rig_with(tmp_path, TIP)))
    with pytest.raises(dataclasses.FrozenInstanceError):
        reading.time = 1.0  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(ValueError, match="read-only"):
        reading.force[0] = 1.0


def test_noise_is_drawn_as_wide_as_asked_and_anew_from_the_same_seed(tmp_path: Path) -> None:
    noisy = TIP + "noise_n = 0.5\nnoise_nm = 0.002\n"
    world = World(rig_with(tmp_path, noisy), seed=5)
    first = np.array([wrench(world).force for _ in range(400)])
    torques = np.array([wrench(world).torque for _ in range(400)])
    assert first.std() == pytest.approx(0.5, rel=0.1)  # 1200 draws: 2 % standard error
    assert torques.std() == pytest.approx(0.002, rel=0.1)
    assert abs(first.mean()) < 0.06
    world.reset()
    again = np.array([wrench(world).force for _ in range(400)])
    np.testing.assert_array_equal(first, again)
    world.reset(seed=6)
    assert (wrench(world).force != first[0]).any()


def test_without_noise_nothing_is_drawn(tmp_path: Path) -> None:
    world, other = World(rig_with(tmp_path, ALL)), World("psm")
    for name in world.sensors:
        world.sensor(name)
    assert world.rng.standard_normal() == other.rng.standard_normal()


def test_a_sensor_with_a_rate_has_one_sample_a_period(tmp_path: Path) -> None:
    world = World(rig_with(tmp_path, TIP + "noise_n = 0.5\nrate_hz = 100.0\n"))
    seen: list[tuple[float, float]] = []
    for _ in range(60):
        reading = wrench(world)
        seen.append((reading.time, reading.force[0]))
        world.step(3)
    times = sorted({time for time, _ in seen})
    assert len(set(seen)) == len(times) == 18  # 0.177 s
    assert all(time - int(time * 100 + 1e-9) / 100 < 0.003 + 1e-9 for time in times)
    first = seen[0]
    world.reset()
    reading = wrench(world)
    assert (reading.time, reading.force[0]) == first
    world.reset(seed=1)
    assert wrench(world).force[0] != reading.force[0]  # at the same time, and yet a new sample


def test_sensors_stay_when_another_tool_is_mounted(tmp_path: Path) -> None:
    world = World(rig_with(tmp_path, TIP + NEAR + imu("finger_left")))
    world.step(10)
    for tool in ("PROGRASP_FORCEPS:420093", "LARGE_NEEDLE_DRIVER:400006"):
        world.exchange_tool("PSM1", tool)
        for _ in range(2):
            felt = inertial(world).linear_acceleration
            assert np.linalg.norm(felt) == pytest.approx(G, rel=0.05)
            assert not wrench(world).force.any()
            assert near(world).time == world.time
            world.step(300)
        world.mj_data.xfrc_applied[world.mj_model.body("PSM1/finger_right").id, :3] = [
            0.1,
            0.0,
            0.0,
        ]
        world.step()
        assert np.linalg.norm(wrench(world).force) == pytest.approx(0.1)
    with pytest.raises(InputError, match=r"PSM1: sensor 'tip' needs tip, which the bare arm"):
        world.exchange_tool("PSM1", "none")
    assert wrench(world).time == world.time
