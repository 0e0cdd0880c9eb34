"""A lab's configuration becomes a rig that stands and reaches as the file says."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robot.dvrk_config import configurations as lab
from trocar.descriptions import RigDescription, load_arm, load_rig
from trocar.errors import DescriptionError
from trocar.kinematics.forward import pose
from trocar.robot.dvrk_config import RigImportOptions, import_dvrk
from trocar.robot.dvrk_config.agreement import agreement
from trocar.robot.dvrk_config.system import read_system
from trocar.simulation import World

#: The issue asks for 1e-6 m and rad; what is left is rounding.
EXACT = 1e-9
CART_Z = 0.167458


def moved(rig: RigDescription, name: str, q: np.ndarray, q_suj: np.ndarray) -> np.ndarray:
    """Return the base of an arm that setup joints hold, on the cart, from the rig's TOML."""
    arm = rig.arm(name)
    carrier = rig.arm(arm.on).arm
    mechanism = arm.arm.mechanism
    root = mechanism.frames[0].name
    return (
        pose(carrier.mechanism, q_suj, arm.frame)
        @ arm.pose
        @ pose(mechanism, q, mechanism.reference, root)
    )


@pytest.mark.parametrize("generation", ["Classic", "Si"])
def test_bases_and_tips_agree_with_the_file_at_any_joints(tmp_path: Path, generation: str) -> None:
    found = import_dvrk(lab.lab(tmp_path / "in", generation), tmp_path / "rig.toml")
    rng = np.random.default_rng(1)
    setups = {s["name"]: s for s in (lab.CLASSIC if generation == "Classic" else lab.SI)}
    psm, ecm = (lab.PSM, lab.ECM) if generation == "Classic" else (lab.PSM_SI, lab.ECM_SI)
    for name, setup in setups.items():
        arm, suj = found.rig.arm(name).arm.mechanism, found.rig.arm(f"SUJ_{name}").arm.mechanism
        for _ in range(10):
            q, q_suj = (
                rng.uniform(arm.lower, arm.upper),
                rng.uniform(suj.lower, suj.upper),
            )
            seen = moved(found.rig, name, q, q_suj)
            np.testing.assert_allclose(seen, lab.base(setup, q_suj), atol=EXACT)
            if name == "ECM":
                tip = lab.chain(ecm, q) @ lab.SCOPE_TIP
            else:
                tip = lab.chain([*psm, *lab.TOOL[generation]], q[:6]) @ lab.TOOLTIP
            np.testing.assert_allclose(pose(arm, q), tip, atol=EXACT)
    gap = dict(found.agreement)
    assert {kind: each.count for kind, each in gap.items()} == {
        "bases": 6, "chains": 4, "tips": 1, "cameras": 1, "setup_joints": 4, "limits": 4
    }  # fmt: skip
    assert gap.pop("limits").radians < 1e-5  # 1.5708 is read as 90 degrees
    assert max(max(each.metres, each.radians) for each in gap.values()) < EXACT


@pytest.mark.parametrize("generation", ["Classic", "Si"])
def test_the_comparison_sees_setup_joints_that_leave_out_the_tool_origin(
    tmp_path: Path, generation: str
) -> None:
    path = lab.lab(tmp_path / "in", generation)
    rig = import_dvrk(path, tmp_path / "rig.toml").rig
    arms = []
    for each in rig.arms:
        arm = each.arm
        if arm.type == "SUJ":  # their last row, as trocar once published
            last = next(f.parent for f in arm.mechanism.frames if f.name == "mount")
            arm = replace(arm, mechanism=replace(arm.mechanism, tip=last))
        arms.append(replace(each, arm=arm))
    read = read_system(path)
    gap = agreement(read, replace(rig, arms=tuple(arms)))
    assert gap["bases"].metres < EXACT
    assert gap["setup_joints"].metres > 0.4
    assert gap["setup_joints"].radians == pytest.approx(np.pi / 2, abs=1e-6)
    in_the_cart = agreement(replace(read, reference_arm="PSM1"), rig)
    assert (
        in_the_cart["setup_joints"].metres > 0.4
    )  # the rig's reference arm is another than the file's


