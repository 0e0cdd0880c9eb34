"""Errors in a file's conventions that make two bodies on a hinge seem not to turn about an axis."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.fitting.robust import near, shared_direction, shared_point
from trocar.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix
from trocar.geometry.se3 import inverse

Array = NDArray[np.float64]

# Source: our choice; a hinge that is this much better under another reading was misread.
_BETTER = 0.2
# Source: our choice; enough to tell centimetres from noise.
_SAMPLES = 400


def likely_cause(T_ca: ArrayLike, T_cb: ArrayLike) -> str | None:
    """Name the slip of convention that explains why two bodies do not turn about one axis.

    Each likely one is undone in turn; the one that makes the hinge at least five times better is
    named.

    Args:
        T_ca, T_cb: poses of two bodies of one hinge in the camera's frame, (n, 4, 4), NaN where
            not tracked

    Returns:
        the cause in words, or None when no slip explains the residual
    """
    a, b = np.asarray(T_ca, dtype=np.float64), np.asarray(T_cb, dtype=np.float64)
    both = np.flatnonzero(np.isfinite(a).all(axis=(1, 2)) & np.isfinite(b).all(axis=(1, 2)))
    chosen = both[:: max(1, len(both) // _SAMPLES)]
    a, b = a[chosen], b[chosen]
    found = {cause: hinge_miss(undo(a), undo(b)) for cause, undo in _slips()}
    best = min(found, key=found.__getitem__)
    return best if found[best] < _BETTER * hinge_miss(a, b) else None


def hinge_miss(T_ca: Array, T_cb: Array) -> float:
    """Return by how much two bodies miss a common hinge, median [m].

    Args:
        T_ca, T_cb: poses in the camera's frame, (n, 4, 4), all finite
    """
    T = inverse(T_ca) @ T_cb
    R, p = T[:, :3, :3], T[:, :3, 3]
    h_a, h_b, missed = shared_direction(R)
    weights = near(missed).astype(np.float64)
    g_a, g_b, missed = shared_point(R, p, weights)
    # A slip may spare the point and spoil what lies along the axis.
    size = float(np.median(np.linalg.norm(p, axis=1)))
    tilt = np.linalg.norm(R @ h_b - h_a, axis=1) * size
    shift = (R @ g_b + p - g_a) @ h_a
    return float(np.median(missed) + np.median(tilt) + np.ptp(np.percentile(shift, [25, 75])))


def _slips() -> Iterator[tuple[str, Callable[[Array], Array]]]:
    """Give each likely slip and what undoes it, for poses (n, 4, 4)."""
    yield (
        "the quaternions are x, y, z, w where w, x, y, z was announced",
        lambda T: _requaternioned(T, 1),
    )
    yield (
        "the quaternions are w, x, y, z where x, y, z, w was announced",
        lambda T: _requaternioned(T, -1),
    )
    for axis, name in enumerate("xyz"):
        yield (
            f"the {name} axis of the positions is mirrored, but not that of the rotations "
            "(mixed handedness)",
            lambda T, axis=axis: _mirrored(T, axis),
        )
    yield "the rotations are those of the camera in the bodies (inverted)", _inverted


def _requaternioned(T: Array, shift: int) -> Array:
    """Read the four numbers of each quaternion in another order."""
    q = quaternion_from_matrix(T[:, :3, :3])
    out = T.copy()
    out[:, :3, :3] = matrix_from_quaternion(np.roll(q, shift, axis=1))
    return out


def _mirrored(T: Array, axis: int) -> Array:
    out = T.copy()
    out[:, axis, 3] *= -1.0
    return out


def _inverted(T: Array) -> Array:
    out = T.copy()
    out[:, :3, :3] = np.swapaxes(T[:, :3, :3], 1, 2)
    return out
