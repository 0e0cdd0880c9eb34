"""The data of the arms against the dVRK's own rows, written out here a second time."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm, load_rig, names
from trocar.descriptions.paper import errata
from trocar.geometry import rotation_x
from trocar.geometry.dh import modified_dh, standard_dh
from trocar.geometry.se3 import translation
from trocar.kinematics import loops
from trocar.kinematics.forward import pose, poses

Array = NDArray[np.float64]
Row = tuple[float, float, float, float]

RIGHT = np.pi / 2
#: Rounding of a product of ten transforms of metre size.
EXACT = 1e-12
GRAVITY = 9.81

#: (d2, a3, d4) of the setup joints. Source: sawIntuitiveResearchKit suj-simulated.json.
SETUP = {
    "suj_psm1": (0.4166, 0.4318, -0.1302),
    "suj_psm2": (0.4166, 0.4318, -0.1302),
    "suj_psm3": (0.3404, 0.5842, 0.2571),
    "suj_ecm": (0.4166, 0.4318, -0.3459),
}
#: world_origin_to_SUJ: translation, then where x and y point. Source: the same file.
WORLD_TO_SETUP = {
    "suj_psm1": ((-0.1016, -0.1016, 0.43), (-1.0, 0.0)),
    "suj_psm2": ((0.1016, -0.1016, 0.43), (1.0, 0.0)),
    "suj_psm3": ((0.0, 0.0, 0.1264), (0.0, 1.0)),
    "suj_ecm": ((0.0, 0.0, 0.43), (0.0, 1.0)),
}

#: {arm: (torque constant [N m/A], gear ratio [-; insertions: 1/m], largest current [A]) of each
#: motor}. Source: sawIntuitiveResearchKit@9e535e6 dvrk-io-config-generator.py.
MOTORS: dict[str, list[tuple[float, float, float]]] = {
    "psm": [(0.0438, 56.5, 1.34), (0.0438, 56.5, 1.34), (0.0438, 336.6, 0.67)],
    "psm_si": [(0.0603, 83.3333, 3.4), (0.0603, 85.0, 3.4), (0.0385, 965.91, 1.1)],
    "ecm": [(0.119, 240.0, 0.943), (0.119, 240.0, 0.943), (0.0438, 2748.55, 0.67),
            (0.00495, 300.15, 0.59)],
    "ecm_si": [(0.0603, 83.3333, 3.4), (0.0603, 168.3333, 3.4), (0.0385, 2748.6, 0.67),
               (0.0385, 300.2, 0.59)],
    "mtm": [(0.0438, 63.41, 0.67), (0.0438, 49.88, 0.67), (0.0438, 59.73, 0.67),
            (0.0438, 10.53, 0.67), (0.00495, 33.16, 0.59), (0.00495, 33.16, 0.59),
            (0.00339, 16.58, 0.407)],
}  # fmt: skip
#: Relative. Source: the dVRK prints a PSM's efforts 1e-6 and 6e-6 above these products.
ROUNDED = 1e-5


def samples(arm: ArmDescription, count: int, seed: int = 7) -> Array:
    lower, upper = arm.mechanism.lower, arm.mechanism.upper
    return lower + (upper - lower) * np.random.default_rng(seed).random((count, len(lower)))


def endoscope_chain(q: Array) -> Array:
    """T_rcm_tip of the ECM. Source: SAW ECM.json and mtsIntuitiveResearchKitECM.cpp."""
    last_row = (
        modified_dh(0.0, RIGHT, 0.0, q[0] + RIGHT)
        @ modified_dh(0.0, -RIGHT, 0.0, q[1] - RIGHT)
        @ modified_dh(0.0, RIGHT, q[2] - 0.3822, 0.0)
        @ modified_dh(0.0, 0.0, 0.3829, q[3])
    )
    tooltip = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    return last_row @ tooltip


def instrument_chain(q: Array, drop: float, shaft: float) -> Array:
    """T_rcm_tip of a PSM with its tool. Source: SAW PSM.json, PSM_Si.json, share/tool."""
    to_yaw = (
        modified_dh(0.0, RIGHT, 0.0, q[0] + RIGHT)
        @ modified_dh(0.0, -RIGHT, 0.0, q[1] - RIGHT)
        @ modified_dh(0.0, RIGHT, q[2] - drop, 0.0)
        @ modified_dh(0.0, 0.0, shaft, q[3])
        @ modified_dh(0.0, -RIGHT, 0.0, q[4] - RIGHT)
        @ modified_dh(0.0091, -RIGHT, 0.0, q[5] - RIGHT)
    )
    tooltip = np.array([[0.0, -1, 0, 0], [0, 0, 1, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    return to_yaw @ tooltip


def setup_chain(name: str, q: Array) -> Array:
    """T_cart_tip of a setup arm. Source: SAW suj-simulated.json."""
    (at, (cosine, sine)) = WORLD_TO_SETUP[name]
    place = translation(np.array(at)) @ modified_dh(0.0, 0.0, 0.0, np.arctan2(sine, cosine))
    d2, a3, d4 = SETUP[name]
    arm = (
        place
        @ modified_dh(0.0896, 0.0, q[0], 0.0)
        @ modified_dh(0.0, 0.0, d2, q[1])
        @ modified_dh(a3, 0.0, 0.1429, q[2])
        @ modified_dh(0.4318, 0.0, d4, q[3] + RIGHT)
    )
    if name == "suj_ecm":
        return arm @ modified_dh(0.0, -RIGHT / 2, 0.0, RIGHT) @ modified_dh(-0.0667, 0.0, 0.0, 0.0)
    return (
        arm
        @ modified_dh(0.0, RIGHT, 0.4089, q[4])
        @ modified_dh(0.0, -RIGHT, -0.1029, q[5] - RIGHT)
    )


def master_chain(q: Array) -> Array:
    """T_base_tip of an MTM. Source: SAW MTML.json, MTMR.json (the same rows)."""
    rows: list[Row] = [
        (0.0, RIGHT, 0.0, -RIGHT),
        (0.2794, 0.0, 0.0, -RIGHT),
        (0.3645, -RIGHT, 0.0, RIGHT),
        (0.0, RIGHT, 0.1506, 0.0),
        (0.0, -RIGHT, 0.0, 0.0),
        (0.0, RIGHT, 0.0, -RIGHT),
        (0.0, 0.0, 0.0, RIGHT),
    ]
    reached = np.eye(4)
    for (a, alpha, d, theta), angle in zip(rows, q[:7], strict=True):  # the gripper is the eighth
        reached = reached @ standard_dh(a, alpha, d, theta + angle)
    return reached


@pytest.mark.parametrize("name", ["psm", "psm_si", "ecm", "ecm_si", "mtml", "mtmr"])
def test_effort_limits_are_what_the_motors_exert_at_their_largest_current(name: str) -> None:
    motors = np.prod(MOTORS["mtm" if name.startswith("mtm") else name], axis=1)
    joint_from_motor = np.eye(len(motors))
    if name.startswith("mtm"):  # Source: compute-ftmax.py
        joint_from_motor[2, 1] = -1.0
        joint_from_motor[3, 1:3] = 0.6697, -0.6697
    efforts = np.array([joint.effort_max for joint in load_arm(name).joints[: len(motors)]])
    expected = np.linalg.inv(joint_from_motor).T @ motors
    np.testing.assert_allclose(efforts, expected, rtol=ROUNDED)


@pytest.mark.parametrize("tool", names("tools"))
def test_of_a_wrist_only_the_limit_of_the_roll_is_beyond_the_motors_of_a_classic(tool: str) -> None:
    arm = load_arm("psm", tool)
    assert arm.coupling is not None
    motor = 0.0438 * 11.71 * 0.67  # [N m]. Source: as MOTORS
    alone = motor / np.abs(arm.coupling.actuator_to_joint).max(axis=1)  # one joint exerts
    efforts = [arm.joint(name).effort_max for name in arm.coupling.joints]
    assert [e > most for e, most in zip(efforts, alone, strict=True)] == [True, False, False, False]


@pytest.mark.parametrize("name", names("arms"))
def test_an_arm_has_the_mended_value_of_each_erratum_of_its_source(name: str) -> None:
    arm = load_arm(name)
    for row in errata(name):
        assert row.printed != row.mended and row.effect and row.source
        if row.key == "effort_max_nm":
            assert arm.joint(row.frame).effort_max == row.mended


def test_the_efforts_that_the_dvrk_prints_wrong_for_the_si_are_errata() -> None:
    wrong = {
        name: [(e.frame, e.printed) for e in errata(name) if e.key == "effort_max_nm"]
        for name in ("psm_si", "ecm_si")
    }
    assert wrong == {"psm_si": [("pitch", 17.0845)], "ecm_si": [("pitch", 34.0845)]}
    assert [e.key for name in wrong for e in errata(name)] == [
        "effort_max_nm", "zero_rad", "offset_m", "effort_max_nm",
    ]  # fmt: skip


def test_the_zero_of_dvrk_model_s_pitch_leans_the_shaft_and_moves_the_mount() -> None:
    """Source: dvrk_model@70998aa urdf/Si/PSM_base.urdf.xacro, origins of the three pitch joints."""
    row = next(e for e in errata("psm_si") if e.key == "zero_rad")
    assert row.printed == pytest.approx(1.1345 - 0.90761 - 0.063963, abs=1e-9)
    assert np.rad2deg(row.printed) == pytest.approx(9.335, abs=5e-4)
    arm, lean = load_arm("psm_si", "none"), np.array([0.0, float(row.printed), 0.0])
    moved = [
        pose(arm.mechanism, q + lean, "insertion")[:3, 3]
        - pose(arm.mechanism, q, "insertion")[:3, 3]
        for q in samples(arm, 2000)
    ]
    far = 1e3 * np.linalg.norm(moved, axis=1)
    assert far.max() == pytest.approx(79.0, abs=1.0)
    assert far.mean() == pytest.approx(55.0, abs=1.0)


def test_the_dvrk_s_physical_chain_of_the_si_ends_0_1_mm_beside_its_serial_one() -> None:
    row = next(e for e in errata("psm_si") if e.key == "offset_m")
    assert row.printed == pytest.approx(-0.1810 - 0.1800 - 0.1215, abs=1e-12)
    assert isinstance(row.mended, float)
    arm = load_arm("psm_si", "none")
    at = pose(arm.mechanism, np.zeros(3), "insertion")
    assert np.linalg.norm(at[:3, 3]) == pytest.approx(-row.mended, abs=1e-9)


@pytest.mark.parametrize("name", ["ecm", "ecm_si"])
def test_endoscope_tip_is_the_dvrks(name: str) -> None:
    arm = load_arm(name)
    for q in samples(arm, 100):
        np.testing.assert_allclose(pose(arm.mechanism, q), endoscope_chain(q), rtol=0, atol=EXACT)


@pytest.mark.parametrize(
    ("name", "drop", "shaft"), [("psm", 0.4318, 0.4162), ("psm_si", 0.4826, 0.4670)]
)
def test_instrument_tip_is_the_dvrks(name: str, drop: float, shaft: float) -> None:
    arm = load_arm(name)
    for q in samples(arm, 100):
        expected = instrument_chain(q, drop, shaft)
        np.testing.assert_allclose(pose(arm.mechanism, q), expected, rtol=0, atol=EXACT)


@pytest.mark.parametrize("name", ["mtml", "mtmr"])
def test_master_tip_is_the_dvrks(name: str) -> None:
    arm = load_arm(name)
    for q in samples(arm, 100):
        np.testing.assert_allclose(pose(arm.mechanism, q), master_chain(q), rtol=0, atol=EXACT)


@pytest.mark.parametrize("name", sorted(SETUP))
def test_setup_tip_and_remote_centre_are_the_dvrks(name: str) -> None:
    arm = load_arm(name)
    along, up = (0.6126, 0.1016) if name == "suj_ecm" else (0.4864, 0.1524)
    for q in samples(arm, 100):
        found = poses(arm.mechanism, q, "cart")
        expected = setup_chain(name, q)
        np.testing.assert_allclose(found["suj_6"], expected, rtol=0, atol=EXACT)
        origin = np.array([[0, 1, 0, along], [-1, 0, 0, 0], [0, 0, 1, up], [0, 0, 0, 1.0]])
        np.testing.assert_allclose(found["tip"], expected @ origin, rtol=0, atol=EXACT)
        centre = found["mount"] @ np.array([0.0, along, 0.0, 1.0])
        np.testing.assert_allclose(centre, found["tip"][:, 3], rtol=0, atol=EXACT)


def test_ecm_stands_where_the_mended_table_puts_it() -> None:
    # Source: positions at q = 0 from the mended rows, rounded betas; 0.2 mm is their rounding
    expected = {
        "pitch_front": (0.0, 0.2722, 0.0),
        "pitch_back": (0.0, 0.23563, -0.0098),
        "pitch_bottom": (0.0, 0.16921, 0.28677),
        "pitch_top": (0.0, 0.16371, 0.32423),
        "pitch_end": (0.0, 0.50961, 0.28677),
        "insertion": (0.0, 0.61261, 0.38207),
        "rcm": (0.0, 0.6126, 0.0),
    }
    arm = load_arm("ecm")
    found = poses(arm.mechanism, np.zeros(4), "base")
    for frame, at in expected.items():
        np.testing.assert_allclose(found[frame][:3, 3], at, rtol=0, atol=2e-4, err_msg=frame)


def test_endoscope_shaft_passes_the_remote_centre_exactly() -> None:
    arm = load_arm("ecm")
    for q in samples(arm, 200):
        shaft = pose(arm.mechanism, q, "insertion")
        assert np.linalg.norm(np.cross(shaft[:3, 2], shaft[:3, 3])) < EXACT


@pytest.mark.parametrize("name", ["ecm", "mtml", "mtmr"])
def test_loops_are_exact_parallelograms_far_from_flat(name: str) -> None:
    mechanism = load_arm(name).mechanism
    q = samples(load_arm(name), 500)
    assert loops.gaps(mechanism, loops.coupled_coordinates(mechanism, q)).max() < EXACT
    assert min(place.margin for place in loops.flattenings(mechanism)) > 0.2


@pytest.mark.parametrize("name", names("arms"))
def test_every_moving_frame_has_a_possible_body(name: str) -> None:
    arm = load_arm(name)
    loaded = {body.frame for body in arm.bodies}
    for frame in arm.mechanism.frames:
        assert frame.motion == "fixed" or frame.name in loaded, frame.name
    for body in arm.bodies:
        low, middle, high = np.linalg.eigvalsh(body.inertia)
        assert body.mass > 0.0 and low > 0.0, body.frame
        assert high <= (low + middle) * 1.001, body.frame
        assert body.source, body.frame


@pytest.mark.parametrize("name", names("arms"))
def test_every_frame_and_the_file_name_a_source(name: str) -> None:
    arm = load_arm(name)
    assert arm.source
    assert all(arm.row_sources[frame.name] for frame in arm.mechanism.frames)


@pytest.mark.parametrize(
    ("name", "lean_deg"), [("ecm", 0), ("ecm", 45), ("ecm", -45), ("mtml", 0), ("mtmr", 0)]
)
def test_gravity_needs_at_most_half_of_each_effort_limit(name: str, lean_deg: float) -> None:
    # the cart's scope leans by 45 degrees; the other way round for good measure
    arm = load_arm(name)
    limits = np.array([joint.effort_max for joint in arm.joints])
    lean = np.radians(lean_deg)
    down = np.array([0.0, -np.sin(lean), -np.cos(lean)])
    for q in samples(arm, 30):
        assert (np.abs(holding_efforts([arm], q, down)) <= 0.5 * limits).all()


@pytest.mark.parametrize("name", names("arms"))
def test_servos_that_feed_no_gravity_forward_hold_every_arm_within_a_tenth_of_its_tolerance(
    name: str,
) -> None:
    """P alone holds a weight W off the set-point by W / P; the cart's scope leans by 45 degrees."""
    arm = load_arm(name)
    trips = np.array([joint.tracking_tolerance for joint in arm.joints])
    for control in arm.control.values():
        if control.gravity_compensation:
            continue
        stiffness = np.array([control.pid[joint.name].p for joint in arm.joints])
        for lean in np.radians([0.0, 45.0, -45.0]):
            down = np.array([0.0, -np.sin(lean), -np.cos(lean)])
            for q in samples(arm, 30):
                sag = np.abs(holding_efforts([arm], q, down)) / stiffness
                assert (sag <= 0.1 * trips).all(), (control.name, sag)


