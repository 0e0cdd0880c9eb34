"""`trocar export`: what it prints, and what it refuses."""

from __future__ import annotations

import pytest

from trocar.formats.exports import FORMATS
from trocar.formats.exports.task import ExportTask, Format


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("lxml", reason="exports need the extra 'export'")

    def write(task: ExportTask) -> tuple[str, ...]:
        text = f"{task.options.package or 'no'} package, SDF {task.options.sdf_version}\n"
        (task.folder / "model.txt").write_text(text, encoding="utf-8")
        return ("straight lines",)

    monkeypatch.setitem(FORMATS, "plain", Format("Plain", write, ("package", "sdf_version")))


def test_an_export_says_what_it_wrote_and_warns_on_stderr(trocar, tmp_path):
    answer = trocar("export", "ecm", "--format", "plain", "-o", tmp_path / "out")
    assert answer.status == 0
    assert answer.err == "trocar: warning: straight lines\n"
    head, *files = answer.out.splitlines()
    assert head.startswith(f"{tmp_path / 'out'}: plain, ") and "links" in head
    assert files == ["  model.txt"]


def test_meshes_are_counted_and_not_listed(trocar, tmp_path, monkeypatch):
    def write(task: ExportTask) -> tuple[str, ...]:
        for name in ("parts/a.obj", "parts/b.obj", "parts/colours.mtl", "model.txt"):
            (task.folder / name).parent.mkdir(exist_ok=True)
            (task.folder / name).write_text("", encoding="utf-8")
        return ()

    monkeypatch.setitem(FORMATS, "plain", Format("Plain", write))
    _, *lines = trocar("export", "ecm", "--format", "plain", "-o", tmp_path).out.splitlines()
    assert lines[0] == "  model.txt"
    assert lines[1].startswith("  and 2 meshes, ")


def test_json_names_files_counts_and_warnings(trocar, tmp_path):
    words = ("export", "ecm", "--format", "plain", "-o", tmp_path, "--package", "scope")
    found = trocar(*words, "--sdf-version", "1.7", "--json").document
    assert (found["format"], found["folder"]) == ("plain", str(tmp_path))
    assert found["files"] == ["model.txt"] and found["warnings"] == ["straight lines"]
    assert found["links"] == found["joints"] + 1 and found["triangles"] > 1000
    assert (tmp_path / "model.txt").read_text(encoding="utf-8") == "scope package, SDF 1.7\n"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("ecm", "--format", "step"), "unknown format 'step'"),
        (("ecn", "--format", "plain"), "unknown arm or rig 'ecn' (did you mean 'ecm'?)"),
        (("psm_si", "--format", "plain"), "has no mass for yaw"),
        (("full_cart", "--format", "plain", "--tool", "X:1"), "allowed: ARM=TOOL"),
        (("psm", "--format", "plain", "--tool", "SPOON"), "SPOON"),
        (("psm", "--format", "plain", "--calibration", "none.toml"), "none.toml"),
    ],
)
def test_what_cannot_be_exported_is_refused_and_nothing_is_written(
    words, complaint, trocar, tmp_path
):
    answer = trocar("export", *words, "-o", tmp_path / "out")
    assert answer.status == 2
    assert complaint in answer.complaint
    assert not list(tmp_path.iterdir())


def test_a_folder_in_use_needs_force(trocar, tmp_path):
    (tmp_path / "notes").write_text("mine", encoding="utf-8")
    words = ("export", "ecm", "--format", "plain", "-o", tmp_path)
    assert "is not empty" in trocar(*words).complaint
    assert trocar(*words, "--overwrite").status == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["model.txt", "notes"]
