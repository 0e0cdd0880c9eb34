"""Bodies for arms whose masses and shapes nobody has published.

They let the arm be simulated and seen; they touch nothing. Source: our own choice, and every body
says so.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.se3 import inverse, transform_points
from trocar.kinematics.forward import poses
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]
Point = tuple[float, float, float]

SOURCE = "a stand-in: masses and shapes of this arm are not published, so these are our own choice"
#: Of a PSM or ECM at q = 0, in its remote centre's frame (z up, the base towards -y): body's frame,
#: ends and radius of each capsule, mass [m, kg].
ARM: tuple[tuple[str, tuple[tuple[Point, Point, float], ...], float], ...] = (
    ("yaw", (((0.0, -0.60, 0.0), (0.0, -0.46, 0.0), 0.055),), 2.0),
    (
        "pitch",
        (
            ((0.0, -0.46, 0.02), (0.0, -0.43, 0.26), 0.035),
            ((0.0, -0.43, 0.26), (0.0, -0.08, 0.31), 0.028),
            ((0.0, -0.43, 0.18), (0.0, -0.08, 0.23), 0.018),
            ((0.0, -0.08, 0.16), (0.0, -0.08, 0.58), 0.024),
        ),
        2.0,
    ),
    ("insertion", (((0.0, -0.055, 0.36), (0.0, -0.02, 0.40), 0.028),), 0.3),
)
#: What an endoscope adds: its shaft, from its end outward.
SCOPE = ("roll", (((0.0, 0.0, 0.005), (0.0, 0.0, 0.40), 0.006),), 1.0)
#: Links of setup joints: mass, and radius of links and of the hubs about their axes [kg, m].
LINK_MASS, LINK_RADIUS, HUB_RADIUS = 4.0, 0.038, 0.055
#: How far ahead of the remote centre the last link ends: where the arm's base is [m].
BASE_AHEAD = 0.58


def arm_bodies(mechanism: Mechanism, scope: bool) -> list[dict[str, Any]]:
    """Return bodies of a PSM or ECM whose chain begins at its remote centre.

    Args:
        mechanism: frames rcm, yaw, pitch, insertion, and roll of an endoscope
        scope: whether it is an ECM
    """
    at = poses(mechanism, np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, None), "rcm")
    found: list[dict[str, Any]] = []
    for frame, capsules, mass in (*ARM, *([SCOPE] if scope else [])):
        ends = inverse(at[frame])
        shapes = [_capsule(ends, start, stop, radius) for start, stop, radius in capsules]
        found.append({"frame": frame, "mass_kg": mass, "source": SOURCE, "shape": shapes})
    return found


def link_bodies(mechanism: Mechanism, frames: list[str]) -> list[dict[str, Any]]:
    """Return bodies along a chain: a capsule from each frame to the next.

    Args:
        mechanism: the chain
        frames: those that move, from the base outward, and what the last one carries
    """
    at = poses(mechanism, np.zeros(len(mechanism.joints)), mechanism.reference)
    found: list[dict[str, Any]] = []
    for frame, following in pairwise(frames):
        own = inverse(at[frame])
        last = following == frames[-1]
        end = at[following] @ np.array([0.0, -BASE_AHEAD * last, 0.0, 1.0])
        tip = transform_points(own, end[:3])
        bend = np.array([0.0, 0.0, tip[2]])  # up the own axis, then along the link
        ends = [np.zeros(3), bend, tip]
        pieces = [(a, b) for a, b in pairwise(ends) if np.linalg.norm(b - a) > 0.02] or [
            (np.array([0.0, 0.0, -0.03]), np.array([0.0, 0.0, 0.03]))
        ]
        still, hub = np.eye(4), np.array([0.0, 0.0, 0.05])
        shapes = [_capsule(still, tuple(a), tuple(b), LINK_RADIUS) for a, b in pieces]
        for middle in {tuple(ends[0]), tuple(bend)} if frame != frames[0] else set[Point]():
            shapes.append(_hub(np.array(middle) - hub, np.array(middle) + hub))
        found.append({"frame": frame, "mass_kg": LINK_MASS, "source": SOURCE, "shape": shapes})
    return found


def _hub(start: Array, stop: Array) -> dict[str, Any]:
    shape = _capsule(np.eye(4), start, stop, HUB_RADIUS)
    return {**shape, "kind": "cylinder", "material": "joint"}


def _capsule(T: Array, start: Any, stop: Any, radius: float) -> dict[str, Any]:
    ends = np.round(transform_points(T, np.array([start, stop], dtype=np.float64)), 6) + 0.0
    return {
        "kind": "capsule",
        "from_m": ends[0].tolist(),
        "to_m": ends[1].tolist(),
        "radius_m": radius,
        "material": "cover",
        "collide": False,
    }
