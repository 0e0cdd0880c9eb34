"""Which web pages may talk to a server on this machine: the `Origin` that a browser sends along.

A browser lets any page open a WebSocket to 127.0.0.1 and only tells the server, in the header
`Origin`, where the page came from. Programs that are no browser send none.
"""

from __future__ import annotations

import ipaddress
from urllib.parse import urlsplit


def is_loopback(host: str) -> bool:
    """Whether a host name or address means this machine and can be reached from nowhere else."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def host_of(address: str) -> str | None:
    """Return the host of an origin (`http://localhost:8080`), or None where there is none."""
    try:
        return urlsplit(address).hostname
    except ValueError:
        return None


def may_come_from(origin: str | None, also: str | None = None) -> bool:
    """Whether a page from this origin may connect.

    Pages that this machine serves may, and programs that send no origin. A page that was opened as
    a file sends "null", which every sandboxed page of the web can send, too: it may not.

    Args:
        origin: what the browser sent, or None
        also: another host whose pages may connect, besides this machine's own
    """
    if origin is None:
        return True
    scheme, _, rest = origin.partition("://")
    host = host_of(origin)
    if scheme not in ("http", "https") or not rest or host is None:
        return False
    return is_loopback(host) or (also is not None and host == also.strip("[]").lower())
