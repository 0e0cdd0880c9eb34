"""A rig as a MuJoCo model: a pure function of its description and a few options."""

from __future__ import annotations

from typing import Any, cast

import mujoco
import numpy as np

from trocar.descriptions.records import ArmDescription, Prop, RigArm, RigDescription
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.modeling import naming
from trocar.modeling.arm_model import Anchor, Place, add_arm, add_shape, set_mass
from trocar.modeling.contacts import OBJECTS, ContactMask, contact_masks
from trocar.modeling.options import IMPRATIO, STILL_M_S, ModelOptions, solved_apart


def rig_spec(rig: RigDescription, options: ModelOptions | None = None) -> mujoco.MjSpec:
    """Return the model of a rig, ready to compile or to be written as MJCF.

    Source of the settings: measured on these arms, docs/simulation.md (integrator `discrete`,
    Newton, dense Jacobian: the sparse one of MuJoCo 4.0.0 diverges on these chains).

    Raises:
        InputError: an arm has no masses
    """
    chosen = options or ModelOptions()
    spec = new_spec(chosen)
    spec.modelname = rig.name
    masks = contact_masks(rig)
    world = Anchor(cast(mujoco.MjsBody, spec.worldbody), np.eye(4))
    for prop in rig.props:
        _add_prop(spec, prop, masks[OBJECTS if prop.movable else ""], chosen)
    frames: dict[str, dict[str, Anchor]] = {}
    for group, arm in enumerate(rig.arms, start=1):
        mount = frames[arm.on][arm.frame] if arm.on else world
        at = Anchor(mount.body, mount.pose @ arm.pose)
        place = Place(arm.name, at, masks[arm.name], group)
        frames[arm.name] = add_arm(spec, arm.arm, place, chosen)
    objects = len(rig.objects)
    apart = solved_apart(len(spec.joints) - objects, objects)
    cast(Any, spec.option).disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_WARMSTART if apart else mujoco.mjtDisableBit.mjDSBL_ISLAND
    )
    if objects:
        cast(Any, spec.option).enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        cast(Any, spec.option).sleep_tolerance = STILL_M_S
    return spec


def _add_prop(spec: mujoco.MjSpec, prop: Prop, mask: ContactMask, options: ModelOptions) -> None:
    """Add a body that stands in the world, or one that nothing holds."""
    world = cast(mujoco.MjsBody, spec.worldbody)
    body = world.add_body(
        name=prop.name, pos=prop.pose[:3, 3], quat=quaternion_from_matrix(prop.pose[:3, :3])
    )
    if prop.movable is not None:
        body.add_freejoint(name=naming.free_joint(prop.name))
        set_mass(body, prop.movable.mass, prop.movable.com, prop.movable.inertia)
    for number, shape in enumerate(prop.shapes):
        add_shape(spec, body, f"{prop.name}/{number}", shape, mask, options)


def lone_rig(arm: ArmDescription, name: str = "arm") -> RigDescription:
    """Return a rig of one arm whose root stands at the world's origin."""
    rest = np.clip(np.zeros(len(arm.joints)), arm.mechanism.lower, arm.mechanism.upper)
    return RigDescription(
        arm.name,
        arm.title,
        arm.source,
        arm.file,
        (RigArm(name, arm, "", "", np.eye(4)),),
        (),
        {"start": {name: rest}},
    )


def new_spec(options: ModelOptions) -> mujoco.MjSpec:
    """Return an empty model with the solver's settings."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.autolimits = True
    spec.compiler.boundmass = 0.0
    option = cast(Any, spec.option)
    option.timestep = options.timestep
    option.gravity = [0.0, 0.0, -9.81]
    option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = IMPRATIO
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # World reports, never resets
    return spec
