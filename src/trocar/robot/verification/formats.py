"""Exported files, read back by other programs: every frame against the kinematics.

Files are written as `trocar export` writes them, without meshes. MuJoCo reads MJCF and URDF; where
they are installed, pinocchio reads URDF, and Drake URDF and SDF.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from typing import Any, cast
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import MissingExtraError
from trocar.formats.links import LinkModel, joint_values, link_name, link_poses, rig_links
from trocar.formats.mjcf import mjcf_document
from trocar.formats.sdf import DRAKE, joint_name, sdf
from trocar.formats.urdf import urdf, urdf_tree
from trocar.geometry.se3 import inverse, pose_difference, transform
from trocar.kinematics import forward
from trocar.robot.verification.figures import Figure, ReportPart
from trocar.robot.verification.subject import Subject
from trocar.simulation.trials import compiled_poses, random_positions

Array = NDArray[np.float64]
#: From coordinates {joint: rad or m} to {link: T_world_link (4, 4)}.
Stand = Callable[[Mapping[str, float]], Mapping[str, Array]]

#: Random poses at which formats are compared, and the largest deviation of a frame [m, rad].
POSES, SEED, FORMAT_LIMIT = 100, 6, 1e-9
LIMIT = "limit: both sides compute in float64 over some twenty products"


def formats(subject: Subject) -> ReportPart:
    """Compare every frame of the simulated model and of exported files with the kinematics."""
    arm, command = subject.arm, subject.command("formats")
    title = "Formats: one description, the same frames"
    if not subject.simulated:
        note = f"{arm.name}: unknown masses or gains, no model"
        return ReportPart("formats", subject.name, title, (), command, (note,))
    q = random_positions(arm, SEED, POSES)
    analytic = forward.poses(arm.mechanism, q, relative_to=arm.root)
    found = compiled_poses(arm, q)
    figures = [*_figures("model as simulated", found, analytic, LIMIT)]
    try:
        files, notes = _files(_without_shapes(lone_arm_rig(arm)), q, analytic)
        figures += files
    except MissingExtraError as problem:
        notes = (f"MJCF, URDF and SDF files are not checked: {problem}",)
    return ReportPart("formats", subject.name, title, tuple(figures), command, notes)


def _figures(
    label: str, found: Mapping[str, Array], expected: Mapping[str, Array], source: str
) -> Iterator[Figure]:
    """Yield the largest errors of frames, {frame: poses (k, 4, 4)}."""
    off = [pose_difference(poses, expected[frame]) for frame, poses in found.items()]
    metres, radians = (max(float(each[k].max()) for each in off) for k in range(2))
    label = f"{label}, {len(found)} frames at {POSES} poses"
    yield Figure(f"{label}: position", metres, "m", FORMAT_LIMIT, shown="nm", source=source)
    yield Figure(f"{label}: rotation", radians, "rad", FORMAT_LIMIT, shown="urad", source=source)


def _files(
    rig: RigDescription, q: Array, analytic: Mapping[str, Array]
) -> tuple[list[Figure], tuple[str, ...]]:
    """Return figures of the exported files of one arm, and notes."""
    (place,) = rig.arms
    mechanism, model = place.arm.mechanism, rig_links(rig)
    closed = forward.coordinates(mechanism, q)
    index = mechanism.frame_index
    values = {j.name: closed[:, index[j.frame]] for j in model.joints if j.hinge is not None}
    frames = {link_name(place.name, f.name): f.name for f in mechanism.frames}
    truth = {link: place.pose @ analytic[frame] for link, frame in frames.items()}
    tree = urdf_tree(model)
    own = {j.name: values[j.name] for j in model.joints if j.hinge and not j.follows}
    followed = joint_values(tree, own)
    lines = link_poses(tree, followed)
    straight = {link: lines[link] for link in frames}

    figures: list[Figure] = []

    def compare(label: str, stand: Stand, at: Mapping[str, Array], expected: Any, why: str) -> None:
        rows = [stand({name: float(v[k]) for name, v in at.items()}) for k in range(len(q))]
        found = {link: np.array([row[link] for row in rows]) for link in frames}
        figures.extend(_figures(label, found, expected, why))

    compare("MJCF, read by MuJoCo", _mjcf(rig, model), values, truth, LIMIT)
    error = model.line_errors.get(place.name)
    why = LIMIT if error is None else f"{LIMIT}; against the straight lines of its passive joints"
    for reader, stand in _urdf_readers(tree):
        compare(f"URDF, read by {reader}", stand, followed, straight, why)
    notes: list[str] = []
    if error is not None:
        source = "stated: no tree moves as loops that are no parallelograms (docs/exports.md)"
        for what, off in ((f"worst frame ({error.frame})", error.worst), ("tip", error.tip)):
            label = f"URDF, {what} off the closed loops"
            figures.append(Figure(label, off, "m", shown="mm", source=source))
    if find_spec("pydrake") is None:
        notes.append("SDF is not checked: Drake, which reads it, is not installed (pip: drake)")
    else:
        stand, gap = _drake_sdf(model)
        compare("SDF, read by Drake", stand, values, truth, LIMIT)
        if model.loops:
            gaps = [gap({name: float(v[k]) for name, v in values.items()}) for k in range(len(q))]
            figures.append(
                Figure("SDF, read by Drake: loop gap", max(gaps), "m", 2.0 * FORMAT_LIMIT,
                       shown="nm", source="limit: the kinematics closes each loop to 1 nm")
            )  # fmt: skip
    return figures, tuple(notes)


def _without_shapes(rig: RigDescription) -> RigDescription:
    arms = tuple(
        replace(a, arm=replace(a.arm, bodies=tuple(replace(b, shapes=()) for b in a.arm.bodies)))
        for a in rig.arms
    )
    return replace(rig, arms=arms)


def _mjcf(rig: RigDescription, links: LinkModel) -> Stand:
    """Read the MJCF of a lone arm, whose bodies and sites have the names of its frames."""
    text, _ = mjcf_document(rig)
    model = mujoco.MjModel.from_xml_string(text.decode())
    data = mujoco.MjData(model)
    prefix = f"{rig.arms[0].name}_"
    moving = {
        j.name: model.jnt_qposadr[model.body(j.frame).jntadr[0]]
        for j in links.joints
        if j.hinge is not None
    }
    bodies = {model.body(k).name: k for k in range(1, model.nbody)}
    sites = {model.site(k).name: k for k in range(model.nsite)}

    def stand(values: Mapping[str, float]) -> dict[str, Array]:
        for name, value in values.items():
            data.qpos[moving[name]] = value
        mujoco.mj_kinematics(model, data)
        found = {
            f"{prefix}{n}": _pose(data.site_xpos[k], data.site_xmat[k]) for n, k in sites.items()
        }
        return found | {
            f"{prefix}{n}": _pose(data.xpos[k], data.xmat[k]) for n, k in bodies.items()
        }

    return stand


def _urdf_readers(tree: LinkModel) -> Iterator[tuple[str, Stand]]:
    """Yield each program that is here and reads a URDF, and its reading."""
    yield "MuJoCo", _mujoco_urdf(tree)
    if find_spec("pinocchio") is not None:
        yield "pinocchio", _pinocchio_urdf(tree)
    if find_spec("pydrake") is not None:
        yield "Drake", _drake(urdf(tree, friction=False).decode(), "urdf", tree, str)


def _mujoco_urdf(tree: LinkModel) -> Stand:
    """Read with MuJoCo's own reader, in which what mimics is an equality with a polynomial."""
    model = mujoco.MjModel.from_xml_string(urdf(tree).decode())
    data = mujoco.MjData(model)
    leading = [joint.name for joint in tree.joints if joint.hinge and not joint.follows]

    def stand(values: Mapping[str, float]) -> dict[str, Array]:
        for name in leading:
            data.joint(name).qpos = values[name]
        for k in range(model.neq):
            follower, leader = (model.jnt_qposadr[j[k]] for j in (model.eq_obj1id, model.eq_obj2id))
            polynomial = model.eq_data[k, :5]
            data.qpos[follower] = np.polynomial.polynomial.polyval(data.qpos[leader], polynomial)
        mujoco.mj_kinematics(model, data)
        bodies = range(model.nbody)
        return {model.body(k).name: _pose(data.xpos[k], data.xmat[k]) for k in bodies}

    return stand


