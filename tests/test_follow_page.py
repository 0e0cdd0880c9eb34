"""The mirror on docs/follow.md, run as it is written, with a bag that has what it shows."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

from trocar.cli import main
from trocar.cli.program import BAD_INPUT

pytest.importorskip("rosbags", reason="rosbags is not installed (extra bags)")

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

PAGE = Path(__file__).parents[1] / "docs" / "follow.md"
TEXT = PAGE.read_text(encoding="utf-8").split("\n## Replay\n")[0]
KIND = "sensor_msgs/msg/JointState"


def session(path: Path, arms: dict[str, int]) -> None:
    """Write two seconds of arms that stand still; the ECM is silent after the first."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(path) as writer:
        topics = {
            arm: writer.add_connection(f"/{arm}/measured_js", KIND, typestore=store) for arm in arms
        }
        for k in range(400):
            ns = 1_700_000_000_000_000_000 + 5_000_000 * k
            stamp = store.types["builtin_interfaces/msg/Time"](*divmod(ns, 1_000_000_000))
            header = store.types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id="")
            for arm, count in arms.items():
                if arm == "ECM" and k >= 200:
                    continue
                q = np.zeros(count)
                q[2] = 0.12
                message = store.types[KIND](header, [], q, np.zeros(0), np.zeros(0))
                writer.write(topics[arm], ns, store.serialize_ros1(message, KIND))


def command(pattern: str) -> list[str]:
    (line,) = re.findall(rf"^trocar (mirror .*{pattern}.*)$", TEXT, re.MULTILINE)
    return shlex.split(line)


def test_the_run_without_the_page_prints_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    session(tmp_path / "session.bag", {"PSM1": 6, "PSM2": 6, "ECM": 4})
    assert main(command("--no-page")) == 0
    (shown,) = re.findall(r"<!-- output -->\n```\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
    assert shown in capsys.readouterr().out


def test_a_bag_without_the_arm_is_refused_with_its_joint_states(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    session(tmp_path / "session.bag", {"PSM2": 6, "ECM": 4})
    words = ["mirror", "--bag", "session.bag", "--rig", "psm", "--arms", "PSM1"]
    assert main(words) == BAD_INPUT
    said = capsys.readouterr().err
    assert "has no /PSM1/measured_js; its joint states: /ECM/measured_js, /PSM2/measured_js" in said


def test_with_a_host_other_machines_have_an_address_that_only_watches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser", reason="the page's library is not there")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("TROCAR_TOKEN", raising=False)
    session(tmp_path / "session.bag", {"PSM1": 6})
    words = ["mirror", "--bag", "session.bag", "--rig", "psm", "--no-cameras", "--serve", "0"]
    assert main([*words, "--host", "0.0.0.0", "--port", "0", "--duration", "0.2"]) == 0
    own, others, websocket, file = capsys.readouterr().out.splitlines()
    assert own.startswith("http://127.0.0.1:") and "watch, request control" in others
    assert websocket.startswith("ws") and "addresses with the secret" in file
    assert main([*words, "--no-page", "--host", "0.0.0.0"]) == BAD_INPUT
    assert "--host: has no effect here; allowed without --no-page only" in capsys.readouterr().err


def test_every_source_of_the_page_is_an_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["mirror", "--help"])
    told = capsys.readouterr().out
    for option in set(re.findall(r"--[a-z][a-z0-9-]+", TEXT)):
        assert option in told


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--bag", "x.bag", "--ros1"], "not allowed with argument"),
        ([], "one of the arguments --ros1 --ros2 --websocket --bag is required"),
        (["--bag", "x.bag", "--no-page"], "x.bag: no such file; allowed: rosbag 1"),
        (["--bag", "x.bag", "--json"], "--json: allowed with --no-page only"),
        (["--ros1", "--speed", "max"], "--speed max: allowed with --bag only"),
        (["--websocket", "here"], "allowed: ws://HOST:PORT"),
        (["--bag", "x.bag", "--duration", "0"], "--duration: got 0; allowed: above 0 s"),
    ],
)
def test_bad_input_is_told_in_one_line(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["mirror", *words]) == BAD_INPUT
    assert said in capsys.readouterr().err


def test_the_picture_of_the_page_is_there() -> None:
    for name in re.findall(r"\]\((images/\S+)\)", TEXT):
        assert (PAGE.parent / name).stat().st_size > 20_000


def test_json_stands_alone_beside_what_is_served(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session(tmp_path / "session.bag", {"PSM1": 6})
    words = ["mirror", "--rig", "psm", "--bag", str(tmp_path / "session.bag"), "--no-page"]
    assert main([*words, "--json", "--serve", "0"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)
    assert "ws://" in printed.err


@pytest.mark.parametrize("option", [("--preset", "nonsense"), ("--exposure", "99")])
def test_options_of_cameras_are_checked_and_refused_where_nobody_looks(
    tmp_path: Path, option: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    session(tmp_path / "session.bag", {"PSM1": 6, "PSM2": 6, "ECM": 4})
    words = ["mirror", "--rig", "two_psm_ecm", "--bag", str(tmp_path / "session.bag"), "--no-page"]
    assert main([*words, "--serve", "0", *option]) == BAD_INPUT
    assert option[1] in capsys.readouterr().err
    assert main([*words, *option]) == BAD_INPUT
    assert f"{option[0]}: has no effect here; allowed" in capsys.readouterr().err
