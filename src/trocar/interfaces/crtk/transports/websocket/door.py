"""Who may connect: programs on this machine, pages that it serves, and whoever has the token."""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from urllib.parse import parse_qs, urlsplit

from trocar.errors import InputError
from trocar.interfaces.origins import host_of, is_loopback, may_come_from

SHORTEST_TOKEN = 16
"""Characters of a token. Source: our own choice; 16 of base64 are 96 bits."""

BEARER = "Bearer "


@dataclass(frozen=True)
class Door:
    """What is asked of everybody who connects.

    Args:
        host: address that is listened on
        token: what a client has to show, or None on the loopback address

    Raises:
        InputError: the host can be reached from elsewhere and there is no token, or a short one
    """

    host: str = "127.0.0.1"
    token: str | None = None

    def __post_init__(self) -> None:
        if self.token is None and not is_loopback(self.host):
            raise InputError(
                f"--host {self.host}: whoever reaches this address could drive the arms: give a "
                "--token (or TROCAR_TOKEN) that clients have to show, or leave --host out and "
                "forward the port with ssh"
            )
        if self.token is not None and len(self.token) < SHORTEST_TOKEN:
            raise InputError(
                f"--token: got {len(self.token)} characters; allowed: {SHORTEST_TOKEN} or more, as "
                "python -c 'import secrets; print(secrets.token_urlsafe())' gives"
            )

    def objection(self, path: str, headers: Mapping[str, str]) -> tuple[HTTPStatus, str] | None:
        """Say why a request to connect is refused, or None.

        Args:
            path: what is asked for, with its query; `?token=...` shows the token
            headers: of the request; `Authorization: Bearer ...` shows the token, too
        """
        if not self._is_ours(headers):
            return HTTPStatus.FORBIDDEN, "pages of other sites may not connect\n"
        if self.token is not None and not _same(self.token, _shown(path, headers)):
            return HTTPStatus.UNAUTHORIZED, "show the token: ?token=... or Authorization: Bearer\n"
        return None

    def _is_ours(self, headers: Mapping[str, str]) -> bool:
        """Whether the page comes from here; with a token also from the name that we are called."""
        also = None if self.token is None else host_of(f"//{headers.get('Host', '')}")
        return may_come_from(headers.get("Origin"), also)


def _shown(path: str, headers: Mapping[str, str]) -> str:
    authorization = headers.get("Authorization", "")
    if authorization.startswith(BEARER):
        return authorization.removeprefix(BEARER).strip()
    return parse_qs(urlsplit(path).query).get("token", [""])[0]


def _same(token: str, shown: str) -> bool:
    """Compare in a time that does not tell how much was right."""
    return hmac.compare_digest(token.encode(), shown.encode("utf-8", "surrogateescape"))
