"""trocar import from the command line: what it prints, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.conftest import Command

pytest.importorskip("lxml", reason="lxml is not installed (extra export)")
trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")


def test_an_object_is_imported_and_told_as_json(trocar: Command, tmp_path: Path) -> None:
    trimesh.creation.box([100.0, 20.0, 10.0]).export(tmp_path / "bar.stl")
    answer = trocar(
        "import", str(tmp_path / "bar.stl"), "--unit", "mm", "--mass", "0.2", "-o",
        str(tmp_path / "bar"), "--json",
    )  # fmt: skip
    assert answer.status == 0
    told = answer.document
    assert (told["name"], told["kind"], told["mass"], told["pieces"]) == ("bar", "prop", 0.2, 1)
    assert Path(told["file"]).is_file()


def test_the_wrong_unit_is_bad_input(trocar: Command, tmp_path: Path) -> None:
    trimesh.creation.box([100.0, 20.0, 10.0]).export(tmp_path / "bar.stl")
    answer = trocar("import", str(tmp_path / "bar.stl"), "-o", str(tmp_path / "bar"))
    assert answer.status == 2
    assert "got a size of 100 m" in answer.complaint
    assert not (tmp_path / "bar").exists()