@pytest.mark.parametrize(
    ("setup", "carried"), [("suj_psm1", "psm"), ("suj_psm3", "psm"), ("suj_ecm", "ecm")]
)
def test_setup_joints_hold_their_arm(setup: str, carried: str) -> None:
    arms = [load_arm(setup), load_arm(carried)]
    limits = np.array([joint.effort_max for joint in arms[0].joints])
    both = np.concatenate([samples(arm, 25) for arm in arms], axis=1)
    for q in both:
        efforts = holding_efforts(arms, q, np.array([0.0, 0.0, -1.0]))[: len(limits)]
        assert (np.abs(efforts) <= 0.5 * limits).all()


def holding_efforts(arms: list[ArmDescription], q: Array, down: Array) -> Array:
    """Return d(potential energy)/dq of arms that carry each other, by central differences."""

    def energy(at: Array) -> float:
        total, mount, first = 0.0, np.eye(4), 0
        for arm in arms:
            count = len(arm.joints)
            placed = poses(arm.mechanism, at[first : first + count], arm.root)
            for body in arm.bodies:
                centre = mount @ placed[body.frame] @ np.append(body.com, 1.0)
                total -= body.mass * GRAVITY * float(down @ centre[:3])
            mount, first = mount @ placed.get("mount", np.eye(4)), first + count
        return total

    step = 1e-5
    turn = step * np.eye(len(q))
    return np.array([(energy(q + row) - energy(q - row)) / (2.0 * step) for row in turn])


