"""Open the page: on this machine only, on the port that was asked for, and quietly."""

from __future__ import annotations

import contextlib
import io
import socket

import viser

from trocar.errors import InputError

LOOPBACK = ("127.0.0.1", "localhost", "::1")


class LocalServer(viser.ViserServer):
    """viser's server without its tunnel to the outside: the page has no password."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse to open a public address."""
        return None


def open_server(host: str, port: int, label: str) -> LocalServer:
    """Start serving.

    Args:
        host: a loopback address; the page lets everybody drive, so no other is accepted
        port: port to listen on; 0 takes any free one
        label: what the page's panel is called

    Raises:
        InputError: the host is not this machine's loopback, or the port is taken or forbidden
    """
    if host not in LOOPBACK:
        raise InputError(
            f"the page has no password and is served to this machine only: host is {host!r}, "
            f"allowed are {', '.join(LOOPBACK)} (from elsewhere: ssh -L {port}:127.0.0.1:{port})"
        )
    host = "127.0.0.1" if host == "localhost" else host
    if not 0 <= port <= 65535:
        raise InputError(f"port {port} does not exist: 0 (any free one) to 65535")
    _check_free(host, port)
    with quiet():
        server = LocalServer(host=host, port=port, label=label, verbose=False)
    if port not in (0, server.get_port()):  # somebody took it in between; viser took the next
        close_server(server)
        raise _taken(host, port)
    return server


def close_server(server: LocalServer) -> None:
    """Stop serving."""
    with quiet():
        server.stop()


def address(server: LocalServer) -> str:
    """Say where the page is."""
    host = server.get_host()
    return f"http://{f'[{host}]' if ':' in host else host}:{server.get_port()}"


@contextlib.contextmanager
def quiet():
    """Keep viser's banners off the terminal: what is printed is the caller's business."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


def _check_free(host: str, port: int) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        if hasattr(socket, "SO_EXCLUSIVEADDRUSE"):  # Windows: two could share a port otherwise
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
        else:  # a port that was just closed is free
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
