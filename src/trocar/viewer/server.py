"""The web viewer's server: viser behind our own answers to requests.

viser serves its client to every host name, lets every page frame it, and the client connects to any
address in its own address (`?websocket=`, `?playbackPath=`) and runs the scripts that are sent from
there. So every request comes to `ClientPage` before viser sees it.

Build, refresh and touch the page in viser's own thread and nowhere else (`run_there`). viser takes
messages from any thread, but wakes its senders with an `asyncio.Event`, which is not thread-safe:
now and then a message from another thread raises "deque mutated during iteration" (viser 1.1.1,
once in some minutes at 30 updates a second). In one thread there is no race and no need of locks.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import io
import logging
import secrets
import socket
import sys
from collections.abc import Callable, Generator, Sequence
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlencode

import viser
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import WebSocketException
from websockets.http11 import Request, Response

from trocar.errors import InputError, TrocarError
from trocar.live.access import (
    PageAccess,
    is_loopback,
    local_host,
    names_loopback,
    network_host,
    queried,
)
from trocar.live.connections import Connections
from trocar.viewer.viser_hooks import grey_out, served_with

T = TypeVar("T")

#: The logger and message by which websockets reports clients that hang up before their request or
#: send none that is HTTP, as browsers and port scanners do.
_handshakes = logging.getLogger("websockets.server")
HUNG_UP = "opening handshake failed"

#: Time limit of sending the page, 0.8 MB, through a slow ssh [s]. Source: our own choice.
PAGE_S = 60.0

LOOPBACK = "127.0.0.1"
CLIENT = Path(viser.__file__).parent / "client" / "build" / "index.html"
#: The start of viser's client, the place where it inserts the script that it has unpacked, and the
#: title of the browser's tab.
UNPACKER, UNPACKED, TITLE = '<script data-p="', 'e.type="module";', "<title>Viser</title>"


class ClientPage:
    """Answer the requests of browsers with viser's client, secured.

    Args:
        access: which pages may connect to viser's WebSocket
        sockets: addresses, as ws://127.0.0.1:9090, that the page reaches besides its own
        networked: whether other machines reach the page: then it needs a token, any name may lead
            here, and who does not show the secret of the run, or the token on this machine, watches
        framed: whether pages of this machine, as notebooks, may show it in a frame

    Attributes:
        access, networked: as given
        nonce: of the scripts that may run; one for the whole run: none of the page's HTML comes
            from a request

    Raises:
        InputError: a socket whose address no policy can name
        TrocarError: this version of viser has another page
    """

    def __init__(
        self,
        access: PageAccess,
        sockets: Sequence[str] = (),
        *,
        networked: bool = False,
        framed: bool = False,
    ) -> None:
        self.access, self.networked = access, networked
        self._connections = Connections("web viewer")
        self.nonce = secrets.token_urlsafe()
        html = CLIENT.read_text(encoding="utf-8")
        self._console = self._with_our_script(html, access.query)
        self._watching = self._with_our_script(html, access.watch_query)
        self._headers = {
            "Content-Security-Policy": _policy(self.nonce, sockets, framed=framed),
            **({} if framed else {"X-Frame-Options": "DENY"}),
            "X-Content-Type-Options": "nosniff",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Referrer-Policy": "no-referrer",
            "Cache-Control": "no-store",
        }
        self._headers_watching = {
            **self._headers,
            "Content-Security-Policy": _policy(self.nonce, (), framed=framed),
        }

    def respond(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request, or return None: it opens viser's WebSocket."""
        host = request.headers.get("Host", "")
        if not self.networked and not names_loopback(host):
            return self._text(
                connection,
                HTTPStatus.FORBIDDEN,
                "Host: allowed: localhost or a loopback address; to look from elsewhere, forward "
                "the port with ssh\n",
            )
        if request.headers.get("Upgrade", "").lower() == "websocket":
            refusal = self.access.objection(
                request.path, request.headers, {f"http://{host}"}, watching=True
            )
            if refusal is None:
                return self._connections.admit(connection)
            return self._text(connection, *refusal)
        path, _, query = request.path.partition("?")
        if path not in ("/", "/index.html"):
            return self._text(connection, HTTPStatus.NOT_FOUND, "there is only /\n")
        ours, console = "", True
        if self.access.token is not None:
            if not self.access.knows(request.path, request.headers, watching=True):
                told = "open the address that trocar printed, with its ?token=...\n"
                return self._text(connection, HTTPStatus.UNAUTHORIZED, told)
            ours = urlencode({"token": shown}) if (shown := queried(request.path, "token")) else ""
            console = self.access.is_console(ours) or (
                self.access.knows(request.path, request.headers)
                and (not self.networked or _from_here(connection))
            )
        if query != ours:
            text = "the page takes no parameters but the token\n"
            response = self._text(connection, HTTPStatus.FOUND, text)
            response.headers["Location"] = f"/?{ours}" if ours else "/"
            return response
        html = self._console if console else self._watching
        response = self._text(connection, HTTPStatus.OK, html)
        if not console:
            response.headers.update(self._headers_watching)
        del response.headers["Content-Type"]
        response.headers["Content-Type"] = "text/html; charset=utf-8"
        return response

    @property
    def options(self) -> dict[str, Any]:
        """Keyword arguments of websockets' `serve`: answers, and bounds."""
        patience = {"open_timeout": PAGE_S, "close_timeout": PAGE_S}
        return {**self._connections.options, **patience, "process_request": self.respond}

    @property
    def entrance(self) -> str:
        """Path and query of the page's address, with the token if there is one."""
        return "" if self.access.token is None else f"/?{self.access.query}"

    def _text(self, connection: ServerConnection, status: HTTPStatus, text: str) -> Response:
        response = connection.respond(status, text)
        response.headers.update(self._headers)
        return response

    def _with_our_script(self, html: str, query: str) -> str:
        if any(html.count(part) != 1 for part in (UNPACKER, UNPACKED, TITLE)):
            raise TrocarError(f"viser {viser.__version__}: unsupported web client; allowed: 1.1")
        html = html.replace(TITLE, "<title>trocar</title>")
        ours = files("trocar.viewer").joinpath("client.js").read_text(encoding="utf-8")
        ours = ours.replace("{{QUERY}}", query)
        begin = f'<script nonce="{self.nonce}"'
        html = html.replace(UNPACKER, f"{begin}>\n{ours}</script>\n{begin}{UNPACKER[7:]}")
        return html.replace(UNPACKED, f'e.nonce="{self.nonce}";{UNPACKED}')


