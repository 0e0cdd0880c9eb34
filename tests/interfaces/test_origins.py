"""Which web pages may talk to a server on this machine."""

from __future__ import annotations

import pytest

from trocar.interfaces.origins import is_loopback, may_come_from


@pytest.mark.parametrize(
    "origin",
    [None, "http://localhost:8080", "http://127.0.0.1:3000", "https://[::1]", "http://127.8.9.1"],
)
def test_pages_of_this_machine_and_programs_may_connect(origin: str | None) -> None:
    assert may_come_from(origin)


@pytest.mark.parametrize(
    "origin",
    [
        "",
        "null",
        "https://example.org",
        "http://localhost.example.org",
        "http://127.0.0.1.example.org",
        "http://localhost@example.org",
        "http://example.org#localhost",
        "file://",
        "file://localhost",
        "chrome-extension://localhost",
        "http://",
        "http://[::1",
        "localhost",
    ],
)
def test_no_other_page_may(origin: str) -> None:
    assert not may_come_from(origin)


def test_one_more_host_may_be_named() -> None:
    assert may_come_from("http://robot:8080", also="robot")
    assert may_come_from("http://[fe80::1]:8080", also="[fe80::1]")
    assert not may_come_from("http://robot.org", also="robot")


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "robot", "192.168.0.1", ""])
def test_what_others_can_reach_is_no_loopback(host: str) -> None:
    assert not is_loopback(host)
