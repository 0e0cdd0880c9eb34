"""The cameras' options of `trocar sim`: what is refused before anything starts."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

import pytest

from trocar.cli import main
from trocar.cli.worlds import add_look, changed_look, look_of
from trocar.descriptions import load_rig
from trocar.descriptions.catalogue import load_scene
from trocar.errors import InputError
from trocar.rendering import Look

LIVE = ("sim", "--no-page", "--websocket-port", "0", "--duration", "0.05")


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("--rig", "ecm", "--preset", "kitchen"), "dvrk_sd_640x480"),
        (
            ("--rig", "psm", "--preset", "hd_1280x720"),
            "--preset: rig psm has no rendered endoscope",
        ),
        (("--rig", "ecm", "--camera-rate", "0"), "camera rate: got 0 Hz"),
        (("--rig", "ecm", "--vignette", "3"), "vignette: got 3"),
        (("--rig", "ecm", "--smoke", "0.3"), "--smoke: got 0.3 in the plain style; allowed: with"),
        (("--rig", "ecm", "--look", "surgical", "--blood", "2"), "blood: got 2.0; allowed: 0 to 1"),
        (("--rig", "ecm", "--jpeg", "99"), "jpeg: got 99; allowed: 0 to 95"),
        (("--rig", "ecm", "--record-images"), "requires --record FILE or --foxglove-record FILE"),
        (("--rig", "psm", "--record-images", "--record", "run.mcap"), "psm has no rendered camera"),
        (("--rig", "ecm", "--record-images", "--headless"), "requires --record FILE"),
        (
            ("--rig", "psm", "--record-images", "--headless", "--record", "a"),
            "rig psm has no camera",
        ),
    ],
)
def test_what_cameras_cannot_do_is_refused(
    options: tuple[str, ...],
    complaint: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("sim", "--duration", "0.05") if "--headless" in options else LIVE
    assert main([*words, *options]) == 2
    assert complaint in capsys.readouterr().err


def test_smoke_blood_noise_and_compression_reach_the_renderer() -> None:
    parser = ArgumentParser()
    add_look(parser)
    words = [
        "--look",
        "surgical",
        "--smoke",
        "0.3",
        "--blood",
        "0.1",
        "--noise",
        "0.02",
        "--jpeg",
        "70",
    ]
    plain, tissue = load_rig("pegs"), load_scene("needle-pick").rig
    found = look_of(parser.parse_args(words), plain)
    assert found == Look("surgical", smoke=0.3, blood=0.1, noise=0.02, jpeg=70)
    assert look_of(parser.parse_args([]), plain) == Look()
    assert look_of(parser.parse_args([]), tissue) == Look("surgical")
    assert look_of(parser.parse_args(["--look", "plain"]), tissue) == Look()
    with pytest.raises(InputError, match=r"--smoke: got 0\.3 in the plain style"):
        look_of(parser.parse_args(["--smoke", "0.3"]), plain)


def test_a_scene_takes_the_settings_of_its_images_that_are_given_and_no_others() -> None:
    parser = ArgumentParser()
    add_look(parser)
    assert changed_look(parser.parse_args([])) == {}
    assert changed_look(parser.parse_args(["--look", "plain"])) == {"style": "plain"}
    assert changed_look(parser.parse_args(["--smoke", "0.3"])) == {"smoke": 0.3}
    given = ["--look", "surgical", "--smoke", "0.3", "--exposure", "1"]
    expected = {"style": "surgical", "smoke": 0.3, "exposure": 1.0}
    assert changed_look(parser.parse_args(given)) == expected


def test_a_rig_with_cameras_runs_without_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*LIVE, "--rig", "ecm", "--no-cameras"]) == 0
    assert "ws://" in capsys.readouterr().out
