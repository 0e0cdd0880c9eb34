"""Hinges, slides, loops and couplings in SDF."""

from __future__ import annotations

from typing import Any

import numpy as np

from trocar.geometry.se3 import translation
from trocar.modeling.links import LinkJoint, LinkLoop, LinkModel
from trocar.modeling.markup import child
from trocar.modeling.sdf_filters import DRAKE
from trocar.modeling.sdf_shapes import add_pose, exact

#: Hinges that lean by less have the same direction: rounding. Source: our own choice. [rad]
PARALLEL = 1e-9
Z = "0 0 1"


def joint_name(name: str) -> str:
    """Return what a joint is called in the file, where links and joints share their names."""
    return f"{name}_joint"


def add_fixed(parent: Any, name: str, on: str, link: str) -> None:
    """Append a joint that does not move."""
    _start(parent, name, "fixed", on, link)


def add_joint(parent: Any, model: LinkModel, joint: LinkJoint, on: str, version: str) -> None:
    """Append what joins a link to its parent.

    Args:
        parent: the element that gets it
        model: the rig
        joint: which; its child has mass
        on: the link that the joint's parent is, or is a frame of
        version: of SDF
    """
    if joint.kind == "fixed" or joint.hinge is None:
        add_fixed(parent, joint.name, on, joint.child)
        return
    made = _start(parent, joint.name, joint.kind, on, joint.child)
    axis = child(made, "axis")
    child(axis, "xyz", text=Z)
    if joint.follows and not joint.in_loop:
        _add_coupling(made, axis, model, joint, version)
    if joint.hinge.armature and version != "1.7" and not joint.in_loop:
        child(made, f"{{{DRAKE}}}rotor_inertia", text=exact([joint.hinge.armature]))
    _add_limit(axis, model, joint)
    _add_dynamics(axis, model, joint)


def _start(parent: Any, name: str, kind: str, on: str, link: str) -> Any:
    made = child(parent, "joint", {"name": joint_name(name), "type": kind})
    child(made, "parent", text=on)
    child(made, "child", text=link)
    return made


def _add_limit(axis: Any, model: LinkModel, joint: LinkJoint) -> None:
    """Append how far a joint goes; what a loop determines, its loop limits, and no motor drives."""
    limit = child(axis, "limit")
    if joint.in_loop or joint.hinge is None:
        child(limit, "effort", text=exact([0.0]))
        return
    lower = max(joint.lower, joint.hinge.lower) - model.zero[joint.name]
    upper = min(joint.upper, joint.hinge.upper) - model.zero[joint.name]
    child(limit, "lower", text=exact([lower]))
    child(limit, "upper", text=exact([upper]))
    child(limit, "effort", text=exact([joint.effort]))
    if np.isfinite(joint.velocity):
        child(limit, "velocity", text=exact([joint.velocity]))


def _add_dynamics(axis: Any, model: LinkModel, joint: LinkJoint) -> None:
    hinge = joint.hinge
    if hinge is None or not (hinge.damping or hinge.frictionloss or hinge.stiffness):
        return
    dynamics = child(axis, "dynamics")
    child(dynamics, "damping", text=exact([hinge.damping]))
    child(dynamics, "friction", text=exact([hinge.frictionloss]))
    if hinge.stiffness:
        rest = hinge.rest - model.zero[joint.name]
        child(dynamics, "spring_reference", text=exact([rest]))
        child(dynamics, "spring_stiffness", text=exact([hinge.stiffness]))


def _add_coupling(made: Any, axis: Any, model: LinkModel, joint: LinkJoint, version: str) -> None:
    """Say which joint a joint follows, in the words that readers of the version know."""
    ((leader, ratio),) = joint.follows
    offset = joint.offset + ratio * model.zero[leader] - model.zero[joint.name]
    if version == "1.11":
        mimic = child(axis, "mimic", {"joint": joint_name(leader)})
        for tag, value in (("multiplier", ratio), ("offset", offset), ("reference", 0.0)):
            child(mimic, tag, text=exact([value]))
    elif version == "1.9":
        named = {
            "joint": joint_name(leader),
            "multiplier": exact([ratio]),
            "offset": exact([offset]),
        }
        child(made, f"{{{DRAKE}}}mimic", named)


def add_gearbox(parent: Any, model: LinkModel, joint: LinkJoint, on: str) -> None:
    """Append the gearbox that ties a hinge to the one it follows, where both sit on one link.

    Gazebo Classic turns the child by -ratio times what the parent turns, both seen from the
    reference body. Source: the description of `gearbox_ratio` in SDF.
    """
    if joint.kind != "revolute" or not joint.follows or joint.in_loop:
        return
    ((name, ratio),) = joint.follows
    leader = model.joint(name)
    if leader.kind != "revolute" or leader.parent != joint.parent:
        return
    sides = leader.child, joint.child
    made = _start(parent, f"{joint.name}_gear", "gearbox", *sides)
    child(made, "gearbox_ratio", text=exact([-ratio]))
    child(made, "gearbox_reference_body", text=on)
    for tag, link in zip(("axis", "axis2"), sides, strict=True):
        child(child(made, tag), "xyz", {"expressed_in": link}, Z)


def add_loop(parent: Any, model: LinkModel, loop: LinkLoop) -> None:
    """Append the joint that closes a loop: a hinge, or a ball where the hinges are skew.

    Four skew hinges could not turn; with a ball and the pin that slides (`descriptions.pins`) they
    turn as the kinematics say.
    """
    kind = "revolute" if _flat(model, loop) else "ball"
    made = _start(parent, loop.name, kind, loop.link_a, loop.link_b)
    add_pose(made, translation(loop.point_a), loop.link_a)
    if kind == "revolute":
        axis = child(made, "axis")
        child(axis, "xyz", text=Z)
        child(child(axis, "limit"), "effort", text=exact([0.0]))


def _flat(model: LinkModel, loop: LinkLoop) -> bool:
    """Tell whether every hinge of a loop has the same direction."""
    above = {joint.child: joint for joint in model.joints}

    def chain(link: str) -> list[LinkJoint]:
        found: list[LinkJoint] = []
        while link in above:
            found.append(above[link])
            link = found[-1].parent
        return found

    sides = chain(loop.link_a), chain(loop.link_b)
    common = {joint.name for joint in sides[0]} & {joint.name for joint in sides[1]}
    directions: list[np.ndarray] = []
    for side in sides:
        turned = np.eye(3)
        for joint in (j for j in reversed(side) if j.name not in common):
            # About its own z a hinge turns no direction that is parallel to it.
            turned = turned @ joint.pose[:3, :3]
            if joint.kind == "revolute":
                directions.append(turned[:, 2])
    return max(float(np.linalg.norm(d - directions[0])) for d in directions) < PARALLEL
