"""Tracks of marker clusters: the pose of each body over time, from a Motive export or tidy CSV."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, TracksError
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.robot.calibration.track_csv import parse_csv, read_text

Array = NDArray[np.float64]

#: Bodies of one arm are never this far from one another, nor all this near. The longest distance on
#: a real arm is about 1 m. Source: our own choice, wide enough for any arm and its base. [m]
FARTHEST_M, NEAREST_M = 10.0, 0.005
#: A usual distance of the two farthest bodies, and how much larger numbers are in other units.
USUAL_M = 0.5
LARGER = {"millimetres": 1000.0, "centimetres": 100.0, "inches": 39.37}
#: A rate in a header that is off the times by more than this is worth a warning.
RATE_TOLERANCE = 0.02


@dataclass(frozen=True, eq=False)
class Tracks:
    """Poses of bodies that a camera system recorded.

    Attributes:
        file: the file they were read from
        sha256: of the file's bytes
        times: of every sample, increasing, (n,) [s]
        poses: {body: T_camera_body (n, 4, 4)}, NaN where the body is not tracked
        rate_hz: samples a second
        warnings: for the user
    """

    file: str
    sha256: str
    times: Array
    poses: Mapping[str, Array]
    rate_hz: float
    warnings: tuple[str, ...] = ()

    def tracked(self, body: str) -> NDArray[np.bool_]:
        """Return the samples at which a body is tracked, (n,)."""
        return ~np.isnan(self.poses[body][:, 0, 0])

    def together(self, *bodies: str) -> NDArray[np.bool_]:
        """Return the samples at which all of some bodies are tracked, (n,)."""
        return np.logical_and.reduce([self.tracked(body) for body in bodies])

    def coverage(self, body: str) -> str:
        """Describe a body's coverage: number of samples, first and last time, longest gap."""
        seen = np.flatnonzero(self.tracked(body))
        if not len(seen):
            return f"none of {len(self.times)} samples"
        first, last = self.times[seen[0]], self.times[seen[-1]]
        gap = float(np.diff(self.times[seen]).max(initial=0.0))
        return (
            f"{len(seen)} of {len(self.times)} samples, from {first:.3f} to {last:.3f} s,"
            f" longest gap {gap:.3f} s"
        )


def read_tracks(path: str | Path) -> Tracks:
    """Read a file of motion capture: a CSV export of OptiTrack Motive, or tidy CSV.

    Raises:
        TracksError: naming file, line, what was got and what is allowed
    """
    file = str(path)
    text, sha256 = read_text(path)
    found = parse_csv(file, text)
    times = np.unique(np.concatenate([track.times for track in found.bodies.values()]))
    poses: dict[str, Array] = {}
    for body, track in found.bodies.items():
        pose = np.full((len(times), 4, 4), np.nan)
        seen = ~np.isnan(track.positions[:, 0])
        at = np.searchsorted(times, track.times[seen])
        pose[at, :3, :3] = matrix_from_quaternion(track.quaternions[seen])
        pose[at, :3, 3] = track.positions[seen]
        pose[at, 3] = (0.0, 0.0, 0.0, 1.0)
        pose.setflags(write=False)
        poses[body] = pose
    times.setflags(write=False)
    tracks = Tracks(file, sha256, times, poses, np.nan)
    check_size(tracks)
    if len(times) < 2:
        raise TracksError(file, f"got {len(times)} samples; allowed: 2 or more")
    rate, header, warnings = 1.0 / float(np.median(np.diff(times))), found.rate_hz, found.warnings
    if header is not None and abs(rate / header - 1.0) <= RATE_TOLERANCE:
        rate = header  # the times are rounded
    elif header is not None:
        text = f"the header says {header:g} Hz, the times {rate:.3g} Hz; the times are used"
        warnings = (*warnings, text)
    return replace(tracks, rate_hz=rate, warnings=warnings)


