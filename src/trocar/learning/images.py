"""Small images of the endoscope as observations, and pictures of an episode for people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar.cameras import Calibration, Intrinsics, MonoCalibration
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.se3 import transform
from trocar.inputs import check_whole, shown
from trocar.learning.observations import scene_centre
from trocar.rendering import Channels, Endoscope, Look, Renderer, StereoFrame
from trocar.simulation import World
from trocar.tasks import Task

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

#: Channels of an image and their numbers. "depth" is along the optical axis in mm, 255 from there
#: on and where nothing is. "ids" is 0 but for objects and arms, see `SceneCamera.ids`.
CHANNELS = {"rgb": 3, "depth": 1, "ids": 1}
COLOURS = ("red", "green", "blue")
#: Counts of depth. Source: our own choice; the scenes lie 60 to 200 mm ahead. [1/m]
DEPTH_PER_M = 1000.0
#: Edge of an image, and its range. Source: 84 is usual since Mnih et al., Nature 2015. [px]
EDGE, LEAST, MOST = 84, 16, 512
#: Views for people, and their width: what the left eye sees, and the scene from beside. [px]
VIEWS, VIEW_WIDTH = ("endoscope", "room"), 640
#: Direction of "room" into the picture, its distance, and its focal length over the picture's
#: height. Source: by eye. [deg, m]
AZIMUTH, ELEVATION, DISTANCE_M, FOCAL = 130.0, -25.0, 0.35, 1.2


class SceneCamera:
    """The endoscope of a scene as a policy sees it: small, without shadows, exposed once for all.

    The whole picture is there, narrower where the image is square. The exposure is that of the
    scene's start pose, so that it follows from the scene alone.

    Args:
        task: of the scene
        size: edge, or width and height [px]
        channels: some of `CHANNELS`
        eyes: 1 for the left one, 2 for both

    Attributes:
        shape: of an image, (height, width, channels of all eyes)
        names: of the channels: "left.red", ..., "left.depth", "left.ids", then those of the right
        ids: {object or arm: its number in "ids"}

    Raises:
        InputError: the scene has no endoscope, or another size, channel or number of eyes
        UnknownNameError: no such channel
        TrocarError, MissingExtraError: see `Endoscope`
    """

    def __init__(
        self,
        task: Task,
        size: int | Sequence[int] = EDGE,
        channels: Sequence[str] = ("rgb",),
        eyes: int = 1,
    ) -> None:
        label = task.scene.name
        width, height = check_size(size, label)
        channels = (channels,) if isinstance(channels, str) else tuple(channels)
        for one in channels:
            if one not in CHANNELS:
                raise UnknownNameError("channel", one, CHANNELS, label)
        if not channels or len(set(channels)) < len(channels):
            raise InputError(
                f"{label}: channels: got {shown(channels)}; allowed: each of {', '.join(CHANNELS)}"
                " at most once"
            )
        name, calibration = _endoscope(task)
        if eyes not in range(1, len(calibration.eyes) + 1):
            allowed = " or ".join(str(k + 1) for k in range(len(calibration.eyes)))
            raise InputError(f"{label}: eyes: got {shown(eyes)}; allowed: {allowed}")
        self._world, self._camera, self._channels = task.world, name, channels
        self._calibration = calibration.resized(width, height)
        stops = _exposure(task, name, self._calibration)
        self._eyes = eyes
        look = Look(shadows=False, exposure=stops)
        layers = Channels(depth="depth" in channels, ids="ids" in channels)
        self._renderer = _renderer(task.world, look, layers)
        of_eye = [n for one in channels for n in (COLOURS if one == "rgb" else (one,))]
        self.names = tuple(f"{eye}.{n}" for eye in ("left", "right")[:eyes] for n in of_eye)
        self.shape = height, width, len(self.names)
        named = (*task.world.objects, *(arm.name for arm in task.world.rig.arms))
        self.ids = {one: k + 1 for k, one in enumerate(named)}

    def capture(self) -> Picture:
        """Return the image of the world as it is now, (height, width, channels)."""
        snapshot = self._world.snapshot(arms=False)
        record = self._world.cameras()[self._camera].seeing(self._calibration)
        frame = self._renderer.render(snapshot, {record.name: record}, record.name)
        parts: list[Picture] = []
        for eye, picture in enumerate(frame.eyes[: self._eyes]):
            for one in self._channels:
                if one == "depth" and frame.depth is not None:
                    depth = np.minimum(DEPTH_PER_M * frame.depth[eye], 255.0)
                    parts.append(depth.astype(np.uint8)[..., None])
                elif one == "ids" and frame.ids is not None:
                    parts.append(self._numbers(frame)[frame.ids[eye]][..., None])
                else:
                    parts.append(picture)
        return np.concatenate(parts, axis=2)

    def close(self) -> None:
        """Release the graphics library."""
        self._renderer.close()

    def _numbers(self, frame: StereoFrame) -> Picture:
        """Return the number in "ids" of each of a frame's ids, (n,)."""
        table = np.zeros(max(frame.names, default=0) + 1, np.uint8)
        for number, name in frame.names.items():
            table[number] = self.ids.get(name.partition("/")[0], 0)
        return table


