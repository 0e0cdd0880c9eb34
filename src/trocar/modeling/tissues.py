"""Soft tissue in a model: the places where stitches hold it, and the thread.

Every stitch has eight places, bodies on three slides whose coordinates are where they are in the
tissue's frame. Four are channel points that needle and thread pass; at four more both walls of the
wound meet. The simulation pulls them with the forces of the condensed mesh; the model has what is
rigid: beads that slide along the needle and take hold of the channel points, plates that a tip
presses on until it punctures, walls that do not pass through each other, the thread's lengths.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, cast

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.tissues import Tissue
from trocar.modeling import naming
from trocar.modeling.geoms import COLLISION_GROUP
from trocar.modeling.options import CONTACT_IMPEDANCE, STIFF_IMPEDANCE

Array = NDArray[np.float64]

#: Channel points in the order of passage, then the walls' places: halfway down and at the edge.
CHANNEL = ("entry", "inner_in", "inner_out", "exit")
WALLS = ("wall_in", "edge_in", "wall_out", "edge_out")
PLACES = (*CHANNEL, *WALLS)
#: Plates of a stitch: on the entry, and on the second wall, whichever side it is on.
PLATES = ("entry", "wall_plus", "wall_minus")
#: Inertia of places, beads and thread. Source: measured: the explicit forces of the mesh and the
#: limits of tendons are steady with these at steps of 1 ms. [kg, kg, kg m^2, kg]
EYE_KG, EYE_ARMATURE, BEAD_ARMATURE, FEED_KG = 5e-5, 2e-3, 1e-6, 4e-3
#: Damping of a place's slides. Source: our own choice, 1/50 of what the mesh has. [N s/m]
EYE_DAMPING = 1e-3
#: Half edges of a plate that a tip presses on before it punctures, and its friction. Source: our
#: own choice: twice as wide as a patch; a sharp tip that dents tissue does not slide. [m]
PLATE_M, PLATE_FRICTION = (0.003, 0.003, 0.001), (3.0, 0.002, 0.0005)
#: Radius of the very tip, which alone presses on plates. Source: our own choice; the wire's would
#: press before the tip is there. [m]
TIP_M = 1e-4
#: Impedance of dry friction. Source: measured: with MuJoCo's default the friction of joints as
#: light as beads vanishes; with this it is the description's to 5 %.
FRICTION_IMPEDANCE = (0.999, 0.999, 0.001, 0.5, 2.0)
#: A tendon of a thread that is not threaded is longer than anything [m].
SLACK_M = 9.0
#: Slide coordinate at which thread that has passed is kept, far above everything; the
#: branch of each tendon that reads it has this length at 0. [m]
STORE_M, BRANCH_M = 2.0, 1.0
#: Tissue between two channel points bunches to this share of its length and no shorter.
#: Source: measured: without, pulls above 2.3 N turn the thread through itself.
BUNCHED = 0.5


def tissue_bit(arms: int) -> int:
    """Return the contact bit of plates, in a rig of so many arms."""
    return 4 << arms


def add_tissue(
    spec: mujoco.MjSpec, name: str, tissue: Tissue, *, bit: int, timestep: float
) -> None:
    """Add what a stitch needs to a tissue's body and to its needle.

    Args:
        spec: has the bodies of the tissue and of the needle
        name: of the tissue's prop
        tissue: its record
        bit: of contacts between tips and plates
        timestep: of the physics [s]
    """
    hard: dict[str, Any] = {"solref": [2.0 * timestep, 1.0], "solimp": STIFF_IMPEDANCE}
    limit: dict[str, Any] = {
        "limited": True,
        "solref_limit": hard["solref"],
        "solimp_limit": STIFF_IMPEDANCE,
    }
    dry: dict[str, Any] = {
        "solref_friction": hard["solref"],
        "solimp_friction": FRICTION_IMPEDANCE,
    }
    body = cast(mujoco.MjsBody, spec.body(name))
    for stitch in range(tissue.stitches):
        _add_places(body, f"{name}/{stitch}", bit, hard["solref"])
        _add_walls(spec, f"{name}/{stitch}", limit)
    needle, wire = cast(mujoco.MjsBody, spec.body(tissue.needle)), tissue.wire
    tip = wire.tip[:3, 3]
    for number, place in enumerate(CHANNEL):
        bead = _light(needle, naming.scoped(name, f"bead{number}"), 1e-5)
        bead.add_joint(
            name=bead.name,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0, 0, 1],
            armature=BEAD_ARMATURE,
            frictionloss=tissue.drag * wire.radius,
            **dry,
        )
        for stitch in range(tissue.stitches):
            spec.add_equality(
                name=naming.scoped(f"{name}/{stitch}", place),
                type=mujoco.mjtEq.mjEQ_CONNECT,
                objtype=mujoco.mjtObj.mjOBJ_BODY,
                name1=bead.name,
                name2=naming.scoped(f"{name}/{stitch}", place),
                active=False,
                data=[*tip, *[0.0] * 9],
                **hard,
            )
    needle.add_geom(
        name=naming.scoped(name, "tip"),
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[TIP_M, 0.0, 0.0],
        pos=tip,
        mass=0.0,
        contype=0,
        conaffinity=bit,
        group=COLLISION_GROUP,
    )
    _add_thread(spec, name, tissue, limit | dry)


def _add_places(body: mujoco.MjsBody, stitch: str, bit: int, solref: Sequence[float]) -> None:
    for place in PLACES:
        eye = _light(body, naming.scoped(stitch, place), EYE_KG)
        for axis, along in zip("xyz", np.eye(3), strict=True):
            eye.add_joint(
                name=naming.scoped(eye.name, axis),
                type=mujoco.mjtJoint.mjJNT_SLIDE,
                axis=along,
                armature=EYE_ARMATURE,
                damping=[EYE_DAMPING, 0.0, 0.0],
            )
        eye.add_site(name=eye.name, size=[3e-4] * 3)
        wide, _, thick = PLATE_M
        below = thick + TIP_M  # the middle of the tip is on the surface where it begins to press
        plates: list[tuple[str, list[float], list[float]]] = []
        if place == "entry":
            plates = [("entry", [wide, wide, thick], [0.0, 0.0, -below])]
        elif place == "wall_out":
            upright = [wide, thick, wide]
            plates = [
                ("wall_plus", upright, [0.0, below, 0.0]),
                ("wall_minus", upright, [0.0, -below, 0.0]),
            ]
        for plate, size, at in plates:
            eye.add_geom(
                name=naming.scoped(stitch, plate),
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=size,
                pos=at,
                mass=0.0,
                contype=bit,
                conaffinity=0,
                condim=4,
                friction=PLATE_FRICTION,
                priority=2,
                solref=solref,
                solimp=CONTACT_IMPEDANCE,
            )


def _add_walls(spec: mujoco.MjSpec, stitch: str, limit: dict[str, Any]) -> None:
    """Add what keeps the walls apart, in the middle and at the edges, and tissue from vanishing."""
    for kind in ("wall", "edge"):
        wall = spec.add_tendon(name=naming.scoped(stitch, kind), range=[-SLACK_M, SLACK_M], **limit)
        wall.wrap_joint(f"{stitch}/{kind}_in/y", 1.0)
        wall.wrap_joint(f"{stitch}/{kind}_out/y", -1.0)
    for one, two in pairwise(CHANNEL):
        strut = spec.add_tendon(
            name=naming.scoped(stitch, f"strut_{one}"), range=[0.0, SLACK_M], **limit
        )
        strut.wrap_site(naming.scoped(stitch, one))
        strut.wrap_site(naming.scoped(stitch, two))


def _add_thread(spec: mujoco.MjSpec, name: str, tissue: Tissue, hard: dict[str, Any]) -> None:
    """Add the thread's lengths: a tendon for each channel point that it comes to end at."""
    needle, world = (cast(mujoco.MjsBody, b) for b in (spec.body(tissue.needle), spec.worldbody))
    swage, feed = naming.scoped(name, "swage"), naming.scoped(name, "feed")
    needle.add_site(name=swage, pos=tissue.wire.swage[:3, 3], size=[3e-4] * 3)
    store = _light(world, feed, FEED_KG)
    store.pos = [0.0, 0.0, STORE_M]
    store.add_joint(
        name=feed,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[1, 0, 0],
        range=[0.0, tissue.thread.free],
        frictionloss=tissue.thread.friction,
        **hard,
    )
    store.add_site(name=feed, size=[3e-4] * 3)
    world.add_site(name=naming.scoped(name, "store"), pos=[BRANCH_M, 0.0, STORE_M], size=[3e-4] * 3)
    limit = {key: value for key, value in hard.items() if "friction" not in key}
    path: list[str] = []
    for stitch in range(tissue.stitches):
        for place in CHANNEL:
            path.insert(0, naming.scoped(f"{name}/{stitch}", place))
            string = spec.add_tendon(
                name=naming.scoped(f"{name}/{stitch}", f"thread_{place}"),
                range=[0.0, SLACK_M],
                **limit,
            )
            for site in (swage, *path):
                string.wrap_site(site)
            string.wrap_pulley(1.0)
            string.wrap_site(naming.scoped(name, "store"))
            string.wrap_site(feed)
        lock = spec.add_tendon(
            name=naming.scoped(f"{name}/{stitch}", "lock"), range=[0.0, SLACK_M], **limit
        )
        for site in path:
            lock.wrap_site(site)


def _light(parent: mujoco.MjsBody, name: str, mass: float) -> mujoco.MjsBody:
    made = parent.add_body(name=name)
    made.explicitinertial = True
    made.mass, made.inertia = mass, [1e-9] * 3
    return made
