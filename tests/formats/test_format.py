"""A format is one file: found, listed, written and read without an edit elsewhere."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.formats.dropped import PLAIN, drop_in
from trocar.errors import InputError
from trocar.formats.export import export, find_rig
from trocar.formats.format import formats
from trocar.formats.importing import import_file


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("lxml", reason="exports need the extra 'export'")
    drop_in(monkeypatch, tmp_path / "formats", "plain", PLAIN)


def test_a_dropped_in_format_is_found_behind_the_others() -> None:
    assert list(formats()) == ["urdf", "sdf", "mjcf", "plain"]
    assert formats()["plain"].option_names == ("note", "fail")
    assert formats()["urdf"].option_names == ("package", "fit_tip")


def test_a_dropped_in_format_is_written_with_its_options(tmp_path: Path) -> None:
    done = export(find_rig("ecm"), "plain", tmp_path / "out", {"note": "short"})
    assert done.files == ("model.txt", "parts/part.txt")
    assert (tmp_path / "out" / "model.txt").read_text(encoding="utf-8").endswith("note short")


def test_a_dropped_in_format_is_read_by_its_ending(tmp_path: Path) -> None:
    (tmp_path / "ball.plain").write_text("0.25", encoding="utf-8")
    found = import_file(tmp_path / "ball.plain", tmp_path / "out")
    assert (found.kind, found.name, found.mass) == ("prop", "ball", 0.25)
    with pytest.raises(
        InputError, match=r"allowed: .urdf, .xacro, .sdf, .xml, .mjcf, .plain, .obj"
    ):
        import_file(__file__, tmp_path / "other")


def test_formats_are_found_without_their_libraries() -> None:
    code = "import sys; from trocar.formats.format import formats; formats(); print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numpy", "mujoco", "lxml", "trimesh"} & set(ran.stdout.split())
