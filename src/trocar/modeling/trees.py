"""A model of links and joints as trees of joints have it that follow one other joint at most."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import transform
from trocar.modeling.links import SLACK, Link, LinkJoint, LinkModel

Array = NDArray[np.float64]

#: What a link between two joints takes from the link behind it, as a share of its mass and
#: inertia: engines refuse a moving link without any. Source: our own choice, a micro of the whole.
SHARE = 1e-6
#: Between a joint's own name and that of the one that it is to stand behind.
BEHIND = "_and_"


def single_leaders(model: LinkModel) -> LinkModel:
    """Return a model whose joints follow one joint at most: the others get a link of their own.

    A joint that follows two becomes two joints about the same axis, one behind the other; each has
    the damping and the friction of the one. The link between them has a millionth of the mass.
    """
    links: list[Link] = []
    joints: list[LinkJoint] = []
    start: dict[str, float] = dict(model.start)
    by_child = {joint.child: joint for joint in model.joints}
    for link in model.links:
        joint = by_child.get(link.name)
        if joint is None or len(joint.follows) < 2:
            links.append(link)
            joints += [joint] if joint else []
            continue
        parts = list(_split(model, joint))
        between = [replace(_share(link), name=part.child) for part in parts[:-1]]
        left = 1.0 - SHARE * len(between)
        links += [*between, replace(link, mass=left * link.mass, inertia=left * link.inertia)]
        joints += parts
        del start[joint.name]
        start |= {p.name: p.offset + sum(r * start[n] for n, r in p.follows) for p in parts}
    return replace(model, links=tuple(links), joints=tuple(joints), start=start)


def _share(link: Link) -> Link:
    return replace(link, frame="", mass=SHARE * link.mass, inertia=SHARE * link.inertia, shapes=())


def _split(model: LinkModel, joint: LinkJoint) -> Iterator[LinkJoint]:
    last = len(joint.follows) - 1
    parent, pose, offset = joint.parent, joint.pose, joint.offset
    for k, (name, ratio) in enumerate(joint.follows):
        leader = model.joint(name)
        own = joint.name if k == last else f"{joint.name}_{k + 1}"
        child = joint.child if k == last else f"{joint.child}_{k + 1}"
        lower, upper = np.sort(offset + ratio * np.array([leader.lower, leader.upper]))
        yield replace(
            joint,
            name=own,
            parent=parent,
            child=child,
            pose=pose,
            lower=float(lower) - SLACK,
            upper=float(upper) + SLACK,
            velocity=abs(ratio) * leader.velocity,
            offset=offset,
            follows=((name, ratio),),
        )
        parent, pose, offset = child, np.eye(4), 0.0


def leaders_first(model: LinkModel) -> LinkModel:
    """Return a model in which sorting joints by name brings each behind the joint that it follows.

    Readers that sort the joints of a link by name, and then go down each branch, want to know a
    joint before those that follow it. A joint whose branch comes too early is renamed: behind the
    name of the branch that must come first comes its own. Joints that move on their own keep their
    names, so a model in which two of them wait for one another stays as it is.
    """
    for _ in model.joints:
        renamed = dict(_to_rename(model))
        if not renamed:
            break
        joints = tuple(replace(j, name=renamed.get(j.name, j.name)) for j in model.joints)
        start = {renamed.get(name, name): value for name, value in model.start.items()}
        model = replace(model, joints=joints, start=start)
    return model


def _to_rename(model: LinkModel) -> Iterator[tuple[str, str]]:
    """Yield (old, new) names of joints that come too early, at most one of each link's."""
    for joints in _branches(model).values():
        for joint in sorted(joints, key=lambda joint: joint.name):
            later = [other.name for other in joints if other.name > joint.name
                     and _waits_for(model, joint, other)]  # fmt: skip
            if later and (joint.follows or joint.kind == "fixed"):
                yield joint.name, f"{max(later)}{BEHIND}{joint.name.split(BEHIND)[-1]}"
                break


def late_leaders(model: LinkModel) -> tuple[tuple[str, str], ...]:
    """Return (follower, leader) of each joint that sorting by name brings ahead of its leader."""
    order: dict[str, int] = {}
    branches = _branches(model)

    def visit(link: str) -> None:
        for joint in sorted(branches.get(link, ()), key=lambda joint: joint.name):
            order[joint.name] = len(order)
            visit(joint.child)

    visit(model.links[0].name)
    return tuple(
        (joint.name, name)
        for joint in model.joints
        for name, _ in joint.follows
        if order[name] > order[joint.name]
    )


def _branches(model: LinkModel) -> Mapping[str, list[LinkJoint]]:
    """Return the joints that hang on each link."""
    found: dict[str, list[LinkJoint]] = defaultdict(list)
    for joint in model.joints:
        found[joint.parent].append(joint)
    return found


def _waits_for(model: LinkModel, joint: LinkJoint, other: LinkJoint) -> bool:
    """Tell whether a joint behind `joint`, or itself, follows one behind `other`, or itself."""
    mine, theirs = _behind(model, joint), {j.name for j in _behind(model, other)}
    return any(name in theirs for j in mine for name, _ in j.follows)


def _behind(model: LinkModel, root: LinkJoint) -> list[LinkJoint]:
    found, reached = [root], {root.child}
    for joint in model.joints:  # parents come before children
        if joint.parent in reached:
            found.append(joint)
            reached.add(joint.child)
    return found


def joint_values(model: LinkModel, own: Mapping[str, float]) -> dict[str, float]:
    """Return every joint's coordinate.

    Args:
        own: coordinates of the joints that follow none [rad or m]
    """
    found = dict(own)
    for joint in model.joints:
        if joint.follows:
            found[joint.name] = joint.offset + sum(r * found[n] for n, r in joint.follows)
    return found


def link_poses(model: LinkModel, values: Mapping[str, float]) -> dict[str, Array]:
    """Return where links stand in the world, {link: (4, 4)}.

    Args:
        values: coordinates of all joints that move [rad or m]
    """
    found = {model.links[0].name: np.eye(4)}
    for joint in model.joints:
        at = values.get(joint.name, 0.0)
        turn = rotation_z(at if joint.kind == "revolute" else 0.0)
        slide = np.array([0.0, 0.0, at if joint.kind == "prismatic" else 0.0])
        found[joint.child] = found[joint.parent] @ joint.pose @ transform(turn, slide)
    return found
