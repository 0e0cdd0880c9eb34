"""The page lives in viser's own thread: it is built, refreshed and touched there and nowhere else.

viser takes messages from any thread, but wakes its senders with an `asyncio.Event`, which is not
made for that: now and then a message from another thread raises "deque mutated during iteration"
(viser 1.1.1, seen once in some minutes at 30 updates a second). In one thread there is nothing
to race, touches come in the order in which they were made, and no part of the page needs a lock.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar

import viser

T = TypeVar("T")


def run_there(server: viser.ViserServer, work: Callable[[], T]) -> T:
    """Do something in viser's thread and wait for what it returns or raises."""

    async def job() -> T:
        return work()

    return asyncio.run_coroutine_threadsafe(job(), server.get_event_loop()).result()


def when_touched(handle: viser.GuiInputHandle[Any], act: Callable[[Any], object]) -> None:
    """Call `act(value)` in viser's thread when a person changes an input.

    When the page itself changes it nothing is called.
    """

    @handle.on_update
    async def _(event: viser.GuiEvent[Any]) -> None:
        if event.client_id is not None:
            act(event.target.value)


def when_pressed(buttons: viser.GuiButtonGroupHandle, act: Callable[[str], object]) -> None:
    """Call `act(name)` in viser's thread when a person presses a button of a group."""

    @buttons.on_click
    async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
        act(event.target.value)
