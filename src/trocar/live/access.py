"""Access of web pages and programs to the sockets of one run.

A browser lets every page open a WebSocket to 127.0.0.1. It sends the page's scheme, host and port
in the header `Origin`, which scripts cannot change; programs that are not browsers send none.

A page passes two checks. Its origin is the web viewer's, port included: other ports of this
machine serve other people's pages. And it shows the secret of this run, which stands in the HTML
of the web viewer; the same-origin policy keeps every other page from reading that. A cookie would
be no second check: browsers send the cookies of a host to all its ports. Pages that the user names
with --origin need no secret.

With --token, programs, named pages and browsers that open the web viewer show the token or the
secret. The secret stands in a file that only the user can read, for programs of the same user.

A second secret opens the web viewer and nothing else: other machines watch with it.
"""

from __future__ import annotations

import contextlib
import hmac
import ipaddress
import json
import os
import secrets
import socket
from collections.abc import Collection, Generator, Iterable, Mapping
from http import HTTPStatus
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from trocar.errors import InputError, TrocarError

#: Ports that browsers leave out of an origin. Source: RFC 6454, section 6.1.
DEFAULT_PORTS = {"http": 80, "https": 443}
#: Fewest characters of a token. Source: our own choice; 16 of base64 are 96 bits.
SHORTEST_TOKEN = 16
#: An address that is on no network of this machine, by family. Source: RFC 5737, RFC 3849.
ANYWHERE = {"0.0.0.0": ("192.0.2.1", 9), "::": ("2001:db8::1", 9)}


class PageAccess:
    """Decide which pages and programs may connect to the sockets of one run.

    Args:
        origins: pages of the user's own, as `http://localhost:3000`
        token: what all others have to show; None: programs connect without one

    Attributes:
        token: as given
        query: what the web viewer's page adds to the address of a socket: its secret
        watch_query: of the secret that opens the web viewer alone, to watch
        viewer: origins of the web viewer; empty until it is served
        watch_address: of the web viewer for other machines; "" where they cannot reach it

    Raises:
        InputError: an origin that no browser sends, or a short token
    """

    def __init__(self, origins: Iterable[str] = (), token: str | None = None) -> None:
        if token is not None and len(token) < SHORTEST_TOKEN:
            raise InputError(
                f"--token: got {len(token)} characters; allowed: at least {SHORTEST_TOKEN}, "
                "e.g. python -c 'import secrets; print(secrets.token_urlsafe())'"
            )
        self._named = frozenset(map(checked_origin, origins))
        self._secret, self._watch_secret = secrets.token_urlsafe(), secrets.token_urlsafe()
        self.token = token
        self.query = f"token={self._secret}"
        self.watch_query = f"token={self._watch_secret}"
        self.viewer: frozenset[str] = frozenset()
        self.watch_address = ""

    def objection(
        self,
        path: str,
        headers: Mapping[str, str],
        viewer: Collection[str],
        *,
        watching: bool = False,
    ) -> tuple[HTTPStatus, str] | None:
        """Check a request to open a WebSocket; return status and reason of a rejection, or None.

        Args:
            path: what is requested, with its query; `?token=...` shows the token
            headers: of the request; `Authorization: Bearer ...` shows the token, too
            viewer: origins that the web viewer's page has on this socket
            watching: whether the secret of those who watch is accepted, too
        """
        origin = headers.get("Origin")
        if origin is None or origin in self._named:
            if self.token is None or self.knows(path, headers, watching=watching):
                return None
            return HTTPStatus.UNAUTHORIZED, "show the token: ?token=... or Authorization: Bearer\n"
        if origin not in viewer:
            refusal = "pages of other origins may not connect; --origin URL lets one of yours in\n"
            return HTTPStatus.FORBIDDEN, refusal
        if self.knows(path, headers, watching=watching):
            return None
        return HTTPStatus.FORBIDDEN, "this page is of an earlier run: reload it\n"

    def knows(self, path: str, headers: Mapping[str, str], *, watching: bool = False) -> bool:
        """Whether a request shows the token or a secret of this run.

        Args:
            path, headers: of the request
            watching: whether the secret of those who watch is accepted, too
        """
        kind, _, bearer = headers.get("Authorization", "").partition("Bearer ")
        shown = bearer.strip() if bearer and not kind else queried(path, "token")
        accepted = [self._secret, *([] if self.token is None else [self.token])]
        accepted += [self._watch_secret] if watching else []
        return any(same(word, shown) for word in accepted)

    def is_console(self, query: str) -> bool:
        """Whether a query is that of the console: of the page that may drive by itself."""
        return same(self.query, query)


