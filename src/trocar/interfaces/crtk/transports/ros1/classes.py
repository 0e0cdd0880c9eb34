"""Message and service classes for rospy, made at run time from our own definitions.

rospy asks of a class its name, md5 sum and definition, and how to write and read bytes. Ours carry
bytes only: they are written once, for all subscribers, and what comes in is read by our own
decoder, which trusts nobody.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trocar.interfaces.crtk.messages import MessageType, ServiceType
    from trocar.interfaces.crtk.transports.ros1.library import Library


def message_class(library: Library, kind: MessageType) -> Any:
    """Return a class of messages that hold their bytes in `data`."""
    return type(
        kind.name.replace("/", "_"),
        (library.genpy.Message,),
        {
            "__slots__": ("data",),
            "__init__": _init,
            "__module__": __name__,
            "_type": kind.name,
            "_md5sum": kind.md5,
            "_full_text": kind.text_ros1,
            "_has_header": False,  # rospy would write its own sequence number into an attribute
            "_slot_types": ("uint8[]",),
            "serialize": _serialize,
            "deserialize": _deserialize,
        },
    )


def service_class(library: Library, kind: ServiceType, name: str) -> Any:
    """Return the class of a service of type `name`, such as "std_srvs/Trigger"."""
    return type(
        name.replace("/", "_"),
        (),
        {
            "_type": name,
            "_md5sum": kind.md5,
            "_request_class": message_class(library, kind.request),
            "_response_class": message_class(library, kind.response),
        },
    )


def _init(self: Any, data: bytes = b"") -> None:
    self.data = data


def _serialize(self: Any, buffer: Any) -> None:
    buffer.write(self.data)


def _deserialize(self: Any, data: bytes) -> Any:
    self.data = data
    return self
