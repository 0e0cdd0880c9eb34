"""Classes of messages and services, which the packages of a ROS 2 workspace bring.

Messages travel as our own bytes, so a class serves to tell rclpy the type; only services have
objects of theirs. A class must have the fields that we write: nothing checks the bytes later.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from trocar.errors import TrocarError

if TYPE_CHECKING:
    from trocar.interfaces.crtk.messages import MessageType, ServiceType

#: Where packages are that no distribution of ROS 2 has.
SOURCES = {
    "crtk_msgs": "github.com/collaborative-robotics/crtk_msgs",
    "cisst_msgs": "github.com/jhu-cisst/cisst-ros",
    "trocar_msgs": "docs/ros.md, ROS 2",
}


class LackingError(TrocarError):
    """The workspace has no such type as ours; `package` is where it should be."""

    def __init__(self, package: str, problem: str) -> None:
        self.package, self.problem = package, problem
        super().__init__(f"{package}: {problem}")

    @property
    def told(self) -> str:
        """The package, what is wrong with it, and where there is another."""
        source = SOURCES.get(self.package)
        what = self.package if self.problem == MISSING else f"{self.package}, {self.problem}"
        return f"{what} ({source})" if source else what


MISSING = "cannot be imported"


def message_class(kind: MessageType) -> Any:
    """Return the class of a message.

    Raises:
        LackingError: there is none, or with other fields
    """
    found = _class(kind.ros2_name)
    _check(kind, found)
    return found


def service_class(kind: ServiceType) -> Any:
    """Return the class of a service.

    Raises:
        LackingError: there is none, or with other fields
    """
    found = _class(kind.ros2_name)
    for half, name in ((kind.request, "Request"), (kind.response, "Response")):
        _check(half, getattr(found, name, None))
    return found


def _class(name: str) -> Any:
    package, folder, own = name.split("/")
    try:
        module = import_module(f"{package}.{folder}")
    except ImportError as error:
        raise LackingError(package, MISSING) from error
    found = getattr(module, own, None)
    if found is None:
        raise LackingError(package, f"which has no {own}")
    return found


def _check(kind: MessageType, found: Any) -> None:
    package = kind.ros2_name.split("/")[0]
    fields = getattr(found, "get_fields_and_field_types", None)
    if fields is None:
        raise LackingError(package, "which is none of ROS 2")
    ours = [field.name for field in kind.fields if not field.only_ros1]
    if list(fields()) != ours:
        raise LackingError(package, f"in which {kind.name} has other fields")
