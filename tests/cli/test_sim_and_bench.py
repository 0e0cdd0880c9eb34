"""`trocar sim` and `trocar bench`: their documents, their options, their refusals."""

from __future__ import annotations

import json
import re
import socket
from argparse import ArgumentParser
from pathlib import Path

import numpy as np
import pytest

from trocar.cli import main
from trocar.cli.worlds import add_world, make_world
from trocar.descriptions import load_arm
from trocar.descriptions.overlay import ClosurePatch, Overlay, write_overlay
from trocar.errors import UnknownNameError
from trocar.simulation import World

REPORT = [
    "rig", "timestep_s", "simulated_s", "wall_s", "pass_s", "real_time_factor",
    "bare_real_time_factor", "overhead", "overhead_at_rest", "loop_gap_um_max", "rcm_error_um_max",
    "rcm_wander_um_max", "branch_ok", "tracking_rms",
]  # fmt: skip


def general_overlay(folder: Path) -> Path:
    """A PSM's overlay that lengthens a side of the second loop by 1 mm."""
    (c2,) = (c for c in load_arm("psm").mechanism.closures if c.name == "c2")
    patch = ClosurePatch(c2.point_a + np.array([1e-3, 0.0, 0.0]), c2.point_b)
    write_overlay(folder / "mine.toml", Overlay("psm", "general", closures={"c2": patch}))
    return folder / "mine.toml"


def test_a_headless_run_prints_one_document(capsys):
    words = ["sim", "--headless", "--rig", "psm", "--duration", "0.2", "--tip-load", "10", "--json"]
    assert main(words) == 0
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    assert list(document) == REPORT
    assert document["rig"] == "psm"
    assert document["branch_ok"] is True
    assert document["rcm_error_um_max"] <= 3.0
    assert document["rcm_wander_um_max"] < 1e-6


def test_a_headless_run_tells_how_far_a_robot_s_own_geometry_lets_its_centre_wander(
    capsys, tmp_path
):
    file = general_overlay(tmp_path)
    words = ["sim", "--headless", "--rig", "psm", "--duration", "0.2", "--json"]
    assert main([*words, "--calibration", str(file)]) == 0
    document = json.loads(capsys.readouterr().out)
    world = World("psm", calibration=str(file))
    wanted = 1e6 * world.health().rcm_wander_m
    assert document["rcm_wander_um_max"] == pytest.approx(wanted)
    assert document["rcm_error_um_max"] <= wanted + 3.0
    assert wanted > 100.0
    assert main([*words[:3], "mtm", "--duration", "0.1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rcm_wander_um_max"] is None


def test_errors_and_their_seed_change_how_an_arm_tracks(capsys):
    words = ["sim", "--headless", "--rig", "psm", "--duration", "0.2", "--json"]
    found = []
    for options in ([], ["--errors", "lab"], ["--errors", "lab", "--seed", "3"]):
        assert main([*words, *options]) == 0
        found.append(json.dumps(json.loads(capsys.readouterr().out)["tracking_rms"]))
    assert len(set(found)) == 3


def test_a_headless_run_tells_people_what_it_found(capsys):
    assert main(["sim", "--headless", "--rig", "ecm", "--duration", "0.2"]) == 0
    out = capsys.readouterr().out
    for text in (
        "real-time factor",
        "overhead",
        "um",
        "assembly branch    correct",
        "ECM",
        "mrad",
        "mm",
    ):
        assert text in out


def test_tools_are_chosen_at_the_start(capsys):
    words = ["sim", "--headless", "--rig", "three_psm", "--duration", "0.1"]
    tools = ["PSM1=PROGRASP_FORCEPS:420093", "PSM3=MARYLAND_BIPOLAR_FORCEPS:400172"]
    assert main([*words, "--tool", tools[0], "--tool", tools[1]]) == 0
    assert "PSM3" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--tool", "PSM1", "--headless"],
            "--tool: got 'PSM1'; allowed: ARM=TOOL, e.g. PSM1=LARGE",
        ),
        (["--tool", "PSM1=SPOON", "--headless"], "unknown tool 'SPOON'; known: FENESTRATED"),
        (["--tool", "PSM9=PROGRASP_FORCEPS:420093", "--headless"], "unknown arm 'PSM9'"),
        (["--tool", "ECM=PROGRASP_FORCEPS:420093", "--headless"], "ECM: ecm: takes no tool"),
        (["--duration", "0", "--headless"], "--duration: got 0; allowed: above 0 s"),
        (["--tip-load", "-1", "--headless"], "--tip-load: got -1; allowed: 0 N or more"),
        (["--json"], "--json: allowed with --headless only"),
        (["--rig", "ful_cart", "--headless"], "unknown rig 'ful_cart' (did you mean 'full_cart'?)"),
        (["--timestep", "0.5", "--headless"], "allowed: above 0 to 0.01 s"),
        (["--errors", "labb", "--headless"], "unknown errors 'labb' (did you mean 'lab'?); known"),
        (["--seed", "-1", "--headless"], "seed: got -1; allowed: a whole number from 0 on"),
        (["--speed", "slow"], "got 'slow'; allowed: realtime, max, or a factor of real time"),
        (["--port", "70000"], "got port 70000; allowed: 1 to 65535"),
    ],
)
def test_bad_input_is_one_line(words, said, capsys):
    assert main(["sim", *words]) == 2
    printed = capsys.readouterr()
    assert said in printed.err
    assert not printed.out
    assert len([line for line in printed.err.splitlines() if "error" in line]) == 1


