"""Thread in a model: links on universal joints that bend, and do not twist."""

from __future__ import annotations

import mujoco
import numpy as np

from trocar.descriptions.records import Prop
from trocar.descriptions.threads import ChainThread
from trocar.modeling import naming
from trocar.modeling.geoms import COLLISION_GROUP, Surface
from trocar.modeling.options import STIFF_IMPEDANCE, STOP_STEPS

#: Tension acts on the shape of one step and moves that of the next: waves on the thread grow where
#: it is above 4 inertia / (link step^2), with the inertia of a link about any axis. That is chosen
#: for so many times the tension of the description. Source: measured.
SPARE = 2.5
#: Ratio of the joints' damping to the critical one of a link, and of their armature to its inertia.
#: Source: measured: overhand knots that are pulled shut by 1 and 2 N stay knots; with less armature
#: links are so fast that some pass through each other.
DAMPED, ARMATURE = 4.0, 12.5
#: Links bend so far against each other; two hinges lose their second axis at a right angle.
#: Source: our own choice. [rad]
BEND_RAD = 1.3
#: On large soft boxes a thread lies on every second link, and on the last one: a thread that
#: slides costs most by its contacts with friction, of which capsules on a box have two each.
#: Source: measured on thread-knot (docs/suturing.md): USP 3-0 would sag by 0.02 mm in between.
LYING = 2


def add_thread(
    body: mujoco.MjsBody, prop: Prop, thread: ChainThread, timestep: float
) -> list[mujoco.MjsBody]:
    """Add all links but the first one, and give all of them their mass; return them.

    Args:
        body: the first link
        prop, thread: the prop, and its record
        timestep: of the physics [s]
    """
    mass, link = thread.mass / thread.links, thread.link
    stiffness = thread.rigidity / link
    inertia = 0.25 * SPARE * thread.tension * link * timestep**2
    damping = 2.0 * DAMPED * np.sqrt(stiffness * inertia)
    links = [body]
    for number in range(1, thread.links):
        made = links[-1].add_body(name=naming.link(prop.name, number), pos=[link, 0.0, 0.0])
        for name, axis in (("y", [0.0, 1.0, 0.0]), ("z", [0.0, 0.0, 1.0])):
            made.add_joint(
                name=naming.scoped(made.name, name),
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=axis,
                stiffness=[stiffness, 0.0, 0.0],
                damping=[damping, 0.0, 0.0],
                armature=ARMATURE * inertia,
                range=[-BEND_RAD, BEND_RAD],
                solref_limit=[STOP_STEPS * timestep, 1.0],
                solimp_limit=STIFF_IMPEDANCE,
            )
        links.append(made)
    for made in links:
        made.explicitinertial = True
        made.mass, made.ipos = mass, [0.5 * link, 0.0, 0.0]
        made.inertia = [inertia] * 3
    return links


def rests_of(
    link: mujoco.MjsBody, surface: Surface, number: int, thread: ChainThread
) -> tuple[Surface, ...]:
    """Add the sphere in the middle of a link by which a thread touches large soft boxes, if any.

    It touches nothing unless it has a pair (`props.soften`).

    Args:
        link: its body
        surface: of its capsule
        number: of the link
        thread: its record
    """
    if number % LYING and number != thread.links - 1:
        return ()
    own = surface.geom
    ball = link.add_geom(
        name=naming.scoped(link.name, "rest"),
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[0.5 * thread.diameter, 0.0, 0.0],
        pos=[0.5 * thread.link, 0.0, 0.0],
        mass=0.0,
        group=COLLISION_GROUP,
        contype=0,
        conaffinity=0,
        friction=own.friction,
        priority=own.priority,
        condim=own.condim,
    )
    return (Surface(ball, surface.shape, surface.body),)


def bodies_of(prop: Prop) -> tuple[str, ...]:
    """Return the names of a prop's bodies: several of a thread."""
    count = 1 if prop.thread is None else prop.thread.links
    return tuple(naming.link(prop.name, number) for number in range(count))