class SceneView:
    """A view of a scene for people: the endoscope's, or one of the scene from outside.

    Args:
        task: of the scene
        kind: one of `VIEWS`

    Raises:
        UnknownNameError: no such view
        InputError: the scene has no endoscope
        TrocarError, MissingExtraError: see `Endoscope`
    """

    def __init__(self, task: Task, kind: str) -> None:
        if kind not in VIEWS:
            raise UnknownNameError("render_mode", kind, VIEWS, task.scene.name)
        self._world = task.world
        self._camera, calibration = _endoscope(task)
        eye, width = calibration.eyes[0], VIEW_WIDTH
        height = round(width * eye.height / eye.width)
        self._pose: Array | None = None
        if kind == "room":
            focal = FOCAL * height
            K = np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])
            self._calibration: Calibration = MonoCalibration(Intrinsics(width, height, K))
            self._pose = _beside(scene_centre(task))
        else:
            self._calibration = calibration.resized(width, height)
        stops = 0.0 if kind == "room" else _exposure(task, self._camera, self._calibration)
        self._renderer = _renderer(self._world, Look(samples=4, exposure=stops), Channels())

    def capture(self) -> Picture:
        """Return the picture of the world as it is now, (height, 640, 3)."""
        record = self._world.cameras()[self._camera]
        if self._pose is None:
            record = record.seeing(self._calibration)
        else:
            free = {"body": 0, "T_body_mount": self._pose, "T_world_body": np.eye(4), "angle": 0.0}
            record = replace(record, kind="view", calibration=self._calibration, **free)
        snapshot = self._world.snapshot(arms=False)
        return self._renderer.render(snapshot, {record.name: record}, record.name).left

    def close(self) -> None:
        """Release the graphics library."""
        self._renderer.close()


def check_size(size: int | Sequence[int], where: str) -> tuple[int, int]:
    """Return width and height of an image.

    Raises:
        InputError: other than one or two whole numbers in the range
    """
    each = (size, size) if isinstance(size, int) else tuple(size)
    if len(each) != 2:
        raise InputError(
            f"{where}: image_size: got {shown(size)}; allowed: an edge, or width and height"
        )
    width, height = (check_whole(one, f"{where}: image_size", LEAST, MOST) for one in each)
    return width, height


def _endoscope(task: Task) -> tuple[str, Calibration]:
    """Return name and calibration of the scene's endoscope."""
    for camera in task.scene.rig.cameras:
        if camera.kind == "endoscope":
            return camera.name, camera.calibration
    raise InputError(
        f"{task.scene.name}: images: the rig {task.scene.rig.name} has no endoscope; allowed: a"
        " scene whose rig has one, or the observations 'state' and 'goal'"
    )


def _renderer(world: World, look: Look, channels: Channels) -> Renderer:
    return Renderer(lambda: (world.snapshot(arms=False).build, world.shapes()), channels, look)


def _exposure(task: Task, camera: str, calibration: Calibration) -> float:
    """Return the automatic exposure of the scene where it starts, without shadows [stops]."""
    world = World(task.scene.rig, welded=task.scene.welded)
    scope = Endoscope(world, camera, calibration=calibration, look=Look(shadows=False))
    stops = scope.capture().exposure
    scope.close()
    return stops


def _beside(centre: Array) -> Array:
    """Return the pose of the view from outside, (4, 4)."""
    turn, tilt = np.radians(AZIMUTH), np.radians(ELEVATION)
    ahead = np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)])
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    R = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    return transform(R, centre - DISTANCE_M * ahead)