@contextlib.contextmanager
def announced(addresses: Mapping[str, str]) -> Generator[Path]:
    """Keep a file with addresses that only this user can read, while the block lasts.

    Args:
        addresses: {name of a server: its address, with the secret of this run}

    Raises:
        TrocarError: the file cannot be written
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = (Path(runtime) if runtime else Path.home() / ".local" / "share") / "trocar"
    path = folder / f"{os.getpid()}.json"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.unlink(missing_ok=True)  # of a process that was killed and had our number
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            json.dump({"pid": os.getpid(), **addresses}, file, indent=2)
    except OSError as error:
        raise TrocarError(
            f"cannot write {path}, from which programs read the run's token: {error.strerror}; "
            "set XDG_RUNTIME_DIR to a folder of yours, or leave out --token"
        ) from error
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)


def checked_origin(url: str) -> str:
    """Return the origin that a browser sends for pages at this address.

    Raises:
        InputError: the address has no http or https origin, or more than an origin
    """
    try:
        parts = urlsplit(url)
        scheme, host, port = parts.scheme, parts.hostname or "", parts.port
    except ValueError:
        raise _no_origin(url) from None
    more = parts.path.strip("/") or parts.query or parts.fragment or "@" in parts.netloc
    if scheme not in DEFAULT_PORTS or not host or more:
        raise _no_origin(url)
    shown = "" if port in (None, DEFAULT_PORTS[scheme]) else f":{port}"
    return f"{scheme}://{f'[{host}]' if ':' in host else host}{shown}"


def _no_origin(url: str) -> InputError:
    return InputError(
        f"--origin: got {url!r}; allowed: scheme, host and port of a web page, e.g. "
        "http://localhost:3000 (a page opened as a file has no origin: serve it with "
        "python -m http.server)"
    )


def is_loopback(host: str) -> bool:
    """Whether a host name or address means this machine and can be reached from nowhere else."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def local_host(host: str) -> str:
    """Return the address at which this machine reaches a server that listens on `host`."""
    return {"0.0.0.0": "127.0.0.1", "::": "::1", "localhost": "127.0.0.1"}.get(host, host)


def network_host(host: str) -> str:
    """Return the address at which other machines reach a server that listens on `host`."""
    if host not in ("0.0.0.0", "::"):
        return host
    family = socket.AF_INET6 if host == "::" else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect(ANYWHERE[host])  # sends nothing: it chooses the network's interface
            return str(probe.getsockname()[0])
    except OSError:  # no network
        return socket.gethostname()


def names_loopback(authority: str) -> bool:
    """Whether the header `Host` names this machine.

    A site can let its own name mean 127.0.0.1 (DNS rebinding); its pages then have the origin of
    the server that they reach, but not its name.
    """
    try:
        return is_loopback(urlsplit(f"//{authority}").hostname or "")
    except ValueError:
        return False


def queried(path: str, key: str) -> str:
    """Return a value of the query of a path, or ""."""
    return parse_qs(urlsplit(path).query).get(key, [""])[0]


def same(secret: str, shown: str) -> bool:
    """Compare in a time that does not depend on how much is right."""
    return hmac.compare_digest(secret.encode(), shown.encode("utf-8", "surrogateescape"))
