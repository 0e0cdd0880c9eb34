"""Standalone MJCF has the description's bodies, and stands where the kinematics say."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.formats.mjcf.conftest import ARMS, RIGS, compiled, find, model_of, written
from trocar.descriptions import load_arm, load_rig, names
from trocar.descriptions.calibrated import apply_overlay
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import InputError, MissingExtraError
from trocar.formats.mjcf import (
    BRAKED_DAMPING,
    MJX,
    PID,
    POSITION,
    VARIANTS,
    mjcf_document,
    scene_document,
)
from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import coordinates, poses
from trocar.modeling.build import build
from trocar.robot.dvrk_config.arms import SERIAL
from trocar.simulation.servos import HOLDING_DAMPING

#: Both sides compute in float64 over about twenty products of matrices of size 1.
AGREED = 1e-9


@pytest.mark.slow
def test_every_arm_and_rig_compiles_without_a_warning():
    for name in (*ARMS, *RIGS):
        for variant in VARIANTS:
            model, complaints = model_of(name, variant)
            assert model.nu and model.nkey == 1 and not complaints, (name, variant)


@pytest.mark.slow
@pytest.mark.parametrize("tool", [*names("tools"), "none"])
def test_every_instrument_compiles_and_rests(tool, complaints):
    model = compiled(lone_arm_rig(load_arm("psm", tool=tool)))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data)
    assert np.abs(data.qacc).max() < 1e-3 and not complaints


@pytest.mark.parametrize("name", [*ARMS, *RIGS])
def test_bodies_hinges_and_loops_are_those_of_the_simulation(name):
    rig = find(name)
    file, ours = model_of(name)[0], build(rig).mj
    lone = f"{rig.arms[0].name}_" if len(rig.arms) == 1 else ""
    kept = ours.eq_type != int(mujoco.mjtEq.mjEQ_WELD)  # what jaws hold by stays here
    assert file.nbody == ours.nbody and file.nv == ours.nv and file.neq == kept.sum()
    for k in range(ours.nbody):
        expected = ours.body(k).name.replace("/", "_").removeprefix(lone)
        assert file.body(k).name == expected
    for field in (
        "body_mass", "body_inertia", "body_ipos", "body_pos", "jnt_type", "jnt_pos", "jnt_axis",
        "jnt_range", "jnt_limited", "jnt_stiffness", "qpos_spring",
        "dof_armature", "dof_damping", "dof_frictionloss", "eq_type", "eq_solref", "eq_solimp",
        "actuator_forcerange", "actuator_gear",
    ):  # fmt: skip
        a, b = getattr(file, field), getattr(ours, field)
        b = b[kept] if field.startswith("eq_") else b
        b = (
            b[ours.actuator_ctrlnum > 0] if field.startswith("actuator_") else b
        )  # limits of voltage
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-14, err_msg=field)
    stops = ours.jnt_limited.astype(bool)
    for field in ("jnt_solref", "jnt_solimp"):
        np.testing.assert_array_equal(getattr(file, field)[stops], getattr(ours, field)[stops])
    for field in ("body_quat", "body_iquat"):
        aligned = np.abs(np.sum(getattr(file, field) * getattr(ours, field), axis=1))
        np.testing.assert_allclose(aligned, 1.0, atol=1e-12, err_msg=field)
    ties = ours.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)
    tied = file.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)
    np.testing.assert_allclose(file.eq_data[tied, :5], ours.eq_data[ties, :5], atol=1e-14)


@pytest.mark.parametrize("name", RIGS)
def test_geoms_that_touch_are_those_of_the_simulation(name):
    rig = find(name)
    file, ours = model_of(name)[0], build(rig).mj
    touching = file.geom_group == 3
    assert touching.sum() == ours.ngeom
    plain = ours.geom_type != int(mujoco.mjtGeom.mjGEOM_MESH)
    for field in (
        "geom_type", "geom_bodyid", "geom_size", "geom_pos", "geom_contype", "geom_conaffinity",
        "geom_condim", "geom_friction", "geom_solref", "geom_solimp",
    ):  # fmt: skip
        a, b = getattr(file, field)[touching], getattr(ours, field)
        np.testing.assert_allclose(a[plain], b[plain], rtol=1e-13, atol=1e-14, err_msg=field)
        # A mesh has passed through a file, to a nanometre, and MuJoCo's single precision.
        np.testing.assert_allclose(a[~plain], b[~plain], atol=1e-7, err_msg=field)
    seen = file.geom_group == 2
    assert (seen | touching).all() and not file.geom_contype[seen].any()


@pytest.mark.parametrize("name", ARMS)
def test_every_frame_is_where_the_kinematics_have_it(name, rng, random_positions):
    arm = load_arm(name)
    model = compiled(lone_arm_rig(arm))
    data = mujoco.MjData(model)
    hinges = [model.joint(k) for k in range(model.njnt)]
    for q in random_positions(arm, rng, 30):
        own = coordinates(arm.mechanism, q)
        at = {f.name: own[k] for k, f in enumerate(arm.mechanism.frames)}
        for hinge in hinges:
            data.qpos[hinge.qposadr[0]] = at[model.body(hinge.bodyid[0]).name]
        mujoco.mj_kinematics(model, data)
        root = np.eye(4)
        root[:3, 3] = data.body(arm.root).xpos
        root[:3, :3] = data.body(arm.root).xmat.reshape(3, 3)
        analytic = poses(arm.mechanism, q, relative_to=arm.root)
        for closure in arm.mechanism.closures:
            point = (root @ analytic.pop(closure.name))[:3, 3]
            for side in "ab":
                site = data.site(f"{closure.name}_{side}").xpos
                assert np.abs(site - point).max() < AGREED
        for frame, pose in analytic.items():
            isbody = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, frame) >= 0
            found = data.body(frame) if isbody else data.site(frame)
            relative = inverse(root) @ np.vstack(
                [np.column_stack([found.xmat.reshape(3, 3), found.xpos]), [0, 0, 0, 1]]
            )
            assert np.abs(relative - pose).max() < AGREED, frame


def test_servos_have_the_motors_limits_and_the_dvrks_gains():
    for name in ARMS:
        arm = load_arm(name)
        model = compiled(lone_arm_rig(arm))
        for joint in arm.joints:
            servo = model.actuator(joint.name)
            np.testing.assert_allclose(servo.forcerange, [-joint.effort_max, joint.effort_max])
            if joint.spring is not None:
                np.testing.assert_array_equal(servo.ctrlrange, servo.forcerange)
                continue
            gains = arm.control["dvrk"].pid[joint.name]
            assert (servo.gainprm[0], -servo.biasprm[1], -servo.biasprm[2]) == (
                gains.p, gains.p, gains.d,
            )  # fmt: skip
            np.testing.assert_allclose(servo.ctrlrange, [joint.lower, joint.upper], rtol=1e-13)


def test_sensors_read_the_public_joints():
    arm = load_arm("psm")
    model = compiled(lone_arm_rig(arm))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[model.joint("finger_left").qposadr[0]] = 0.2
    data.qpos[model.joint("pitch").qposadr[0]] = 0.3
    mujoco.mj_forward(model, data)
    assert data.sensor("jaw_position").data[0] == pytest.approx(0.4)
    assert data.sensor("pitch_position").data[0] == pytest.approx(0.3)
    assert {f"{j.name}_{w}" for j in arm.joints for w in ("position", "velocity", "effort")} == {
        model.sensor(k).name for k in range(model.nsensor)
    }


@pytest.mark.parametrize(
    ("variant", "rigs"),
    [
        (POSITION, ["full_cart rig"]),
        (MJX, ["full_cart rig"]),
        pytest.param(POSITION, RIGS, marks=pytest.mark.slow),
    ],
    ids=["position", "mjx", "position of all rigs"],
)
def test_home_is_at_rest(variant, rigs):
    """The wall of MuJoCo Menagerie's reviewers: 1e-3 after one step.

    What lies on a table is left out: until it is some nanometres deep in it, it falls.
    """
    for name in (*ARMS, *rigs):
        model, _ = model_of(name, variant)
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_step(model, data)
        held = model.jnt_type[model.dof_jntid] != int(mujoco.mjtJoint.mjJNT_FREE)
        assert np.abs(data.qacc[held]).max() < 1e-3, name


@pytest.mark.parametrize("name", [*ARMS, "full_cart rig"])
def test_home_of_the_servos_of_the_simulation_holds_the_weight(name):
    """In the first milliseconds the loops take up the weight, 0.1 um; then nothing moves."""
    model, _ = model_of(name, PID)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    home = data.qpos.copy()
    mujoco.mj_step(model, data, nstep=1000)
    assert np.abs(data.qpos - home).max() < 5e-5
    assert np.abs(data.qvel).max() < 1e-4


def test_a_calibrated_arm_has_its_own_loops(skew_overlay, rng):
    arm = apply_overlay(load_arm("psm"), skew_overlay("psm", rng))
    rig = lone_arm_rig(arm)
    model = compiled(rig)
    ours = build(rig).mj
    np.testing.assert_array_equal(model.eq_type, ours.eq_type)
    assert (model.eq_type == int(mujoco.mjtEq.mjEQ_CONNECT)).sum() == 8
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data)
    assert np.abs(data.qacc).max() < 1e-3


def test_the_file_reads_as_those_of_menagerie():
    text, _ = written(find("psm"))
    assert text == written(find("psm"))[0]
    root = ET.fromstring(text)
    assert [part.tag for part in root] == [
        "compiler", "option", "default", "asset", "worldbody", "equality", "actuator",
        "sensor", "keyframe",
    ]  # fmt: skip
    indents = {len(line) - len(line.lstrip()) for line in text.splitlines()}
    assert all(n % 2 == 0 for n in indents) and "\t" not in text
    assert {d.get("class") for d in root.iter("default")} >= {"psm", "visual", "collision", "yaw"}
    for geom in root.find("worldbody").iter("geom"):  # type: ignore[union-attr]
        assert geom.get("class") in ("visual", "collision")
    for place, joint in (("PSM1", "yaw"), ("PSM2", "yaw"), ("ECM", "insertion")):
        assert f'<joint name="{place}_{joint}"' in written(load_rig("two_psm_ecm"))[0]


def test_numbers_are_as_short_as_read_back_the_same():
    text, _ = written(find("psm"))
    long = re.findall(r"(?<=[ \"])-?\d[\d.]{12,}(?:e-?\d+)?(?=[ \"])", text)
    assert len(long) > 50
    assert not [word for word in long if len(repr(float(word))) < len(word)]
    assert 'pos="0 -0.4864 0.3"' in text and 'rgba="0.9 0.91 0.92 1"' in text


def test_the_file_for_mjx_asks_for_nothing_that_mjx_lacks():
    """Source: MuJoCo 4.0.0, page on MJX, table of features, column MJX-JAX."""
    for name in ARMS:
        model, _ = model_of(name, MJX)
        option, geom = model.opt, mujoco.mjtGeom
        assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        assert option.jacobian == mujoco.mjtJacobian.mjJAC_DENSE
        assert option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
        assert set(model.eq_type) <= {int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_JOINT)}
        assert set(model.actuator_dyntype) == {int(mujoco.mjtDyn.mjDYN_NONE)}
        touching = model.geom_type[model.geom_group == 3]
        kinds = (geom.mjGEOM_SPHERE, geom.mjGEOM_CAPSULE, geom.mjGEOM_BOX, geom.mjGEOM_MESH)
        assert set(touching) <= {int(kind) for kind in kinds}


def test_brakes_hold_as_those_of_the_simulation():
    assert BRAKED_DAMPING == HOLDING_DAMPING


def test_an_arm_without_gains_or_masses_is_rejected():
    rig = lone_arm_rig(replace(load_arm("ecm"), control={}))
    with pytest.raises(InputError, match="ecm: has no control gains"):
        mjcf_document(rig)
    with pytest.raises(InputError, match="no mass for yaw"):
        mjcf_document(lone_arm_rig(load_arm(SERIAL["PSM"])))


def test_without_lxml_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "lxml", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'trocar\[export\]'"):
        scene_document(find("ecm"))


def tetrahedron(size: float, name: str) -> Mesh:
    vertices = size * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    return Mesh(vertices, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]), name)


def test_meshes_are_read_from_their_files_and_only_convex_pieces_touch():
    arm = load_arm("ecm")
    reach = np.full(3, 0.1)
    at = np.eye(4)
    at[:3, 3] = 0.3, 0.2, 0.1
    cover, hull = tetrahedron(0.1, "yaw_cover"), tetrahedron(0.2, "yaw_convex1")
    seen = Shape("mesh", at, reach, "cover", collide=False, mesh=cover)
    piece = Shape("mesh", at, reach, "cover", visible=False, mesh=hull)
    bodies = tuple(
        replace(b, shapes=(seen, piece)) if b.frame == "yaw" else replace(b, shapes=())
        for b in arm.bodies
    )
    model = compiled(lone_arm_rig(replace(arm, bodies=bodies)))
    assert model.geom_group.tolist() == [2, 3]
    assert [model.mesh(k).name for k in model.geom_dataid] == ["yaw_cover", "yaw_convex1"]
    assert not model.geom_contype[0] and model.geom_contype[1]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    yaw = data.body("yaw")
    for k, mesh in enumerate((cover, hull)):
        first = model.mesh_vertadr[model.geom_dataid[k]]
        corners = model.mesh_vert[first : first + 4]
        world = data.geom_xpos[k] + corners @ data.geom_xmat[k].reshape(3, 3).T
        placed = yaw.xpos + (mesh.vertices + at[:3, 3]) @ yaw.xmat.reshape(3, 3).T
        gap = np.linalg.norm(world[:, None] - placed, axis=2).min(axis=1)
        assert gap.max() < 1e-7  # MuJoCo keeps corners in single precision


def test_a_movable_prop_may_have_a_mesh():
    rig = load_rig("pegs")
    shape = Shape("mesh", np.eye(4), np.full(3, 0.02), "steel", mesh=tetrahedron(0.02, "wedge"))
    prop = next(prop for prop in rig.props if prop.movable is not None)
    rest = tuple(replace(p, shapes=(shape,)) if p is prop else p for p in rig.props)
    model = compiled(replace(rig, props=rest))
    body = model.body(prop.name).id
    assert [model.mesh(k).name for k in model.geom_dataid[model.geom_bodyid == body]] == [
        "wedge",
        "wedge",
    ]


def meet(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return whether two geoms touch by MuJoCo's rule, each by (contype, conaffinity)."""
    return bool(one[0] & other[1] or other[0] & one[1])


def test_a_lone_arm_touches_what_a_scene_has_but_neither_itself_nor_its_like(complaints):
    default, second = (1, 1), (4, 3)  # MuJoCo's, and what the README gives a second arm
    for name in ARMS:
        model, _ = model_of(name)
        masks = set(zip(model.geom_contype, model.geom_conaffinity, strict=True)) - {(0, 0)}
        for arm in masks:
            assert meet(arm, default) and meet(arm, second) and meet(second, default)
            assert not meet(arm, arm) and not meet(second, second)
    text, meshes = written(find("psm"))
    spec = mujoco.MjSpec.from_string(text, assets=meshes)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.01], pos=[0, 0, 0.2])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert data.ncon and not complaints
    assert all(0 in model.geom_bodyid[contact.geom] for contact in data.contact)
