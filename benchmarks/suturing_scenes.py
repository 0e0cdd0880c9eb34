"""The scene `suturing` with the needles and tissues of the benchmark."""

from __future__ import annotations

from dataclasses import replace

from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.needles import Needle, needle_sizes
from trocar.descriptions.records import Movable, Prop
from trocar.descriptions.scenes import Scene
from trocar.descriptions.shapes import needle_shapes
from trocar.descriptions.tissues import MOST_STITCHES, Tissue
from trocar.errors import InputError, UnknownNameError
from trocar.tasks.suturing.scene import MORE_M, MORE_S

SCENE = "suturing"
#: Moduli, layers and forces of tissues. Source: phantom: silicone pads, 0.2 MPa (ONU 2025), 0.5 N;
#: skin: its upper 2 mm of dermis on fat, forces of entry of Frick 2001; soft: half a phantom, like
#: bowel.
TISSUES: dict[str, dict[str, object]] = {
    "phantom": {"modulus": 2e5, "layers": (), "puncture": 0.5, "drag": 0.06},
    "skin": {"modulus": 1e5, "layers": ((2e-3, 4e5),), "puncture": 1.0, "drag": 0.1},
    "soft": {"modulus": 1e5, "layers": (), "puncture": 0.2, "drag": 0.03},
}
#: Length of a needle's point by its wire: jaws that take it behind the point hold it well.
#: Source: our own choice.
POINT = 2.0


def suturing_scene(stitches: int = 1, needle: str = "", tissue: str = "phantom") -> Scene:
    """Load the scene with a number of stitches, a needle and a tissue.

    Args:
        stitches: how many to make
        needle: name of a size, "26mm-half" or "half_26"; "" for the scene's own
        tissue: name of a row in `TISSUES`

    Raises:
        InputError, UnknownNameError: which, and what is allowed
    """
    if not 1 <= stitches <= MOST_STITCHES:
        raise InputError(f"stitches: got {stitches}; allowed: 1 to {MOST_STITCHES}")
    if tissue not in TISSUES:
        raise UnknownNameError("tissue", tissue, TISSUES)
    scene = load_scene(SCENE)
    props = {prop.name: prop for prop in scene.rig.props}
    pad, soft = next((p, p.tissue) for p in scene.rig.props if p.tissue is not None)
    name, wire = soft.needle, soft.wire
    if needle:
        wire = _size(needle)
        props[name] = _with_needle(props[name], wire)
    more = stitches - soft.stitches
    length = soft.thread.length * wire.radius / soft.wire.radius + MORE_M * more
    changed: Tissue = replace(
        soft,
        wire=wire,
        stitches=stitches,
        thread=replace(soft.thread, length=length),
        **TISSUES[tissue],
    )
    props[pad.name] = replace(pad, tissue=changed)
    rig = replace(scene.rig, props=tuple(props.values()))
    return replace(scene, rig=rig, time_limit=scene.time_limit + MORE_S * more)


def _size(name: str) -> Needle:
    """Return a needle by its name: "half_26", or "26mm-half"."""
    sizes = needle_sizes()
    length, _, shape = name.partition("mm-")
    spelled = f"{shape.replace('3/8', 'three_eighths')}_{length}" if shape else name
    if spelled not in sizes:
        known = [f"{key.split('_')[-1]}mm-{'_'.join(key.split('_')[:-1])}" for key in sizes]
        raise UnknownNameError("needle", name, known)
    found = sizes[spelled]
    return replace(found, taper=min(found.taper, POINT * found.wire))


def _with_needle(prop: Prop, needle: Needle) -> Prop:
    """Return a needle's prop with another needle."""
    old, before = prop.movable, prop.needle
    if old is None or before is None:
        raise InputError(f"{prop.name}: is no needle that moves")
    larger = needle.radius / before.radius
    inertia = old.inertia * needle.mass / old.mass * larger**2
    movable = Movable(needle.mass, old.com * larger, inertia, old.inertia_from)
    shapes = needle_shapes(needle, prop.shapes[0].material)
    return replace(prop, shapes=shapes, movable=movable, needle=needle)
