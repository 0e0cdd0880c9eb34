"""MuJoCo's own renderer is the judge: the same silhouettes, the same ids, the same depth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.mujoco_renderer import Reference
from trocar.descriptions.cameras import load_camera
from trocar.rendering import Channels, Renderer, StereoFrame
from trocar.simulation import World

pytestmark = pytest.mark.usefixtures("opengl")

Mask = NDArray[np.bool_]


def compared(
    rig: str, pose: str, camera: str
) -> tuple[StereoFrame, list[np.ndarray], list[np.ndarray]]:
    """Return our frame, and MuJoCo's depth and ids of each eye."""
    world = World(rig)
    world.reset(pose=pose)
    snapshot, cameras = world.snapshot(), world.cameras()
    if camera == "endoscope":
        cameras = {camera: cameras[camera].seeing(load_camera("dvrk_sd_640x480"))}
    renderer = Renderer(lambda: (snapshot.build, world.shapes()), Channels(depth=True, ids=True))
    frame = renderer.render(snapshot, cameras, camera)
    renderer.close()
    judge = Reference(world.rig, frame.calibration.eyes[0].size)
    judge.place(snapshot)
    number = {name: k for k, name in frame.names.items()}
    ids_of = np.array([*(number.get(name, 0) for name in judge.bodies), 0])
    depths, ids = [], []
    for T, eye in zip(frame.T_world_camera, frame.calibration.eyes, strict=True):
        depth, bodies = judge.depth_and_bodies(T, eye)
        depths.append(depth)
        ids.append(ids_of[bodies])
    judge.close()
    return frame, depths, ids


def edges(ids: np.ndarray) -> Mask:
    """Return the pixels that stand beside one of another id."""
    found = np.zeros(ids.shape, dtype=bool)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1), (0, -1), (-1, 0), (-1, -1), (-1, 1)):
        found |= np.roll(ids, (down, right), axis=(0, 1)) != ids
    return found


@pytest.mark.parametrize(
    ("rig", "pose", "camera", "other"),
    [
        ("full_cart", "work", "endoscope", 2e-4),
        ("full_cart", "start", "endoscope", 2e-4),
        # MuJoCo's capsules have 28 sides, and its boxes sharp edges
        ("pegs", "work", "endoscope", 5e-3),
        # of what is far away we draw simpler surfaces
        ("full_cart", "start", "room", 1e-3),
    ],
)
def test_silhouettes_ids_and_depth_are_mujocos(
    rig: str, pose: str, camera: str, other: float
) -> None:
    frame, depths, ids = compared(rig, pose, camera)
    assert frame.ids is not None and frame.depth is not None
    pixel = 1.0 / frame.K[0, 0, 0]
    for own_ids, own_depth, their_depth, their_ids in zip(
        frame.ids, frame.depth, depths, ids, strict=True
    ):
        edge = edges(own_ids) | edges(their_ids)
        differ = own_ids != their_ids
        assert (differ & ~edge).mean() < 1e-5  # the board's corners are round, MuJoCo's are not
        assert differ.mean() < 0.01
        near = np.where(np.isfinite(their_depth), their_depth, 100.0)
        inner = ~edge & (own_ids > 0) & (near < (1.0 if camera == "endoscope" else 8.0))
        steep = np.maximum(*(np.abs(np.gradient(near, axis=axis)) for axis in (0, 1)))
        off = np.abs(np.where(own_ids > 0, own_depth, 100.0) - near)
        allowed = 1e-4 + (steep + near * pixel if camera == "room" else 0.0)
        assert (off > allowed)[inner].mean() < other
