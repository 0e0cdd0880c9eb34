"""Where a compiled model has the frames of an arm, to compare with the kinematics."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription
from trocar.kinematics import forward
from trocar.modeling import naming
from trocar.modeling.mjcf import lone_rig, rig_spec

Array = NDArray[np.float64]


def compiled_poses(arm: ArmDescription, q: Array) -> dict[str, Array]:
    """Return the pose of every frame that is a body of the compiled model.

    The hinges stand where the kinematics has them; where the frames are is MuJoCo's doing.

    Args:
        arm: the arm, alone in the model, its root at the origin
        q: joint positions, (k, n) [rad or m]

    Returns:
        {frame: poses in the arm's root, (k, 4, 4)}

    Raises:
        InputError: no masses are known, so that there is no model
    """
    model = rig_spec(lone_rig(arm)).compile()
    data = mujoco.MjData(model)
    moving = [
        (index, model.joint(naming.scoped("arm", frame.name)).qposadr[0])
        for index, frame in enumerate(arm.mechanism.frames)
        if frame.motion != "fixed"
    ]
    bodies = {
        frame: mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, naming.scoped("arm", frame))
        for frame in arm.mechanism.frame_names
    }
    found = {
        frame: np.tile(np.eye(4), (len(q), 1, 1)) for frame, body in bodies.items() if body > 0
    }
    for row, coordinate in enumerate(forward.coordinates(arm.mechanism, q)):
        for index, address in moving:
            data.qpos[address] = coordinate[index]
        mujoco.mj_kinematics(model, data)
        for frame, poses in found.items():
            poses[row, :3, 3] = data.xpos[bodies[frame]]
            poses[row, :3, :3] = data.xmat[bodies[frame]].reshape(3, 3)
    return found
