"""The kit over each transport, against a simulator in a process or thread of its own."""

from __future__ import annotations

import json
import subprocess
from contextlib import closing
from pathlib import Path

import pytest

from benchmarks.served import served
from tests.conformance.test_kit import failed
from tests.ros.ros1.robot_os import (
    MAIN,
    PATIENCE_S,
    ROOT,
    Master,
    Simulator,
    need,
    python_with_rospy,
)
from tests.ros.served import running
from trocar.cli import main
from trocar.conformance import ConformanceSettings, conform
from trocar.errors import TrocarError
from trocar.ros.transports.websocket import WebSocketTransport
from trocar.ros.transports.websocket.client import WebSocketClient

SETTINGS = ConformanceSettings(seconds=1.0, rate_hz=20.0)
#: A loaded machine publishes late and unevenly; test_kit.py judges that in simulated time.
TIMED = ("Streams",)


def test_our_psm_conforms_over_rosbridge(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "conform.html"
    with running(WebSocketTransport("127.0.0.1", 0, None)) as (_, transport):
        address = next(w for w in transport.greeting.split() if w.startswith("ws://"))
        words = [address, "--seconds", "1", "--rate", "20", "--html", str(page), "--json"]
        status = main(["conform", *words])
        report = json.loads(capsys.readouterr().out)
        wrong = [r for r in report["results"] if r["verdict"] == "fail"]
        assert [r for r in wrong if r["group"] not in TIMED] == []
        assert status == bool(wrong)
        assert main(["conform", address, "--arm", "PSM2"]) == 2
        assert "known: PSM1" in capsys.readouterr().err
    assert "Conformance of PSM1" in page.read_text(encoding="utf-8")


def test_a_client_of_rosbridge_publishes_and_calls() -> None:
    with running(WebSocketTransport("127.0.0.1", 0, None)) as (_, transport):
        address = next(w for w in transport.greeting.split() if w.startswith("ws://"))
        with closing(WebSocketClient(address)) as client:
            client.start()
            ratios: list[float] = []
            topic, kind = "PSM1/trajectory_j/ratio", "std_msgs/Float64"
            client.subscribe(topic, kind, lambda message: ratios.append(message["data"]))
            client.sleep(0.3)
            client.publish("PSM1/trajectory_j/set_ratio", kind, {"data": 0.5})
            client.sleep(0.5)
            # a subscription in the moment in which a simulator starts gets the first value twice
            assert list(dict.fromkeys(ratios)) == [1.0, 0.5]
            request = {"jp": [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]}
            reply = client.call(
                "PSM1/forward_kinematics", "crtk_msgs/QueryForwardKinematics", request
            )
            assert reply["cp"]["position"]["z"] == pytest.approx(-0.1135)
            with pytest.raises(TrocarError, match="unknown service"):
                client.call("PSM1/nothing", "std_srvs/Trigger", {})


@pytest.mark.slow
def test_our_psm_conforms_on_ros_2() -> None:
    pytest.importorskip("cyclonedds", reason="cyclonedds is not installed (extra ros2)")
    from trocar.ros.transports.ros2 import Ros2Client, network

    alone = {"ROS_DOMAIN_ID": "88"}
    words = ["--no-page", "--rig", "psm", "--ros2", "dds", "--websocket-port", "0"]
    with (
        served(words, r"ROS 2.*|.*loopback.*", alone),
        closing(Ros2Client(network(alone))) as client,
    ):
        client.start()
        report = conform(client, "PSM1", SETTINGS)
        timed = {r.name for r in report.results if r.group in TIMED}
        assert failed(report) - timed == set()
        assert client.latched("PSM1/trajectory_j/ratio") is True
        assert client.latched("PSM1/measured_js") is False
        with pytest.raises(TrocarError, match="PSM1/nothing: no such service"):
            client.call("PSM1/nothing", "std_srvs/Trigger", {}, timeout_s=0.2)


@pytest.mark.slow
def test_our_psm_conforms_on_ros_1(tmp_path: Path) -> None:
    need("rosmaster")
    master = Master(tmp_path)
    simulator = Simulator(master.env, "--rig", "psm")
    python, prelude = python_with_rospy() or ("", "")
    words = ["conform", "--ros1", "--json", "--seconds", "1", "--rate", "20"]
    done = subprocess.run(
        [python, "-c", f"{prelude} {MAIN}", *words],
        env={**master.env, "PYTHONPATH": str(ROOT / "src"), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    simulator.stop()
    master.close()
    report = json.loads(done.stdout)
    failures = [r for r in report["results"] if r["verdict"] == "fail"]
    wrong = [r["name"] for r in failures if r["group"] not in TIMED]
    assert wrong == []
    assert report["pass"] > 35


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ([], "got 0 of ADDRESS, --ros1 and --ros2; allowed: one of them"),
        (["ws://127.0.0.1:1", "--ros2"], "got 2 of ADDRESS"),
        (["http://127.0.0.1:1"], "conform: got 'http://127.0.0.1:1'; allowed: ws://HOST:PORT"),
        (["ws://127.0.0.1:1", "--nan"], "--nan: has no effect here; allowed with --move only"),
        (["ws://127.0.0.1:1", "--rate", "0"], "rate: got 0; allowed: above 0"),
    ],
)
def test_bad_input_is_one_error(
    words: list[str], error: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["conform", *words]) == 2
    assert error in capsys.readouterr().err
