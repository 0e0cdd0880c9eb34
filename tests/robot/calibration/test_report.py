"""The page that a calibration writes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="drawings need matplotlib (extra: plot)")

from trocar.descriptions import load_arm
from trocar.descriptions.overlay import apply_overlay
from trocar.robot.calibration import calibrate, read_tracks
from trocar.robot.calibration.rcm import centre_links, centre_samples, own_centre
from trocar.robot.calibration.report import write_report
from trocar.robot.mocap import MarkerNoise, MocapSettings, simulate_tracks, worn, write_tracks

SETTINGS = MocapSettings("kinematic", "both", 6.0, 0.6, 30.0, MarkerNoise(1e-4, 8.7e-4), 3)


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_a_report_holds_every_figure_and_nothing_from_elsewhere(name: str, tmp_path: Path) -> None:
    arm = load_arm(name)
    tracks = simulate_tracks(arm, SETTINGS)
    write_tracks(tmp_path / "tracks.csv", tracks, "tidy")
    found = calibrate(read_tracks(tmp_path / "tracks.csv"), arm)
    page = write_report(tmp_path / "report", found, arm).read_text()
    for label, value in found.axis_distances.items():
        assert label in page
        assert f"{1e3 * value.value:.4f}" in page
    assert page.count("<svg") == 3
    assert not re.findall(r'(?:src|href)="http', page)
    assert re.search(r"nan|inf\b", re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL)) is None


def test_a_nominal_arms_own_centre_is_the_papers_and_does_not_wander() -> None:
    q = np.stack(np.meshgrid([-0.5, 0.0, 0.5], [-0.4, 0.1, 0.6]), axis=-1).reshape(-1, 2)
    for name, place in (("psm", (0.0, -0.516, 0.0)), ("ecm", (0.3404, 0.0, 0.0))):
        arm = load_arm(name)
        own = own_centre(arm.mechanism, centre_links(arm), q)
        np.testing.assert_allclose(own.position, place, atol=1e-9)
        assert own.rms_axes.max() < 1e-9


def test_a_worn_arms_own_centre_wanders() -> None:
    arm = worn(load_arm("psm"), np.random.default_rng(1))
    q = np.stack(np.meshgrid([-0.5, 0.0, 0.5], [-0.4, 0.1, 0.6]), axis=-1).reshape(-1, 2)
    assert 5e-5 < own_centre(arm.mechanism, centre_links(arm), q).rms_axes.max() < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_a_calibrated_arms_own_centre_wanders_as_the_worn_arms_did(
    name: str, tmp_path: Path
) -> None:
    arm = load_arm(name)
    settings = MocapSettings("kinematic", "both", 8.0, 0.6, 30.0, MarkerNoise(), 4)
    real = worn(arm, np.random.default_rng(8))
    write_tracks(tmp_path / "tracks.csv", simulate_tracks(real, settings), "tidy")
    found = calibrate(read_tracks(tmp_path / "tracks.csv"), arm, closure="general")
    assert found.centre is not None
    report = found.centre
    assert report.table7 is not None
    q, _ = centre_samples(report.hinges, report.fit)
    robot = apply_overlay(arm, found.overlay)
    own = own_centre(robot.mechanism, centre_links(arm), q)
    np.testing.assert_allclose(own.position, report.table7.position, atol=2e-6)
    np.testing.assert_allclose(own.rms_axes, report.table7.rms_axes, atol=2e-6)
    assert report.table7.rms_axes.max() > 5e-5
    # Every hinge that tilts has the standard deviation of its tilt.
    for hinge, patch in found.overlay.frames.items():
        if hinge != "insertion":
            assert patch.rpy_sigma is not None and np.all(patch.rpy_sigma[:2] > 0.0)
