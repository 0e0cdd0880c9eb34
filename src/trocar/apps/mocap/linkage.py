"""Which links of an arm carry markers, and which joints sweep its loops."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError
from trocar.kinematics.mechanism import Closure, Mechanism

Array = NDArray[np.float64]


def marked_frames(arm: ArmDescription) -> dict[str, str]:
    """Return {body: frame} of the links of an arm's loops: the root, and what moves on them."""
    mechanism = arm.mechanism
    on_loops = {i for c in mechanism.closures for i in _sides(mechanism, c)[2]}
    frames = [mechanism.frames[i] for i in sorted(on_loops)]
    found = [arm.root, *(frame.name for frame in frames if frame.motion != "fixed")]
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


#: The paper's numbers of the axes, and the pairs of its Table 6. An axis is named by the frame that
#: moves about it or by the closure. Source: closed-loop paper, Figures 3 and 4, Table 6.
LABELS: Mapping[str, Mapping[str, str]] = {
    "PSM": {"3": "pitch_back", "4": "pitch_front"},
    "ECM": {"3": "pitch_front", "4": "pitch_back"},
}
COMMON_LABELS = {"6": "pitch_bottom", "7": "pitch_top", "8": "pitch_end", "c1": "c1", "c2": "c2"}
DISTANCES = (
    ("3", "4"), ("3", "6"), ("4", "c1"), ("6", "c1"),
    ("3", "7"), ("6", "8"), ("7", "c2"), ("6", "7"),
)  # fmt: skip


def labelled_axes(arm: ArmDescription) -> dict[str, str]:
    """Return {label: axis} of the hinges of an arm's loops."""
    if arm.type in LABELS:
        return {**LABELS[arm.type], **COMMON_LABELS}
    mechanism = arm.mechanism
    hinges = sorted({i for c in mechanism.closures for i in _sides(mechanism, c)[0]})
    names = [mechanism.frames[i].name for i in hinges if mechanism.frames[i].motion != "fixed"]
    return {name: name for name in (*names, *(c.name for c in mechanism.closures))}


def shared_pairs(arm: ArmDescription) -> tuple[tuple[str, str], ...]:
    """Return the pairs of labelled axes that one body carries, whose distance stays the same."""
    carriers = {label: _carriers(arm.mechanism, name) for label, name in labelled_axes(arm).items()}
    return tuple((a, b) for a, b in combinations(carriers, 2) if carriers[a] & carriers[b])


def _carriers(mechanism: Mechanism, axis: str) -> set[str]:
    """Return the two bodies that a hinge joins, each named by its first frame."""
    closure = next((c for c in mechanism.closures if c.name == axis), None)
    if closure is not None:
        return {_body(mechanism, closure.frame_a), _body(mechanism, closure.frame_b)}
    return {_body(mechanism, axis), _body(mechanism, mechanism.frame(axis).parent or axis)}


def _body(mechanism: Mechanism, name: str) -> str:
    """Return the first frame of the body that a frame is fixed to."""
    frame = mechanism.frame(name)
    while frame.motion == "fixed" and frame.parent is not None:
        frame = mechanism.frame(frame.parent)
    return frame.name