def _pinocchio_urdf(tree: LinkModel) -> Stand:
    """Read with pinocchio, which works out what mimics."""
    library: Any = import_module("pinocchio")  # compiled, without types
    model = library.buildModelFromXML(urdf(tree).decode(), mimic=True)
    data = model.createData()
    leading = {
        joint.name: model.joints[model.getJointId(joint.name)].idx_q
        for joint in tree.joints
        if joint.hinge and not joint.follows
    }
    frames = {link.name: model.getFrameId(link.name, library.FrameType.BODY) for link in tree.links}

    def stand(values: Mapping[str, float]) -> dict[str, Array]:
        q = np.zeros(model.nq)
        for name, at in leading.items():
            q[at] = values[name]
        library.framesForwardKinematics(model, data, q)
        return {name: data.oMf[k].homogeneous for name, k in frames.items()}

    return stand


def _drake(text: str, kind: str, model: LinkModel, named: Callable[[str], str]) -> Stand:
    """Read with Drake, whose coordinates of passive joints are ours to choose.

    Args:
        text, kind: the file, "urdf" or "sdf"
        model: whose links are looked for
        named: from a joint's name to the file's
    """
    from pydrake.multibody import parsing, plant  # pyright: ignore

    parsers, plants = cast(Any, parsing), cast(Any, plant)  # compiled, without types
    read = plants.MultibodyPlant(0.001)
    parsers.Parser(read).AddModelsFromString(text, kind)
    read.Finalize()
    context = read.CreateDefaultContext()

    def stand(values: Mapping[str, float]) -> dict[str, Array]:
        for name, value in values.items():
            joint: Any = read.GetJointByName(named(name))
            slides = joint.type_name() == "prismatic"
            (joint.set_translation if slides else joint.set_angle)(context, value)
        found: dict[str, Any] = {k.name: read.GetFrameByName(k.name) for k in model.links[1:]}
        return {n: f.CalcPoseInWorld(context).GetAsMatrix4() for n, f in found.items()}

    return stand


