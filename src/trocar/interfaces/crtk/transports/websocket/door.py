"""Who may connect: programs on this machine, pages of this run, and whoever has the token."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from http import HTTPStatus

from trocar.errors import InputError
from trocar.interfaces.origins import PageAccess, is_loopback, names_loopback, queried, same

SHORTEST_TOKEN = 16
"""Characters of a token. Source: our own choice; 16 of base64 are 96 bits."""

BEARER = "Bearer "


@dataclass(frozen=True)
class Door:
    """What is asked of everybody who connects.

    Args:
        host: address that is listened on
        token: what a client has to show, or None on the loopback address
        pages: which web pages may connect

    Raises:
        InputError: the host can be reached from elsewhere and there is no token, or a short one
    """

    host: str = "127.0.0.1"
    token: str | None = None
    pages: PageAccess = field(default_factory=PageAccess)

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

        Beyond the loopback address any name may lead here, and the token is asked for.

        Args:
            path: what is asked for, with its query; `?token=...` shows the token
            headers: of the request; `Authorization: Bearer ...` shows the token, too
        """
        host = headers.get("Host", "")
        if is_loopback(self.host) and not names_loopback(host):
            return HTTPStatus.FORBIDDEN, "Host: allowed: localhost or a loopback address\n"
        refusal = self.pages.objection(headers.get("Origin"), path, self.pages.viewer)
        if refusal is not None:
            return HTTPStatus.FORBIDDEN, refusal
        if self.token is not None and not same(self.token, _shown(path, headers)):
            return HTTPStatus.UNAUTHORIZED, "show the token: ?token=... or Authorization: Bearer\n"
        return None


def _shown(path: str, headers: Mapping[str, str]) -> str:
    authorization = headers.get("Authorization", "")
    if authorization.startswith(BEARER):
        return authorization.removeprefix(BEARER).strip()
    return queried(path, "token")
