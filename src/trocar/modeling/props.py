"""Props in a model: their joints, elastic bands, soft shapes, and what a rig's own file adds."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations, product
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import Band, Prop, PropJoint
from trocar.errors import DescriptionError
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.geometry.se3 import inverse
from trocar.modeling import naming
from trocar.modeling.geoms import Geoms, Surface
from trocar.modeling.options import STIFF_IMPEDANCE, STOP_STEPS
from trocar.modeling.threads import LYING

Array = NDArray[np.float64]

JOINTS = {
    "hinge": mujoco.mjtJoint.mjJNT_HINGE,
    "slide": mujoco.mjtJoint.mjJNT_SLIDE,
    "ball": mujoco.mjtJoint.mjJNT_BALL,
}
#: Impedance of soft contacts, and of rigid ones. Source: our own choice; with 0.5 an object is as
#: heavy again while it is pressed, which the depth at rest does not depend on.
SOFT, RIGID = 0.5, STIFF_IMPEDANCE[0]


def add_prop(
    spec: mujoco.MjSpec, prop: Prop, poses: Mapping[str, Array], timestep: float
) -> mujoco.MjsBody:
    """Add the body of a prop without its shapes: still, free, or on the joint that it has.

    Args:
        spec: grows
        prop: the prop
        poses: of the props before it, {name: T_world_prop (4, 4)}
        timestep: of the physics [s]
    """
    joint = prop.joint
    on = joint.on if joint is not None else ""
    carrier = spec.body(on) if on else spec.worldbody
    at = inverse(poses[on]) @ prop.pose if on else prop.pose
    body = carrier.add_body(name=prop.name, pos=at[:3, 3], quat=quaternion_from_matrix(at[:3, :3]))
    if joint is not None:
        _add_joint(body, prop.name, joint, timestep)
        if on:
            spec.add_exclude(bodyname1=on, bodyname2=prop.name)
    elif prop.movable is not None:
        body.add_freejoint(name=naming.free_joint(prop.name))
    return body


def _add_joint(body: mujoco.MjsBody, prop: str, joint: PropJoint, timestep: float) -> None:
    made = body.add_joint(
        name=naming.prop_joint(prop, joint.kind),
        type=JOINTS[joint.kind],
        pos=joint.point,
        damping=[joint.damping, 0.0, 0.0],
        stiffness=[joint.stiffness, 0.0, 0.0],
    )
    if joint.kind == "ball":
        return
    made.axis, made.springref = joint.axis, joint.rest
    if np.isfinite([joint.lower, joint.upper]).all():
        made.range = [joint.lower, joint.upper]
        made.solref_limit = [STOP_STEPS * timestep, 1.0]
        made.solimp_limit = STIFF_IMPEDANCE


def add_band(spec: mujoco.MjSpec, band: Band) -> None:
    """Add an elastic band: a tendon through sites of props, slack up to its rest length."""
    tendon = spec.add_tendon(name=naming.band(band.name))
    tendon.stiffness = [band.stiffness, 0.0, 0.0]
    tendon.damping = [band.damping, 0.0, 0.0]
    tendon.springlength = [0.0, band.rest_length]
    tendon.width = band.radius
    for number, (prop, point) in enumerate(band.points):
        site = naming.band_site(band.name, number)
        spec.body(prop).add_site(name=site, pos=point, size=[band.radius] * 3)
        tendon.wrap_site(site)


def soften(
    spec: mujoco.MjSpec,
    geoms: Geoms,
    timestep: float,
    compiled: Callable[[], mujoco.MjModel],
) -> None:
    """Add a pair for each soft shape and each shape that may touch it, with the stated stiffness.

    A contact of MuJoCo yields by an acceleration and not by a force: its force per depth is
    `stiffness * impedance / ((1 - impedance) * A)`, with the inverse inertia A of both bodies. So
    each pair gets the numbers that make its force per depth the one of the description, with
    critical damping. Source: MuJoCo's documentation, "Solver parameters"; measured by
    `python -m benchmarks laws`: depths to 1e-6.

    Args:
        spec: complete but for these pairs
        geoms: what was added to it
        timestep: of the physics [s]
        compiled: compiles it as it is
    """
    surfaces = [(surface, surface.shape.stiffness is not None) for surface in geoms.surfaces]
    meeting = [
        (one, two)
        for (one, soft), (two, other_soft) in combinations(surfaces, 2)
        if (soft or other_soft) and _meet(one, two)
    ]
    if not meeting:
        return
    touching = _laid(spec, meeting, geoms.surfaces)
    model = compiled()
    yields = {model.body(k).name: float(model.body_invweight0[k, 0]) for k in range(model.nbody)}
    for number, (one, two) in enumerate(touching):
        names = [_named(side, geoms.surfaces) for side in (one, two)]
        softness = sum(1.0 / s.shape.stiffness for s in (one, two) if s.shape.stiffness is not None)
        pliant = yields[one.body] + yields[two.body]
        if not pliant:  # both stand still
            continue
        pair = spec.add_pair(name=f"soft_{number}", geomname1=names[0], geomname2=names[1])
        slide, spin, roll = _friction(one.geom, two.geom)
        pair.condim = min(one.geom.condim, two.geom.condim)
        pair.friction = [slide, slide, spin, roll, roll]
        impedance = _impedance(pliant * timestep**2 / softness)
        stiffness = (1.0 - impedance) * pliant / softness
        pair.solref = [-stiffness, -2.0 * np.sqrt(stiffness)]
        pair.solimp = [impedance, impedance, *STIFF_IMPEDANCE[2:]]


def pair_grips(spec: mujoco.MjSpec, pads: Sequence[Surface], held: Sequence[Surface]) -> None:
    """Add pairs, with their usual contact, of pads and shapes that have a friction of their own.

    Such a shape's friction and dimension prevail over all that it touches, unless they have a pair.
    Soft shapes have pairs already.

    Args:
        spec: grows
        pads: shapes of a jaw
        held: shapes of what it may hold
    """
    for pad, shape in product(pads, held):
        if pad.geom.priority == shape.geom.priority or _soft(pad, shape):
            continue
        names = pad.geom.name, shape.geom.name
        pair = spec.add_pair(geomname1=names[0], geomname2=names[1])
        slide, spin, roll = _friction(pad.geom, shape.geom)
        pair.condim, pair.friction = pad.geom.condim, [slide, slide, spin, roll, roll]
        pair.solref, pair.solimp = shape.geom.solref, shape.geom.solimp


def _laid(
    spec: mujoco.MjSpec, meeting: Sequence[tuple[Surface, Surface]], surfaces: Sequence[Surface]
) -> list[tuple[Surface, Surface]]:
    """Replace links of threads by their spheres where they meet bodies of large soft boxes.

    Large: two edges are longer than the spheres' distance, so a thread lies on its faces; narrow
    sides may sink in between spheres. The bodies then touch by these pairs alone.
    """
    edges: dict[str, float] = {}
    for surface in surfaces:
        shape = surface.shape
        flat = shape.kind == "box" and shape.stiffness is not None
        edge = 2.0 * float(np.median(shape.size)) if flat else 0.0
        edges[surface.body] = min(edge, edges.get(surface.body, np.inf))
    touching: list[tuple[Surface, Surface]] = []
    apart: set[tuple[str, str]] = set()
    for one, two in meeting:
        link, box = (one, two) if one.rests is not None else (two, one)
        if link.rests is not None and edges[box.body] > 2.0 * LYING * link.shape.size[1]:
            touching += [(rest, box) for rest in link.rests]
            apart.add((link.body, box.body))
        else:
            touching.append((one, two))
    for link, box in sorted(apart):
        spec.add_exclude(bodyname1=link, bodyname2=box)
    return touching


def _soft(one: Surface, two: Surface) -> bool:
    """Return whether one of two shapes is soft."""
    return one.shape.stiffness is not None or two.shape.stiffness is not None


def _meet(one: Surface, two: Surface) -> bool:
    """Return whether two shapes are of different bodies and contact masks let them touch."""
    a, b = one.geom, two.geom
    may = int(a.contype) & int(b.conaffinity) or int(b.contype) & int(a.conaffinity)
    return one.body != two.body and bool(may)


def _named(side: Surface, surfaces: Sequence[Surface]) -> str:
    """Return the name of a shape's geom, which it gets where files have none."""
    if not side.geom.name:
        side.geom.name = f"{side.body}/touches/{surfaces.index(side)}"
    return side.geom.name


