"""The rosbridge protocol (version 2) over WebSockets: roslibpy, roslib, or any other client."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trocar.ros.transports.websocket.server import PORT, WebSocketTransport

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from trocar.live.access import PageAccess

__all__ = ["OPTIONS", "ORDER", "PORT", "WebSocketTransport", "open_transport"]

ORDER = 10
OPTIONS = """
--no-websocket                 do not serve the rosbridge WebSocket
--websocket-port N:int = 9090  WebSocket port (default: 9090, 0 = any free port)
--host HOST = 127.0.0.1        address of the web viewer and the WebSocket (default: 127.0.0.1);
                               0.0.0.0: other machines watch, and drive if the viewer here or
                               --token lets them
--token TOKEN                  token required by the WebSocket and the web viewer (default:
                               $TROCAR_TOKEN)
"""


def open_transport(options: Mapping[str, Any], pages: PageAccess) -> WebSocketTransport | None:
    """Return the transport, unless --no-websocket."""
    if options["no_websocket"]:
        return None
    return WebSocketTransport(options["host"], options["websocket_port"], pages)