@pytest.mark.parametrize("name", names("rigs"))
def test_rigs_without_setup_joints_keep_the_carts_spacing(name: str) -> None:
    rig = load_rig(name)
    if any(arm.on for arm in rig.arms) or name == "training":  # which has ports of its own
        return
    held = [arm.name for arm in rig.arms if "rcm" in arm.arm.mechanism.frame_index]
    if not held:
        return
    centre = {arm: remote_centre(name, arm) for arm in held}
    first = next(iter(centre.values()))
    upright = translation(np.array([0.0, 0.0, 0.3]))
    # Those of an Si lean by the mounting pitch. Source: SAW suj-si-simulated.json.
    upright[:3, :3] = rotation_x(np.radians({"psm_si": -45.0, "ecm_si": -70.0}.get(name, 0.0)))
    si = name.endswith("_si")
    if not (si and len(centre) > 1):  # several stand as on their cart, which is level
        np.testing.assert_allclose(first, upright, rtol=0, atol=EXACT)
    if len(centre) == 1:
        return
    cart = {arm: remote_centre("full_cart_si" if si else "full_cart", arm) for arm in centre}
    to_rig = first @ np.linalg.inv(cart["PSM1"])
    for arm, found in centre.items():
        np.testing.assert_allclose(found, to_rig @ cart[arm], rtol=0, atol=EXACT)


