"""The rosbridge protocol (version 2) over WebSockets: roslibpy, roslib, or any other client."""

from trocar.interfaces.crtk.transports.websocket.server import PORT, WebSocketTransport

__all__ = ["PORT", "WebSocketTransport"]
