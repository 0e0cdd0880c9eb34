"""Closing hinges whose pin may shift along its own axis, so that loops with skew axes close.

Four hinges whose axes are not parallel cannot turn unless something gives. In a real linkage it
is the play along the pins; here it is a passive frame, the pin, that slides from point_b
along the axis that frame_a turns about, and carries the point that both sides share.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import Body
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.mechanism import Closure, Frame

Array = NDArray[np.float64]

#: A pin's own mass, and what resists its slide besides, as a rotor does [kg]. Source: measured on a
#: PSM and an ECM with skew axes under 10 N: with 0.2 kg loop errors are half as large again, with
#: 5 kg as small; a pin slides by parts of a millimetre, so neither matters.
PIN_MASS_KG = 0.001
PIN_ROTOR_KG = 1.0
#: Inertia of a ball of 1 g and 10 mm. [kg m^2]
PIN_INERTIA = 4e-8


def pin_name(closure: str) -> str:
    """Return the name of a closure's pin."""
    return f"{closure}_pin"


def pinned(closure: Closure) -> Closure:
    """Return a closure whose side b is its pin."""
    pin = pin_name(closure.name)
    passive = (*closure.passive[:2], pin)
    return replace(closure, frame_b=pin, point_b=np.zeros(3), passive=passive)


def pin_frame(closure: Closure, frames: Mapping[str, Frame]) -> Frame:
    """Return the frame of a closure's pin: slides from point_b on frame_b along frame_a's axis.

    Args:
        closure: not pinned, on frames that `rest_poses` has
        frames: of the mechanism by name; they stand as at coordinate 0 of each
    """
    at, frame_a = rest_poses(frames), frames[closure.frame_a]
    axis = at[frame_a.name] @ inverse(frame_a.after)
    turned = at[closure.frame_b][:3, :3].T @ axis[:3, 2]
    before = transform(_rotation_to(turned), closure.point_b)
    return Frame(pin_name(closure.name), closure.frame_b, "prismatic", before, np.eye(4))


def rest_poses(frames: Mapping[str, Frame]) -> dict[str, Array]:
    """Return the pose in the root of each frame that has one, at coordinate 0 of each, (4, 4)."""
    at: dict[str, Array] = {}
    for frame in frames.values():
        if frame.parent is None or frame.parent in at:
            parent = np.eye(4) if frame.parent is None else at[frame.parent]
            at[frame.name] = parent @ frame.before @ frame.after
    return at


def _rotation_to(axis: Array) -> Array:
    """Return the smallest rotation that takes the z axis to this one, or to its opposite."""
    z = axis if axis[2] >= 0.0 else -axis
    across = np.array([-z[1], z[0], 0.0])  # z axis x axis
    sine = float(np.linalg.norm(across))
    if sine == 0.0:
        return np.eye(3)
    return matrix_from_rotation_vector(across * (np.arctan2(sine, z[2]) / sine))


def pin_body(closure: str, part: str) -> Body:
    """Return what a pin weighs."""
    return Body(
        frame=pin_name(closure),
        mass=PIN_MASS_KG,
        com=np.zeros(3),
        inertia=PIN_INERTIA * np.eye(3),
        shapes=(),
        inertia_from="shape",
        source="our own choice: a pin too light to be felt",
        part=part,
    )
