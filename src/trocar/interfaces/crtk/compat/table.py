"""Older interfaces that scripts were written for, served beside the dVRK's own.

Each is one table over the same core: its topics, how to make their messages from a sample, and what
its commands make the arms do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from trocar.descriptions.records import RigDescription
from trocar.errors import UnknownNameError
from trocar.interfaces.crtk.compat import dvrk_env, dvrk_vrep
from trocar.interfaces.crtk.image_rows import Origin
from trocar.interfaces.crtk.publishing import Figure
from trocar.interfaces.crtk.topics import Topic

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core

#: Does what a message asks for; raises InputError where it cannot.
Handler = Callable[["Core", Topic, Mapping[str, Any]], None]
MODULES = {"dvrk_env": dvrk_env, "dvrk_vrep": dvrk_vrep}


@dataclass(frozen=True)
class Compatible:
    """Rows beside the dVRK's own.

    Attributes:
        topics: by name
        makers: {topic that is published: how to make its message}
        handlers: {topic that is listened to: what a message does}
        cameras: topics of cameras and what each is of
    """

    topics: Mapping[str, Topic]
    makers: Mapping[str, Figure]
    handlers: Mapping[str, Handler]
    cameras: tuple[tuple[Topic, Origin], ...] = ()


def compatible(rig: RigDescription, names: Sequence[str]) -> Compatible:
    """Return the rows of some older interfaces for a rig.

    Raises:
        UnknownNameError: no such interface
    """
    topics: dict[str, Topic] = {}
    makers: dict[str, Figure] = {}
    handlers: dict[str, Handler] = {}
    cameras: list[tuple[Topic, Origin]] = []
    for name in names:
        if name not in MODULES:
            raise UnknownNameError("compat", name, MODULES)
        cameras += MODULES[name].cameras(rig)
        for topic, act in MODULES[name].rows(rig):
            topics[topic.name] = topic
            if topic.direction == "pub":
                makers[topic.name] = act
            else:
                handlers[topic.name] = act
    return Compatible(topics, makers, handlers, tuple(cameras))
