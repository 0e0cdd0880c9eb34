"""A live view in Foxglove, and files for it, by Foxglove's own SDK (extra `foxglove`)."""

from trocar.interfaces.crtk.transports.foxglove.transport import FoxgloveTransport

__all__ = ["FoxgloveTransport"]