@pytest.mark.parametrize("generation", ["Classic", "Si"])
def test_the_rig_is_simulated_and_its_poses_are_the_dvrk_s(tmp_path: Path, generation: str) -> None:
    import_dvrk(lab.lab(tmp_path / "in", generation), tmp_path / "rig.toml")
    world = World(str(tmp_path / "rig.toml"))
    setups = {s["name"]: s for s in (lab.CLASSIC if generation == "Classic" else lab.SI)}
    psm, ecm = (lab.PSM, lab.ECM) if generation == "Classic" else (lab.PSM_SI, lab.ECM_SI)
    before = np.zeros(0)
    for _ in range(2):
        q = {name: arm.joints.readings()[0] for name, arm in world.arms.items()}
        scope = lab.base(setups["ECM"], q["SUJ_ECM"]) @ lab.chain(ecm, q["ECM"]) @ lab.SCOPE_TIP
        for name in ("PSM1", "PSM2", "PSM3"):
            tip = lab.chain([*psm, *lab.TOOL[generation]], q[name][:6]) @ lab.TOOLTIP
            seen = np.linalg.inv(scope) @ lab.base(setups[name], q[f"SUJ_{name}"]) @ tip
            told = world.arm(name).measured_cp()
            assert told.frame_id == "ECM"
            np.testing.assert_allclose(told.matrix, seen, atol=1e-6)
        told = world.arm("ECM").measured_cp().matrix
        np.testing.assert_allclose(told, scope, atol=1e-6)
        before = world.arm("PSM1").joints.readings()[0]
        world.arm("PSM1").servo_jp(before[:6] + np.array([0.05, 0.05, 0.01, 0.2, 0.1, 0.1]))
        world.step(400)
    gone = world.arm("PSM1").joints.readings()[0][:6] - before[:6]
    np.testing.assert_allclose(gone, [0.05, 0.05, 0.01, 0.2, 0.1, 0.1], atol=0.02)


def test_the_classic_cart_is_trocar_s_own_and_starts_where_the_file_says(tmp_path: Path) -> None:
    found = import_dvrk(lab.lab(tmp_path / "in"), tmp_path / "rig.toml")
    assert found.files == (str(tmp_path / "rig.toml"),)  # nothing differs, so no file of its own
    start, own = found.rig.poses["start"], load_rig("full_cart_mtm").poses["start"]
    assert set(start) == set(own)
    for name, q in own.items():
        np.testing.assert_allclose(start[name], q, atol=1e-9, err_msg=name)
    assert found.unknown == ()


def test_masters_stand_under_the_display_as_the_file_says(tmp_path: Path) -> None:
    found = import_dvrk(lab.lab(tmp_path / "in"), tmp_path / "rig.toml")
    world = World(str(tmp_path / "rig.toml"))
    for name, x in (("MTML", 0.18), ("MTMR", -0.18)):
        base, frame = world.arm(name).local.base_frame()
        assert frame == "HRSV"
        np.testing.assert_allclose(base[:3, :3], lab.HRSV, atol=1e-9)
        np.testing.assert_allclose(base[:3, 3], [x, 0.4, 0.475], atol=1e-9)
    tool, other, scope = found.rig.teleops
    assert (tool.name, tool.scale, tool.gripper_threshold) == ("MTMR_PSM1", 0.2, 0.0)
    assert math.degrees(other.gripper_threshold) == pytest.approx(40.0)
    assert (scope.kind, scope.masters, scope.slave) == ("ecm", ("MTML", "MTMR"), "ECM")


def test_angles_are_exact_unless_they_are_asked_for_as_printed(tmp_path: Path) -> None:
    order = RigImportOptions(literal=True)
    found = import_dvrk(lab.lab(tmp_path / "in"), tmp_path / "rig.toml", order)
    suj = found.rig.arm("SUJ_ECM").arm.mechanism
    rng = np.random.default_rng(2)
    far = 0.0
    for _ in range(10):
        q = rng.uniform(suj.lower, suj.upper)
        seen = moved(found.rig, "ECM", np.zeros(4), q)
        np.testing.assert_allclose(seen, lab.base(lab.CLASSIC[0], q, literal=True), atol=EXACT)
        exact = lab.base(lab.CLASSIC[0], q)
        far = max(far, float(np.linalg.norm(seen[:3, 3] - exact[:3, 3])))
    assert 1e-5 < far < 1e-4  # 0.7853 for 45 degrees


