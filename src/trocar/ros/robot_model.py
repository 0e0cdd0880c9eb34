"""The rig for ROS viewers: a URDF with its meshes, and the positions of its hinges.

Frames of CRTK (`Cart`, `PSM1_base`) are not the links of these names: a link that would have the
name of such a frame ends in `_link` here.
"""

from __future__ import annotations

import shutil
import tempfile
import threading
import weakref
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import DISPLAY, RigArm, RigDescription
from trocar.formats.links import LinkModel, own_joints, rig_links
from trocar.formats.meshes import mesh_files, mesh_names, seen_materials
from trocar.formats.urdf import urdf
from trocar.kinematics.forward import coordinates, pose

Array = NDArray[np.float64]

#: Suffix of a link's name that would equal the name of a frame.
LINK = "_link"
#: The root of every URDF. Source: `modeling.links`.
WORLD = "world"
#: Folders of meshes that are kept: viewers read them soon. Source: our own choice.
KEPT = 4


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A rig as URDF.

    Attributes:
        urdf: the text; meshes are named by `file://` and a path on this machine
        folder: where the meshes are, as long as this object or the process lives
    """

    urdf: str
    folder: Path


_lock = threading.Lock()


def robot_model(rig: RigDescription) -> RobotModel:
    """Write a rig's meshes into a folder, and its URDF; those of the newest KEPT rigs stay.

    Raises:
        MissingExtraError: lxml is not installed
        InputError: a moving frame of an arm has no mass
    """
    with _lock:
        return _written(rig)


@lru_cache(maxsize=KEPT)
def _written(rig: RigDescription) -> RobotModel:
    model = without_clashes(rig_links(rig), set(frames(rig)))
    names = mesh_names(model)
    files = mesh_files(names, seen_materials(model))
    folder = Path(tempfile.mkdtemp(prefix="trocar-meshes-"))
    try:
        text = urdf(model, {mesh: (folder / f"{n}.obj").as_uri() for mesh, n in names.items()})
        for name, content in files.items():
            (folder / name).write_bytes(content)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    found = RobotModel(text.decode(), folder)
    weakref.finalize(found, shutil.rmtree, folder, ignore_errors=True)
    return found


def without_clashes(model: LinkModel, taken: set[str]) -> LinkModel:
    """Return a model in which no link has one of the names that are taken."""

    def free(name: str) -> str:
        return name + LINK if name in taken else name

    links = tuple(replace(link, name=free(link.name)) for link in model.links)
    joints = tuple(
        replace(joint, parent=free(joint.parent), child=free(joint.child)) for joint in model.joints
    )
    return replace(model, links=links, joints=joints)


def frames(rig: RigDescription) -> tuple[str, ...]:
    """Return the names of every frame of published poses."""
    own = (arm.own_frame for arm in rig.arms)
    return tuple(dict.fromkeys([*own, *(arm.name for arm in rig.arms), DISPLAY]))


@lru_cache(maxsize=4)
def fixed_frames(rig: RigDescription) -> dict[str, Array]:
    """Return the frames that stand still in the world, {name: pose (4, 4)}: the roots of tf."""
    found: dict[str, Array] = {} if rig.display is None else {DISPLAY: rig.display}
    scoped = any(arm.arm.type == "ECM" for arm in rig.arms)
    for arm in rig.arms:
        kind, mechanism = arm.arm.type, arm.arm.mechanism
        placed = (kind == "PSM" and scoped) or (kind == "MTM" and rig.display is not None)
        if arm.on or placed:
            continue
        rest = np.zeros(len(mechanism.joints))
        at = arm.pose @ pose(mechanism, rest, mechanism.reference, arm.arm.root)
        found[arm.own_frame] = at
    return found


@dataclass(frozen=True, eq=False)
class Hinges:
    """Map from joints of an arm to its hinges with a motion of their own: ratio @ q + offset."""

    names: tuple[str, ...]
    ratio: Array
    offset: Array


@lru_cache(maxsize=64)
def hinges(arm: RigArm) -> Hinges:
    """Return an arm's hinges under the URDF's names; those that mimic others are left out."""
    mechanism = arm.arm.mechanism
    n = len(mechanism.joints)
    own = own_joints(arm)
    rows = [mechanism.frame_index[frame] for frame in own.values()]
    zero = coordinates(mechanism, np.zeros(n))[rows]
    step = 0.01  # in this much of every joint's range; the relation is a straight line
    moved = [coordinates(mechanism, step * unit)[rows] for unit in np.eye(n)]
    ratio = (np.stack(moved, axis=1) - zero[:, None]) / step
    return Hinges(tuple(own), np.where(np.abs(ratio) < 1e-9, 0.0, ratio), zero)


def hinge_states(
    rig: RigDescription, q: Mapping[str, Array], qd: Mapping[str, Array]
) -> tuple[list[str], Array, Array]:
    """Return names, positions and velocities of the hinges of a rig [rad or m, per s].

    Args:
        rig: the rig
        q, qd: {arm: positions and velocities of all its joints (n,)}
    """
    found = [(arm.name, hinges(arm)) for arm in rig.arms]
    names = [name for _, own in found for name in own.names]
    position = np.concatenate([own.ratio @ q[arm] + own.offset for arm, own in found])
    velocity = np.concatenate([own.ratio @ qd[arm] for arm, own in found])
    return names, position, velocity
