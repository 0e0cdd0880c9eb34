"""Every command with an output file refuses to replace one, by one error and before its work."""

from __future__ import annotations

from pathlib import Path

import pytest

from trocar.recording import record
from trocar.simulation import World


@pytest.mark.parametrize(
    ("words", "output"),
    [
        ("render -o {}", "scope.png"),
        ("render -o {}", "scope.mp4"),
        ("mocap --arm psm -o {}", "tracks.csv"),
        ("mocap --arm psm -o {0}/new.csv", "new.csv.truth.json"),
        ("calibrate no.csv --arm psm -o {}", "mine.toml"),
        ("calibrate no.csv --arm psm --report {0}", "index.html"),
        ("calibrate-bases no.toml -o {}", "bases.toml"),
        ("calibrate-paper --arm psm -o {}", "twin.toml"),
        ("calibrate-plan --arm psm --report {0}", "index.html"),
        ("calibrate-camera no.toml -o {}", "scope.toml"),
        ("calibrate-camera no.toml --ros {} {0}/right.yaml", "left.yaml"),
        ("touches --arm PSM1=psm -o {}", "touches.toml"),
        ("touches --arm PSM1=psm -o {0}/new.toml", "new.csv"),
        ("views -o {0}", "views.toml"),
        ("identify no.csv --arm psm -o {}", "dynamics.toml"),
        ("identify no.csv --arm psm -o {0}/new.toml --report {0}", "result.json"),
        ("predict no.csv --arm psm --report {0}", "result.json"),
        ("excite -o {}", "swing.csv"),
        ("play peg-board --headless --policy scripted --record {}", "run.mcap"),
        ("play peg-board --headless --policy scripted --video {}", "run.mp4"),
        ("verify --report {0}", "index.html"),
        ("show psm --picture {0}", "front.png"),
        ("export psm --format urdf -o {0}", "README.md"),
        ("import no.urdf -o {0}", "arm.toml"),
        ("import-dvrk no.json -o {}", "rig.toml"),
        ("sample {0}", "psm.bag"),
        ("sim --rig psm --headless --duration 0.1 --record {}", "run.mcap"),
    ],
)
def test_an_existing_output_is_refused_by_one_error_that_names_overwrite(
    trocar, tmp_path: Path, words: str, output: str
) -> None:
    file = tmp_path / output
    file.write_text("mine")
    answer = trocar(*(w.replace("{0}", str(tmp_path)).format(file) for w in words.split()))
    assert answer.status == 2
    assert "--overwrite" in answer.complaint and output in answer.complaint
    assert [path.name for path in tmp_path.iterdir()] == [output]
    assert file.read_text() == "mine"


def test_a_plot_replaces_an_older_one_with_overwrite_alone(trocar, tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    world, file = World("psm"), tmp_path / "run.mcap"
    with record(world, file):
        world.arm("PSM1").move_jp([0.3, 0.2, 0.15, 0.4, 0.2, -0.3])
        world.step(20)
    drawn = tmp_path / "run.html"
    assert trocar("plot", file, "-o", drawn).status == 0
    before = drawn.read_bytes()
    drawn.write_text("mine")
    answer = trocar("plot", file, "-o", drawn)
    assert (answer.status, drawn.read_text()) == (2, "mine")
    assert f"{drawn}: exists already; allowed: a new file, or --overwrite" in answer.complaint
    assert trocar("plot", file, "-o", drawn, "--overwrite").status == 0
    assert drawn.read_bytes() == before