def test_a_rig_file_that_is_broken_is_named_with_its_key(tmp_path: Path, capsys):
    path = tmp_path / "mine.toml"
    path.write_text('schema = 1\nname = "mine"\nsource = "me"\n', encoding="utf-8")
    assert main(["sim", "--headless", "--rig", str(path)]) == 2
    assert "mine.toml: arm: is missing; a rig needs at least one arm" in capsys.readouterr().err


def test_a_port_that_is_taken_is_one_clear_error(capsys):
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 0))
        busy.listen()
        port = busy.getsockname()[1]
        words = ["sim", "--rig", "psm", "--duration", "0.1"]
        assert main([*words, "--port", str(port), "--websocket-port", "0"]) == 2
        assert str(port) in capsys.readouterr().err
        assert main([*words, "--no-page", "--websocket-port", str(port)]) == 2
    told = capsys.readouterr().err
    assert f"WebSocket: cannot listen on 127.0.0.1 port {port}: address already in use" in told
    assert "--websocket-port" in told and "--no-websocket" in told


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--host", "0.0.0.0"], "--host 0.0.0.0: other machines could move the arms"),
        (
            ["--host", "0.0.0.0", "--token", "easy"],
            "--token: got 4 characters; allowed: at least 16",
        ),
        (["--websocket-port", "70000"], "got port 70000"),
        (["--no-websocket"], "nothing is served"),
        (["--rate", "2000", "--websocket-port", "0"], "rate: got 2000 Hz; allowed: above 0 to"),
    ],
)
def test_what_cannot_be_served_is_one_clear_error(words: list[str], told: str, capsys):
    assert main(["sim", "--rig", "psm", "--no-page", "--duration", "0.1", *words]) == 2
    assert told in capsys.readouterr().err


def test_clients_alone_can_be_served_and_the_token_is_not_printed(capsys, monkeypatch):
    monkeypatch.setenv("TROCAR_TOKEN", "0123456789abcdef")
    words = ["sim", "--rig", "psm", "--no-page", "--websocket-port", "0", "--speed", "max"]
    assert main([*words, "--duration", "0.1"]) == 0
    printed = capsys.readouterr().out
    assert re.fullmatch(
        r"ws://127\.0\.0\.1:\d+  \(rosbridge, with the token\)  \(Ctrl-C stops\)\n"
        r".*[/\\]trocar[/\\]\d+\.json  \(addresses with the secret of this run\)\n",
        printed,
    )


def test_bench_prints_one_document(capsys):
    assert main(["bench", "speed", "--duration", "0.05", "--passes", "1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [row["rig"] for row in document["table9"]][-2:] == ["full_cart", "full_cart"]
    assert document["figures"] == []


@pytest.mark.slow
def test_bench_measures_calibrated_robots_by_their_speed_alone(capsys, tmp_path):
    file = str(general_overlay(tmp_path))
    words = ["bench", "--duration", "0.02", "--passes", "1", "--calibration", file]
    assert main([*words, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["table9"] and document["figures"] == []
    assert main(["bench", "fidelity", "--calibration", file]) == 2
    assert "--calibration OVERLAY: allowed with PART speed only" in capsys.readouterr().err
    assert main(["bench", "speed", "--calibration"]) == 2
    assert "--calibration: got no OVERLAY; allowed: one or more" in capsys.readouterr().err
    write_overlay(file, Overlay("mtml"), overwrite=True)
    assert main(words) == 2
    assert "is a calibration of 'mtml'; allowed: ecm" in capsys.readouterr().err


def test_bench_refuses_a_duration_of_nothing(capsys):
    for words in (["--duration", "0"], ["fidelity", "--calibration", "--robots", "0"]):
        assert main(["bench", *words]) == 2
        assert "allowed: above 0" in capsys.readouterr().err


def test_bench_refuses_calibration_without_an_overlay(capsys):
    assert main(["bench", "speed", "--calibration"]) == 2
    assert "--calibration: got no OVERLAY; allowed: one or more" in capsys.readouterr().err


def test_bench_says_that_a_part_comes_before_calibration(capsys):
    assert main(["bench", "--calibration", "some.toml", "speed"]) == 2
    assert "trocar bench speed --calibration" in capsys.readouterr().err


@pytest.mark.slow
def test_bench_calibrates_robots_that_it_has_not_seen(capsys):
    assert main(["bench", "calibration", "--robots", "1", "--json"]) == 0
    found = {f["name"]: f for f in json.loads(capsys.readouterr().out)["figures"]}
    for name in ("psm", "ecm"):
        assert found[f"{name}: exchanged labels named, of 84 exchanges"]["met"]
        (missed,) = (f for n, f in found.items() if n.startswith(f"{name}: figures of a calib"))
        assert missed["met"]
    assert found["psm: drift of a free arm with broken loops in 5 s"]["met"]
    assert found["remote centre, median, white noise"]["value"] < 60e-6


def test_computed_torque_of_an_arm_is_an_option_of_the_command_line() -> None:
    parser = ArgumentParser()
    add_world(parser)
    world = make_world(parser.parse_args(["--rig", "psm", "--computed-torque", "PSM1"]))
    assert world.arm("PSM1").joints.computed_torque
    assert not make_world(parser.parse_args(["--rig", "psm"])).arm("PSM1").joints.computed_torque
    with pytest.raises(UnknownNameError, match="PSM1"):
        make_world(parser.parse_args(["--rig", "psm", "--computed-torque", "PSM7"]))
