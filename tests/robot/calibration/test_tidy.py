"""The tidy format: what is read, and what is refused with which words."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from trocar.errors import TracksError
from trocar.robot.calibration import read_tracks

BASE = "psm_base,0.5,1.2,-0.3,1,0,0,0"
YAW = "psm_yaw,0.6,1.3,-0.2,0.6,0,0.8,0"


def test_a_row_is_a_pose_in_the_camera(tidy_file):
    path = tidy_file(f"0,{BASE}", f"0,{YAW}", f"0.01,{BASE}", f"0.01,{YAW}")
    tracks = read_tracks(path)
    assert tracks.times == pytest.approx([0.0, 0.01])
    assert tracks.rate_hz == pytest.approx(100.0)
    assert tracks.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    # A turn about y by 2 atan(0.8 / 0.6): cos = 0.36 - 0.64, sin = 2 * 0.48.
    expected = [[-0.28, 0, 0.96, 0.6], [0, 1, 0, 1.3], [-0.96, 0, -0.28, -0.2], [0, 0, 0, 1]]
    assert tracks.poses["psm_yaw"][1] == pytest.approx(np.array(expected))
    assert tracks.warnings == ()


def test_blank_rows_and_missing_rows_are_both_not_tracked(tidy_file):
    tracks = read_tracks(
        tidy_file(f"0,{BASE}", f"0,{YAW}", f"0.1,{BASE}", "0.1,psm_yaw,,,,,,,", f"0.2,{BASE}")
    )
    assert tracks.tracked("psm_base").all()
    assert tracks.tracked("psm_yaw").tolist() == [True, False, False]
    assert np.isnan(tracks.poses["psm_yaw"][1:]).all()
    assert tracks.coverage("psm_yaw").startswith("1 of 3 samples")


def test_the_order_of_bodies_and_columns_does_not_matter(tidy_file):
    by_time = read_tracks(tidy_file(f"0,{BASE}", f"0,{YAW}", f"1,{BASE}", f"1,{YAW}"))
    by_body = read_tracks(
        tidy_file(
            "1,0,0,0,psm_base,0.5,1.2,-0.3,0,x",
            "1,0,0,0,psm_base,0.5,1.2,-0.3,1,y",
            "0.6,0,0.8,0,psm_yaw,0.6,1.3,-0.2,0,z",
            "0.6,0,0.8,0,psm_yaw,0.6,1.3,-0.2,1,",
            head="qw,qx,qy,qz,body,x_m,y_m,z_m,time_s,remark",
        )
    )
    for body, pose in by_time.poses.items():
        assert np.array_equal(by_body.poses[body], pose)


def test_the_sign_of_a_quaternion_and_a_spreadsheet_change_nothing(tidy_file):
    plain = read_tracks(tidy_file(f"0,{BASE}", f"0,{YAW}", f"1,{BASE}", f"1,{YAW}"))
    other = read_tracks(
        tidy_file(
            f"0,{BASE}",
            f"0,{YAW}",
            f'1,"psm_base",{BASE[9:]}',
            "1,psm_yaw,0.6,1.3,-0.2,-0.6,0,-0.8,0",
            head="\ufefftime_s,body,x_m,y_m,z_m,qw,qx,qy,qz",
            end="\r\n",
        )
    )
    for body, pose in plain.poses.items():
        assert np.array_equal(other.poses[body], pose)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([f"0,{BASE}", "1,psm_base,nan,0,0,1,0,0,0"],
         "line 3: x_m: got 'nan'; allowed: a finite number, or blank"),
        ([f"0,{BASE}", "1,psm_base,0,0,zero,1,0,0,0"], "line 3: z_m: got 'zero'; allowed"),
        ([f"0,{BASE}", "1,psm_base,0,0,inf,1,0,0,0"], "line 3: z_m: got 'inf'; allowed"),
        ([f"0,{BASE}", "1,psm_base,0,0,,1,0,0,0"], "line 3: psm_base: 1 of 7 values are blank"),
        ([f"0,{BASE}", f" ,{BASE}"], "line 3: time is blank; allowed: seconds"),
        ([f"0,{BASE}", "1,,0,0,0,1,0,0,0"], "line 3: body: is blank"),
        ([f"1,{BASE}", f"0,{YAW}", f"0.5,{BASE}"],
         "line 4: psm_base: got the time 0.5 s after 1 s; allowed: increasing times"),
        ([f"1,{BASE}", f"0,{YAW}", f"1,{BASE}"],
         "line 4: psm_base: got the time 1 s a second time; allowed"),
        ([f"0,{BASE}", "1,psm_base,0,0,0,0.9,0,0,0"],
         "line 3: psm_base: got a quaternion of norm 0.9 (w, x, y, z = 0.9, 0, 0, 0); allowed"),
        ([f"0,{BASE}"], "got 1 samples; allowed: 2 or more"),
        ([], "has a header but no rows"),
        (["0,a,500,1200,-300,1,0,0,0", "0,b,610,1310,100,1,0,0,0", "1,b,610,1310,100,1,0,0,0"],
         "a and b are 429.2 m apart, more than the size of an arm: are the positions in millimetres"
         " (1000 times too large)?"),
        (["0,a,50,0,0,1,0,0,0", "0,b,10,0,0,1,0,0,0", "1,b,10,0,0,1,0,0,0"],
         "a and b are 40 m apart, more than the size of an arm: are the positions in centimetres"),
        (["0,a,0,0,0,1,0,0,0", "0,b,0.0003,0,0,1,0,0,0", "1,b,0.0003,0,0,1,0,0,0"],
         "all bodies lie within 0.0003 m"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_named_with_its_line(rows, said, tidy_file):
    with pytest.raises(TracksError) as refused:
        read_tracks(tidy_file(*rows))
    assert said in str(refused.value)
    assert str(refused.value).startswith(str(tidy_file(*rows)))


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ("time_s,body,x_mm,y_mm,z_mm,qw,qx,qy,qz",
         "line 1: columns missing: x_m, y_m, z_m; found: time_s, body, x_mm"),
        ("0,0.1,0.2,0.3", "line 1: has no header; export it with the header"),
        ("time_s;body;x_m", "line 1: is separated by semicolons; allowed"),
        ("name,value", "line 1: got 'name,value' as the first line; allowed: a Motive export"),
        ("", "line 2: has no header"),
    ],
)  # fmt: skip
def test_a_header_that_is_none_is_named(head, said, tidy_file):
    with pytest.raises(TracksError) as refused:
        read_tracks(tidy_file(f"0,{BASE}", head=head))
    assert said in str(refused.value)


def test_a_file_that_is_empty_missing_or_binary_is_named(tmp_path):
    for content, said in ((b"", "is empty; allowed"), (b"\xff\xfe\0", "is not UTF-8 text")):
        (tmp_path / "a.csv").write_bytes(content)
        with pytest.raises(TracksError, match=said):
            read_tracks(tmp_path / "a.csv")
    with pytest.raises(TracksError, match=r"cannot be read: No such file"):
        read_tracks(tmp_path / "none.csv")
