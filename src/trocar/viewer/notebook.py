"""A world that runs in the background and is shown in a notebook, or in a browser beside it."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from html import escape
from typing import TYPE_CHECKING, Literal

from trocar.errors import InputError, TrocarError
from trocar.live.loop import Loop
from trocar.viewer.page import serve

if TYPE_CHECKING:
    from trocar.simulation import World

HEIGHT_PX = 640
"""Height of the frame [CSS px]. Source: chosen by eye."""


class ShownWorld:
    """A world that runs, and its page: made by `show`.

    A notebook shows the page below a cell that ends with it; elsewhere, open `address`.

    Attributes:
        loop: of the world, which belongs to it until `close`: use `loop.ask` and `loop.post`
        address: of the page, for browsers of this machine, with the secret of the run
    """

    def __init__(
        self,
        world: World,
        speed: Literal["realtime", "max"] | float,
        port: int,
        height: int,
    ) -> None:
        if world.waiter is not None:
            raise InputError("the world runs already: close what runs it, or show another world")
        self.loop = Loop(world, speed=speed)
        self._height = height
        self._failure: TrocarError | None = None
        ready: Future[str] = Future()
        self._thread = threading.Thread(
            target=self._serve, args=(world, port, ready), name="trocar-page", daemon=True
        )
        self._thread.start()
        self.address = ready.result()

    def close(self) -> None:
        """Stop the world, which can be stepped again, and the page.

        Raises:
            TrocarError: what had stopped the world before, for instance a DivergedError
        """
        self.loop.close()
        self._thread.join()
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _serve(self, world: World, port: int, ready: Future[str]) -> None:
        try:
            serve(world, port=port, loop=self.loop, on_ready=ready.set_result, framed=True)
        except TrocarError as error:
            self._failure = error
            if not ready.done():
                ready.set_exception(error)

    def __repr__(self) -> str:
        rig = self.loop.world.rig.name
        return f"{rig}: {self.address}" if self._thread.is_alive() else f"{rig}: closed"

    def _repr_html_(self) -> str:
        if not self._thread.is_alive():
            return f"<p>{escape(repr(self))}</p>"
        return (
            f'<iframe src="{escape(self.address)}" title="trocar" width="100%"'
            f' height="{self._height}" style="border:0" allowfullscreen></iframe>'
        )


def show(
    world: World,
    *,
    speed: Literal["realtime", "max"] | float = "realtime",
    port: int = 0,
    height: int = HEIGHT_PX,
) -> ShownWorld:
    """Run a world in the background and serve its page, for a notebook or any browser.

    Pages of this machine may show it in a frame, and only with the secret in its address.

    Args:
        world: to run; it belongs to the page until that is closed
        speed: "realtime" keeps to the wall clock, "max" runs as fast as it goes; a number is a
            factor of real time
        port: port to listen on; 0 takes any free one
        height: of the frame in a notebook [CSS px]

    Raises:
        InputError: the world runs already, or the port or the speed cannot be used
    """
    return ShownWorld(world, speed, port, height)
