"""Which web pages may talk to a server on this machine."""

from __future__ import annotations

import pytest

from trocar.cli import main
from trocar.interfaces.origins import checked_origin, is_loopback, names_loopback


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
