"""A simulated robot whose remote centre is, and wanders, where a real one's does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.overlay import write_overlay
from trocar.descriptions.paper import TABLE6, TABLE7
from trocar.errors import InputError
from trocar.robot.calibration import Tracks, calibrate
from trocar.robot.calibration.paper_robot import paper_twin
from trocar.robot.mocap import MarkerNoise, MocapSettings, simulate_tracks, worn
from trocar.robot.verification import verify


def verified(path: Path) -> dict[str, tuple[float, float, bool | None]]:
    """Return (calibrated, nominal, met) of what is compared with the hardware."""
    (part,) = verify(calibrations=[path], parts=["rcm"]).parts
    return {
        f.name.removeprefix("as measured: "): (f.value, f.nominal, f.met)
        for f in part.figures
        if f.nominal is not None
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_the_papers_robot_is_simulated_to_a_millimetre(name: str, tmp_path: Path) -> None:
    arm = load_arm(name)
    found = paper_twin(arm)
    assert list(found.hardware.position) == list(TABLE7[arm.type][0].position)
    # what the nominal description misses, and what is asked for
    assert found.missed(found.nominal)[0] > 2.5e-3
    place, spread = found.missed(found.twin)
    assert place < 5e-4
    assert spread < 5e-4
    for label, printed in TABLE6[arm.type].items():
        assert found.distances[label][2] == pytest.approx(printed, abs=5e-4)
    # and so has the simulation of it, by physics, from the file
    write_overlay(tmp_path / "twin.toml", found.overlay)
    rows = verified(tmp_path / "twin.toml")
    for what in ("distance from the hardware's", "spread missed"):
        calibrated, nominal, met = rows[what]
        assert met is True
        assert calibrated < 1e-3
        assert nominal > 0.9e-3
    assert rows["distance from the hardware's"][1] > 2.5e-3


@pytest.mark.slow
def test_tracks_of_a_robot_that_wanders_give_one_that_wanders_alike(tmp_path: Path) -> None:
    psm = load_arm("psm")
    robot = worn(psm, np.random.default_rng(5), 0.0005, 0.002)
    settings = MocapSettings("kinematic", duration_s=8.0, noise=MarkerNoise(1e-4, np.radians(0.05)))
    made = simulate_tracks(robot, settings)
    tracks = Tracks("simulated", "", made.times, made.poses, made.rate_hz)
    found = calibrate(tracks, psm, closure="general")
    assert found.centre is not None
    assert found.centre.wander_rms > 5e-4
    write_overlay(tmp_path / "mine.toml", replace(found.overlay, warnings=()))
    rows = verified(tmp_path / "mine.toml")
    for what in ("distance from the hardware's", "spread missed"):
        calibrated, nominal, met = rows[what]
        assert met is True
        assert 5.0 * calibrated < nominal


def test_only_robots_that_the_paper_measured_have_a_twin() -> None:
    with pytest.raises(InputError, match=r"mtmr: got a MTM; allowed: .* psm and ecm"):
        paper_twin(load_arm("mtmr"))
