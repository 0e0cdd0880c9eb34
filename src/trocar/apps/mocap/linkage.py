"""Which links of an arm carry markers, and which joints sweep its loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.calibration_plan import hinge_side
from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError
from trocar.kinematics.mechanism import Closure, Mechanism

Array = NDArray[np.float64]


def marked_frames(arm: ArmDescription) -> dict[str, str]:
    """Return {body: frame} of the links of an arm's loops: the root, and what moves on them."""
    mechanism = arm.mechanism
    on_loops = {i for c in mechanism.closures for i in _sides(mechanism, c)[2]}
    pins = {hinge_side(mechanism, c)[1] for c in mechanism.closures}
    frames = [mechanism.frames[i] for i in sorted(on_loops)]
    links = [f.name for f in frames if f.motion != "fixed" and f.name not in pins]
    found = [arm.root, *links]
    return {f"{arm.name}_{name}": name for name in found}


def folding_joints(arm: ArmDescription) -> list[int]:
    """Return the indices of the joints that fold an arm's loops, in their order.

    Raises:
        InputError: the arm has no loop
    """
    mechanism = arm.mechanism
    if not mechanism.closures:
        raise InputError(f"{arm.name}: has no closed loop; nothing of it is measured by its axes")
    hinges = sorted({i for c in mechanism.closures for i in _sides(mechanism, c)[0]})
    return [int(i) for i in np.flatnonzero(np.any(mechanism.ratios[hinges] != 0.0, axis=0))]


def _sides(mechanism: Mechanism, closure: Closure) -> tuple[set[int], set[int], set[int]]:
    """Return the frames of one loop, those below it, and both together."""
    a, b = set(mechanism.chain(closure.frame_a)), set(mechanism.chain(closure.frame_b))
    return a ^ b, a & b, a | b


def home(arm: ArmDescription, folding: list[int]) -> Array:
    """Return where the arm stands still: swept joints at 0, the others at the pose "home", (n,)."""
    mechanism = arm.mechanism
    rest = np.zeros(len(mechanism.joints))
    q = np.array(arm.poses.get("home", rest), dtype=np.float64)
    q[: max(folding, default=-1) + 1] = 0.0
    return np.clip(q, mechanism.lower, mechanism.upper)
