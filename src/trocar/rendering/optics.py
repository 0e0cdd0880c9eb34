"""What stays the same from frame to frame of a camera: its lenses, and a scope's own light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.cameras import Calibration
from trocar.errors import InputError
from trocar.geometry.se3 import inverse
from trocar.rendering.lenses import Pinhole, pinhole, sources, wide_pinhole
from trocar.rendering.lighting import Light, scope_light
from trocar.rendering.sight import Frustum
from trocar.simulation.cameras import CameraRecord

Array = NDArray[np.float64]

#: What is nearer than this to an eye, or farther, is not seen [m]. Source: our own choice: nothing
#: of a scope's own tip, and a whole room.
SCOPE_NEAR, SCOPE_FAR = 0.002, 12.0
VIEW_NEAR, VIEW_FAR = 0.02, 40.0


@dataclass(frozen=True, eq=False)
class Eye:
    """One eye: T_eye_reference (4, 4), its lens without distortion, and what it sees."""

    T_eye_reference: Array
    lens: Pinhole
    frustum: Frustum


@dataclass(frozen=True, eq=False)
class Optics:
    """A camera as it is drawn; the reference frame is the camera's, midway between its eyes.

    Attributes:
        eyes: left first
        size: width and height of each eye's picture, distorted or not [px]
        drawn: width and height of what is drawn of each, larger where it will be distorted [px]
        light: the scope's own; None of a view
        places: where in the drawn pictures, which stand above each other, the light of each pixel
            comes from, (eyes height, width, 2) [px]; None without distortion
        shown: calibration of the pictures
    """

    eyes: tuple[Eye, ...]
    size: tuple[int, int]
    drawn: tuple[int, int]
    light: Light | None
    places: NDArray[np.float32] | None
    shown: Calibration

    @property
    def parallel(self) -> bool:
        """Whether a scope's light and both eyes look the same way, from the same depth."""
        return self.light is not None and all(
            np.abs(eye.T_eye_reference[:3, :3] - np.eye(3)).max() < 1e-9
            and abs(eye.T_eye_reference[2, 3] + self.light.at[2]) < 1e-9
            for eye in self.eyes
        )


def optics(record: CameraRecord, distortion: bool, most: int) -> Optics:
    """Return a camera as it is drawn.

    Args:
        record: the camera
        distortion: whether pictures are distorted as the calibration has it
        most: largest width and height of pictures above each other [px]

    Raises:
        InputError: more pixels than the driver allows
    """
    rig, scope = record.calibration, record.kind == "endoscope"
    width, height = rig.eyes[0].size
    if width > most or height * len(rig.eyes) > most:
        raise InputError(
            f"camera {record.name}: {width}x{height} pixels, eyes above each other, are more than"
            f" this graphics driver draws; allowed: {most} wide, {most // len(rig.eyes)} high"
        )
    near, far = (SCOPE_NEAR, SCOPE_FAR) if scope else (VIEW_NEAR, VIEW_FAR)
    bent = distortion and any(eye.distortion.any() for eye in rig.eyes)
    lenses = [
        wide_pinhole(eye, near, far, most // len(rig.eyes)) if bent else pinhole(eye, near, far)
        for eye in rig.eyes
    ]
    drawn = max(lens.width for lens in lenses), max(lens.height for lens in lenses)
    lenses = [lens.on(*drawn) for lens in lenses]
    mounts = [inverse(mount) for mount in rig.mounts]
    eyes = tuple(Eye(T, lens, lens.frustum(T)) for T, lens in zip(mounts, lenses, strict=True))
    places = None
    if bent:
        found = [sources(eye, lens) for eye, lens in zip(rig.eyes, lenses, strict=True)]
        for row, own in enumerate(found):
            own[..., 1] += row * drawn[1]
        places = np.concatenate(found)
    light = scope_light([eye.frustum for eye in eyes], far) if scope else None
    return Optics(eyes, (width, height), drawn, light, places, rig if bent else rig.undistorted())
