"""viser's client as this server hands it out: one page of HTML, and who may have it.

viser serves its client to every host name, lets every page frame it, and the client connects to any
address in its own address (`?websocket=`, `?playbackPath=`) and runs the scripts that are sent from
there. So every request comes here before viser sees it.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path

import viser
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from trocar.errors import InputError, TrocarError
from trocar.interfaces.origins import PageAccess, names_loopback

CLIENT = Path(viser.__file__).parent / "client" / "build" / "index.html"
#: Where viser's client begins, and where it makes the script that it has unpacked.
UNPACKER, UNPACKED = '<script data-p="', 'e.type="module";'


class ClientPage:
    """Answer the requests of browsers.

    Args:
        access: which pages may connect to viser's WebSocket
        sockets: addresses, as ws://127.0.0.1:9090, that the page reaches besides its own

    Attributes:
        nonce: of the scripts that may run; one for the whole run: none of the page's HTML comes
            from a request

    Raises:
        InputError: a socket whose address no policy can name
        TrocarError: this version of viser has another page
    """

    def __init__(self, access: PageAccess, sockets: Sequence[str] = ()) -> None:
        self._access = access
        self.nonce = secrets.token_urlsafe()
        self._html = self._with_our_script(CLIENT.read_text(encoding="utf-8"))
        self._headers = {
            "Content-Security-Policy": _policy(self.nonce, sockets),
            "X-Frame-Options": "DENY",
            "X-Content-Type-Options": "nosniff",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Referrer-Policy": "no-referrer",
            "Cache-Control": "no-store",
        }

    def respond(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request, or return None: it opens viser's WebSocket."""
        host = request.headers.get("Host", "")
        if not names_loopback(host):
            return self._text(
                connection,
                HTTPStatus.FORBIDDEN,
                "Host: allowed: localhost or a loopback address; to look from elsewhere, forward "
                "the port with ssh\n",
            )
        if request.headers.get("Upgrade", "").lower() == "websocket":
            origin = request.headers.get("Origin")
            refusal = self._access.objection(origin, request.path, {f"http://{host}"})
            if refusal is None:
                return None
            return self._text(connection, HTTPStatus.FORBIDDEN, refusal)
        path, _, query = request.path.partition("?")
        if path not in ("/", "/index.html"):
            return self._text(connection, HTTPStatus.NOT_FOUND, "there is only /\n")
        if query:
            response = self._text(connection, HTTPStatus.FOUND, "the page takes no parameters\n")
            response.headers["Location"] = "/"
            return response
        response = self._text(connection, HTTPStatus.OK, self._html)
        del response.headers["Content-Type"]
        response.headers["Content-Type"] = "text/html; charset=utf-8"
        return response

    def _text(self, connection: ServerConnection, status: HTTPStatus, text: str) -> Response:
        response = connection.respond(status, text)
        response.headers.update(self._headers)
        return response

    def _with_our_script(self, html: str) -> str:
        if html.count(UNPACKER) != 1 or html.count(UNPACKED) != 1:
            raise TrocarError(f"viser {viser.__version__}: its page is not that of 1.1; use 1.1")
        ours = files("trocar.interfaces.viewer").joinpath("client.js").read_text(encoding="utf-8")
        ours = ours.replace("{{QUERY}}", self._access.query)
        begin = f'<script nonce="{self.nonce}"'
        html = html.replace(UNPACKER, f"{begin}>\n{ours}</script>\n{begin}{UNPACKER[7:]}")
        return html.replace(UNPACKED, f'e.nonce="{self.nonce}";{UNPACKED}')


def _policy(nonce: str, sockets: Sequence[str]) -> str:
    """Return the Content-Security-Policy of the page and of the frame inside it.

    Raises:
        InputError: a socket on an IPv6 address, which a policy has no way to write
    """
    for socket in sockets:
        if "[" in socket:
            raise InputError(
                f"keys of the page cannot be sent to {socket}: browsers allow a page no IPv6 "
                "address; leave out --host, or drive by another --device"
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
        "frame-ancestors": "'none'",
    }
    return "; ".join(f"{name} {sources}" for name, sources in directives.items())
