"""`trocar rcm`: its document, its table, its refusals."""

from __future__ import annotations

import pytest

from trocar.descriptions import load_arm
from trocar.robot.mocap import MocapSettings, simulate_tracks, write_tracks


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Tracks of a drawn PSM, its truth; both parts, and the sweep of pitch alone."""
    folder = tmp_path_factory.mktemp("swept")
    arm = load_arm("psm")
    settings = MocapSettings(motion="kinematic", duration_s=8.0, rate_hz=30.0)
    simulated = simulate_tracks(arm, settings)
    write_tracks(folder / "both.csv", simulated, "tidy")
    write_tracks(folder / "motive.csv", simulated, "motive")
    only = MocapSettings(motion="kinematic", parts="axes", duration_s=8.0, rate_hz=30.0)
    write_tracks(folder / "pitch.csv", simulate_tracks(arm, only), "tidy")
    return folder, simulated.truth


@pytest.mark.parametrize(("file", "within"), [("both.csv", 1e-8), ("motive.csv", 1e-6)])
def test_the_document_has_the_centre_as_it_is(file, within, trocar, swept):
    folder, truth = swept
    answer = trocar("rcm", folder / file, "--arm", "psm", "--json")
    assert (answer.status, answer.err) == (0, "")
    centre = answer.document["rcm"]
    true = truth["rcm"]
    found = centre["position_in_base_body_m"]
    assert found["value"] == pytest.approx(true["position_in_base_body_m"], abs=within)
    assert len(found["sigma"]) == 3 and found == centre["b_post_m"]
    assert centre["table7"]["position_m"] == pytest.approx([0, -0.516, 0], abs=3 * within)
    assert centre["distance_to_pitch_axis_m"]["value"] == pytest.approx(0.516, abs=within)
    assert set(centre["table7"]) == {"position_m", "sigma", "rms_xyz_m"}
    assert answer.document["warnings"] == []
    assert {"q_rad", "position_m", "samples"} == set(answer.document["cloud"][0])


def test_the_table_tells_the_centre_in_millimetres(trocar, swept):
    answer = trocar("rcm", swept[0] / "both.csv", "--arm", "psm")
    assert answer.status == 0
    assert "from the pitch axis" in answer.out and "-516.000" in answer.out
    assert "mean position per joint pose" in answer.out


def test_pitch_alone_is_refused_with_the_angle_and_the_condition_number(trocar, swept):
    answer = trocar("rcm", swept[0] / "pitch.csv", "--arm", "psm", "--json")
    assert answer.status == 2
    assert "one axis only" in answer.complaint and "condition number" in answer.complaint


def test_bodies_by_other_names(trocar, swept):
    answer = trocar("rcm", swept[0] / "both.csv", "--arm", "psm", "--bodies", "psm_pitch_end=Other")
    assert answer.status == 2
    assert "psm_pitch_end ('Other')" in answer.complaint
