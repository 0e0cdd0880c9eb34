"""The same scene by MuJoCo's own renderer: judge of ours in tests, and baseline of `scope`."""

from __future__ import annotations

from typing import Any, cast

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.cameras import Intrinsics
from trocar.descriptions.records import RigDescription
from trocar.errors import TrocarError
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.modeling.build import Draft
from trocar.modeling.options import ModelOptions
from trocar.rendering.context import PACKAGES
from trocar.rendering.stills import context_class
from trocar.simulation.records import Snapshot

Array = NDArray[np.float64]

#: Range of depth of the camera [m].
NEAR, FAR = 0.002, 12.0


class Reference:
    """Draw the view of one eye; used in one thread.

    Args:
        rig: is drawn
        size: width and height [px]
        shadow_size: edge of the shadow map [px], 0 without shadows

    Attributes:
        bodies: names of bodies, in the order of a snapshot's positions

    Raises:
        TrocarError: there is no OpenGL to draw with
    """

    def __init__(self, rig: RigDescription, size: tuple[int, int], shadow_size: int = 1024) -> None:
        spec = Draft(rig, ModelOptions(collisions=False, decoration=True)).spec
        visual = cast(Any, spec.visual)
        visual.global_.offwidth, visual.global_.offheight = size
        visual.quality.shadowsize, visual.quality.offsamples = shadow_size, 0
        visual.headlight.active = 0
        lamp = cast(mujoco.MjsBody, spec.worldbody).add_light()
        lamp.type, lamp.castshadow = mujoco.mjtLightType.mjLIGHT_SPOT, shadow_size > 0
        lamp.cutoff, lamp.exponent = 80.0, 1.0
        self._model = model = spec.compile()
        self._data = mujoco.MjData(model)
        self.bodies = tuple(model.body(k).name for k in range(model.nbody))
        self._size = size
        try:
            self._window = context_class()(*size)
            self._window.make_current()
            self._target = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as problem:  # each of MuJoCo's backends fails in its own way
            raise TrocarError(f"no OpenGL to draw with: {problem} ({PACKAGES})") from problem
        self._target.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._target)
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 100)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:] = [0, 1, 1, 0, 0, 0]
        self._options.sitegroup[:] = 0

    def place(self, snapshot: Snapshot) -> None:
        """Put every body where a snapshot has it."""
        model, data = self._model, self._data
        turns = matrix_from_quaternion(snapshot.quaternions)[model.geom_bodyid]
        own = matrix_from_quaternion(model.geom_quat)
        shift = (turns @ model.geom_pos[:, :, None])[:, :, 0]
        data.geom_xpos[:] = snapshot.positions[model.geom_bodyid] + shift
        data.geom_xmat[:] = (turns @ own).reshape(-1, 9)
        mujoco.mjv_updateScene(
            model,
            data,
            self._options,
            mujoco.MjvPerturb(),
            mujoco.MjvCamera(),
            mujoco.mjtCatBit.mjCAT_ALL,
            self._scene,
        )

    def colour(self, T_world_eye: Array, eye: Intrinsics) -> NDArray[np.uint8]:
        """Return a picture, (height, width, 3)."""
        self._look(T_world_eye, eye)
        width, height = self._size
        picture = np.empty((height, width, 3), np.uint8)
        frame = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(frame, self._scene, self._target)
        mujoco.mjr_readPixels(picture, None, frame, self._target)
        return picture[::-1]

    def depth_and_bodies(
        self, T_world_eye: Array, eye: Intrinsics
    ) -> tuple[Array, NDArray[np.int64]]:
        """Return depth [m], inf where nothing is, and the body that each pixel shows, else -1."""
        width, height = self._size
        frame = mujoco.MjrRect(0, 0, width, height)
        colours = np.empty((height, width, 3), np.uint8)
        z = np.empty((height, width), np.float32)
        flags = mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR
        self._look(T_world_eye, eye)
        for flag in flags:
            self._scene.flags[flag] = 1
        mujoco.mjr_render(frame, self._scene, self._target)
        mujoco.mjr_readPixels(colours, z, frame, self._target)
        for flag in flags:
            self._scene.flags[flag] = 0
        number = colours[::-1].astype(np.int64) @ [1, 256, 65536]
        owner = np.full(self._scene.ngeom + 1, -1, dtype=np.int64)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.segid >= 0:
                owner[geom.segid + 1] = self._model.geom_bodyid[geom.objid]
        # Depth runs from 1 (near) to 0 (far). Source: MuJoCo 4, mjr_render's reversed projection.
        near, far = float(np.float32(NEAR)), float(np.float32(FAR))
        depth = near * far / (near + z[::-1].astype(np.float64) * (far - near))
        bodies = owner[number]
        return np.where(bodies >= 0, depth, np.inf), bodies

    def close(self) -> None:
        """Release the graphics library."""
        self._target.free()
        self._window.free()

    def _look(self, T_world_eye: Array, eye: Intrinsics) -> None:
        """Stand where an eye is, with the light beside it."""
        self._window.make_current()
        K = eye.K
        left, right = ((u - K[0, 2]) / K[0, 0] for u in (-0.5, eye.width - 0.5))
        top, bottom = ((K[1, 2] - v) / K[1, 1] for v in (-0.5, eye.height - 0.5))
        for camera in self._scene.camera:  # the mean of both is used
            camera.pos = T_world_eye[:3, 3]
            camera.forward, camera.up = T_world_eye[:3, 2], -T_world_eye[:3, 1]
            camera.frustum_near, camera.frustum_far = NEAR, FAR
            camera.frustum_center = 0.5 * NEAR * (left + right)
            camera.frustum_width = 0.5 * NEAR * (right - left)
            camera.frustum_top, camera.frustum_bottom = NEAR * top, NEAR * bottom
        lamp = self._scene.lights[0]
        lamp.pos = T_world_eye[:3, 3] - 0.0045 * T_world_eye[:3, 1]
        lamp.dir = T_world_eye[:3, 2]
