"""A first guess of a robot: closed geometry and marker poses, from axes measured one by one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.axes import Axes
from trocar.apps.calibration.geometry import Slot, freedoms, shift_rows, slots
from trocar.apps.calibration.home import Home, in_plane, planar_fit, planar_turn
from trocar.apps.calibration.linkage import Linkage
from trocar.geometry import inverse, transform

Array = NDArray[np.float64]

STEPS = 5


@dataclass(frozen=True, eq=False)
class Robot:
    """One robot's linkage, and where the markers sit on it.

    Attributes:
        linkage: the description's
        moved: displacements of its axes, (n_slots, 2) [m] (see `geometry`)
        tilts: {frame: small turn of its hinge about the plane's two axes (2,) [rad]}
        markers: {body: T_frame_markers (4, 4)}, of the body's first frame
    """

    linkage: Linkage
    moved: Array
    tilts: Mapping[str, Array]
    markers: Mapping[str, Array]


def first_guess(axes: Axes, home: Home, parallelogram: bool, datum: Array) -> Robot:
    """Fit a closed linkage to the axes at home.

    What the tracks do not show stays as the description has it. Along the axes, the linkage stands
    so that the datum, (3,) as `home` has it [m], is level with the origin of the first axis' frame.
    """
    linkage = axes.linkage
    flat, first_plane = in_plane(axes, home)
    up = first_plane[:3, 2]
    first_plane[:3, 3] += (up @ (datum - first_plane[:3, 3])) * up
    keys = list(flat)
    rows = np.vstack([np.kron(_row(linkage, *key), np.eye(2)) for key in keys])
    got = np.stack([flat[key] for key in keys])
    nominal = np.stack([linkage.points[name] for name, _ in keys])
    basis = freedoms(linkage, parallelogram)
    angle, shift = planar_fit(got, nominal)
    free = np.zeros(basis.shape[1])
    for _ in range(STEPS):
        placed = got @ planar_turn(angle).T + shift
        turned = np.stack([-placed[:, 1], placed[:, 0]], axis=1)
        left = np.hstack([
            rows @ basis,
            -turned.reshape(-1, 1),
            -np.tile(np.eye(2), (len(keys), 1)),
        ])  # fmt: skip
        right = (placed - nominal).ravel() - rows @ basis @ free
        step = np.linalg.lstsq(left, right, rcond=1e-10)[0]
        free = free + step[: len(free)]
        more = float(step[len(free)])
        shift = planar_turn(more) @ shift + step[len(free) + 1 :]
        angle += more
    moved = (basis @ free).reshape(-1, 2)
    # T_ground_plane: the measured plane's coordinates, turned and shifted onto the description's.
    spin = np.eye(3)
    spin[:2, :2] = planar_turn(angle)
    onto = transform(linkage.plane @ spin, linkage.plane @ np.append(shift, linkage.level))
    ground_first = onto @ inverse(first_plane)
    shifts = shift_rows(linkage)
    markers: dict[str, Array] = {}
    for body, pose in home.poses.items():
        frame = linkage.frames[linkage.bodies[body]].copy()
        frame[:3, 3] += linkage.plane[:, :2] @ (shifts[body] @ moved)
        markers[body] = inverse(frame) @ ground_first @ pose
    return Robot(linkage, moved, {}, markers)


def _row(linkage: Linkage, name: str, body: str) -> Array:
    """Return how displacements move a hinge as a body has it, (n_slots,)."""
    places, shifts = slots(linkage), shift_rows(linkage)
    hinge = linkage.hinge(name)
    if not hinge.closure:
        body = hinge.body_a  # of a frame's hinge both bodies have the same place
    return shifts[body] + np.eye(len(places))[places.index(Slot(name, body))]
