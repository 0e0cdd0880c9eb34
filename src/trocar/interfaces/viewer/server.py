"""Open the page: on this machine only, on the port that was asked for, and quietly."""

from __future__ import annotations

import contextlib
import io
import logging
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import viser
import viser.infra._infra as viser_infra
import websockets
from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response

from trocar.errors import InputError, TrocarError
from trocar.interfaces.origins import PageAccess
from trocar.interfaces.viewer.client_page import ClientPage

#: Where viser's server tells of whoever hangs up before a word, as browsers and scanners do.
_strangers = logging.getLogger("websockets.server")
HUNG_UP = "opening handshake failed"

LOOPBACK = ("127.0.0.1", "localhost", "::1")

_constructing = threading.Lock()


class LocalServer(viser.ViserServer):
    """viser's server behind our own answers to requests, and without its tunnel to the outside.

    Args:
        host, port: where it listens
        label: what the page's panel is called
        page: answers requests, from the first on

    Attributes:
        page: as given
    """

    def __init__(self, host: str, port: int, label: str, page: ClientPage) -> None:
        self.page = page
        with _answered_by(page.respond):
            super().__init__(host=host, port=port, label=label, verbose=False)

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002  as inherited
        """Refuse to open a public address."""
        return None


@contextlib.contextmanager
def _answered_by(
    respond: Callable[[ServerConnection, Request], Response | None],
) -> Iterator[None]:
    """Let viser open its port with our answers to requests in place of its own.

    viser listens before its constructor returns, and takes no other answers.

    Raises:
        TrocarError: this version of viser opens its port in another way
    """
    opened: list[int] = []

    def serve_ours(*args: Any, **options: Any) -> serve:
        opened.append(1)
        return serve(*args, **{**options, "process_request": respond})

    theirs = SimpleNamespace(server=SimpleNamespace(serve=serve_ours))
    with _constructing:
        for_viser = SimpleNamespace(**{**vars(websockets), "asyncio": theirs})
        setattr(viser_infra, "websockets", for_viser)  # noqa: B010  viser exports no such name
        try:
            yield
        finally:
            setattr(viser_infra, "websockets", websockets)  # noqa: B010
    if not opened:
        raise TrocarError(f"viser {viser.__version__} serves in another way than 1.1; use 1.1")


@contextlib.contextmanager
def serving(
    host: str,
    port: int,
    label: str,
    access: PageAccess | None = None,
    sockets: Sequence[str] = (),
) -> Iterator[LocalServer]:
    """Serve while the `with` block lasts.

    Args:
        host: a loopback address; the page lets everybody drive, so no other is accepted
        port: port to listen on; 0 takes any free one
        label: what the page's panel is called
        access: which web pages may connect; when omitted, the page itself
        sockets: addresses, as ws://127.0.0.1:9090, that the page reaches besides its own

    Raises:
        InputError: the host is not this machine's loopback, or the port is taken or forbidden
    """
    host = _checked_host(host)
    _check_free(host, port)
    access = access or PageAccess()
    page = ClientPage(access, sockets)
    with _quiet():
        server = LocalServer(host, port, label, page)
    _strangers.addFilter(_is_news)
    try:
        if port not in (0, server.get_port()):  # taken in between: viser went on to the next
            raise _taken(host, port)
        access.viewer = frozenset((address(server), f"http://localhost:{server.get_port()}"))
        yield server
    finally:
        with _quiet():
            server.stop()
        _strangers.removeFilter(_is_news)


def address(server: LocalServer) -> str:
    """Say where the page is."""
    host = server.get_host()
    return f"http://{f'[{host}]' if ':' in host else host}:{server.get_port()}"


def _checked_host(host: str) -> str:
    if host not in LOOPBACK:
        raise InputError(
            f"the page has no password and is served to this machine only: got host {host!r}, "
            f"allowed are {', '.join(LOOPBACK)}; to look from elsewhere, forward the port with ssh"
        )
    return LOOPBACK[0] if host == "localhost" else host


def _is_news(record: logging.LogRecord) -> bool:
    problem = record.exc_info[1] if record.exc_info else None
    ended = isinstance((problem and problem.__cause__) or problem, EOFError | ConnectionError)
    return not (ended and record.getMessage() == HUNG_UP)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep viser's banners off the terminal: what is printed is the caller's business."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


def _check_free(host: str, port: int) -> None:
    if not 0 <= port <= 65535:
        raise InputError(f"port {port} does not exist; allowed: 0 (any free one) to 65535")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        if sys.platform != "win32":  # a port that was just closed is free; Windows would share it
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except PermissionError as error:
            raise InputError(f"port {port} on {host} needs an administrator") from error
        except OSError as error:
            raise _taken(host, port) from error


def _taken(host: str, port: int) -> InputError:
    return InputError(
        f"port {port} on {host} is taken: choose another (--port), or 0 for any free one"
    )
