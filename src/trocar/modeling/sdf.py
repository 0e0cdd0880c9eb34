"""A rig as an SDF model: links, hinges, and the joints that close its loops.

The model stands as it does where every public joint is at 0 and the loops are closed, which is
where a reader of the file counts every joint from: a passive joint of a loop that is no
parallelogram differs by the constant `LinkModel.zero`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.meshes import Mesh
from trocar.errors import UnknownNameError
from trocar.geometry.rotations import matrix_from_rpy
from trocar.geometry.se3 import transform
from trocar.modeling.links import WORLD, Link, LinkJoint, LinkModel
from trocar.modeling.markup import child, document, lxml_etree
from trocar.modeling.sdf_filters import DRAKE, add_collision_filters
from trocar.modeling.sdf_joints import add_fixed, add_gearbox, add_joint, add_loop
from trocar.modeling.sdf_shapes import add_pose, add_shape, exact

Array = NDArray[np.float64]

#: 1.7 is what Gazebo Classic 11 reads, 1.9 Gazebo from Fortress on and Drake, 1.11 Gazebo from
#: Harmonic on. Source: the table of versions in gazebosim/sdformat's README.
VERSIONS = ("1.9", "1.7", "1.11")
#: The link that stands in the world and holds what stands there.
GROUND = "ground"


def check_version(version: str) -> str:
    """Return a version of SDF that can be written.

    Raises:
        UnknownNameError: another one
    """
    if version not in VERSIONS:
        raise UnknownNameError("SDF version", version, VERSIONS)
    return version


def model_name(model: LinkModel) -> str:
    """Return what a rig is called in files: letters, digits and _."""
    return re.sub(r"\W+", "_", model.name)


def sdf(model: LinkModel, version: str = "1.9", meshes: Mapping[Mesh, str] | None = None) -> bytes:
    """Return a rig as an SDF file of one model.

    A frame without mass is a `frame`, so no link is weightless; what stands still in the world is
    one link, "ground". Numbers read back as the float64 they are.

    Args:
        model: the rig
        version: one of `VERSIONS`
        meshes: {mesh: its file's name without folder and ending}; absent: each by its own name

    Raises:
        UnknownNameError: a version that cannot be written
        MissingExtraError: lxml is not installed
    """
    root = sdf_root(version)
    add_model(root, model, version, meshes)
    return document(root, f"{model.title}; SI units and radians")


def sdf_root(version: str) -> Any:
    """Return the element that an SDF file consists of.

    Raises:
        UnknownNameError: a version that cannot be written
    """
    spaces = {} if check_version(version) == "1.7" else {"drake": DRAKE}
    return lxml_etree().Element("sdf", {"version": version}, nsmap=spaces)


def add_model(
    parent: Any, model: LinkModel, version: str, meshes: Mapping[Mesh, str] | None = None
) -> None:
    """Append a rig as a model."""
    made = child(parent, "model", {"name": model_name(model)})
    carriers = rigid_links(model)
    links = {GROUND: child(made, "link", {"name": GROUND})}
    add_fixed(made, GROUND, WORLD, GROUND)
    for joint, link in zip(model.joints, model.links[1:], strict=True):
        on = GROUND if joint.parent == WORLD else joint.parent
        if link.mass:
            links[link.name] = _add_link(made, model, joint, link, on)
        else:
            add_pose(child(made, "frame", {"name": link.name, "attached_to": on}), joint.pose)
        names = meshes if meshes is not None else _own_names(link)
        carrier, frame = links[carriers[link.name]], "" if link.mass else link.name
        for k, shape in enumerate(link.shapes):
            add_shape(carrier, f"{link.name}_{k}", shape, frame, version, names)
    for joint in model.joints:
        if joint.child in links:
            add_joint(made, model, joint, carriers[joint.parent], version)
    for loop in model.loops:
        add_loop(made, model, loop)
    if version != "1.7":
        add_collision_filters(made, model, carriers)
        return
    for joint in model.joints:
        add_gearbox(made, model, joint, carriers[joint.parent])


def rigid_links(model: LinkModel) -> dict[str, str]:
    """Return the SDF link that each link is, or is a frame of: {link: SDF link}."""
    found = {WORLD: GROUND}
    for joint, link in zip(model.joints, model.links[1:], strict=True):
        found[link.name] = link.name if link.mass else found[joint.parent]
    return found


def standing(joint: LinkJoint, zero: Mapping[str, float]) -> Array:
    """Return the pose of a joint's child in its parent as the file has it, (4, 4)."""
    at = zero.get(joint.name, 0.0)
    if joint.kind == "prismatic":
        return joint.pose @ transform(np.eye(3), np.array([0.0, 0.0, at]))
    return joint.pose @ transform(matrix_from_rpy(0.0, 0.0, at), np.zeros(3))


def _own_names(link: Link) -> dict[Mesh, str]:
    return {s.mesh: s.mesh.name for s in link.shapes if s.mesh is not None}


def _add_link(parent: Any, model: LinkModel, joint: LinkJoint, link: Link, on: str) -> Any:
    made = child(parent, "link", {"name": link.name})
    add_pose(made, standing(joint, model.zero), on)
    inertial = child(made, "inertial")
    add_pose(inertial, transform(np.eye(3), link.com))
    child(inertial, "mass", text=exact([link.mass]))
    inertia = child(inertial, "inertia")
    for row, column in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        tag = f"i{'xyz'[row]}{'xyz'[column]}"
        child(inertia, tag, text=exact([link.inertia[row, column]]))
    return made
