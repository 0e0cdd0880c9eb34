"""Which web pages may connect to the sockets of one run.

A browser lets every page open a WebSocket to 127.0.0.1. It sends the page's scheme, host and port
in the header `Origin`, which scripts cannot change; programs that are not browsers send none.

A page passes two checks. Its origin is the web viewer's, port included: other ports of this
machine serve other people's pages. And it shows the secret of this run, which stands in the HTML
of the web viewer; the same-origin policy keeps every other page from reading that. A cookie would
be no second check: browsers send the cookies of a host to all its ports. Pages that the user names
with --origin need no secret.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from collections.abc import Collection, Iterable
from urllib.parse import parse_qs, urlsplit

from trocar.errors import InputError

#: Ports that browsers leave out of an origin. Source: RFC 6454, section 6.1.
DEFAULT_PORTS = {"http": 80, "https": 443}


class PageAccess:
    """Decide which web pages may connect to the sockets of one run.

    Args:
        origins: pages of the user's own, as `http://localhost:3000`

    Attributes:
        query: what the web viewer's page adds to the address of a socket: its secret
        viewer: origins of the web viewer; empty until it is served

    Raises:
        InputError: an origin that no browser sends
    """

    def __init__(self, origins: Iterable[str] = ()) -> None:
        self._named = frozenset(map(checked_origin, origins))
        self._secret = secrets.token_urlsafe()
        self.query = f"page={self._secret}"
        self.viewer: frozenset[str] = frozenset()

    def objection(self, origin: str | None, path: str, viewer: Collection[str]) -> str | None:
        """Say why a request to open a WebSocket is refused, or return None.

        Args:
            origin: what the browser sent, or None
            path: what is requested, with its query
            viewer: origins that the web viewer's page has on this socket
        """
        if origin is None or origin in self._named:
            return None
        if origin not in viewer:
            return "pages of other origins may not connect; --origin URL lets one of yours in\n"
        if not same(self._secret, queried(path, "page")):
            return "this page is of an earlier run: reload it\n"
        return None


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
