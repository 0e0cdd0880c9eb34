"""A still picture of a rig on white, from in front, the side, above or a corner."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from trocar.descriptions.records import RigDescription
from trocar.errors import InputError, TrocarError
from trocar.modeling.build import Draft
from trocar.modeling.options import ModelOptions
from trocar.outputs import check_file, whole_file

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
View = Literal["front", "side", "top", "three_quarter"]

#: Direction into the picture: azimuth, elevation [deg]. Front is seen from the patient.
VIEWS: Mapping[View, tuple[float, float]] = {
    "front": (-90.0, 0.0),
    "side": (180.0, 0.0),
    "top": (90.0, -90.0),
    "three_quarter": (-130.0, -18.0),
}
#: Vertical angle of the view with perspective [deg], and the margin around a rig. Source: by eye.
FIELD_OF_VIEW, MARGIN = 25.0, 1.06
#: Samples of a pixel across and down, and edge of the shadow map [px]. Source: by eye.
FINER, SHADOW = 2, 8192
#: Largest body that is drawn, so that floors are left out [m]. Source: our own choice.
LARGEST = 3.0


def portrait(
    rig: RigDescription,
    *,
    view: View = "three_quarter",
    q: Mapping[str, ArrayLike] | None = None,
    size: tuple[int, int] = (1200, 900),
) -> Picture:
    """Return a picture of a rig that stands still.

    Front, side and top are without perspective, so that lengths can be read from them.

    Args:
        rig: is drawn without its floor
        view: direction of the view
        q: {arm: joint positions (n,)} [rad or m]; arms without one stand as in the pose "start"
        size: width, height [px]

    Returns:
        (height, width, 3)

    Raises:
        TrocarError: there is no OpenGL to draw with
    """
    stand = {**rig.poses["start"], **{k: np.asarray(v, np.float64) for k, v in (q or {}).items()}}
    spec = Draft(rig, ModelOptions(collisions=False, decoration=True, locked=stand)).spec
    width, height = FINER * size[0], FINER * size[1]
    _light(spec, (width, height))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    fine = _draw(model, data, _camera(model, data, view, size), (width, height))
    blocks: Picture = fine.reshape(size[1], FINER, size[0], FINER, 3)
    mean: Array = blocks.mean(axis=(1, 3))
    return np.round(mean).astype(np.uint8)


def _light(spec: mujoco.MjSpec, size: tuple[int, int]) -> None:
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = size
    visual.quality.shadowsize = SHADOW
    visual.headlight.ambient = [0.42] * 3
    visual.headlight.diffuse = [0.30] * 3
    visual.headlight.specular = [0.10] * 3
    world = spec.worldbody
    for place, strength, shadow in (((2, 3, 5), 0.36, True), ((-4, 2, 3), 0.18, False)):
        light = world.add_light(pos=place, dir=-np.array(place, dtype=np.float64))
        light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        light.castshadow = shadow
        light.diffuse = [strength] * 3
        light.specular = [0.25 * shadow] * 3
    sky = spec.add_texture(name="white", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
    sky.rgb1 = sky.rgb2 = [1.0, 1.0, 1.0]
    sky.width = sky.height = 32
    for body in spec.bodies:
        for geom in list(body.geoms):
            if np.max(geom.size) > 0.5 * LARGEST and geom.type == mujoco.mjtGeom.mjGEOM_BOX:
                spec.delete(geom)


def _camera(
    model: mujoco.MjModel, data: mujoco.MjData, view: View, size: tuple[int, int]
) -> mujoco.MjvCamera:
    """Return a camera that shows the whole rig as large as the picture allows."""
    azimuth, elevation = VIEWS[view]
    turn, tilt = np.deg2rad(azimuth), np.deg2rad(elevation)
    ahead = np.array(
        [np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)], dtype=np.float64
    )
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    axes = np.stack([right, np.cross(right, ahead), ahead])
    seen = _corners(model, data) @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle = 0.5 * (low + high)
    aspect = size[0] / size[1]
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.azimuth, camera.elevation = azimuth, elevation
    camera.orthographic = int(view != "three_quarter")
    if camera.orthographic:
        wide, tall, deep = MARGIN * (high - low)
        model.vis.global_.fovy = max(tall, wide / aspect)
        camera.distance = deep + tall
    else:
        model.vis.global_.fovy = FIELD_OF_VIEW
        slope = np.tan(0.5 * np.deg2rad(FIELD_OF_VIEW)) / MARGIN
        away = seen - middle
        reach = np.maximum(np.abs(away[:, 1]), np.abs(away[:, 0]) / aspect) / slope
        camera.distance = float((reach - away[:, 2]).max())
    camera.lookat = middle @ axes
    depth = 0.5 * float(high[2] - low[2])
    extent = float(model.stat.extent)
    model.vis.map.znear = max(0.02, 0.8 * (camera.distance - depth)) / extent
    model.vis.map.zfar = 2.0 * (camera.distance + depth) / extent
    return camera


def _corners(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Return the corners of the boxes around all geoms, in the world, (n, 3) [m]."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), np.float64).reshape(3, 8).T
    local = model.geom_aabb[:, None, :3] + signs * model.geom_aabb[:, None, 3:]
    turns = data.geom_xmat.reshape(-1, 3, 3)
    world = np.einsum("nij,nkj->nki", turns, local) + data.geom_xpos[:, None]
    return world.reshape(-1, 3)


def _draw(
    model: mujoco.MjModel, data: mujoco.MjData, camera: mujoco.MjvCamera, size: tuple[int, int]
) -> Picture:
    width, height = size
    try:
        window = context_class()(width, height)
        window.make_current()
        target = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    except Exception as problem:  # each of MuJoCo's backends fails in its own way
        raise TrocarError(
            f"no OpenGL to draw with: {problem}"
            " (on Debian and Ubuntu: sudo apt install libegl1 libgl1 libgl1-mesa-dri)"
        ) from problem
    scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 100)
    scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, target)
    options, nothing = mujoco.MjvOption(), mujoco.MjvPerturb()
    options.geomgroup[:] = [0, 1, 1, 0, 0, 0]
    options.sitegroup[:] = 0
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(model, data, options, nothing, camera, everything, scene)
    frame = mujoco.MjrRect(0, 0, width, height)
    mujoco.mjr_render(frame, scene, target)
    image = np.empty((height, width, 3), np.uint8)
    mujoco.mjr_readPixels(image, None, frame, target)
    target.free()
    window.free()
    return image[::-1].copy()


def context_class() -> Any:
    """Return the class of contexts that draw without a display."""
    if sys.platform == "linux" and (os.environ.get("MUJOCO_GL") or "egl") == "egl":
        from mujoco.egl import GLContext  # pyright: ignore[reportMissingTypeStubs] - no types
    else:
        from mujoco.gl_context import GLContext  # pyright: ignore[reportMissingTypeStubs] - the same
    return GLContext


def write_pictures(
    rig: RigDescription,
    folder: Path,
    views: Sequence[View] = tuple(VIEWS),
    size: tuple[int, int] = (1200, 900),
    *,
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write a rig's portraits into a folder, front.png and so on, and return their paths.

    Raises:
        InputError: the folder cannot be written, or has such a file (without `overwrite`)
        TrocarError: there is no OpenGL to draw with, or the disk is full
    """
    paths: dict[View, Path] = {view: folder / f"{view}.png" for view in views}
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputError(f"{folder}: cannot be written: {problem.strerror}") from problem
    for path in paths.values():
        check_file(path, overwrite)
    for view, path in paths.items():
        image = portrait(rig, view=view, size=size)
        with whole_file(path, overwrite) as part:
            Image.fromarray(image).save(part, optimize=True)
    return tuple(paths.values())
