"""trocar learn collect, export, import: what they take and print."""

from pathlib import Path

import pytest

from tests.cli.conftest import Command

pytest.importorskip("pyarrow", reason="the extra `learn` is not there")


def test_a_dataset_is_collected_imported_and_replayed(trocar: Command, tmp_path: Path) -> None:
    data, out, again = tmp_path / "data", tmp_path / "one.mcap", tmp_path / "again"
    words = ("needle-reach", "--episodes", 3, "--seed", 5, "--noise", 0.01, "--mcap")
    done = trocar("learn", "collect", *words, "-o", data, "--json")
    assert done.status == 0, done.err
    found = done.document
    assert (found["kept"], found["successes"], len(found["episodes"])) == (3, 3, 3)
    card = (data / "card.toml").read_text()
    command = "trocar learn collect needle-reach --episodes 3 --seed 5 --noise 0.01 --mcap -o DIR"
    assert f'command = "{command}"' in card
    assert trocar("replay", data / "recordings/episode_000002.mcap").status == 0
    done = trocar("learn", "import", data, "--episode", 2, "-o", out)
    assert (done.status, done.out) == (0, f"{out}\n")
    done = trocar("replay", out, "--arm", "psm", "--json")
    assert done.status == 0 and done.document["clipped"] == 0
    recordings = sorted((data / "recordings").iterdir())
    done = trocar("learn", "export", *recordings, "--arm", "PSM1", "-o", again)
    assert done.status == 0
    assert done.out.startswith("3 episodes, ") and " frames of PSM1 in " in done.out


def test_the_summary_names_successes_and_frames(trocar: Command, tmp_path: Path) -> None:
    done = trocar("learn", "collect", "needle-reach", "--episodes", 2, "-o", tmp_path)
    assert done.out.startswith("needle-reach: 2 of 2 successful; 2 episodes, ")


def test_a_dataset_of_randomised_worlds_has_the_command_that_makes_it(
    trocar: Command, tmp_path: Path
) -> None:
    from trocar.learning.lerobot import open_dataset

    tips: list[float] = []
    for name, more in (("nominal", ()), ("drawn", ("--randomise", "lab", "--tips", "camera"))):
        words = ("needle-reach", "--episodes", 1, *more, "--keep-failures")
        done = trocar("learn", "collect", *words, "-o", tmp_path / name)
        assert done.status == 0, done.err
        tips.append(float(open_dataset(tmp_path / name).rows(0)["observation.tips"][0, 0]))
    assert tips[0] != tips[1]
    assert (
        "--episodes 1 --randomise lab --tips camera" in (tmp_path / "drawn/card.toml").read_text()
    )


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("collect", "needle-reah"), "unknown scene 'needle-reah' (did you mean 'needle-reach'?)"),
        (("collect", "needle-reach", "--episodes", "0"), "--episodes: got 0; allowed: 1 or more"),
        (("collect", "needle-reach", "--workers", "0"), "--workers: got 0; allowed: 1 or more"),
        (("collect", "needle-reach", "--noise", "2"), "noise: got 2; allowed: 0 to 1"),
        (
            ("collect", "needle-reach", "--images", "84"),
            "learn-collect: argument --images: got '84'; allowed: WIDTHxHEIGHT, e.g. 84x84 (see",
        ),
        (
            ("collect", "needle-reach", "--policy", "teleop"),
            "--policy: got teleop; record with `trocar play needle-reach --policy none --record",
        ),
        (
            ("collect", "needle-reach", "--policy", "mine"),
            "--policy: got 'mine'; allowed: scripted",
        ),
        (("collect", "needle-reach", "--trust"), "--trust: has no effect here; allowed with"),
        (
            ("collect", "needle-reach", "--policy", "mine.py", "--trust"),
            "--trust: has no effect here; allowed with --policy FILE.zip",
        ),
        (("collect", "needle-reach", "--tips", "camera"), "--tips: has no effect here; allowed"),
        (("export", "none.mcap"), "none.mcap: no such file; allowed: rosbag 1"),
        (
            ("import", "none", "--base", "PSM1=0,0,0,1,1,0,0"),
            "learn-import: argument --base: got 'PSM1=0,0,0,1,1,0,0'; allowed: ARM=X,Y,Z,QW",
        ),
        (("import", "none"), "none/meta/info.json: no such file; allowed: a dataset of LeRobot's"),
    ],
)
def test_bad_input_is_one_clear_error(
    trocar: Command, tmp_path: Path, words: tuple[str, ...], complaint: str
) -> None:
    done = trocar("learn", *words, "-o", tmp_path / "out")
    assert done.status == 2
    assert done.complaint.startswith(complaint)
    assert not (tmp_path / "out").exists()