def test_what_a_lab_changed_is_in_the_rig(tmp_path: Path) -> None:
    rows = [dict(r) for r in lab.PSM]
    rows[0] |= {"qmin": -1.0, "qmax": 1.2, "ftmax": 2.5}
    setups = json.loads(json.dumps(lab.CLASSIC))
    setups[1]["world_origin_to_SUJ"]["Translation"] = [-0.11, -0.1, 0.5]
    setups[1]["DH"]["links"][2]["A"] = 0.44
    setups[1] |= {"primary_offsets": [1.0] * 6, "primary_scales": [2.0] * 6}
    names = ["yaw", "pitch", "insertion", "disc_1", "disc_2", "disc_3", "disc_4"]
    gains = [
        {"index": k, "name": n, "p_gain": 99.0, "i_gain": 0.0, "d_gain": 4.0}
        for k, n in enumerate(names)
    ]
    system = lab.system()
    parameters = {
        "scale": 0.35,
        "align_MTM": False,
        "jaw_rate": 6.0,
        "gripper_scaling": {"max": 0.9},
    }
    system["consoles"][0]["teleop_PSMs"][0]["configure_parameter"] = parameters
    path = lab.lab(
        tmp_path / "in",
        files={
            "system-lab.json": system,
            "arm/suj.json": {"arms": setups},
            "kinematic/PSM.json": {"DH": {"convention": "modified", "joints": rows}},
            "pid/sawControllersPID-PSM.json": {"pid": gains},
        },
    )
    found = import_dvrk(path, tmp_path / "rig.toml")
    arm = found.rig.arm("PSM1").arm
    assert (arm.joint("yaw").lower, arm.joint("yaw").upper) == (-1.0, 1.2)
    assert arm.joint("yaw").effort_max == 2.5
    assert arm.joint("pitch").upper == pytest.approx(0.925025)
    assert {g.p for g in arm.control["dvrk"].pid.values()} == {99.0}  # the discs' are the tool's
    q = found.rig.arm("SUJ_PSM1").arm.mechanism.upper * 0.5
    seen = moved(found.rig, "PSM1", np.zeros(7), q)
    np.testing.assert_allclose(seen, lab.base(setups[1], q), atol=EXACT)
    tool = found.rig.teleops[0]
    assert (tool.scale, tool.align, tool.jaw_rate, tool.gripper_max) == (0.35, False, 6.0, 0.9)
    assert "primary_offsets" in (tmp_path / "rig.toml").read_text(encoding="utf-8")
    World(str(tmp_path / "rig.toml")).step(10)


def test_bases_in_a_frame_that_no_arm_has_stand_so_and_are_told_so(tmp_path: Path) -> None:
    psm: dict[str, Any] = {"name": "PSM1", "type": "PSM", "serial": "12345", "IO": "IO"}
    T = [[-1.0, 0, 0, -0.2], [0, 0.866025404, 0.5, 0], [0, 0.5, -0.866025404, 0], [0, 0, 0, 1]]
    psm["base_frame"] = {"reference_frame": "ECM", "transform": T}
    path = lab.write(
        tmp_path / "in",
        {
            "system-lab.json": {"IOs": [{"name": "IO", "port": "fw"}], "arms": [psm]},
            "PSM1-12345.json": {"kinematic": "kinematic/PSM.json", "generation": "Classic"},
        },
    )
    found = import_dvrk(path, tmp_path / "rig.toml")
    told = World(str(tmp_path / "rig.toml")).arm("PSM1")
    assert told.measured_cp().frame_id == "ECM"
    np.testing.assert_allclose(told.local.base_frame()[0], T, atol=1e-9)
    assert any("tool_detection is AUTOMATIC" in text for text in found.notes)
    assert found.idle == (f"{path}: IOs, arms[].IO",)


def test_arms_that_no_file_places_stand_apart(tmp_path: Path) -> None:
    arms = [
        {"name": n, "type": "PSM", "arm_file": "arm/PSM_KIN_SIMULATED_MANUAL.json"}
        for n in ("PSM1", "PSM2")
    ]
    path = lab.write(tmp_path / "in", {"system-lab.json": {"arms": arms}})
    order = RigImportOptions(tools=(("PSM2", "PROGRASP_FORCEPS:400093"),))
    rig = import_dvrk(path, tmp_path / "rig.toml", order).rig
    apart = rig.arm("PSM1").pose[:3, 3] - rig.arm("PSM2").pose[:3, 3]
    assert np.linalg.norm(apart) > 0.4
    assert rig.arm("PSM2").arm.tool == "PROGRASP_FORCEPS:400093"
    assert rig.arm("PSM1").arm.tool == "LARGE_NEEDLE_DRIVER:400006"