def _drake_sdf(model: LinkModel) -> tuple[Stand, Callable[[Mapping[str, float]], float]]:
    """Read the SDF with Drake without the joints that close loops, which Drake rejects.

    Returns:
        how links stand, and how far the loops' points are apart [m]
    """
    ElementTree.register_namespace("drake", DRAKE)
    root = ElementTree.fromstring(sdf(model))
    body = cast(ElementTree.Element, root.find("model"))
    points: list[tuple[str, Array, str]] = []
    for loop in model.loops:
        joint = next(j for j in body.iter("joint") if j.get("name") == joint_name(loop.name))
        body.remove(joint)
        a, b, at = (str(joint.findtext(tag)) for tag in ("parent", "child", "pose"))
        points.append((a, np.array([*map(float, at.split()[:3]), 1.0]), b))
    read = _drake(ElementTree.tostring(root, encoding="unicode"), "sdf", model, joint_name)

    def stand(values: Mapping[str, float]) -> Mapping[str, Array]:
        return read({name: value - model.zero[name] for name, value in values.items()})

    def ends(at: Mapping[str, Array]) -> list[Array]:
        return [inverse(at[b]) @ (at[a] @ point) for a, point, b in points]

    closed = ends(stand(model.zero))

    def gap(values: Mapping[str, float]) -> float:
        off = [now - then for now, then in zip(ends(stand(values)), closed, strict=True)]
        return max(float(np.linalg.norm(each)) for each in off)

    return stand, gap


def _pose(position: Array, turn: Array) -> Array:
    return transform(turn.reshape(3, 3), position)
