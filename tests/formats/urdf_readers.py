"""How other people's libraries read a URDF: each answers the same few questions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.formats.links import LinkModel, joint_values

Array = NDArray[np.float64]
Body = tuple[float, Array, Array]


@dataclass(frozen=True, eq=False)
class Reading:
    """A file as a library reads it.

    Attributes:
        bodies: {link: (mass [kg], centre of mass (3,) [m], inertia about it (3, 3) [kg m^2])}
        stand: from the joints that follow none {joint: rad or m} to {link: T_world_link (4, 4)}
        free: how many coordinates are left to choose
        couplings: how many joints mimic another
    """

    bodies: Mapping[str, Body]
    stand: Callable[[Mapping[str, float]], Mapping[str, Array]]
    free: int
    couplings: int


def by_mujoco(file: Path, tree: LinkModel) -> Reading:
    """MuJoCo's own import of URDF, where a mimic is an equality with a polynomial."""
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)

    def body(k: int) -> Body:
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.body_iquat[k])
        turn = turn.reshape(3, 3)
        inertia = turn @ np.diag(model.body_inertia[k]) @ turn.T
        return float(model.body_mass[k]), model.body_ipos[k].copy(), inertia

    def stand(own: Mapping[str, float]) -> dict[str, Array]:
        for name, value in own.items():
            data.joint(name).qpos = value
        for k in range(model.neq):
            follower, leader = model.eq_obj1id[k], model.eq_obj2id[k]
            x = data.qpos[model.jnt_qposadr[leader]]
            y = np.polynomial.polynomial.polyval(x, model.eq_data[k, :5])
            data.qpos[model.jnt_qposadr[follower]] = y
        mujoco.mj_kinematics(model, data)
        return {
            model.body(k).name: _pose(data.xpos[k], data.xmat[k].reshape(3, 3))
            for k in range(model.nbody)
        }

    bodies = {model.body(k).name: body(k) for k in range(model.nbody)}
    assert model.njnt == sum(joint.kind != "fixed" for joint in tree.joints)
    return Reading(bodies, stand, model.nq - model.neq, model.neq)


def by_yourdfpy(file: Path, tree: LinkModel) -> Reading:
    """Read with yourdfpy, which works out what mimics and looks at every mesh."""
    library = pytest.importorskip("yourdfpy", reason="yourdfpy is not installed (extra judges)")
    robot = library.URDF.load(
        str(file), load_collision_meshes=True, build_collision_scene_graph=True
    )
    assert robot.validate() and not robot.errors
    bodies = {}
    for link in robot.robot.links:
        if link.inertial is not None:
            at = link.inertial.origin
            bodies[link.name] = (link.inertial.mass, at[:3, 3], link.inertial.inertia)

    def stand(own: Mapping[str, float]) -> dict[str, Array]:
        robot.update_cfg(dict(own))
        return {link.name: robot.get_transform(link.name) for link in tree.links}

    couplings = sum(joint.mimic is not None for joint in robot.robot.joints)
    return Reading(bodies, stand, robot.num_actuated_joints, couplings)


def by_pinocchio(file: Path, tree: LinkModel) -> Reading:
    """Read with pinocchio, mimic on; a joint's inertia is that of all that is fixed to its link."""
    library = pytest.importorskip("pinocchio", reason="pinocchio is not installed (extra judges)")
    model = library.buildModelFromUrdf(str(file), mimic=True)
    for kind in (library.GeometryType.VISUAL, library.GeometryType.COLLISION):
        library.buildGeomFromUrdf(model, str(file), kind, package_dirs=[str(file.parent)])
    data = model.createData()
    bodies = {}
    for joint in tree.joints:
        if joint.kind != "fixed":
            found = model.inertias[model.getJointId(joint.name)]
            bodies[joint.child] = (found.mass, found.lever, found.inertia)

    def stand(own: Mapping[str, float]) -> dict[str, Array]:
        q = np.zeros(model.nq)
        for name, value in own.items():
            q[model.joints[model.getJointId(name)].idx_q] = value
        library.framesForwardKinematics(model, data, q)
        places = (model.getFrameId(link.name, library.FrameType.BODY) for link in tree.links)
        return {
            link.name: data.oMf[k].homogeneous for link, k in zip(tree.links, places, strict=True)
        }

    return Reading(bodies, stand, model.nq, model.njoints - 1 - model.nq)


def by_drake(file: Path, tree: LinkModel) -> Reading:
    """Read with Drake, where a mimic is a constraint of the solver: coordinates are ours."""
    drake = pytest.importorskip("pydrake.all", reason="Drake is not installed (extra judges)")
    plant, _ = drake.AddMultibodyPlantSceneGraph(drake.DiagramBuilder(), time_step=1e-3)
    drake.Parser(plant).AddModels(file)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    bodies = {}
    for link in tree.links[1:]:
        found = plant.GetBodyByName(link.name).default_spatial_inertia()
        about = found.Shift(found.get_com()).CalcRotationalInertia()
        bodies[link.name] = (
            found.get_mass(), found.get_com(), about.CopyToFullMatrix3()
        )  # fmt: skip

    def stand(own: Mapping[str, float]) -> dict[str, Array]:
        for name, value in joint_values(tree, own).items():
            joint = plant.GetJointByName(name)
            turns = hasattr(joint, "set_angle")
            (joint.set_angle if turns else joint.set_translation)(context, value)
        return {
            link.name: plant.EvalBodyPoseInWorld(
                context, plant.GetBodyByName(link.name)
            ).GetAsMatrix4()
            for link in tree.links
        }

    couplings = plant.num_constraints()
    return Reading(bodies, stand, plant.num_positions() - couplings, couplings)


def _pose(position: Array, turn: Array) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, position
    return pose
