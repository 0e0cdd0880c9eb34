"""Exports of Motive: every layout that is known, and what is refused with which words."""

from __future__ import annotations

import re

import numpy as np
import pytest

from trocar.errors import TracksError
from trocar.geometry import matrix_from_quaternion
from trocar.robot.calibration import read_tracks


def same(path, reference) -> bool:
    tracks = read_tracks(path)
    return list(tracks.poses) == list(reference.poses) and all(
        np.array_equal(tracks.poses[body], pose, equal_nan=True)
        for body, pose in reference.poses.items()
    )


def with_column(text: str, index: int, cells: dict[str, str]) -> str:
    """Put one more column in front of each line's cells from the label row on."""
    first, *rest = text.split("\n")
    done = []
    for line in rest:
        parts = line.split(",")
        if len(parts) > index:
            parts.insert(index, cells.get(parts[0], "" if not parts[0] else "00:00:00:00"))
        done.append(",".join(parts))
    return "\n".join([first, *done])


def test_quaternions_have_the_scalar_last_and_blank_is_not_tracked(motive_file):
    tracks = read_tracks(motive_file())
    assert list(tracks.poses) == ["psm_base", "psm_yaw"]
    assert tracks.rate_hz == 120.0
    assert tracks.warnings == ()
    pose = tracks.poses["psm_base"][1]
    assert pose[:3, 3].tolist() == [0.500012, 1.200034, -0.3]
    assert pose[:3, :3] == pytest.approx(matrix_from_quaternion([0.927362, 0.1, 0.2, 0.3]))
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0, abs=1e-15)
    assert tracks.tracked("psm_yaw").tolist() == [True, False, True]


def test_blank_lines_line_ends_and_a_byte_order_mark_make_no_difference(motive_file):
    reference = read_tracks(motive_file())
    assert same(motive_file(end="\r\n"), reference)
    assert same(motive_file(head="\ufeff"), reference)
    assert same(motive_file(("\n\n,Type", "\n,Type")), reference)
    assert same(motive_file(("\n\n,Type", "\n,,,,,,\n,Type")), reference)
    assert same(motive_file(('"A1"', "A1"), ("Global\n", "Global,,,,,\n")), reference)


def test_older_and_newer_layouts_are_read_by_their_labels(motive_file):
    path = motive_file()
    reference, text = read_tracks(path), path.read_text(encoding="utf-8")
    parent = re.sub(r"\n,ID,.*", lambda m: m[0] + "\n,Parent" + 16 * ",", text)
    path.write_text(parent.replace("1.23", "1.25"), encoding="utf-8")
    assert same(path, reference)
    path.write_text(with_column(text, 2, {"Frame": "TimeCode"}), encoding="utf-8")
    assert same(path, reference)
    path.write_text(with_column(text, 1, {"Frame": "TimeCode"}), encoding="utf-8")
    assert same(path, reference)
    assert same(motive_file((",Take Notes,", ""), ("1.23", "1.2")), reference)
    assert same(motive_file(("Mean Marker Error", "Error Per Marker")), reference)


def test_free_text_may_hold_commas_and_keys(motive_file):
    reference = read_tracks(motive_file())
    for note in ("one, two, three", '"quoted, text"', "Length Units,Feet"):
        assert same(motive_file(("Take Notes,,", f"Take Notes,{note},")), reference)


def test_markers_and_bones_are_passed_over(motive_file):
    path = motive_file()
    reference = read_tracks(path)
    lines = path.read_text(encoding="utf-8").splitlines()
    more = {
        ",Type": ",Rigid Body Marker,Marker", ",Name": ",psm_base:Marker1,Unlabeled 1189",
        ",ID": ",C1,D1", ",,": ",Position,Position", "Frame": ",X,X",
    }  # fmt: skip
    lines = [
        line + next((cells for start, cells in more.items() if line.startswith(start)), ",1,")
        if line and number else line
        for number, line in enumerate(lines)
    ]  # fmt: skip
    path.write_text("\n".join(lines), encoding="utf-8")
    assert same(path, reference)


@pytest.mark.parametrize(("unit", "metres"), [("Millimeters", 1e-3), ("Centimeters", 1e-2)])
def test_lengths_are_read_in_the_unit_of_the_header(unit, metres, motive_file):
    path = motive_file(("Meters", unit), ("0.5,1.2,-0.3", f"{0.5 / metres},{1.2 / metres},0"),
                       ("0.61,1.31", f"{0.61 / metres},{1.31 / metres}"))  # fmt: skip
    assert read_tracks(path).poses["psm_base"][0, :2, 3] == pytest.approx([0.5, 1.2])


@pytest.mark.parametrize(
    ("change", "warned"),
    [
        (("1.23", "1.31"), "unknown format version 1.31; read as version 1.25"),
        (("Frames,3", "Frames,9"), "announces 9 frames, got 3"),
        (("Export Frame Rate,120", "Export Frame Rate,100"),
         "the header says 100 Hz, the times 120 Hz; the times are used"),
    ],
)  # fmt: skip
def test_what_looks_odd_is_a_warning(change, warned, motive_file):
    (text,) = read_tracks(motive_file(change)).warnings
    assert warned in text


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ([("Length Units,Meters,", "")],
         "line 1: Length Units: got none; allowed: Meters, Centimeters, Millimeters, Inches"),
        ([("Meters", "Furlongs")], "line 1: Length Units: got 'Furlongs'; allowed: Meters"),
        ([("Quaternion", "XYZ")], "line 1: Rotation Type: got 'XYZ'; allowed: Quaternion"),
        ([("Global", "Local")], "line 1: Coordinate Space: got 'Local'; allowed: Global"),
        ([("X,Y,Z,W,", "X,Y,Z,,")], "psm_base: columns missing: Rotation W; was its rotation"),
        ([("Rigid Body", "Bone")], "contains no rigid body; found columns of: Bone; allowed"),
        ([("psm_yaw", "psm_base")], "two rigid bodies are named 'psm_base'"),
        ([(",Name,", ",Title,")], "the header has no row of Name"),
        ([("Frame,Time", "Number,Time")], 'no line begins with "Frame"'),
        ([("Time (Seconds)", "Seconds")], 'the header has no column "Time (Seconds)"'),
        ([("\n2,0.01", "\n1,0.01")], "line 10: frame 1 comes after frame 1; allowed"),
        ([("0.016667", "0.003333")], "line 10: Time (Seconds): got the time 0.003333 s after"),
        ([("0.61,1.31,-0.28,", "0.61,,-0.28,")],
         "line 8: psm_yaw: 1 of 7 values are blank; allowed: seven numbers, or all seven blank"),
        ([("0.61,1.31,-0.28,", "0.61,nan,-0.28,")],
         "line 8: psm_yaw, Position Y: got 'nan'; allowed: a finite number"),
        ([("-0.713793", "0.3")], "line 8: psm_yaw: got a quaternion of norm 0.761906"),
        ([("Export Frame Rate,120", "Export Frame Rate,fast")],
         "line 1: Export Frame Rate: got 'fast.000000'; allowed: above 0 Hz"),
        ([("0.61,1.31", "610,1310")], "m apart, more than the size of an arm"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_named_with_its_line(changes, said, motive_file):
    with pytest.raises(TracksError) as refused:
        read_tracks(motive_file(*changes))
    assert said in str(refused.value)


def test_an_export_without_its_header_is_refused(motive_file):
    path = motive_file()
    path.write_text("\n".join(path.read_text().splitlines()[7:]), encoding="utf-8")
    with pytest.raises(TracksError, match=r"line 1: has no header"):
        read_tracks(path)
