"""How straight the way of a track is through its calibration."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

from tests.calls import calls_of, in_package
from trocar.cli import main
from trocar.robot.calibration.selection import SelectedTracks
from trocar.robot.calibration.tracks import Tracks

#: Rooms through which a track goes.
ROOMS = ("cli/", "robot/calibration/", "fitting/")
#: Visits of a file by a track, and visits of one that it had left before: in all, and without those
#: of fitting. Source: measured; 38 and 22, and 26 and 14, when files shared what they did.
MOST, MOST_WITHOUT_FITTING = (32, 16), (15, 4)
#: An array that is longer than any of the linkage's has a row a sample.
LEAST_SAMPLES = 50


def holds_samples(value: object) -> bool:
    """Tell whether a value is a track, or has a row of each sample."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0 and len(value) >= LEAST_SAMPLES
    if isinstance(value, Mapping):
        return any(isinstance(one, np.ndarray) and holds_samples(one) for one in value.values())
    return isinstance(value, (Tracks, SelectedTracks))


def takes_samples(frame: FrameType) -> bool:
    """Tell whether a function of the rooms that a track visits is handed some of its samples."""
    code = frame.f_code
    if not in_package(frame) or not any(f"/{room}" in code.co_filename for room in ROOMS):
        return False
    names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    return any(holds_samples(frame.f_locals.get(name)) for name in names)


@pytest.mark.parametrize("arm", ["psm", "ecm"])
def test_a_track_goes_through_its_calibration_without_much_to_and_fro(
    tmp_path: Path, arm: str
) -> None:
    tracks, overlay = f"{tmp_path / 'tracks.csv'}", f"{tmp_path / 'mine.toml'}"
    sweep = ("--motion", "kinematic", "--duration", "6", "--rate", "60")
    assert main(["mocap", "--arm", arm, "-o", tracks, "--perturb", "3", *sweep]) == 0
    command = ["calibrate", tracks, "--arm", arm, "-o", overlay]
    calls = calls_of(lambda: main(command), takes_samples)
    files = [call.file for call in dict.fromkeys(calls)]  # a reader reads each function once
    for most, rooms in ((MOST, ROOMS), (MOST_WITHOUT_FITTING, ROOMS[:2])):
        visits = [file for file, _ in groupby(file for file in files if file.startswith(rooms))]
        assert len(visits) <= most[0], visits
        assert len(visits) - len(set(visits)) <= most[1], visits
