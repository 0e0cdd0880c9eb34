"""`trocar export`: what it prints, and what it refuses."""

from __future__ import annotations

import pytest

from tests.formats.dropped import drop_in
from trocar.cli import main
from trocar.robot.dvrk_config.arms import SERIAL

PLAIN = '''
"""A text."""

from trocar.formats.folder import ExportTask
from trocar.formats.format import Format
from trocar.robot.dvrk_config.arms import SERIAL

FILES = {files!r}


def write_plain(task: ExportTask, *, scope: str = "no", level: str = "1") -> tuple[str, ...]:
    for name in FILES:
        (task.folder / name).parent.mkdir(exist_ok=True)
        (task.folder / name).write_text(f"{{scope}} scope, level {{level}}\\n", encoding="utf-8")
    return ("straight lines",)


FORMAT = Format(
    title="Plain",
    order=90,
    options="""
        --scope NAME     plain: a name
        --level N = 1    plain: a number
    """,
    write=write_plain,
)
'''


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    pytest.importorskip("lxml", reason="exports need the extra 'export'")
    folder = tmp_path_factory.mktemp("formats")
    drop_in(monkeypatch, folder, "plain", PLAIN.format(files=("model.txt",)))
    meshes = ("parts/a.obj", "parts/b.obj", "parts/colours.mtl", "model.txt")
    other = PLAIN.format(files=meshes).replace("scope", "area").replace("level", "depth")
    drop_in(monkeypatch, folder, "wavefront", other)


def test_an_export_says_what_it_wrote_and_warns_on_stderr(trocar, tmp_path):
    answer = trocar("export", "ecm", "--format", "plain", "-o", tmp_path / "out")
    assert answer.status == 0
    assert answer.err == "trocar: warning: straight lines\n"
    head, *files = answer.out.splitlines()
    assert head.startswith(f"{tmp_path / 'out'}: plain, ") and "links" in head
    assert files == ["  model.txt"]


def test_meshes_are_counted_and_not_listed(trocar, tmp_path):
    _, *lines = trocar("export", "ecm", "--format", "wavefront", "-o", tmp_path).out.splitlines()
    assert lines[0] == "  model.txt"
    assert lines[1].startswith("  and 2 meshes, ")


def test_json_names_files_counts_and_warnings(trocar, tmp_path):
    words = ("export", "ecm", "--format", "plain", "-o", tmp_path, "--scope", "wide")
    found = trocar(*words, "--level", "7", "--json").document
    assert (found["format"], found["folder"]) == ("plain", str(tmp_path))
    assert found["files"] == ["model.txt"] and found["warnings"] == ["straight lines"]
    assert found["links"] == found["joints"] + 1 and found["triangles"] > 1000
    assert (tmp_path / "model.txt").read_text(encoding="utf-8") == "wide scope, level 7\n"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("ecm", "--format", "step"), "unknown format 'step'"),
        (("ecn", "--format", "plain"), "unknown arm or rig 'ecn' (did you mean 'ecm'?)"),
        ((str(SERIAL["PSM"]), "--format", "plain"), "has no mass for yaw"),
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


def test_a_dropped_in_format_is_in_the_help(capsys):
    with pytest.raises(SystemExit):
        main(["export", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert "output format: urdf, sdf, mjcf, plain or wavefront" in text
    assert "--level N plain: a number (default: 1)" in text


def test_the_picture_shows_the_robot(trocar, tmp_path):
    image = pytest.importorskip("PIL.Image", reason="pictures are read with pillow")
    found = trocar("export", "ecm", "--format", "mjcf", "-o", tmp_path / "out", "--json").document
    if found["warnings"]:
        pytest.skip(found["warnings"][0])
    with image.open(tmp_path / "out" / "ecm.png") as picture:
        grey = picture.convert("L")
        assert picture.size == (800, 600)
        dark = sum(count for value, count in enumerate(grey.histogram()) if value < 230)
    assert 0.03 < dark / (800 * 600) < 0.6