def test_comments_and_both_spellings_are_read_and_unknown_keys_are_listed(tmp_path: Path) -> None:
    text = """
    /* -*- Mode: Javascript -*- */
    { // a "comment" with { and /* in it
        "arms": [ { "name": "ECM", "type": "ECM", "arm-file": "ecm.json", "colour": "blue" } ],
        "lunch": {"at": 12}
    }"""
    ecm = {"kinematic": "kinematic/ecm.json", "generation": "Classic", "mounting-pitch": -0.785}
    ecm |= {"endoscope": "Classic_HD_STRAIGHT", "zoom": 2}
    path = lab.write(tmp_path / "in", {"system-lab.json": text, "ecm.json": ecm})
    found = import_dvrk(path, tmp_path / "rig.toml")
    folder = tmp_path / "in"
    assert set(found.unknown) == {
        f"{path}: lunch",
        f"{path}: arms[0].colour",
        f"{folder / 'ecm.json'}: zoom",
    }
    assert found.idle == ()
    (scope,) = found.rig.cameras
    assert (scope.name, scope.kind, scope.arm) == ("endoscope", "endoscope", "ECM")


def test_fixed_mounts_stand_where_they_are_given(tmp_path: Path) -> None:
    at = {"ECM": [0.1, 0.5, 0.4], "PSM1": [0.3, 0.6, 0.35]}
    arms = [
        {"name": n, "measured_cp": [[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z], [0, 0, 0, 1]]}
        for n, (x, y, z) in at.items()
    ]
    system: dict[str, Any] = lab.system()
    system["arms"] = [
        {"name": "SUJ", "type": "SUJ_Fixed", "arm_file": "arm/suj.json"},
        *(a for a in system["arms"] if a["name"] in at),
    ]
    del system["consoles"]
    path = lab.lab(
        tmp_path / "in", files={"system-lab.json": system, "arm/suj.json": {"arms": arms}}
    )
    found = import_dvrk(path, tmp_path / "rig.toml")
    for name, place in at.items():
        arm = found.rig.arm(name)
        root = arm.arm.mechanism.frames[0].name
        rcm = (arm.pose @ pose(arm.arm.mechanism, np.zeros(len(arm.arm.joints)), "rcm", root))[
            :3, 3
        ]
        np.testing.assert_allclose(rcm, np.add(place, [0, 0, CART_Z]), atol=1e-9)
    assert found.agreement["bases"].metres < EXACT


def test_the_published_system_needs_none_of_the_dvrk_s_files(tmp_path: Path) -> None:
    for generation, file in (("Classic", "suj-simulated"), ("Si", "suj-si-simulated")):
        system = lab.system(generation)
        system["arms"][2]["arm_file"] = f"arm/{file}.json"
        path = lab.write(tmp_path / generation, {"system-lab.json": system})
        found = import_dvrk(path, tmp_path / generation / "rig.toml")
        assert len(found.rig.arms) == 10
        assert found.agreement["bases"].metres < EXACT
        (said,) = (text for text in found.notes if text.startswith("not found"))
        assert f"arm/{file}.json" in said and "kinematic/" in said
        for setup in lab.CLASSIC if generation == "Classic" else lab.SI:
            q = found.rig.poses["start"][f"SUJ_{setup['name']}"]
            np.testing.assert_allclose(q, setup["simulated_position"][: len(q)], atol=1e-4)
            joints = len(found.rig.arm(setup["name"]).arm.joints)
            seen = moved(found.rig, setup["name"], np.zeros(joints), q)
            np.testing.assert_allclose(seen, lab.base(setup, q), atol=EXACT)


@pytest.mark.parametrize("generation", ["Classic", "Si"])
def test_the_arms_of_a_lab_s_cart_home_without_meeting(tmp_path: Path, generation: str) -> None:
    import_dvrk(lab.lab(tmp_path / "in", generation), tmp_path / "rig.toml")
    world = World(str(tmp_path / "rig.toml"))
    arms = [world.arm(name) for name in ("PSM1", "PSM2", "PSM3", "ECM")]
    for verb in ("disable", "enable", "home"):
        for arm in arms:
            getattr(arm, verb)()
        world.step(100)
    world.step(10000)
    assert [(arm.operating_state().state, arm.operating_state().is_homed) for arm in arms] == [
        ("ENABLED", True)
    ] * 4
    for arm in arms:
        home = arm.joints.poses["home"][: len(arm.measured_jp())]
        np.testing.assert_allclose(arm.measured_jp(), home, atol=2e-3)