def check_size(tracks: Tracks) -> None:
    """Refuse tracks whose bodies are too far from one another, or too near, for any arm.

    Raises:
        TracksError: naming two bodies, their distance, and the likely unit
    """
    seen = {body: pose[tracks.tracked(body)] for body, pose in tracks.poses.items()}
    middles = {body: np.median(p[:, :3, 3], axis=0) for body, p in seen.items() if len(p)}
    distances = {
        (a, b): float(np.linalg.norm(middles[a] - middles[b])) for a, b in combinations(middles, 2)
    }
    if not distances:
        return
    (a, b), far = max(distances.items(), key=lambda item: item[1])
    if far > FARTHEST_M:
        unit = min(LARGER, key=lambda name: abs(math.log(far / LARGER[name] / USUAL_M)))
        raise TracksError(
            tracks.file,
            f"{a} and {b} are {far:.4g} m apart, more than the size of an arm: are the positions in"
            f" {unit} ({LARGER[unit]:g} times too large)? allowed: at most {FARTHEST_M:g} m",
        )
    if far < NEAREST_M:
        raise TracksError(
            tracks.file,
            f"all bodies lie within {far:.3g} m, less than the size of an arm: are the positions in"
            f" metres, but the header says millimetres (1000 times too small)? allowed: at least"
            f" {NEAREST_M:g} m",
        )


def parse_bodies(text: str) -> dict[str, str]:
    """Read "psm_yaw=Rigid Body 3,psm_base=Base": {body: its name in the file}.

    A comma inside a name is part of it where no "=" follows before the next comma.

    Raises:
        InputError: a part without "=", a blank side, or a body named twice
    """
    found: dict[str, str] = {}
    for part in re.split(r",(?=[^,=]*=)", text):
        body, given, name = (word.strip() for word in part.partition("="))
        if not (body and given and name):
            raise InputError(
                f"bodies: got {part!r}; allowed: BODY=NAME, separated by commas, e.g."
                " psm_yaw=Rigid Body 3,psm_base=Base"
            )
        if body in found:
            raise InputError(f"bodies: got {body} a second time")
        found[body] = name
    return found


def select_bodies(
    tracks: Tracks, wanted: Mapping[str, str], optional: Collection[str] = ()
) -> Tracks:
    """Return the tracks of some bodies alone, under the names that a method knows them by.

    Args:
        tracks: as a file has them
        wanted: {body: its name in the file}
        optional: bodies that may be missing

    Raises:
        TracksError: a body is not in the file, or is nowhere tracked; those found and those
            expected are listed
    """
    missing = [b for b, name in wanted.items() if name not in tracks.poses and b not in optional]
    if missing:
        shown = ", ".join(b if wanted[b] == b else f"{b} ({wanted[b]!r})" for b in missing)
        raise TracksError(
            tracks.file,
            f"bodies missing: {shown}; found: {', '.join(tracks.poses) or 'none'}; expected:"
            f" {', '.join(wanted)}; --bodies {missing[0]}=NAME sets the name in the file",
        )
    picked = {b: tracks.poses[name] for b, name in wanted.items() if name in tracks.poses}
    chosen = replace(tracks, poses=picked)
    lost = [body for body in picked if not chosen.tracked(body).any()]
    if lost:
        raise TracksError(tracks.file, f"not tracked in any sample: {', '.join(lost)}")
    return chosen


def thinned(tracks: Tracks, most: int = 600) -> Tracks:
    """Return some of the samples, evenly spread: enough to see what is centimetres off."""
    step = max(1, len(tracks.times) // most)
    poses = {body: T[::step] for body, T in tracks.poses.items()}
    return replace(tracks, times=tracks.times[::step], poses=poses, rate_hz=tracks.rate_hz / step)


def check_together(tracks: Tracks, first: str, second: str, needed: int = 1) -> None:
    """Reject two bodies that are not tracked at the same time often enough.

    Raises:
        TracksError: with the samples in which each of them is tracked
    """
    count = int(tracks.together(first, second).sum())
    if count >= needed:
        return
    if first == second:
        raise TracksError(
            tracks.file,
            f"{first} is tracked in {count} samples; needed: {needed} ({tracks.coverage(first)})",
        )
    raise TracksError(
        tracks.file,
        f"{first} and {second} are tracked together in {count} samples; needed: {needed}"
        f" ({first}: {tracks.coverage(first)}; {second}: {tracks.coverage(second)})",
    )
