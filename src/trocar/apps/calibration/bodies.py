"""Which bodies of the tracks belong to a linkage, and what they show of it at first sight."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.axes import Axes
from trocar.apps.calibration.home import Home
from trocar.apps.calibration.linkage import Linkage
from trocar.apps.calibration.placement import Centre
from trocar.apps.calibration.register import LEAST_BODIES, Samples
from trocar.apps.calibration.start import Robot
from trocar.apps.calibration.tracks import Tracks, select_bodies
from trocar.errors import TracksError

Array = NDArray[np.float64]

#: Noise is taken to be at least this, so that exact tracks can be weighted: rounding. [m], [rad]
LEAST_NOISE = (1e-10, 1e-9)


def chosen_bodies(
    tracks: Tracks, loops: Linkage, centre: Centre | None, names: Mapping[str, str]
) -> tuple[Tracks, tuple[str, ...]]:
    """Take the bodies of the linkage, and say which of them are missing."""
    wanted = dict.fromkeys(loops.bodies) | ({centre.base: None} if centre else {})
    _check_names(tracks, loops, list(wanted), names)
    optional = _optional(loops, centre)
    chosen = select_bodies(tracks, {b: names.get(b, b) for b in wanted}, optional)
    if not set(chosen.poses) & set(loops.bodies):
        raise TracksError(tracks.file, f"no body of {loops.arm}'s loops")
    missing = [body for body in loops.bodies if body not in chosen.poses]
    if not missing:
        return chosen, ()
    return chosen, (
        f"not in the tracks: {', '.join(missing)}; what these links carry stays as the"
        " description has it, and their distances are absent",
    )


def _check_names(
    tracks: Tracks, loops: Linkage, wanted: list[str], names: Mapping[str, str]
) -> None:
    """Refuse bodies that are called after this arm but are none of its links."""
    unknown = [body for body in names if body not in wanted]
    used = set(names.values())
    unknown += [
        b
        for b in tracks.poses
        if b.startswith(f"{loops.arm}_") and b not in loops.known and b not in used
    ]
    if unknown:
        raise TracksError(
            tracks.file,
            f"unknown bodies: {', '.join(unknown)}; found: {', '.join(tracks.poses)}; expected:"
            f" {', '.join(wanted)}",
        )


def _optional(loops: Linkage, centre: Centre | None) -> list[str]:
    """Return the bodies that may be missing: the base, and passive links with two hinges."""
    driven = {loops.body_of[f] for j in loops.mechanism.joints for f, _ in j.drive
              if f in loops.body_of}  # fmt: skip
    found = [
        body
        for body in loops.bodies
        if body != loops.ground and body not in driven and len(loops.carried(body)) == 2
    ]
    if centre is not None:
        found = [body for body in found if body != centre.body]
        found += [centre.base] if centre.base not in loops.bodies else []
    return found


def seen_samples(
    tracks: Tracks, axes: Axes, home: Home, robot: Robot
) -> tuple[Samples, NDArray[np.bool_]]:
    """Gather the poses of the linkage's bodies, without what the hinges found far off."""
    bodies = list(robot.markers)
    poses = np.stack([tracks.poses[body] for body in bodies], axis=1)
    seen = np.asarray(np.isfinite(poses).all(axis=(2, 3)))
    for i, body in enumerate(bodies):
        fits = [axes.fits[name] for name in axes.linkage.carried(body) if name in axes.fits]
        seen[:, i] &= np.stack([fit.used for fit in fits]).any(axis=0)
    poses = np.where(seen[..., None, None], poses, np.eye(4))
    enough = seen.sum(axis=1) >= min(LEAST_BODIES, len(bodies))
    position, rotation = axes.noise
    sigmas = (max(position, LEAST_NOISE[0]), max(rotation, LEAST_NOISE[1]))
    return Samples(poses[enough], seen[enough], home.samples[enough], sigmas), enough


def first_positions(axes: Axes, home: Home) -> Array:
    """Guess the joint positions from the hinges' angles, (n, n_moving) [rad]."""
    loops = axes.linkage
    columns = list(loops.joints)
    normal = np.zeros((len(home.samples), len(columns), len(columns)))
    right = np.zeros((len(home.samples), len(columns)))
    for name, zero in home.angles.items():
        hinge = loops.hinge(name)
        row = (loops.turns[hinge.body_b] - loops.turns[hinge.body_a])[columns]
        away = np.angle(np.exp(1j * (axes.angles(name) - zero.value)))
        known = np.isfinite(away)
        normal += known[:, None, None] * np.outer(row, row)
        right += np.where(known, away, 0.0)[:, None] * row
    normal += 1e-9 * np.eye(len(columns))
    return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], dtype=np.float64)