def _from_here(connection: ServerConnection) -> bool:
    """Whether a browser runs on this machine, or is forwarded to it with ssh."""
    peer, own = connection.remote_address, connection.local_address
    return bool(peer) and (is_loopback(str(peer[0])) or (bool(own) and peer[0] == own[0]))


def _policy(nonce: str, sockets: Sequence[str], *, framed: bool) -> str:
    """Return the Content-Security-Policy of the page and of the frame inside it.

    Raises:
        InputError: a socket on an IPv6 address, which a policy has no way to write
    """
    for url in sockets:
        if "[" in url:
            raise InputError(
                f"cannot send keys to {url}: browsers block IPv6 "
                "addresses; leave out --host, or use another --device"
            )
    directives = {
        "default-src": "'none'",
        # viser's client is packed, and its unpacker and its messages' are WebAssembly. Scripts from
        # messages, which viser uses for plotly alone, would need 'unsafe-eval', and so would its
        # sorter of Gaussian splats: its one refusal in the browser's console is expected.
        "script-src": f"'nonce-{nonce}' 'wasm-unsafe-eval'",
        # viser's socket lives in a worker that the client makes of itself.
        "worker-src": "blob:",
        # 'self' covers ws: of the same host and port. The client fetches its own assets, which are
        # data:, and images and light maps that it was sent, as blob:.
        "connect-src": " ".join(("'self'", "data:", "blob:", *sockets)),
        "img-src": "data: blob:",
        "font-src": "data:",
        # Mantine, viser's library of widgets, styles by attributes.
        "style-src": "'unsafe-inline'",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": "http://localhost:* http://127.0.0.1:*" if framed else "'none'",
    }
    return "; ".join(f"{name} {sources}" for name, sources in directives.items())


class LocalServer(viser.ViserServer):
    """viser's server behind our own answers to requests, and without its tunnel to the outside.

    Args:
        host, port: address to listen on
        label: title of the page's control panel
        page: answers requests, from the first on

    Attributes:
        page: as given
    """

    def __init__(self, host: str, port: int, label: str, page: ClientPage) -> None:
        self.page = page
        with served_with(page.options):
            base: Any = super()  # its types are partial
            base.__init__(host=host, port=port, label=label, verbose=False)

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002  as inherited
        """Refuse to open a public address."""
        return None


