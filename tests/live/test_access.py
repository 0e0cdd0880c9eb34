"""Which web pages may talk to a server on this machine."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from trocar.cli import main
from trocar.errors import TrocarError
from trocar.live.access import announced, checked_origin, is_loopback, names_loopback


@pytest.mark.parametrize(
    ("url", "origin"),
    [
        ("http://localhost:3000", "http://localhost:3000"),
        ("http://localhost:3000/", "http://localhost:3000"),
        ("HTTP://Robot.Lab:80", "http://robot.lab"),
        ("https://robot.lab:443", "https://robot.lab"),
        ("https://robot.lab:80", "https://robot.lab:80"),
        ("http://[::1]:8000", "http://[::1]:8000"),
    ],
)
def test_an_origin_is_what_a_browser_sends_for_the_page(url: str, origin: str) -> None:
    assert checked_origin(url) == origin


@pytest.mark.parametrize(
    "url",
    [
        "",
        "*",
        "null",
        "localhost:3000",
        "//localhost:3000",
        "file:///home",
        "ws://localhost:3000",
        "http://",
        "http://[::1",
        "http://localhost:many",
        "http://me@localhost",
        "http://localhost/page.html",
        "http://localhost?a",
        "http://localhost#a",
    ],
)
@pytest.mark.parametrize("command", [("sim", "--rig", "psm"), ("mirror", "--bag", "x.bag")])
def test_what_is_no_origin_is_refused(
    command: tuple[str, ...], url: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, "--origin", url]) == 2
    assert f"--origin: got {url!r}; allowed: scheme, host and port" in capsys.readouterr().err


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "robot", "192.168.0.1", ""])
def test_what_others_can_reach_is_no_loopback(host: str) -> None:
    assert not is_loopback(host)


@pytest.mark.parametrize("authority", ["localhost", "127.8.9.1:80", "[::1]:9", "LOCALHOST:1"])
def test_a_host_may_be_a_name_of_this_machine(authority: str) -> None:
    assert names_loopback(authority)


@pytest.mark.parametrize(
    "authority",
    ["", ":80", "example.org", "localhost.org", "localhost@x", "0.0.0.0", "[::1", "::1"],
)
def test_it_may_be_no_other(authority: str) -> None:
    assert not names_loopback(authority)


@pytest.fixture
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no modes")
def test_addresses_with_the_secret_are_readable_by_their_user_alone_while_the_run_lasts(
    runtime: Path,
) -> None:
    with announced({"websocket": "ws://127.0.0.1:9090/?token=x"}) as path:
        assert path.is_relative_to(runtime)
        assert path.stat().st_mode & 0o777 == 0o600
        assert path.parent.stat().st_mode & 0o777 == 0o700
        told = json.loads(path.read_text(encoding="utf-8"))
        assert told == {"pid": os.getpid(), "websocket": "ws://127.0.0.1:9090/?token=x"}
    assert not path.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no modes")
def test_a_file_that_a_killed_run_left_is_replaced_and_a_link_is_not_followed(
    runtime: Path, tmp_path: Path
) -> None:
    target = tmp_path / "target"
    target.write_text("precious", encoding="utf-8")
    (runtime / "trocar").mkdir()
    (runtime / "trocar" / f"{os.getpid()}.json").symlink_to(target)
    with announced({}) as path:
        assert not path.is_symlink()
        assert path.stat().st_mode & 0o777 == 0o600
    assert target.read_text(encoding="utf-8") == "precious"


def test_where_no_file_can_be_written_one_error_says_so(runtime: Path) -> None:
    (runtime / "trocar").write_text("a file", encoding="utf-8")
    with pytest.raises(TrocarError, match=r"cannot write .*XDG_RUNTIME_DIR"), announced({}):
        pass
