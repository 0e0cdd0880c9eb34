"""A rig as one MJCF file that MuJoCo loads without anything else."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import RigDescription
from trocar.modeling.markup import child, document, element
from trocar.modeling.menagerie.bodies import add_bodies
from trocar.modeling.menagerie.equalities import add_couplings, add_loops
from trocar.modeling.menagerie.home import add_home
from trocar.modeling.menagerie.servos import add_servos
from trocar.modeling.menagerie.sheet import Sheet
from trocar.modeling.menagerie.text import exact, row
from trocar.modeling.menagerie.variants import POSITION, Variant
from trocar.modeling.options import IMPRATIO, solved_apart

#: Where the meshes are, beside the file.
MESH_FOLDER = "assets"
#: Order of a file's sections. Source: MuJoCo Menagerie.
SECTIONS = ("worldbody", "equality", "actuator", "sensor", "keyframe")


def mjcf_document(
    rig: RigDescription, variant: Variant = POSITION, meshes: Mapping[Mesh, str] | None = None
) -> bytes:
    """Return a rig as a file of its own.

    A lone arm's names are the description's; in a rig with several they begin with the arm's:
    "PSM1_yaw". Bodies and sites are the frames of the description, hinges and servos are called as
    the public joints.

    Args:
        rig: its description
        variant: which servos and which integrator
        meshes: {mesh: name}: the mesh is read from assets/NAME.obj

    Raises:
        InputError: an arm has no masses or no gains
        MissingExtraError: lxml is not installed
    """
    sheet = Sheet.of(rig, variant, meshes or {})
    root = element("mujoco", {"model": sheet.classes.root})
    parts = {tag: element(tag) for tag in SECTIONS}
    bodies = add_bodies(sheet, parts["worldbody"])
    for place in rig.arms:
        owned = {f: name for name, (arm, f) in bodies.hinges.items() if arm == place.name}
        add_loops(sheet, place, bodies.anchors[place.name], owned, parts["equality"])
        add_couplings(sheet, place, owned, parts["equality"])
    add_servos(sheet, bodies.classes, parts["actuator"], parts["sensor"])
    add_home(sheet, bodies, parts["worldbody"], parts["keyframe"])
    said = {"angle": "radian", "autolimits": "true"}
    child(root, "compiler", {**said, "meshdir": MESH_FOLDER} if meshes else said)
    root.append(option_block(sheet, len(bodies.hinges)))
    root.append(sheet.classes.document())
    root.append(_assets(sheet, parts["worldbody"]))
    for part in parts.values():
        if len(part):
            root.append(part)
    return document(root)


def option_block(sheet: Sheet, hinges: int) -> Any:
    """Return the solver's settings: those of the simulation, but for MJX.

    Source: measured on these arms, docs/simulation.md.
    """
    variant = sheet.variant
    made = element("option", {"timestep": exact(sheet.options.timestep)})
    said = {
        "integrator": variant.integrator,
        "solver": "Newton",
        "jacobian": "dense",
        "cone": variant.cone,
    }
    if variant.cone == "elliptic":
        said["impratio"] = exact(IMPRATIO)
    resting = [k for k, p in enumerate(sheet.rig.arms, start=1) if sheet.braked(p)]
    if resting:
        said["actuatorgroupdisable"] = row(resting)
    for key, value in said.items():
        made.set(key, value)
    if variant.integrator == "discrete":
        apart = solved_apart(hinges, len(sheet.rig.objects))
        spared = "warmstart" if apart else "island"
        child(made, "flag", {spared: "disable", "autoreset": "disable"})
    return made


def _assets(sheet: Sheet, world: Any) -> Any:
    """Return the materials and meshes that the bodies use, each once."""
    made = element("asset")
    used = {geom.get("material") for geom in world.iter("geom")}
    for name, material in MATERIALS.items():
        if name in used:
            look = {"specular": exact(material.gloss), "shininess": exact(material.gloss)}
            child(made, "material", {"name": name, "rgba": row(material.rgba), **look})
    seen = {geom.get("mesh") for geom in world.iter("geom") if geom.get("class") == "visual"}
    meshes = {geom.get("mesh") for geom in world.iter("geom")}
    for name in sorted(meshes - {None}):
        said = {"class": sheet.classes.root, "name": name, "file": f"{name}.obj"}
        child(made, "mesh", said if name in seen else {**said, "inertia": "convex"})
    return made
