"""rosbridge's protocol (version 2) over WebSockets: roslibpy, roslib, or anything with a socket."""

from trocar.interfaces.crtk.transports.websocket.transport import PORT, WebSocketTransport

__all__ = ["PORT", "WebSocketTransport"]
