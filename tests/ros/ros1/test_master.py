"""Where the master is looked for, and what is said when it is not there."""

from __future__ import annotations

import socket
import sys
import threading
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from trocar.errors import InputError
from trocar.ros.transports.ros1 import MissingRospyError, master, transport
from trocar.ros.transports.ros1.master import (
    MasterError,
    RosMasterClient,
    find_master,
    settle_address,
)


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ROS_MASTER_URI", "ROS_HOSTNAME", "ROS_IP"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)


@pytest.mark.parametrize(
    "uri", ["localhost:11311", "http://host", "http://h:99999999", "ftp://h:1"]
)
def test_an_address_that_is_none_is_refused(uri: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_MASTER_URI", uri)
    with pytest.raises(InputError, match=r"ROS_MASTER_URI: got .*allowed: http://HOST:PORT"):
        find_master()


def test_no_master_is_an_error_that_says_how_to_start_one(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{taken.getsockname()[1]}")
        with pytest.raises(MasterError, match="rosmaster --core"):
            find_master()


def test_a_master_that_does_not_answer_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(master, "PATIENCE_S", 0.1)
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{mute.getsockname()[1]}")
        with pytest.raises(MasterError, match="timed out"):
            find_master()


def test_without_a_word_about_it_the_usual_place_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(master, "DEFAULT_URI", "http://127.0.0.1:1")
    with pytest.raises(MasterError, match="ROS_MASTER_URI is not set"):
        find_master()


def test_a_master_is_asked_by_name() -> None:
    with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as server:
        server.register_function(lambda who, key: (1, "ok", f"{who} {key}"), "getParam")
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        found = RosMasterClient(f"http://127.0.0.1:{server.server_address[1]}", True)
        assert found.ask("getParam", "/run_id") == (1, "ok", "/trocar /run_id")
        thread.join()


@pytest.mark.parametrize(
    ("uri", "name", "told", "kept"),
    [
        ("http://localhost:11311", "", "127.0.0.1 only", "127.0.0.1"),
        ("http://10.0.0.7:11311", "", "all interfaces", None),
        ("http://localhost:11311", "10.0.0.7", "advertised as 10.0.0.7", "10.0.0.7"),
        ("http://10.0.0.7:11311", "127.0.0.1", "127.0.0.1 only", "127.0.0.1"),
    ],
)
def test_it_listens_on_loopback_unless_it_is_told_otherwise(
    uri: str, name: str, told: str, kept: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name:
        monkeypatch.setenv("ROS_HOSTNAME", name)
    assert told in settle_address(RosMasterClient(uri, True))
    assert master.os.environ.get("ROS_HOSTNAME") == kept


def test_without_rospy_the_error_says_which_python_and_which_packages(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "rospy", None)
    with pytest.raises(MissingRospyError) as caught:
        transport.load()
    for word in (sys.executable, "python3-rospy", "python3-rosmaster", "make ros1-venv"):
        assert word in str(caught.value)
