"""The pose of one frame, many times over: what does not change is prepared once."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import pose
from trocar.kinematics.loops import closed_coordinates, loops_are_parallelograms
from trocar.kinematics.mechanism import Frame, Mechanism

Array = NDArray[np.float64]


class ChainPose:
    """Compute what `pose` computes, in a tenth of the time.

    Each hinge's matrix is a sum of four constant ones, times 1, cos c, sin c and the slide d, with
    what is fixed between hinges multiplied in.

    Args:
        mechanism: the tree with its loops
        frame: whose pose, the tip's when omitted
        relative_to: frame to express it in; the mechanism's reference when omitted

    Attributes:
        ratios: of its hinges to joints, (k, n_joints)
        slides: which hinges slide, (k,)
        parts: matrices of hinges and of what follows the last, then identities, (2^m, 4, 16)
    """

    def __init__(
        self, mechanism: Mechanism, frame: str | None = None, relative_to: str | None = None
    ) -> None:
        self._mechanism = mechanism
        self._frame, self._base = frame or mechanism.tip, relative_to or mechanism.reference
        self._closed = loops_are_parallelograms(mechanism)
        up, down = self._ways()
        #: A reference frame that moves with the joints is rare, and not prepared for.
        self._general = any(mechanism.frames[k].motion != "fixed" for k in up)
        moving = [k for k in down if mechanism.frames[k].motion != "fixed"]
        self._rows = np.array(moving, dtype=np.intp)
        self.ratios = mechanism.ratios[moving]
        self.slides = np.array([mechanism.frames[k].motion == "prismatic" for k in moving], bool)
        self.parts = self._prepared(up, down)

    def __call__(self, q: Array) -> Array:
        """Return the frame's pose, (..., 4, 4).

        Args:
            q: joint positions, (..., n_joints) [rad or m]

        Raises:
            LoopError: the loops cannot be closed at these joint positions
        """
        if self._general:
            return pose(self._mechanism, q, self._frame, self._base)
        if self._closed:
            where = q @ self.ratios.T
        else:
            where = closed_coordinates(self._mechanism, q)[..., self._rows]
        return _product(where, self.slides, self.parts)

    def _ways(self) -> tuple[list[int], list[int]]:
        """Return the frames from the common ancestor to the base, and from there to the frame."""
        base, end = (
            list(self._mechanism.chain(self._base)),
            list(self._mechanism.chain(self._frame)),
        )
        while base and end and base[0] == end[0]:
            del base[0], end[0]
        return base, end

    def _prepared(self, up: list[int], down: list[int]) -> Array:
        """Return the constant matrices of each hinge, (2^m, 4, 16); unused ones are identity."""
        frames = self._mechanism.frames
        at = np.eye(4)
        if not self._general:
            for index in up:
                at = at @ frames[index].before @ frames[index].after
        at, parts = inverse(at), list[Array]()
        for index in down:
            frame = frames[index]
            if frame.motion != "fixed":
                parts.append(_hinge(at, frame))
                at = frame.after
            else:
                at = at @ frame.before @ frame.after
        parts.append(np.stack([at.ravel(), *np.zeros((3, 16))]))
        return _padded(np.stack(parts), 1 << (len(parts) - 1).bit_length())


def _product(where: Array, slides: NDArray[np.bool_], parts: Array) -> Array:
    """Multiply the links of chains, (..., 4, 4), for coordinates of their hinges, (..., k)."""
    turn = np.where(slides, 0.0, where)
    hinges = where.shape[-1]
    factors = np.empty((*where.shape[:-1], parts.shape[-3], 1, 4))
    factors[..., 0] = 1.0
    moving = factors[..., :hinges, 0, :]
    np.cos(turn, moving[..., 1])
    np.sin(turn, moving[..., 2])
    np.subtract(where, turn, moving[..., 3])
    factors[..., hinges:, 0, 1:] = 0.0
    links = (factors @ parts).reshape(*where.shape[:-1], -1, 4, 4)
    while links.shape[-3] > 1:
        links = links[..., ::2, :, :] @ links[..., 1::2, :, :]
    return links[..., 0, :, :]


def _padded(parts: Array, length: int) -> Array:
    """Add identities to a chain until it is so long, (length, 4, 16)."""
    padded = np.zeros((length, 4, 16))
    padded[:, 0] = np.eye(4).ravel()
    padded[: len(parts)] = parts
    return padded


def _hinge(before: Array, frame: Frame) -> Array:
    """Return the matrices for 1, cos c, sin c and d of what leads to a hinge and it, (4, 16)."""
    A = before @ frame.before
    slide = frame.motion == "prismatic"
    still, cosine, sine, along = np.zeros((4, 4, 4))
    still[:, 2:] = A[:, 2:]
    cosine[:, :2] = A[:, :2]
    sine[:, 0], sine[:, 1] = A[:, 1], -A[:, 0]
    along[:, 3] = A[:, 2] * slide
    return np.stack([part.ravel() for part in (still, cosine, sine, along)])


@lru_cache(maxsize=256)
def chain_pose(
    mechanism: Mechanism, frame: str | None = None, relative_to: str | None = None
) -> ChainPose:
    """Return the function that computes the pose of a frame, prepared once."""
    return ChainPose(mechanism, frame, relative_to)


@lru_cache(maxsize=256)
def standing_pose(mechanism: Mechanism, frame: str, relative_to: str) -> Array:
    """Return the pose of a frame in another that no joint moves against it, (4, 4), read-only."""
    found = pose(mechanism, np.zeros(len(mechanism.joints)), frame, relative_to)
    found.setflags(write=False)
    return found
