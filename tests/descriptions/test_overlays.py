"""Overlays: what they change, what they leave alone, and what is rejected."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_arm, load_rig, names
from trocar.descriptions.calibrated import rig_overlays
from trocar.descriptions.mounting import rig_with_tool
from trocar.descriptions.overlay import (
    ClosurePatch,
    FramePatch,
    Overlay,
    apply_overlay,
    closure_patch,
    frame_patch,
    overlay_between,
    overlay_text,
    parse_overlay,
    read_overlay,
    write_overlay,
)
from trocar.errors import DescriptionError, InputError, UnknownNameError
from trocar.kinematics import coordinates, gaps, pose, poses


@pytest.mark.parametrize("name", names("arms"))
def test_an_empty_overlay_changes_nothing_to_the_last_bit(name):
    arm = load_arm(name)
    assert apply_overlay(arm, Overlay(name)).mechanism is arm.mechanism
    assert arm.overlay is None


@pytest.mark.parametrize("name", ["psm", "ecm", "mtml", "mtmr"])
def test_an_overlay_of_the_nominal_values_leaves_every_frame_where_it_is(name):
    arm = load_arm(name)
    mechanism = arm.mechanism
    own = load_arm(name, "none" if arm.tool else None).mechanism.frames
    same = Overlay(
        name,
        frames={f.name: frame_patch(f) for f in own},
        closures={c.name: closure_patch(c) for c in mechanism.closures},
    )
    again = apply_overlay(arm, parse_overlay(overlay_text(same), "same.toml")).mechanism
    q = 0.5 * (mechanism.lower + mechanism.upper)
    for frame, where in poses(mechanism, q).items():
        assert np.abs(poses(again, q)[frame] - where).max() < 1e-14


def test_a_file_holds_an_overlay_to_the_last_bit(tmp_path, skew_overlay, rng):
    overlay = replace(
        skew_overlay("psm", rng),
        measured={"axis_distances_m": {"3-4": {"value": 0.1 + 0.2, "sigma": 1e-6}}, "n": 3},
        source={"file": 'a "b"\\c\n.csv', "sha256": "0f", "version": "trocar 1"},
        warnings=("one", "two\t\x07"),
    )
    sigmas = FramePatch(np.ones(3), np.zeros(3), np.array([0.0, 1e-6, 2e-6]), np.full(3, 1e-5))
    overlay = replace(overlay, frames={**overlay.frames, "rcm": sigmas})
    write_overlay(tmp_path / "o.toml", overlay)
    again = read_overlay(tmp_path / "o.toml")
    assert overlay_text(again) == overlay_text(overlay)
    for name, patch in overlay.frames.items():
        for key, value in vars(patch).items():
            read = vars(again.frames[name])[key]
            assert (read is None) == (value is None)
            assert value is None or np.asarray(read).tolist() == np.asarray(value).tolist()
    assert again.measured == overlay.measured
    assert (again.source, again.warnings) == (overlay.source, overlay.warnings)
    assert again.file == str(tmp_path / "o.toml")


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path):
    path = tmp_path / "o.toml"
    write_overlay(path, Overlay("psm"))
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"measured\.x: got nan; allowed: a finite number"):
        write_overlay(path, Overlay("psm", measured={"x": float("nan")}))
    with pytest.raises(InputError, match="cannot be written"):
        write_overlay(tmp_path / "none" / "o.toml", Overlay("psm"))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["o.toml"]


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_a_parallelogram_robot_closes_by_its_couplings_and_keeps_a_remote_centre(
    name, parallel_overlay, rng, random_positions
):
    arm = load_arm(name, calibration=parallel_overlay(name, rng))
    assert arm.overlay is not None and arm.overlay.closure == "parallelogram"
    q = random_positions(arm, rng, 100)
    assert gaps(arm.mechanism, q @ arm.mechanism.ratios.T).max() < 1e-12
    shaft = pose(arm.mechanism, q, "insertion")
    across = np.cross(shaft[:, :3, 3], shaft[:, :3, 2])
    assert np.linalg.norm(across, axis=-1).max() < 1e-9


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_a_skew_robot_closes_over_its_whole_range_by_pins_that_slide(
    name, skew_overlay, rng, random_positions
):
    arm = load_arm(name, calibration=skew_overlay(name, rng))
    q = random_positions(arm, rng, 200)
    found = coordinates(arm.mechanism, q)
    assert gaps(arm.mechanism, found).max() < 1e-12
    pins = [arm.mechanism.frame_index[f"{c}_pin"] for c in ("c1", "c2")]
    assert 1e-4 < np.abs(found[:, pins]).max() < 5e-3


def test_the_overlay_between_two_arms_makes_one_of_the_other(parallel_overlay, rng):
    overlay = parallel_overlay("psm", rng)
    robot = load_arm("psm", calibration=overlay)
    again = apply_overlay(load_arm("psm"), overlay_between(load_arm("psm"), robot))
    q = np.array([0.3, 0.4, 0.1, 0.5, 0.2, 0.1, 0.2])
    assert np.abs(pose(again.mechanism, q) - pose(robot.mechanism, q)).max() < 1e-14
    assert set(overlay.frames) <= set(load_arm("psm").mechanism.frame_index)


def psm_with(**change: object) -> Overlay:
    return replace(Overlay("psm"), **change)  # type: ignore[arg-type]


ZERO = np.zeros(3)


@pytest.mark.parametrize(
    ("overlay", "error", "message"),
    [
        (Overlay("ecm"), InputError, "is a calibration of 'ecm'; it cannot be laid over 'psm'"),
        (
            psm_with(frames={"pitch_bak": FramePatch(ZERO, ZERO)}),
            UnknownNameError,
            r"unknown frame 'pitch_bak' \(did you mean 'pitch_back'\?\)",
        ),
        (
            psm_with(closures={"c3": ClosurePatch(ZERO, ZERO)}),
            UnknownNameError,
            "unknown closure 'c3'.*known: c1, c2",
        ),
        (
            psm_with(frames={"yaw": FramePatch(np.array([0.0, np.nan, 0.0]), ZERO)}),
            InputError,
            "yaw.xyz: got .*nan.*; allowed: 3 finite numbers",
        ),
        (
            psm_with(frames={"yaw": FramePatch(np.zeros(2), ZERO)}),
            InputError,
            "yaw.xyz: got .*; allowed: 3 finite numbers",
        ),
        (
            psm_with(
                closures={"c1": ClosurePatch(np.array([0.151, 0, 0]), np.array([0.096, 0, 0]))}
            ),
            DescriptionError,
            "closures.c1: the loop is no parallelogram: its error is 0.001 m.*allowed: 1e-09 m",
        ),
        (
            psm_with(
                closure="general",
                closures={"c1": ClosurePatch(np.array([0.35, 0, 0]), np.array([0.096, 0, 0]))},
            ),
            DescriptionError,
            "closures: psm: the loop error is .* m at these joint positions",
        ),
    ],
)
def test_an_overlay_that_cannot_be_laid_over_says_why(overlay, error, message):
    with pytest.raises(error, match=message):
        apply_overlay(load_arm("psm"), replace(overlay, file="o.toml"))


@pytest.mark.parametrize("tool", [None, "none"])
def test_frames_of_a_tool_are_not_calibrated_whichever_tool_is_mounted(tool):
    at = load_arm("psm").mechanism.frame("wrist_pitch")
    overlay = psm_with(frames={"wrist_pitch": frame_patch(at)})
    with pytest.raises(InputError) as rejected:
        apply_overlay(load_arm("psm", tool), replace(overlay, file="o.toml"))
    message = str(rejected.value)
    assert "o.toml: " in message
    assert "wrist_pitch" in message
    assert "pitch_end, insertion" in message
    assert "finger_left" not in message
    if tool is None:
        assert "frames.wrist_pitch: is a frame of the tool LARGE_NEEDLE_DRIVER:400006" in message


def test_pins_that_slide_stay_where_they_are(skew_overlay, rng):
    nominal = load_arm("psm")
    skew = skew_overlay("psm", rng)
    robot = apply_overlay(nominal, skew)
    (c1, c2) = robot.mechanism.closures
    with pytest.raises(InputError, match="c1: its pin slides already; give its mechanism as well"):
        closure_patch(c1)
    patch = closure_patch(c2, mechanism=robot.mechanism)
    assert patch.slides
    assert np.array_equal(patch.point_b, skew.closures["c2"].point_b)
    again = apply_overlay(nominal, overlay_between(nominal, robot))
    q = np.linspace(robot.mechanism.lower, robot.mechanism.upper, 5)
    there, here = (poses(arm.mechanism, q) for arm in (robot, again))
    for name, expected in there.items():
        assert np.abs(here[name] - expected).max() < 1e-12, name


def test_one_calibration_is_not_laid_over_another():
    with pytest.raises(InputError, match=r"psm carries the calibration a\.toml already"):
        apply_overlay(load_arm("psm", calibration=Overlay("psm", file="a.toml")), Overlay("psm"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('arm = "psm"', "schema: got None; allowed: 1"),
        ("schema = 1", "arm: is missing"),
        (
            'schema = 1\narm = "psm"\nclosure = "open"',
            "closure: got 'open'; allowed: parallelogram",
        ),
        ('schema = 1\narm = "psm"\ncolour = 1', "colour: unknown key"),
        ('schema = 1\narm = "psm"\n[frames.yaw]\nxyz_m = [0, 0, 0]', "frames.yaw.rpy: is missing"),
        (
            'schema = 1\narm = "psm"\n[frames.yaw]\nxyz_m = [0, nan, 0]\nrpy_rad = [0, 0, 0]',
            "frames.yaw.xyz_m: got nan; allowed: a finite number",
        ),
        (
            'schema = 1\narm = "psm"\n[frames.yaw]\nxyz_m = [0, 0]\nrpy_rad = [0, 0, 0]',
            "frames.yaw.xyz_m: got .*; allowed: a list of 3 numbers",
        ),
        (
            'schema = 1\narm = "psm"\n[frames.yaw]\nxyz_m = [0, 0, 0]\nrpy_rad = [0, 0, 0]\n'
            "xyz_sigma_m = [0, -1, 0]",
            "frames.yaw.xyz_sigma: got .*; allowed: 0 or more",
        ),
        ('schema = 1\narm = "psm"\nmeasured = 3', "measured: got 3; allowed: a table"),
        ('schema = 1\narm = "psm', "is not TOML"),
    ],
)
def test_a_broken_file_says_what_is_wrong_and_where(tmp_path, text, message):
    path = tmp_path / "broken.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DescriptionError, match=f"broken.toml: {message}"):
        read_overlay(path)


def test_a_file_that_is_not_there_is_named():
    with pytest.raises(DescriptionError, match=r"nowhere\.toml: cannot be read"):
        load_arm("psm", calibration="nowhere.toml")


# ---------------------------------------------------------------- rigs


@pytest.fixture
def file(tmp_path: Path, skew_overlay, rng) -> str:
    path = tmp_path / "psm_o.toml"
    write_overlay(path, skew_overlay("psm", rng))
    return str(path)


def test_a_calibration_is_for_every_arm_of_its_kind_or_for_one(file):
    assert set(rig_overlays(load_rig("three_psm", file))) == {"PSM1", "PSM2", "PSM3"}
    assert set(rig_overlays(load_rig("three_psm", {"PSM2": file}))) == {"PSM2"}
    assert set(rig_overlays(load_rig("three_psm", [f"PSM3={file}"]))) == {"PSM3"}
    both = load_rig("three_psm", [file, f"PSM1={file}"])
    assert rig_overlays(both)["PSM1"] is not rig_overlays(both)["PSM2"]
    assert rig_overlays(both)["PSM2"] is rig_overlays(both)["PSM3"]


def test_roots_stay_where_the_rig_has_them(file):
    nominal, robot = load_rig("two_psm_ecm"), load_rig("two_psm_ecm", file)
    for one, other in zip(nominal.arms, robot.arms, strict=True):
        np.testing.assert_array_equal(one.pose, other.pose)
    assert robot.arm("ECM").arm.overlay is None


def test_a_calibration_for_nobody_in_the_rig_is_rejected(file):
    with pytest.raises(InputError, match="calibration of 'psm'; the arms of rig ecm are of ecm"):
        load_rig("ecm", file)
    with pytest.raises(UnknownNameError, match=r"unknown arm 'PSM9'.*known: PSM1, PSM2, PSM3"):
        load_rig("three_psm", {"PSM9": file})
    with pytest.raises(InputError, match="got two for 'psm'; allowed: one"):
        load_rig("three_psm", [file, file])


def test_another_tool_leaves_the_calibration_on_the_arm(file):
    rig = load_rig("psm", file)
    other = rig_with_tool(rig, "PSM1", "PROGRASP_FORCEPS:420093")
    assert rig_overlays(other).keys() == {"PSM1"}
    for frame in ("pitch_end", "insertion", "c1_pin"):
        before, after = (r.arm("PSM1").arm.mechanism.frame(frame).before for r in (rig, other))
        np.testing.assert_array_equal(before, after)