@contextlib.contextmanager
def serving(
    host: str,
    port: int,
    label: str,
    access: PageAccess | None = None,
    sockets: Sequence[str] = (),
    *,
    framed: bool = False,
) -> Generator[LocalServer]:
    """Serve while the `with` block lasts.

    Args:
        host: address to listen on; beyond the loopback address, the access has a token
        port: port to listen on; 0 takes any free one
        label: title of the page's control panel
        access: which web pages may connect; when omitted, the page itself, with a token beyond the
            loopback address or in a frame
        sockets: addresses, as ws://127.0.0.1:9090, that the page reaches besides its own
        framed: whether pages of this machine, as notebooks, may show it in a frame

    Raises:
        InputError: the host is not an address of this machine, or reaches beyond it without a
            token, or the port is taken or forbidden
    """
    networked = not is_loopback(host)
    host = LOOPBACK if host == "localhost" else host
    access = access or PageAccess(token=secrets.token_urlsafe() if networked or framed else None)
    if networked and access.token is None:
        raise InputError(
            f"the web viewer on host {host!r}: other machines could move the arms; set a token, or "
            f"listen on {LOOPBACK} and forward the port with ssh"
        )
    _check_free(host, port)
    page = ClientPage(access, sockets, networked=networked, framed=framed)
    with _quiet():
        server = LocalServer(host, port, label, page)
    _handshakes.addFilter(_is_defect)
    try:
        if port not in (0, server.get_port()):  # taken in between: viser went on to the next
            raise _taken(host, port)
        access.viewer = frozenset((address(server), f"http://localhost:{server.get_port()}"))
        if networked:
            there = _url(network_host(host), server.get_port())
            access.watch_address = f"{there}/?{access.watch_query}"
        yield server
    finally:
        with _quiet():
            server.stop()
        _handshakes.removeFilter(_is_defect)


def address(server: LocalServer) -> str:
    """Return the page's address on this machine."""
    return _url(local_host(server.get_host()), server.get_port())


def _url(host: str, port: int) -> str:
    return f"http://{f'[{host}]' if ':' in host else host}:{port}"


def entrance(server: LocalServer) -> str:
    """Return the address to open, with the secret of the run where there is a token."""
    return address(server) + server.page.entrance


def _is_defect(record: logging.LogRecord) -> bool:
    """Drop reports of clients that hang up; every other failed handshake is a defect."""
    problem = record.exc_info[1] if record.exc_info else None
    theirs = isinstance(problem, WebSocketException | EOFError | ConnectionError)
    return not (theirs and record.getMessage() == HUNG_UP)


@contextlib.contextmanager
def _quiet() -> Generator[None]:
    """Keep viser's banners off the terminal."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


def _check_free(host: str, port: int) -> None:
    if not 0 <= port <= 65535:
        raise InputError(f"got port {port}; allowed: 1 to 65535, or 0 for any free port")
    if not host:
        raise _no_host(host)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        if sys.platform != "win32":  # a port that was just closed is free; Windows would share it
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except PermissionError as error:
            raise InputError(f"port {port} on {host} requires administrator rights") from error
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise _taken(host, port) from error
            raise _no_host(host) from error


def _no_host(host: str) -> InputError:
    return InputError(
        f"--host: got {host!r}; allowed: an address of this machine, or 0.0.0.0 for all of them"
    )


def _taken(host: str, port: int) -> InputError:
    return InputError(
        f"port {port} on {host} is in use; choose another --port, or 0 for any free port"
    )


def run_there(server: viser.ViserServer, work: Callable[[], T]) -> T:
    """Call a function in viser's thread; return what it returns, raise what it raises."""

    async def job() -> T:
        return work()

    return asyncio.run_coroutine_threadsafe(job(), server.get_event_loop()).result()


def when_touched(handle: viser.GuiInputHandle[Any], act: Callable[[Any], object]) -> None:
    """Call `act(value)` in viser's thread when a person changes an input.

    When the page itself changes it nothing is called, nor when it is greyed out: a browser can
    send what its page does not offer.
    """

    @handle.on_update
    async def _(event: viser.GuiEvent[Any]) -> None:
        if event.client_id is not None and not handle.disabled:
            act(event.target.value)


class Buttons:
    """A row of buttons whose names change, and that can be greyed out.

    Args:
        gui: the page's widgets
        label: of the row
        names: of the buttons
        act: called with the name of the one that a person presses
        hint: shown under the mouse

    Attributes:
        names, disabled: what is shown
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        label: str,
        names: Sequence[str],
        act: Callable[[str], object],
        hint: str | None = None,
    ) -> None:
        self.names, self.disabled = tuple(names), False
        self._handle = gui.add_button_group(label, self.names, hint=hint)

        def pressed(name: str) -> None:
            if not self.disabled and name in self.names:
                act(name)

        when_pressed(self._handle, pressed)

    def show(self, names: Sequence[str], *, disabled: bool = False) -> None:
        """Show other buttons, or grey all of them out."""
        if tuple(names) != self.names:
            self.names = tuple(names)
            self._handle.options = self.names
        if disabled != self.disabled:
            self.disabled = disabled
            grey_out(self._handle, disabled=disabled)

    def set_visible(self, *, visible: bool) -> None:
        """Show or hide the row."""
        if self._handle.visible != visible:
            self._handle.visible = visible


def when_pressed(buttons: viser.GuiButtonGroupHandle, act: Callable[[str], object]) -> None:
    """Call `act(name)` in viser's thread when a person presses a button of a group."""

    @buttons.on_click
    async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
        act(event.target.value)
