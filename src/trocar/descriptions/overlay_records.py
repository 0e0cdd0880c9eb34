"""What a calibration found of one robot: values that replace those of its description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ClosureKind = Literal["parallelogram", "general"]


@dataclass(frozen=True, eq=False)
class FramePatch:
    """Where a frame stands in its parent, at coordinate 0: for a hinge, where its axis does.

    T_parent_frame = transform(matrix_from_rpy(*rpy), xyz) @ motion_z(coordinate) @ after, with
    what comes after the motion (of standard DH rows) as the description has it.

    Attributes:
        xyz: position in the parent, (3,) [m]
        rpy: angles about the parent's fixed axes x, y, z, (3,) [rad]
        xyz_sigma: one standard deviation of xyz, (3,) [m]; None: not known
        rpy_sigma: of small turns about the frame's own axes x, y, z, (3,) [rad]; None: not known.
            Not of the three angles: these have no meaning each where the frame is pitched by 90 deg
    """

    xyz: Array
    rpy: Array
    xyz_sigma: Array | None = None
    rpy_sigma: Array | None = None


@dataclass(frozen=True, eq=False)
class ClosurePatch:
    """Where a closing hinge sits on its two frames.

    Attributes:
        point_a, point_b: the hinge on frame_a and on frame_b, (3,) [m]
        point_a_sigma, point_b_sigma: one standard deviation, (3,) [m]; None: not known
        slides: whether the pin may shift along frame_a's axis, as loops whose axes are not
            parallel need
    """

    point_a: Array
    point_b: Array
    point_a_sigma: Array | None = None
    point_b_sigma: Array | None = None
    slides: bool = False


@dataclass(frozen=True, eq=False)
class Overlay:
    """One robot's own geometry, to be laid over the description of its kind.

    Attributes:
        arm: name of the description that it belongs to ("psm")
        closure: "parallelogram": the loops close by the couplings alone; "general": four-bars with
            any sides, closed numerically
        frames: {frame: where it stands}
        closures: {closure: where its hinge sits}
        measured: what was measured besides, for reports: tables of numbers, texts and lists
        source: {"file", "sha256", "version"}: the tracks and the software that it comes from
        warnings: what the calibration had to say
        file: where the overlay was read from, "" for one made in Python
    """

    arm: str
    closure: ClosureKind = "parallelogram"
    frames: Mapping[str, FramePatch] = field(default_factory=dict[str, FramePatch])
    closures: Mapping[str, ClosurePatch] = field(default_factory=dict[str, ClosurePatch])
    measured: Mapping[str, Any] = field(default_factory=dict[str, Any])
    source: Mapping[str, str] = field(default_factory=dict[str, str])
    warnings: tuple[str, ...] = ()
    file: str = ""
