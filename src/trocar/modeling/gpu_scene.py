"""The model of a scene for GPUs: weightless arms, and a sensor for each finger on each object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.modeling import naming
from trocar.modeling.build import RigModel, gpu_model

#: Fields of a contact sensor: the force, in the contact's frame, of all contacts together.
#: Source: MuJoCo's `mjtConDataField` and the reduction "netforce".
FORCE, NET_FORCE, SLOTS = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1
#: Numbers of such a sensor.
FORCE_SIZE = 3


@dataclass(frozen=True, eq=False)
class GpuScene:
    """A scene's model for MuJoCo Warp, and the addresses of what is read from its state.

    Attributes:
        model: the rig with position servos; its joint table reads `qpos`
        mj: the model for Warp, never to be stepped by MuJoCo itself
        touch: first of three numbers of `sensordata`, the force between each finger of an arm and
            each object, {arm: (fingers, objects)}
        objects: {object: first of its seven numbers of `qpos`}
        loops: ids of the sites that each loop joins, (k, 2)
    """

    model: RigModel
    mj: mujoco.MjModel
    touch: Mapping[str, NDArray[np.intp]]
    objects: Mapping[str, int]
    loops: NDArray[np.intp]


def gpu_scene(model: RigModel) -> GpuScene:
    """Return the model of a rig with free objects for `mujoco_warp.put_model`.

    Position servos have no input for the weight, so the arms' bodies are weightless.

    Args:
        model: with position servos

    Raises:
        InputError: it has PID servos, or an object that is not free
    """
    rig = model.rig
    if bound := [prop.name for prop in rig.objects if prop.joint or prop.thread]:
        raise InputError(f"{rig.name}: got {', '.join(bound)}; allowed on a GPU: free bodies")
    spec = model.spec.copy()
    arms = {place.name for place in rig.arms}
    for body in spec.bodies:
        if body.mass and naming.owner(body.name) in arms:
            body.gravcomp = 1.0
    driven = [place for place in rig.arms if place.name not in model.options.locked]
    names = [prop.name for prop in rig.objects]
    for place in driven:
        for finger in place.arm.fingers:
            for name in names:
                spec.add_sensor(
                    name=f"{naming.scoped(place.name, finger)}/{name}",
                    type=mujoco.mjtSensor.mjSENS_CONTACT,
                    objtype=mujoco.mjtObj.mjOBJ_BODY,
                    objname=naming.scoped(place.name, finger),
                    reftype=mujoco.mjtObj.mjOBJ_BODY,
                    refname=name,
                    intprm=[FORCE, NET_FORCE, SLOTS],
                )
    mj = gpu_model(replace(model, spec=spec, mj=spec.compile()))
    touch = {
        place.name: np.array(
            [
                [mj.sensor(f"{naming.scoped(place.name, finger)}/{n}").adr[0] for n in names]
                for finger in place.arm.fingers
            ],
            np.intp,
        ).reshape(len(place.arm.fingers), len(names))
        for place in driven
    }
    loops = mj.eq_type == int(mujoco.mjtEq.mjEQ_CONNECT)
    return GpuScene(
        model,
        mj,
        touch,
        {name: int(mj.joint(naming.free_joint(name)).qposadr[0]) for name in names},
        np.stack([mj.eq_obj1id[loops], mj.eq_obj2id[loops]], axis=1).astype(np.intp),
    )
