"""Who may connect."""

from __future__ import annotations

import hmac

import pytest

from trocar.errors import InputError
from trocar.live.access import PageAccess
from trocar.ros.transports.websocket.server import Access

TOKEN = "0123456789abcdef"
GUARDED = PageAccess(token=TOKEN)
HERE = {"Host": "127.0.0.1:9090"}


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.7", "robot"])
def test_beyond_this_machine_a_token_is_needed(host: str) -> None:
    with pytest.raises(InputError, match=rf"--host {host}: .*--token"):
        Access(host)
    Access(host, GUARDED)


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
def test_on_this_machine_none_is(host: str) -> None:
    assert Access(host).objection("/", HERE) is None


@pytest.mark.parametrize("token", ["", "short", "x" * 15])
def test_a_short_token_is_refused(token: str) -> None:
    with pytest.raises(
        InputError, match=rf"--token: got {len(token)} characters; allowed: at least 16"
    ):
        PageAccess(token=token)


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        (f"/?token={TOKEN}", {}),
        (f"/any/where?a=b&token={TOKEN}", {}),
        ("/", {"Authorization": f"Bearer {TOKEN}"}),
    ],
)
def test_the_token_opens(path: str, headers: dict[str, str]) -> None:
    assert Access("0.0.0.0", GUARDED).objection(path, headers) is None


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        ("/", {}),
        ("/?token=", {}),
        (f"/?token={TOKEN[:-1]}", {}),
        (f"/?token={TOKEN}x", {}),
        (f"/?token=x&token={TOKEN}", {}),
        ("/?token=%ff%00", {}),
        (f"/{TOKEN}", {}),
        ("/", {"Authorization": TOKEN}),
        ("/", {"Authorization": "Bearer "}),
        (f"/?token={TOKEN}", {"Authorization": "Bearer wrong"}),
    ],
)
@pytest.mark.parametrize("host", ["0.0.0.0", "127.0.0.1"])
def test_nothing_else_does(host: str, path: str, headers: dict[str, str]) -> None:
    objection = Access(host, GUARDED).objection(path, HERE | headers)
    assert objection is not None
    assert objection[0] == 401
    assert TOKEN not in objection[1]


def test_the_token_is_compared_in_constant_time(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[tuple[bytes, bytes]] = []
    monkeypatch.setattr(hmac, "compare_digest", lambda *pair: compared.append(pair))
    Access("0.0.0.0", GUARDED).objection("/?token=guess", {})
    assert (TOKEN.encode(), b"guess") in compared
    assert len(compared) == 2  # with the secret of the run, too


def test_pages_of_other_sites_are_refused_even_with_the_token() -> None:
    headers = {"Origin": "https://example.org", "Host": "robot:9090"}
    objection = Access("0.0.0.0", GUARDED).objection(f"/?token={TOKEN}", headers)
    assert objection is not None
    assert objection[0] == 403


@pytest.mark.parametrize("token", [None, TOKEN])
def test_a_name_that_another_site_lets_lead_here_does_not_help(token: str | None) -> None:
    """A site may let its own name mean 127.0.0.1 (DNS rebinding)."""
    headers = {"Host": "example.org:9090"}
    for more in ({}, {"Origin": "http://example.org:9090"}):
        objection = Access("127.0.0.1", PageAccess(token=token)).objection(
            f"/?token={TOKEN}", headers | more
        )
        assert objection is not None
        assert objection[0] == 403


@pytest.mark.parametrize("host", ["robot:9090", "192.168.1.7:9090", "robot.lab.example"])
def test_beyond_this_machine_it_may_have_any_name(host: str) -> None:
    assert Access("0.0.0.0", GUARDED).objection(f"/?token={TOKEN}", {"Host": host}) is None


def test_a_page_that_is_named_needs_the_token_alone() -> None:
    door = Access("0.0.0.0", PageAccess(["http://robot:8000/"], TOKEN))
    headers = {"Host": "robot:9090", "Origin": "http://robot:8000"}
    assert door.objection(f"/?token={TOKEN}", headers) is None
    assert (door.objection("/", headers) or (0,))[0] == 401
    other = headers | {"Origin": "http://robot:8001"}
    assert (door.objection(f"/?token={TOKEN}", other) or (0,))[0] == 403


@pytest.mark.parametrize("token", [None, TOKEN])
def test_the_page_of_the_viewer_needs_the_secret_of_the_run(token: str | None) -> None:
    access = PageAccess(token=token)
    headers = HERE | {"Origin": "http://127.0.0.1:8080"}
    door = Access("127.0.0.1", access)
    assert (door.objection(f"/?{access.query}", headers) or (0,))[0] == 403  # not served yet
    access.viewer = frozenset({"http://127.0.0.1:8080"})
    assert door.objection(f"/?{access.query}", headers) is None
    for path in ("/", "/?token=wrong", f"/?{PageAccess().query}"):
        assert (door.objection(path, headers) or (0,))[0] == 403


def test_a_program_of_the_same_user_shows_the_secret_in_place_of_the_token() -> None:
    assert Access("0.0.0.0", GUARDED).objection(f"/?{GUARDED.query}", {}) is None
