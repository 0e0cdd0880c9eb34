"""What the tests of the tracks share: small files of each format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

TIDY_HEAD = "time_s,body,x_m,y_m,z_m,qw,qx,qy,qz"

# Source: the layout of Motive 2.x, format 1.23; own numbers.
MOTIVE = """\
Format Version,1.23,Take Name,psm q2 sweep,Take Notes,,Capture Frame Rate,120.000000,\
Export Frame Rate,120.000000,Capture Start Time,2024-01-01 09.00.00.000 AM,\
Total Frames in Take,3,Total Exported Frames,3,Rotation Type,Quaternion,\
Length Units,Meters,Coordinate Space,Global

,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,\
Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body
,Name,psm_base,psm_base,psm_base,psm_base,psm_base,psm_base,psm_base,psm_base,\
psm_yaw,psm_yaw,psm_yaw,psm_yaw,psm_yaw,psm_yaw,psm_yaw,psm_yaw
,ID,"A1","A1","A1","A1","A1","A1","A1","A1","B2","B2","B2","B2","B2","B2","B2","B2"
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,\
Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z,W,X,Y,Z,
0,0,0.1,0.2,0.3,0.927362,0.5,1.2,-0.3,0.00021,-0.02,0.01,0.7,-0.713793,0.61,1.31,-0.28,0.000187
1,0.008333,0.1,0.2,0.3,0.927362,0.500012,1.200034,-0.3,0.000205,,,,,,,,
2,0.016667,0.100001,0.2,0.3,0.927362,0.5,1.199981,-0.30002,0.000199,\
-0.02,0.01,0.7,-0.713793,0.61,1.31,-0.279985,0.00019
"""

Writer = Callable[..., Path]


@pytest.fixture
def tidy_file(tmp_path: Path) -> Writer:
    """Return the function that writes rows under the tidy header."""

    def write(*rows: str, head: str = TIDY_HEAD, end: str = "\n") -> Path:
        path = tmp_path / "tracks.csv"
        path.write_text(end.join([head, *rows, ""]), encoding="utf-8", newline="")
        return path

    return write


@pytest.fixture
def motive_file(tmp_path: Path) -> Writer:
    """Return the function that writes the example take, some of its text replaced."""

    def write(*changes: tuple[str, str], head: str = "", end: str = "\n") -> Path:
        text = MOTIVE
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "take.csv"
        path.write_text(head + text.replace("\n", end), encoding="utf-8", newline="")
        return path

    return write
