"""Bases and joint offsets from an arm's own readings: exact without noise, honest with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import InputError, TrocarError
from trocar.geometry.se3 import inverse, log_transform
from trocar.robot.calibration.registration import Base, between, register, registration_dict
from trocar.robot.calibration.touches import read_touches
from trocar.robot.mocap.touches import TouchSettings, write_touches

EXACT = {"noise_m": 0.0, "noise_rad": 0.0}


def registered(
    folder: Path, arms: dict[str, str], *changes: tuple[str, str], **settings: Any
) -> tuple[dict[str, Base], dict[str, Any]]:
    """Simulate readings, change the TOML file, and register: (found, truth)."""
    path = folder / "touches.toml"
    named = {name: (arm, load_arm(arm)) for name, arm in arms.items()}
    truth = write_touches(path, named, TouchSettings(**settings), overwrite=True)
    for old, new in changes:
        path.write_text(path.read_text().replace(old, new))
    return register(read_touches(path)), truth


def off(found: Base, truth: dict[str, Any]) -> np.ndarray:
    """Return shift and turn of a base from the truth, in its axes, (6,) [m, rad]."""
    return log_transform(inverse(np.array(truth["T_reference_base"])) @ found.pose)


@pytest.mark.parametrize("boards", [False, True])
def test_readings_without_noise_give_the_pose_between_bases(tmp_path: Path, boards: bool) -> None:
    arms = {"PSM1": "psm", "PSM2": "psm"}
    found, truth = registered(tmp_path, arms, boards=boards, offset_rad=0.0, offset_m=0.0, **EXACT)
    T, _ = between(found["PSM1"], found["PSM2"])
    one, two = (np.array(truth[name]["T_reference_base"]) for name in arms)
    np.testing.assert_allclose(T, inverse(one) @ two, atol=1e-6)
    document = registration_dict(found, "block")
    assert document["bases"]["T_PSM1_PSM2"]["xyz_m"] == pytest.approx(T[:3, 3].tolist())


@pytest.mark.parametrize("boards", [False, True])
def test_offsets_are_found_but_for_those_that_nothing_shows(tmp_path: Path, boards: bool) -> None:
    found, truth = registered(tmp_path, {"A": "psm"}, boards=boards, seed=4, count=60, **EXACT)
    base = found["A"]
    # The tool's tip lies on the last axis, or a board takes its turn: no reading shows that one.
    assert base.undetermined == ("wrist_yaw",)
    for joint in ("pitch", "insertion", "roll", "wrist_pitch"):
        assert base.offsets[joint].value == pytest.approx(truth["A"]["offsets"][joint], abs=2e-5)
    assert np.abs(off(base, truth["A"])).max() < 2e-5


@pytest.mark.parametrize("boards", [False, True])
@pytest.mark.parametrize("arm", ["psm", "ecm"])
def test_rounding_does_not_decide_which_offsets_are_undetermined(
    tmp_path: Path, arm: str, boards: bool
) -> None:
    path = tmp_path / "touches.toml"
    settings = TouchSettings(boards=boards, count=30, noise_m=0.0, noise_rad=0.0)
    write_touches(path, {"A": (arm, load_arm(arm))}, settings)
    mine = read_touches(path)["A"]
    open_offsets = register({"A": mine})["A"].undetermined
    assert open_offsets
    for seed in range(2):
        rounding = 1e-15 * np.random.default_rng(seed).normal(size=mine.q.shape)
        again = register({"A": replace(mine, q=mine.q * (1.0 + rounding))})["A"]
        assert again.undetermined == open_offsets
        # Nothing is better known than what the encoders resolve, nothing worse than beforehand.
        assert all(1e-8 < value.sigma < 0.04 for value in again.offsets.values())


def test_a_reading_that_misses_by_less_than_encoders_resolve_is_not_pointed_out(
    tmp_path: Path,
) -> None:
    path, settings = tmp_path / "touches.toml", TouchSettings(count=40, noise_m=0.0, noise_rad=0.0)
    write_touches(path, {"A": ("psm", load_arm("psm"))}, settings)
    mine = read_touches(path)["A"]
    q = mine.q.copy()
    q[7, 2] += 1e-7  # a thirteenth of a step of the insertion's encoder
    assert register({"A": replace(mine, q=q)})["A"].warnings == ()


@pytest.mark.slow
@pytest.mark.parametrize("boards", [False, True])
def test_standard_deviations_are_honest(tmp_path: Path, boards: bool) -> None:
    scores: list[float] = []
    for seed in range(6):
        found, truth = registered(
            tmp_path, {"A": "psm", "B": "psm"}, boards=boards, seed=seed, count=20
        )
        for name, base in found.items():
            scores += list(off(base, truth[name]) / np.sqrt(np.diag(base.covariance)))
            scores += [
                (value.value - truth[name]["offsets"][joint]) / value.sigma
                for joint, value in base.offsets.items()
                if joint not in base.undetermined
            ]
        T, covariance = between(found["A"], found["B"])
        one, two = (np.array(truth[name]["T_reference_base"]) for name in "AB")
        shift = T[:3, 3] - (inverse(one) @ two)[:3, 3]
        scores += list(shift / np.sqrt(np.diag(covariance))[:3])
    # 12 fits of some 13 figures, correlated within each
    assert np.mean(np.square(scores)) == pytest.approx(1.0, abs=0.4)
    assert np.mean(np.abs(scores) < 1.96) > 0.90


def test_a_tip_that_is_not_given_is_found(tmp_path: Path) -> None:
    change = ("tip_m = [0.0, 0.0, 0.0]\n", "")
    found, _ = registered(tmp_path, {"A": "psm"}, change, offset_rad=0.0, offset_m=0.0)
    base = found["A"]
    assert (base.tip_sigma > 0.0).all()
    assert (np.abs(base.tip) < 4.0 * base.tip_sigma).all()


def test_a_point_with_a_wrong_name_is_pointed_out(tmp_path: Path) -> None:
    path = tmp_path / "touches.toml"
    write_touches(path, {"A": ("psm", load_arm("psm"))}, TouchSettings(count=40), overwrite=True)
    table = path.with_suffix(".csv")
    lines = table.read_text().splitlines()
    assert lines[9].startswith("A,P1,")
    lines[9] = lines[9].replace("P1", "P2")
    table.write_text("\n".join(lines))
    found = register(read_touches(path))["A"]
    assert any(text.startswith("line 10 misses by") for text in found.warnings)
    assert any("is the point P2?" in text for text in found.warnings)


def test_an_endoscope_sees_a_board(tmp_path: Path) -> None:
    found, truth = registered(tmp_path, {"ECM": "ecm"}, boards=True)
    assert np.abs(off(found["ECM"], truth["ECM"]))[:3].max() < 5e-4


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("\nA,P1,", "\nC,P1,", r"line 2: arm: got 'C'; allowed: A"),
        ("\nA,P2,", "\nA,Q2,", r"line 3: point: got 'Q2'; allowed: P1, P2, P3"),
        ("yaw,", "jaw,", r"line 2: columns missing: yaw; needed: yaw, pitch, insertion"),
        ("point,", "spot,", r"line 1: needs a column point \(touches\) or the columns x_m,y_m"),
        ("arm,", "name,", r"line 1: has no column arm"),
        ("A,P3,", "A,P3,99", r"line 4: yaw: got 99.*; allowed: -1.588 to 1.588"),
        ("A,P3,", "A,P3,x", r"line 4: yaw: got 'x"),
        ("A,P3,", "A,P3,,", r"line 4: yaw is blank; allowed: a position in rad or m"),
    ],
)
def test_broken_readings_are_refused_with_their_line(
    tmp_path: Path, old: str, new: str, text: str
) -> None:
    path = tmp_path / "touches.toml"
    write_touches(path, {"A": ("psm", load_arm("psm"))}, TouchSettings(count=8), overwrite=True)
    table = path.with_suffix(".csv")
    assert old in table.read_text()
    table.write_text(table.read_text().replace(old, new, 1))
    with pytest.raises(TrocarError, match=text):
        read_touches(path)


def test_readings_that_determine_nothing_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "touches.toml"
    write_touches(path, {"A": ("psm", load_arm("psm"))}, TouchSettings(count=8), overwrite=True)
    rows = path.with_suffix(".csv")
    rows.write_text("\n".join(rows.read_text().splitlines()[:4]))
    with pytest.raises(InputError, match=r"A: got 3 readings for 11 unknowns; required: at least"):
        register(read_touches(path))
    flat = [(f"[points.P{i}]\nxyz_m = ", f"[points.P{i}]\nxyz_m = [0.0, 0.0, 0.{i}]\n#")
            for i in range(1, 9)]  # fmt: skip
    with pytest.raises(InputError, match="A: touched 8 points that lie on a line"):
        registered(tmp_path, {"A": "psm"}, *flat)
    with pytest.raises(InputError, match="half of the readings miss by more than"):
        registered(tmp_path, {"A": "psm"}, ("0.06,", "0.26,"))
    with pytest.raises(InputError, match="count: got 2; allowed: 4 to 10000"):
        registered(tmp_path, {"A": "psm"}, count=2)
