"""Tracks that are another robot's by their labels, scale, time or handedness: never in silence."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import FarFromNominalError, InputError, LabelsError
from trocar.robot.calibration import Tracks, calibrate
from trocar.robot.mocap import MarkerNoise, MocapSettings, perturbed, simulate_tracks
from trocar.robot.mocap.simulate import Parts

NOISE = MarkerNoise(1e-4, float(np.deg2rad(0.05)))
LINKS = {
    "psm": ("base", "yaw", "pitch_back", "pitch_front", "pitch_bottom", "pitch_top", "pitch_end"),
    "ecm": ("base", "yaw", "pitch_front", "pitch_back", "pitch_bottom", "pitch_top", "pitch_end"),
}


@functools.cache
def take(name: str, parts: Parts) -> Tracks:
    arm = perturbed(load_arm(name), np.random.default_rng(5))
    made = simulate_tracks(arm, MocapSettings("kinematic", parts, 8.0, 0.6, 30.0, NOISE, 5))
    return Tracks(f"{parts}.csv", "", made.times, made.poses, made.rate_hz)


def labelled(tracks: Tracks, labels: Mapping[str, str]) -> Tracks:
    """Return tracks in which what is `label` has the name of another body."""
    return replace(tracks, poses={b: tracks.poses[labels.get(b, b)] for b in tracks.poses})


def wrong(labels: Mapping[str, str]) -> dict[str, str]:
    return {body: label for body, label in labels.items() if body != label}


def check_exchange(name: str, one: str, two: str, where: str) -> None:
    a, b = f"{name}_{one}", f"{name}_{two}"
    swap = {a: b, b: a}
    if where == "one":
        tracks, sweep = labelled(take(name, "both"), swap), None
    else:
        tracks = labelled(take(name, "axes"), swap if where != "rcm" else {})
        sweep = labelled(take(name, "rcm"), swap if where != "axes" else {})
    with pytest.raises(LabelsError, match="labelled wrongly") as caught:
        calibrate(tracks, load_arm(name), sweep)
    for file, labels in caught.value.labels.items():
        swapped = where in ("one", "both") or file == f"{where}.csv"
        assert wrong(labels) == (swap if swapped else {})
    assert f"{a} and {b} are exchanged" in str(caught.value) or (
        f"{b} and {a} are exchanged" in str(caught.value)
    )


@pytest.mark.parametrize(
    ("name", "one", "two", "where"),
    [
        ("psm", "pitch_back", "pitch_end", "both"),
        ("psm", "pitch_front", "pitch_top", "rcm"),  # neither counts for the centre
        ("psm", "base", "yaw", "axes"),  # both rest while the pitch swings
        ("ecm", "pitch_bottom", "pitch_top", "one"),
    ],
)
def test_exchanged_labels_are_named(name: str, one: str, two: str, where: str) -> None:
    check_exchange(name, one, two, where)


@pytest.mark.slow
@pytest.mark.parametrize("name", LINKS)
def test_every_exchange_of_two_labels_in_every_file_is_named(name: str) -> None:
    for one, two in combinations(LINKS[name], 2):
        for where in ("axes", "rcm", "both", "one"):
            check_exchange(name, one, two, where)


def test_three_labels_in_a_circle_are_named() -> None:
    circle = {
        "psm_pitch_bottom": "psm_pitch_top",
        "psm_pitch_top": "psm_pitch_end",
        "psm_pitch_end": "psm_pitch_bottom",
    }
    with pytest.raises(LabelsError) as caught:
        calibrate(labelled(take("psm", "axes"), circle), load_arm("psm"))
    # the circle the other way round undoes it
    assert wrong(caught.value.labels["axes.csv"]) == {b: a for a, b in circle.items()}
    assert "psm_pitch_bottom is labelled psm_pitch_end" in str(caught.value)
    given = "--bodies psm_pitch_bottom=psm_pitch_end,psm_pitch_top=psm_pitch_bottom"
    assert given in str(caught.value)


def scaled(tracks: Tracks, scale: float) -> Tracks:
    poses = {body: T.copy() for body, T in tracks.poses.items()}
    for T in poses.values():
        T[:, :3, 3] *= scale
    return replace(tracks, poses=poses)


@pytest.mark.parametrize("scale", [0.1, 1.05, 2.54])
def test_a_wrong_scale_is_named_and_no_label_blamed(scale: float) -> None:
    with pytest.raises(FarFromNominalError, match=r"are [\d.]+ times the nominal: check the unit"):
        calibrate(scaled(take("psm", "axes"), scale), load_arm("psm"))


def test_a_scale_that_is_a_little_off_is_warned_of() -> None:
    found = calibrate(scaled(take("psm", "axes"), 1.015), load_arm("psm"))
    assert any("times the nominal on average" in text for text in found.warnings)
    assert len(found.warnings) == len(calibrate(take("psm", "axes"), load_arm("psm")).warnings) + 1


def test_reversed_time_is_refused() -> None:
    tracks = take("psm", "axes")
    back = replace(tracks, poses={body: T[::-1] for body, T in tracks.poses.items()})
    with pytest.raises(InputError, match=r"rests for 2\.\d+ s at the end .*time reversed\?"):
        calibrate(back, load_arm("psm"))


@pytest.mark.parametrize("name", ["psm", pytest.param("ecm", marks=pytest.mark.slow)])
def test_a_mirrored_volume_is_warned_of(name: str) -> None:
    tracks = take(name, "both")
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    flipped = replace(tracks, poses={b: mirror @ T @ mirror for b, T in tracks.poses.items()})
    words = "yaw turns to negative joint positions first"
    assert not any(words in text for text in calibrate(tracks, load_arm(name)).warnings)
    (said,) = (t for t in calibrate(flipped, load_arm(name)).warnings if words in t)
    assert "mirrored" in said
