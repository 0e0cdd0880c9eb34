"""Who touches whom, in the words that Drake has for it and other readers pass over.

As `modeling.contacts`: an arm touches other arms and what stands in the world, never itself nor
its carrier; carriers (setup joints) touch neither each other nor what stands.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trocar.modeling.links import WORLD, LinkModel
from trocar.modeling.markup import child

#: Drake's elements. Source: Drake's page "Supported parsing of SDFormat and URDF".
DRAKE = "http://drake.mit.edu"


def add_collision_filters(parent: Any, model: LinkModel, carriers: Mapping[str, str]) -> None:
    """Append a group for each arm, and which groups it does not touch.

    Args:
        parent: the model's element
        model: the rig
        carriers: {link: the SDF link that it is, or is a frame of}
    """
    arm_of = {link.name: link.arm for link in model.links}
    carried = {
        (arm_of[joint.parent], arm_of[joint.child])
        for joint in model.joints
        if arm_of[joint.parent] and arm_of[joint.parent] != arm_of[joint.child]
    }
    ground = carriers[WORLD]
    setup = {carrier for carrier, _ in carried}
    arms = list(dict.fromkeys(link.arm for link in model.links if link.arm))
    _add_group(parent, ground, [ground], [])
    for arm in arms:
        members = [link.name for link in model.links if link.arm == arm and link.mass]
        ignored = [arm, *(ridden for ridden in arms if (arm, ridden) in carried)]
        if arm in setup:
            ignored += [ground, *(other for other in arms if other in setup - {arm})]
        _add_group(parent, arm, members, ignored)


def _add_group(parent: Any, name: str, members: list[str], ignored: list[str]) -> None:
    # Names of links are taken, even for elements that a reader does not know.
    group = child(parent, f"{{{DRAKE}}}collision_filter_group", {"name": f"{name}_group"})
    for member in members:
        child(group, f"{{{DRAKE}}}member", text=member)
    for other in ignored:
        child(group, f"{{{DRAKE}}}ignored_collision_filter_group", text=f"{other}_group")