def test_the_carts_remote_centres_are_saws() -> None:
    rig = load_rig("full_cart")
    above_floor = translation(np.array([0.0, 0.0, 0.167458]))
    turn = modified_dh(0.0, 0.0, 0.0, -RIGHT)
    for arm in ("PSM1", "PSM2", "PSM3", "ECM"):
        q = rig.poses["start"][f"SUJ_{arm}"]
        along, up = (0.6126, 0.1016) if arm == "ECM" else (0.4864, 0.1524)
        tool_origin = translation(np.array([along, 0.0, up])) @ turn
        expected = above_floor @ setup_chain(f"suj_{arm.lower()}", q) @ tool_origin
        np.testing.assert_allclose(remote_centre("full_cart", arm), expected, rtol=0, atol=EXACT)


def remote_centre(rig_name: str, arm_name: str) -> Array:
    """T_world_rcm of an arm in a rig's start pose."""
    rig = load_rig(rig_name)
    place, arm = np.eye(4), rig.arm(arm_name)
    mount = arm.pose
    if arm.on:
        carrier = rig.arm(arm.on)
        q = rig.poses["start"][carrier.name]
        place = carrier.pose @ poses(carrier.arm.mechanism, q, carrier.arm.root)[arm.frame]
    q = rig.poses["start"][arm_name]
    return place @ mount @ poses(arm.arm.mechanism, q, arm.arm.root)["rcm"]
