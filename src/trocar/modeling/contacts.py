"""Which bodies may touch: an arm touches other arms and props, never itself or its carrier.

What can be moved touches everything.
"""

from __future__ import annotations

from dataclasses import dataclass

from trocar.descriptions.records import RigDescription


@dataclass(frozen=True)
class ContactMask:
    """MuJoCo's contype (who I am) and conaffinity (whom I touch)."""

    contype: int
    conaffinity: int


#: The bit of everything that stands still.
WORLD_BIT = 1
#: Where the mask of what can be moved is: no arm has such a name.
OBJECTS = "movable"


def contact_masks(rig: RigDescription) -> dict[str, ContactMask]:
    """Return the mask of every arm by name, and of the props under "".

    What can be moved has its mask under `OBJECTS`.

    Setup joints share the cart's column and touch neither it nor each other; an arm does not touch
    the setup joints that carry it.
    """
    bits = {arm.name: 2 << index for index, arm in enumerate(rig.arms)}
    setup = sum(bits[a.name] for a in rig.arms if a.arm.type == "SUJ")
    everything = WORLD_BIT | sum(bits.values())
    still = [prop for prop in rig.props if prop.movable is None]
    solid = any(shape.collide for prop in still for shape in prop.shapes)
    if not solid:
        everything &= ~WORLD_BIT
    masks = {"": ContactMask(WORLD_BIT, everything & ~WORLD_BIT & ~setup if solid else 0)}
    for arm in rig.arms:
        touches = everything & ~bits[arm.name]
        if arm.arm.type == "SUJ":
            touches &= ~setup & ~WORLD_BIT
            for carried in rig.arms:
                touches &= ~bits[carried.name] if carried.on == arm.name else -1
        elif arm.on:
            touches &= ~bits[arm.on]
        masks[arm.name] = ContactMask(bits[arm.name], touches)
    return _with_objects(masks, rig)


def _with_objects(masks: dict[str, ContactMask], rig: RigDescription) -> dict[str, ContactMask]:
    """Return masks in which what can be moved touches all that collides, and itself."""
    if not rig.objects:
        return masks
    own = 2 << len(rig.arms)
    everyone = WORLD_BIT | sum(mask.contype for name, mask in masks.items() if name) | own
    met = {name: ContactMask(m.contype, m.conaffinity | own) for name, m in masks.items()}
    return {**met, OBJECTS: ContactMask(own, everyone)}
