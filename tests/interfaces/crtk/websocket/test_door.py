"""Who may connect."""

from __future__ import annotations

import hmac

import pytest

from trocar.errors import InputError
from trocar.interfaces.crtk.transports.websocket.door import Door

TOKEN = "0123456789abcdef"


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.7", "robot"])
def test_beyond_this_machine_a_token_is_needed(host: str) -> None:
    with pytest.raises(InputError, match=rf"--host {host}: .*--token"):
        Door(host)
    Door(host, TOKEN)


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
def test_on_this_machine_none_is(host: str) -> None:
    assert Door(host).objection("/", {}) is None


@pytest.mark.parametrize("token", ["", "short", "x" * 15])
def test_a_short_token_is_refused(token: str) -> None:
    with pytest.raises(InputError, match=rf"--token: got {len(token)} characters; allowed: 16"):
        Door("127.0.0.1", token)


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        (f"/?token={TOKEN}", {}),
        (f"/any/where?a=b&token={TOKEN}", {}),
        ("/", {"Authorization": f"Bearer {TOKEN}"}),
    ],
)
def test_the_token_opens(path: str, headers: dict[str, str]) -> None:
    assert Door("0.0.0.0", TOKEN).objection(path, headers) is None


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
    objection = Door(host, TOKEN).objection(path, headers)
    assert objection is not None
    assert objection[0] == 401
    assert TOKEN not in objection[1]


def test_the_token_is_compared_in_constant_time(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[tuple[bytes, bytes]] = []
    monkeypatch.setattr(hmac, "compare_digest", lambda *pair: compared.append(pair))
    Door("0.0.0.0", TOKEN).objection("/?token=guess", {})
    assert compared == [(TOKEN.encode(), b"guess")]


def test_pages_of_other_sites_are_refused_even_with_the_token() -> None:
    headers = {"Origin": "https://example.org", "Host": "robot:9090"}
    objection = Door("0.0.0.0", TOKEN).objection(f"/?token={TOKEN}", headers)
    assert objection is not None
    assert objection[0] == 403


def test_without_a_token_a_name_that_leads_here_does_not_help() -> None:
    """A site may let its own name mean 127.0.0.1 (DNS rebinding)."""
    headers = {"Origin": "http://example.org:9090", "Host": "example.org:9090"}
    assert Door().objection("/", headers) is not None


def test_with_the_token_pages_of_the_same_machine_may_connect() -> None:
    headers = {"Origin": "http://robot:8000", "Host": "robot:9090"}
    assert Door("0.0.0.0", TOKEN).objection(f"/?token={TOKEN}", headers) is None
