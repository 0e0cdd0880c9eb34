"""`trocar list` and `trocar show`: what there is, and where its numbers are from."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from trocar.cli.output import short, table
from trocar.descriptions import load_arm, names
from trocar.geometry import modified_dh, standard_dh
from trocar.kinematics.loops import flattenings

SHELVES = ("arms", "tools", "rigs", "cameras", "scenes")


def test_everything_on_a_shelf_is_listed(trocar):
    for shelf in SHELVES:
        document = trocar("list", shelf, "--json").document
        assert [row["name"] for row in document[shelf]] == list(names(shelf))
        lines = trocar("list", shelf).out.splitlines()
        assert [line.split()[0] for line in lines] == [shelf[:-1], *names(shelf)]


def test_without_a_shelf_all_are_listed(trocar):
    assert set(trocar("list", "--json").document) == set(SHELVES)
    out = trocar("list").out
    assert all(name in out for shelf in SHELVES for name in names(shelf))


def test_a_list_says_what_each_is(trocar):
    arms = {row["name"]: row for row in trocar("list", "arms", "--json").document["arms"]}
    assert arms["psm"]["type"] == "PSM" and arms["psm"]["joints"] == 6
    assert arms["psm"]["tool"] == "LARGE_NEEDLE_DRIVER:400006" and arms["ecm"]["tool"] is None
    rigs = {row["name"]: row for row in trocar("list", "rigs", "--json").document["rigs"]}
    assert rigs["two_psm_ecm"]["arms"] == ["PSM1", "PSM2", "ECM"]
    cameras = {row["name"]: row for row in trocar("list", "cameras", "--json").document["cameras"]}
    assert cameras["hd_1280x720"]["size"] == [1280, 720]
    assert cameras["hd_1280x720"]["fov_deg"][0] == 60.0


def test_an_arm_shows_all_of_itself_and_every_source(trocar):
    for name in names("arms"):
        arm = load_arm(name)
        document = trocar("show", name, "--json").document
        assert document["arm"] == name
        assert [j["name"] for j in document["joints"]] == list(arm.mechanism.joint_names)
        assert [j["upper"] for j in document["joints"]] == arm.mechanism.upper.tolist()
        assert [b["mass"] for b in document["bodies"]] == [b.mass for b in arm.bodies]
        assert [f["name"] for f in document["frames"]] == [f.name for f in arm.mechanism.frames]
        margins = [f["margin"] for c in document["closures"] for f in c["flattenings"]]
        found = [f.margin for f in flattenings(arm.mechanism)]
        assert margins == [margin if math.isfinite(margin) else None for margin in found]
        spoken = " ".join(trocar("show", name).out.split())
        for text in (*arm.mechanism.frame_names, *arm.control, *arm.poses, arm.title):
            assert text in spoken, name
        for entry in arm.missing:
            assert entry.what in spoken and entry.why in spoken, name
        sources = {
            arm.source,
            *(j.source for j in arm.joints),
            *(b.source for b in arm.bodies),
            *(c.source for c in arm.control.values()),
            *arm.row_sources.values(),
            *arm.block_sources.values(),
        }
        assert not [s for s in sources if " ".join(s.split()) not in spoken], name


def test_blocks_of_arm_and_tool_keep_their_sources():
    sources = load_arm("psm").block_sources
    tool = "LARGE_NEEDLE_DRIVER:400006"
    assert "Wang 2019" in sources["friction identified"]
    assert "each finger" in sources[f"{tool} friction identified"]
    assert "share/tool" in sources[tool]
    assert "150 and 29.6 + 66.4 mm" in sources["loop c1"]
    assert f"{tool} rotor" in sources and "rotor" in sources


def test_frames_are_shown_as_the_dh_rows_that_place_them(trocar):
    for name in names("arms"):
        frames = trocar("show", name, "--json").document["frames"]
        rows = [frame for frame in frames if frame["dh"]]
        assert len(rows) > len(frames) / 2, name
        for frame in rows:
            dh = dict(frame["dh"])
            make = {"modified": modified_dh, "standard": standard_dh}[dh.pop("convention")]
            assert np.abs(make(**dh) - frame["pose"]).max() < 1e-9, (name, frame["name"])


def test_the_psm_is_shown_in_the_rows_of_table_4(trocar):
    out = trocar("show", "psm").out
    assert "modified DH: a -0.1 m, alpha 1.570796 rad" in out
    assert "slides by 0.6025 insertion" in out
    assert "xyz (0, 0.4864, 0) m" in out
    assert "turns by -0.5 jaw" in out and "2 finger_left" in out


def test_a_loop_that_flattens_near_the_limits_is_warned_of(trocar, tmp_path):
    path = tmp_path / "bold.toml"
    text = Path(load_arm("psm").file).read_text(encoding="utf-8")
    path.write_text(text.replace("lower_rad = -0.925025", "lower_rad = -1.2"), encoding="utf-8")
    answer = trocar("show", path, "--json")
    assert answer.status == 0
    assert answer.err.startswith("trocar: warning: loop c1 is singular 0.080")
    assert "rad from the limits of pitch; allowed: 0.2 rad or more" in answer.err
    assert answer.document["arm"] == "psm"
    assert trocar("show", "psm", "--json").err == ""


def test_a_table_is_flush_right_where_there_are_numbers():
    text = table(["name", "m"], [["a", "1.5"], ["long", "-12"]], indent="")
    assert text.splitlines() == ["name    m", "a     1.5", "long  -12"]


def test_numbers_that_are_none_are_said_to_be():
    assert [short(v) for v in (None, float("inf"), float("nan"), 1e-17, -0.0, np.pi / 2)] == [
        "-", "-", "-", "0", "0", "1.570796",
    ]  # fmt: skip


@pytest.mark.parametrize("words", [["show", "pms"], ["show", "pms", "--json"]])
def test_an_unknown_arm_is_refused(words, trocar):
    answer = trocar(*words)
    assert answer.status == 2
    assert answer.complaint.startswith("unknown arm 'pms' (did you mean 'psm'?); known: ecm, ")
