"""`trocar fk`: poses of frames, for programs and for people."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm, names
from trocar.kinematics import forward

PSM = ["0.3", "-0.2", "0.15", "-1.2e-05", "0.4", "-0.5"]
LND = "LARGE_NEEDLE_DRIVER:400006"


def pose(name, q, frame=None, tool=None):
    return forward.pose(load_arm(name, tool).mechanism, q, frame)


def test_the_tip_comes_as_one_json_document(trocar):
    answer = trocar("fk", "psm", *PSM, "--json")
    assert (answer.status, answer.err) == (0, "")
    wanted = pose("psm", [*map(float, PSM), 0.0])
    # Python writes the shortest digits that read back to the same number.
    assert answer.document == {
        "arm": "psm",
        "tool": LND,
        "relative_to": "rcm",
        "frame": "tip",
        "pose": wanted.tolist(),
    }


@pytest.mark.parametrize("name", names("arms"))
def test_every_arm_answers_with_every_frame(name, trocar, rng, random_positions):
    arm = load_arm(name)
    q = random_positions(arm, rng, 1)[0]
    document = trocar("fk", name, *q, "--frame", "all", "--json").document
    assert set(document) == {"arm", "tool", "relative_to", "frames"}
    assert document["relative_to"] == arm.mechanism.reference
    assert tuple(document["frames"]) == arm.mechanism.frame_names
    for frame, wanted in forward.poses(arm.mechanism, q).items():
        assert np.array_equal(document["frames"][frame], wanted)


def test_a_seventh_value_is_the_jaw(trocar):
    q = [0.3, -0.2, 0.15, 0.1, 0.4, -0.5, 0.8]
    for frame, moved in (("finger_left", True), ("tip", False)):
        wide = trocar("fk", "psm", *q, "--frame", frame, "--json").document["pose"]
        shut = trocar("fk", "psm", *q[:6], "--frame", frame, "--json").document["pose"]
        assert np.array_equal(wide, pose("psm", q, frame))
        assert (wide != shut) == moved


def test_another_tool_is_as_long_as_it_is(trocar):
    straight = [0, 0, 0.1, 0, 0, 0]
    tool = "LARGE_NEEDLE_DRIVER:420006"
    longer = trocar("fk", "psm", *straight, "--tool", tool, "--json").document
    assert longer["tool"] == tool
    # facts, section 5: d4 = 0.4670 m beside 0.4162 m.
    shorter = trocar("fk", "psm", *straight, "--json").document
    assert longer["pose"][2][3] - shorter["pose"][2][3] == pytest.approx(-0.0508, abs=1e-12)


def test_an_arm_without_tool_has_none(trocar):
    assert trocar("fk", "ecm", 0, 0, 0.1, 0, "--json").document["tool"] is None
    bare = trocar("fk", "psm", 0, 0, 0.1, "--tool", "none", "--json").document
    assert (bare["tool"], bare["frame"]) == (None, "insertion")


def test_people_read_metres_and_a_quaternion(trocar):
    out = trocar("fk", "psm", 0, 0, 0.12, 0, 0, 0).out
    assert out.splitlines() == [
        f"psm with {LND}: tip in rcm",
        "",
        "        x [m]        y [m]         z [m]",
        "  0.000000000  0.000000000  -0.113500000",
        "",
        "           qw            qx            qy           qz",
        "  0.000000000  -0.707106781  -0.707106781  0.000000000",
        "",
        "     0.000000000   1.000000000   0.000000000   0.000000000",
        "     1.000000000   0.000000000   0.000000000   0.000000000",
        "     0.000000000   0.000000000  -1.000000000  -0.113500000",
        "     0.000000000   0.000000000   0.000000000   1.000000000",
    ]


def test_beyond_a_limit_is_computed_with_a_warning(trocar):
    answer = trocar("fk", "ecm", 0, 0, 0.3, 0, "--json")
    assert answer.status == 0
    wanted = "trocar: warning: insertion 0.3 m is beyond its limits 0 to 0.255 m\n"
    assert answer.err == wanted
    assert np.array_equal(answer.document["pose"], pose("ecm", [0, 0, 0.3, 0]))


BARE = """
schema = 1
name = "pointer"
type = "MTM"
source = "a test"
root = "base"
relative_to = "base"
tip = "tip"

[[joint]]
name = "swing"
kind = "revolute"
lower_deg = -90
upper_deg = 90
drive = { tip = 1.0 }

[[frame]]
name = "base"

[[frame]]
name = "tip"
parent = "base"
xyz_mm = [100.0, 0.0, 0.0]
motion = "revolute"
q = { swing = 1.0 }
"""


def test_an_arm_of_one_s_own_is_named_by_its_file(trocar, tmp_path):
    path = tmp_path / "pointer.toml"
    path.write_text(BARE, encoding="utf-8")
    document = trocar("fk", path, 0.5, "--json").document
    assert document["arm"] == "pointer"
    assert document["pose"][0][3] == pytest.approx(0.1)
    assert trocar("show", path).status == 0


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["pms", 0], "unknown arm 'pms' (did you mean 'psm'?); known: ecm,"),
        (["psm", 0, 0], "psm: got 2 joint positions; allowed: 6 (yaw, pitch, insertion, roll, "),
        (["ecm", 0], "ecm: got 1 joint positions; allowed: 4 (yaw, pitch, insertion, roll)"),
        (["ecm", 0, 0, "nan", 0], "ecm: joint positions must be finite, got [0.0, 0.0, nan, 0.0]"),
        (["ecm", 0, 0, "-inf", 0], "ecm: joint positions must be finite, got [0.0, 0.0, -inf"),
        (["ecm", 0, 0, 0, 0, "--frame", "tpi"], "ecm: unknown frame 'tpi' (did you mean 'tip'?)"),
        (
            ["psm", 0, "--tool", "SPOON"],
            "unknown tool 'SPOON'; known: FENESTRATED_BIPOLAR_FORCEPS:400205",
        ),
        (["nowhere/arm.toml", 0], "nowhere/arm.toml: there is no such file"),
    ],
)
def test_bad_input_is_refused(words, complaint, trocar):
    answer = trocar("fk", *words)
    assert answer.status == 2
    assert answer.complaint.startswith(complaint)


def test_a_tool_that_nothing_can_hold_is_refused(trocar):
    answer = trocar("fk", "ecm", 0, 0, 0, 0, "--tool", LND)
    assert answer.status == 2
    assert f"ecm.toml: tool_frame: is missing, so no tool ({LND}) can be mounted" in answer.err


def test_a_broken_file_is_named_with_key_got_and_allowed(trocar, tmp_path):
    path = tmp_path / "broken.toml"
    path.write_text(BARE.replace("lower_deg = -90", "lower_deg = 95"), encoding="utf-8")
    answer = trocar("fk", path, 0)
    assert answer.status == 2
    assert "joint[0].lower: got 1.65806; allowed: less than the upper limit" in answer.complaint
    path.write_text("schema = ", encoding="utf-8")
    assert "broken.toml: is not TOML: " in trocar("fk", path, 0).complaint
