"""Whether every format that the arm is written in has the frames where the kinematics has them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.trials import compiled_poses
from trocar.apps.verification.figure import Figure, Part
from trocar.apps.verification.subject import Subject
from trocar.descriptions.records import ArmDescription
from trocar.geometry.se3 import pose_difference
from trocar.kinematics import forward

Array = NDArray[np.float64]

POSES = 100
SEED = 6


@dataclass(frozen=True)
class Format:
    """A format that descriptions are turned into.

    Attributes:
        name: what it is called
        poses: (arm, joint positions (k, n)) -> {frame: poses in the arm's root, (k, 4, 4)}, as
            another program reads them out of that format
        position, rotation: how far a frame may be off [m, rad]
        source: of these limits
    """

    name: str
    poses: Callable[[ArmDescription, Array], dict[str, Array]]
    position: float
    rotation: float
    source: str


FORMATS = (
    Format(
        "MJCF",
        compiled_poses,
        1e-9,
        1e-9,
        "both sides compute in float64 over some twenty products; MuJoCo places the bodies",
    ),
)


def formats(subject: Subject) -> Part:
    """Compare every frame of every format with the kinematics, at random joint positions."""
    arm = subject.arm
    q = _random_positions(arm)
    analytic = forward.poses(arm.mechanism, q, relative_to=arm.root)
    figures: list[Figure] = []
    for each in FORMATS if subject.simulated else ():
        found = each.poses(arm, q)
        off = [pose_difference(poses, analytic[frame]) for frame, poses in found.items()]
        label = f"{each.name}, {len(found)} frames at {POSES} poses"
        why = f"limit: {each.source}"
        metres = max(float(m.max()) for m, _ in off)
        radians = max(float(r.max()) for _, r in off)
        figures += [
            Figure(f"{label}: position", metres, "m", "nm", upper=each.position, source=why),
            Figure(
                f"{label}: rotation",
                radians,
                "rad",
                "urad",
                upper=each.rotation,
                source=why,
            ),
        ]
    notes = () if figures else (f"{arm.name}: no masses or gains are known, so it has no model",)
    title = "Formats: one description, the same frames"
    return Part("formats", subject.name, title, tuple(figures), subject.command("formats"), notes)


def _random_positions(arm: ArmDescription) -> Array:
    """Return joint positions all over the range, the jaw open or shut, (POSES, n)."""
    lower, upper = arm.mechanism.lower, arm.mechanism.upper
    q = np.random.default_rng(SEED).uniform(lower, upper, (POSES, len(lower)))
    if arm.has_jaw:
        q[:, -1] = np.abs(q[:, -1])
    return q