def test_a_real_si_s_file_has_potentiometers_and_the_dvrk_s_own_chains(tmp_path: Path) -> None:
    arms = [
        {
            "name": setup["name"],
            "arduino-mac": "00:00:00:00:00:00",
            "serial-number": "0000",
            "primary-offsets": [0.5, -2.4, -2.3, 2.57],
            "primary-scales": [-1.7e-5, 7.3e-5, 7.3e-5, -7.3e-5],
        }
        for setup in lab.SI
    ]
    files = {"arm/suj.json": {"base-arduino-mac": "00", "arms": arms}}
    found = import_dvrk(lab.lab(tmp_path / "in", "Si", files), tmp_path / "rig.toml")
    assert found.unknown == ()
    assert "primary_scales [-1.7e-05" in (tmp_path / "rig.toml").read_text(encoding="utf-8")
    for setup in lab.SI:
        suj = found.rig.arm(f"SUJ_{setup['name']}").arm.mechanism
        q = suj.upper * 0.3
        joints = len(found.rig.arm(setup["name"]).arm.joints)
        seen = moved(found.rig, setup["name"], np.zeros(joints), q)
        np.testing.assert_allclose(seen, lab.base(setup, q), atol=EXACT)


def test_an_si_of_a_lab_is_trocar_s_own_with_its_setup_joints_and_no_erratum_of_another_file(
    tmp_path: Path,
) -> None:
    found = import_dvrk(lab.lab(tmp_path / "in", "Si"), tmp_path / "rig.toml")
    assert not [n for n in found.notes if "trocar has no masses and shapes of these arms" in n]
    for name in ("PSM1", "PSM2", "PSM3", "ECM"):
        assert found.rig.arm(f"SUJ_{name}").arm.name == f"suj_si_{name.lower()}"
    assert {"cart", "table"} <= {prop.name for prop in found.rig.props}
    own = load_arm("psm_si")
    masses = {body.frame: body.mass for body in found.rig.arm("PSM1").arm.bodies}
    assert masses == {body.frame: body.mass for body in own.bodies}
    texts = [*found.notes, *(Path(file).read_text(encoding="utf-8") for file in found.files)]
    assert not [text for text in texts if "not published" in text or "[[erratum]]" in text]


def test_two_endoscopes_and_the_older_words_of_a_console(tmp_path: Path) -> None:
    system = lab.system()
    arms = {arm["name"]: arm for arm in system["arms"]}
    scope = arms["ECM"]
    second = {**scope, "name": "ECM2", "base_frame": {"component": "SUJ", "interface": "PSM3"}}
    arms = {"ECM2": second, **{n: a for n, a in arms.items() if n != "PSM3"}}
    older = [
        {**{k: v for k, v in a.items() if k != "arm_file"}, "arm": a["arm_file"]}
        for a in arms.values()
    ]
    console = {
        "arms": older,
        "psm_teleops": [{"mtm": "MTMR", "psm": "PSM1"}],
        "ecm_teleop": {"mtm_left": "MTML", "mtm_right": "MTMR", "ecm": "ECM"},
    }
    path = lab.lab(tmp_path / "in", files={"system-lab.json": console})
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert found.unknown == ()
    assert [teleop.name for teleop in found.rig.teleops] == ["MTMR_PSM1", "MTML_MTMR_ECM"]
    rng = np.random.default_rng(6)
    for name, setup in (("ECM", lab.CLASSIC[0]), ("ECM2", lab.CLASSIC[3])):
        suj = found.rig.arm(found.rig.arm(name).on).arm.mechanism
        q = rng.uniform(suj.lower, suj.upper)
        seen = moved(found.rig, name, np.zeros(4), q)
        np.testing.assert_allclose(seen, lab.base(setup, q), atol=EXACT)
    world = World(found.rig)
    assert world.arm("PSM1").measured_cp().frame_id == "ECM"  # whichever comes first in the file
    assert {camera.name for camera in found.rig.cameras} >= {"endoscope", "endoscope_ECM2"}


@pytest.mark.parametrize("value", [float("inf"), float("nan")])
def test_a_base_that_is_not_finite_is_refused_at_once(tmp_path: Path, value: float) -> None:
    """LAPACK's decomposition does not return from infinite elements."""
    pose = [
        [value, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]
    base = {"reference_frame": "cart", "transform": pose}
    arm = {"name": "PSM1", "type": "PSM", "arm_file": "psm.json", "base_frame": base}
    path = lab.write(tmp_path, {"system-lab.json": {"arms": [arm]}, "psm.json": {}})
    with pytest.raises(DescriptionError, match="allowed: finite numbers"):
        import_dvrk(path, tmp_path / "rig.toml")
