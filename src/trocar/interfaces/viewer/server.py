"""Open the page: on this machine only, on the port that was asked for, and quietly."""

from __future__ import annotations

import contextlib
import io
import logging
import socket
import sys
from collections.abc import Iterator

import viser
from viser.infra import WebsockClientConnection
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from trocar.errors import InputError
from trocar.interfaces.origins import may_come_from

#: Where viser's server tells of whoever hangs up before a word, as browsers and scanners do.
_strangers = logging.getLogger("websockets.server")
HUNG_UP = "opening handshake failed"

LOOPBACK = ("127.0.0.1", "localhost", "::1")


POLICY_VIOLATION = 1008
"""Why a WebSocket is closed. Source: RFC 6455, section 7.4.1."""


class LocalServer(viser.ViserServer):
    """viser's server without its tunnel to the outside: the page has no password.

    viser lets every page of the web connect, so those that do not come from this machine are sent
    away before anything is said or heard. It has no place to do so before the handshake.
    """

    def __init__(self, host: str, port: int, label: str) -> None:
        super().__init__(host=host, port=port, label=label, verbose=False)
        server = self._websock_server
        connections = server._live_connections  # nowhere else does viser tell who connects

        async def send_strangers_away(client: WebsockClientConnection) -> None:
            await _send_away_unless_ours(connections[client.client_id])

        server.on_client_connect(send_strangers_away)
        server.disconnect_all_clients()  # a page that was left open may have been faster

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002  as inherited
        """Refuse to open a public address."""
        return None


@contextlib.contextmanager
def serving(host: str, port: int, label: str) -> Iterator[LocalServer]:
    """Serve while the `with` block lasts.

    Args:
        host: a loopback address; the page lets everybody drive, so no other is accepted
        port: port to listen on; 0 takes any free one
        label: what the page's panel is called

    Raises:
        InputError: the host is not this machine's loopback, or the port is taken or forbidden
    """
    host = _checked_host(host)
    _check_free(host, port)
    with _quiet():
        server = LocalServer(host, port, label)
    _strangers.addFilter(_is_news)
    try:
        if port not in (0, server.get_port()):  # taken in between: viser went on to the next
            raise _taken(host, port)
        yield server
    finally:
        with _quiet():
            server.stop()
        _strangers.removeFilter(_is_news)


def address(server: LocalServer) -> str:
    """Say where the page is."""
    host = server.get_host()
    return f"http://{f'[{host}]' if ':' in host else host}:{server.get_port()}"


async def _send_away_unless_ours(connection: ServerConnection) -> None:
    request = connection.request
    if request is not None and may_come_from(request.headers.get("Origin")):
        return
    await connection.close(POLICY_VIOLATION, "pages of other sites may not connect")
    with contextlib.suppress(ConnectionClosed):
        while True:  # what was said already is not heard
            await connection.recv()


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
