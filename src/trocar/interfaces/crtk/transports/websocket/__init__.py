"""The rosbridge protocol (version 2) over WebSockets: roslibpy, roslib, or any other client."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trocar.interfaces.crtk.transports.websocket.server import PORT, WebSocketTransport

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from trocar.interfaces.origins import PageAccess

__all__ = ["OPTIONS", "ORDER", "PORT", "WebSocketTransport", "open_transport"]

ORDER = 10
OPTIONS = {
    "--no-websocket": {
        "action": "store_true",
        "help": "do not serve the rosbridge WebSocket",
    },
    "--websocket-port": {
        "default": 9090,
        "metavar": "N",
        "help": "WebSocket port (default: 9090, 0 = any free port)",
    },
    "--host": {
        "default": "127.0.0.1",
        "help": "WebSocket address (default: 127.0.0.1); other addresses require --token",
    },
    "--token": {
        "help": "token required by the WebSocket and the web viewer (default: $TROCAR_TOKEN)"
    },
}


def open_transport(options: Mapping[str, Any], pages: PageAccess) -> WebSocketTransport | None:
    """Return the transport, unless --no-websocket."""
    if options["no_websocket"]:
        return None
    return WebSocketTransport(options["host"], options["websocket_port"], pages)