def _friction(one: mujoco.MjsGeom, two: mujoco.MjsGeom) -> Array:
    """Return friction of two geoms as MuJoCo combines it, (3,)."""
    if one.priority != two.priority:
        return np.array((one if one.priority > two.priority else two).friction)
    return np.maximum(one.friction, two.friction)


def _impedance(share: float) -> float:
    """Return the impedance with which a contact is stable, at least that of soft ones.

    Args:
        share: stiffness times inverse inertia, per squared physics step. The contact's time
            constant is two steps or more as long as impedance (1 - impedance) share <= 1/4
    """
    if share <= 1.0:
        return SOFT
    return min(0.5 * (1.0 + np.sqrt(1.0 - 1.0 / share)), RIGID)


def extend(spec: mujoco.MjSpec, path: str) -> None:
    """Call `extend_spec(spec)` of a rig's Python file.

    Raises:
        DescriptionError: the file has no such function, raises, or adds actuators or keyframes
    """
    before = len(spec.actuators), len(spec.keys)
    try:
        run_script(path, "extend_spec")(spec)
    except DescriptionError:
        raise
    except Exception as problem:
        raise script_error(path, problem) from problem
    if before != (len(spec.actuators), len(spec.keys)):
        raise DescriptionError(
            path, "extend_spec", "added an actuator or a keyframe; allowed: all else"
        )
    for part in (*spec.bodies, *spec.joints):  # what stands still is found by its name elsewhere
        part.name = part.name or f"extension/{part.id}"


def run_script(path: str, name: str, content: bytes | None = None) -> Any:
    """Run a Python file and return its function of a name.

    Args:
        path: of the file
        name: of the function
        content: of the file, where it was read before

    Raises:
        DescriptionError: it cannot be read, raises, or has no such function
    """
    try:
        if content is None:
            with open(path, "rb") as file:
                content = file.read()
        code = compile(content, path, "exec")
        names: dict[str, Any] = {"__name__": name, "__file__": path}
        exec(code, names)
    except SyntaxError as problem:
        raise DescriptionError(
            path, f"line {problem.lineno}", f"is no Python: {problem.msg}"
        ) from None
    except Exception as problem:
        raise script_error(path, problem) from problem
    if not callable(names.get(name)):
        known = ", ".join(key for key, value in names.items() if callable(value)) or "none"
        raise DescriptionError(path, "", f"got the functions {known}; allowed: with {name}")
    return names[name]


def script_error(path: str, problem: Exception) -> DescriptionError:
    """Return the error of a Python file that raised, with the last of its lines that ran."""
    lines = [f.lineno for f in traceback.extract_tb(problem.__traceback__) if f.filename == path]
    where = f"line {lines[-1]}" if lines else ""
    return DescriptionError(path, where, f"{type(problem).__name__}: {problem}")
