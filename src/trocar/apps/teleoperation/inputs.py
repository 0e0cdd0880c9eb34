"""The topics by which a page or a program presses keys and moves sticks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from trocar.apps.teleoperation.device import Device
from trocar.apps.teleoperation.drive import Drive
from trocar.apps.teleoperation.engine import Ask
from trocar.apps.teleoperation.mapping import from_keys, from_pad
from trocar.apps.teleoperation.served import component
from trocar.interfaces.crtk import Component, Core, Topic
from trocar.interfaces.crtk.arm_rows import JOY, STRING
from trocar.interfaces.crtk.component import served
from trocar.interfaces.crtk.fields import Message, text, vector
from trocar.interfaces.crtk.topics import topics_from

KEYS, PAD = "teleop/keys", "teleop/gamepad"
#: What is sent when nobody presses keys any longer: the page has lost them to another window.
ASIDE = "aside"

ROWS = (
    ("sub 1", KEYS, STRING, "", "codes of the keys that are held, with spaces between; or `aside`"),
    ("sub 1", PAD, JOY, "", "axes and buttons in the standard layout of browsers; none: aside"),
)


def component_with_inputs(device: Device) -> Component:
    """Return what a core serves of a device: its teleoperation, and its keys and sticks."""
    whole = component(device.engine)
    handlers = {KEYS: partial(_take, device, _keys), PAD: partial(_take, device, _pad)}
    posts: list[Core] = []

    def begin(core: Core) -> Callable[[], None]:
        posts.append(core)
        return whole.begin(core)

    def handle(act: Callable[[Core, Topic, Message], None], topic: Topic, message: Message) -> None:
        if posts:
            act(posts[-1], topic, message)

    own = {name: partial(handle, act) for name, act in handlers.items()}
    return replace(
        whole,
        topics={**whole.topics, **served(topics_from(ROWS))},
        handlers={**whole.handlers, **own},
        begin=begin,
    )


def _take(
    device: Device,
    read: Callable[[Message], Drive | None],
    core: Core,
    topic: Topic,
    message: Message,
) -> None:
    drive = read(message)
    core.incoming.post(Ask(lambda: device.hear(drive), (device.master.name, topic.name)))


def _keys(message: Message) -> Drive | None:
    held = text(message, "data").split()
    return None if held == [ASIDE] else from_keys(held)


def _pad(message: Message) -> Drive | None:
    axes = vector(message, "axes")
    buttons = vector(message, "buttons")
    if not axes.size and not buttons.size:
        return None
    return from_pad(axes.tolist(), buttons.tolist())
