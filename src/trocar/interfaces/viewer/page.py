"""The browser page as a whole, and the function that serves it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import closing, suppress
from typing import TYPE_CHECKING, Literal
from urllib.parse import urlsplit

import numpy as np
import viser
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.interfaces.loop import Loop
from trocar.interfaces.origins import PageAccess
from trocar.interfaces.pictures import Pictures
from trocar.interfaces.viewer.driving import Driving, DrivingTab
from trocar.interfaces.viewer.endoscope import EndoscopeWindow
from trocar.interfaces.viewer.history import History
from trocar.interfaces.viewer.markers import RemoteCentres, ToolFrames, tips_of
from trocar.interfaces.viewer.own_thread import run_there
from trocar.interfaces.viewer.panel import Panel
from trocar.interfaces.viewer.plots import JointPlots
from trocar.interfaces.viewer.scene import Bodies, backdrop, floor, light, look_at_all
from trocar.interfaces.viewer.server import LocalServer, address, serving
from trocar.interfaces.viewer.sheet import read_sheet
from trocar.interfaces.viewer.status import Notices, StatusTables

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.records import ShapeRecord, Snapshot

Floats = NDArray[np.float64]

PERIOD_S = 1 / 30
"""Time between two looks at the simulation [s]. Source: a fifth of a core for 73 bodies."""

NUMBERS_EVERY = 6
"""Looks between two updates of the tables: five a second can still be read."""

PLOTS_EVERY = 3
"""Looks between two updates of the plots and the sliders: ten a second."""

FAREWELL_S = 1.0
"""How long the page still shows what stopped the simulation before it closes [s]."""

PANEL_WIDTH = 370
"""Width of each panel in CSS pixels. Source: chosen by eye."""


class Page:
    """Everything that a browser sees; made, in viser's thread, while the world stands still."""

    def __init__(
        self,
        server: LocalServer,
        world: World,
        loop: Loop,
        pictures: Pictures | None = None,
        driving: Driving | None = None,
    ) -> None:
        self._server, self._loop = server, loop
        self._looks = 0
        self.notices = Notices()
        shapes, now = world.shapes(), loop.latest
        light(server.scene)
        backdrop(server.scene)
        floor(server.scene)
        look_at_all(server, shapes, now)
        self._bodies = Bodies(server.scene, shapes)
        self._build = now.build
        self._shapes: Future[tuple[int, tuple[ShapeRecord, ...]]] | None = None
        self._centres = RemoteCentres(server.scene, now)
        self._tools = ToolFrames(server.scene, tips_of(world))
        self._tips: Future[dict[str, Floats]] | None = None
        self._where: dict[str, Floats] = {}
        self._history = History()
        sheets = {name: read_sheet(world, name) for name in _tools_first(world)}
        _theme(server.gui)
        self._panel = Panel(
            server.gui, loop, sheets, world.rig.poses, marks=(self._centres, self._tools)
        )
        window = server.gui.add_panel()
        self._hands: DrivingTab | None = None
        if driving is not None:
            with window.add_tab(driving.title):
                self._hands = DrivingTab(server, driving)
        with window.add_tab("Measurements"):
            self._tables = StatusTables(server.gui, self.notices)
            self._plots = JointPlots(server.gui, self._panel.sheet)
        window.dock_left()
        window.set_width(PANEL_WIDTH)
        self._scope = None
        if pictures is not None:
            eyes = {name: len(c.calibration.eyes) for name, c in pictures.cameras(world).items()}
            self._scope = EndoscopeWindow(server.gui, pictures, eyes)

    def refresh(self) -> None:
        """Send what changed, if anybody looks; to be called there every PERIOD_S."""
        state = self._loop.state
        self._history.add(state.snapshot)
        if not self._server.get_clients():
            return
        with self._server.atomic():
            self._show_bodies(state.snapshot)
            self._centres.show(state.snapshot)
            self._show_tools()
            if self._hands is not None:
                self._hands.show(self._where)
            if self._scope is not None:
                self._scope.show(time.perf_counter())
        if self._looks % PLOTS_EVERY == 0:
            self._panel.follow(state.snapshot)
            if self._panel.knows(state.snapshot):
                self._plots.show(self._history, self._panel.sheet)
        if self._looks % NUMBERS_EVERY == 0 and self._panel.knows(state.snapshot):
            self._tables.show(state, self._panel.sheet)
        if self._looks % NUMBERS_EVERY == 0 and self._scope is not None:
            self._scope.tell()
        self._looks += 1

    def _show_bodies(self, now: Snapshot) -> None:
        """Show where the bodies are; those of another tool first have to be asked for."""
        if self._shapes is not None and self._shapes.done():
            answer, self._shapes = self._shapes, None
            if not answer.cancelled():
                self._build, shapes = answer.result()
                self._bodies.renew(shapes)
        if now.build == self._build:
            self._bodies.show(now)
        elif self._shapes is None:
            self._shapes = self._loop.ask(lambda world: (world.snapshot().build, world.shapes()))

    def _show_tools(self) -> None:
        if not self._tools.visible and self._hands is None:
            return
        if self._tips is not None and self._tips.done() and not self._tips.cancelled():
            self._where = self._tips.result()
            self._tools.show(self._where)
        if self._tips is None or self._tips.done():
            self._tips = self._loop.ask(tips_of)

    def note(self, note: Callable[[], str] | None) -> None:
        """Show what a function says, above the table of joints."""
        self._tables.note = note

    def fail(self, error: Exception) -> None:
        """Show what stopped the simulation."""
        self._tables.fail(error)
        self._server.flush()


def serve(
    world: World,
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    speed: Literal["realtime", "max"] = "realtime",
    duration_s: float | None = None,
    on_ready: Callable[[str], None] | None = None,
    loop: Loop | None = None,
    pictures: Pictures | None = None,
    note: Callable[[], str] | None = None,
    driving: Driving | None = None,
    access: PageAccess | None = None,
) -> None:
    """Run a world and serve the page that shows and drives it, until Ctrl-C or the time is over.

    Args:
        world: what runs; it belongs to this function until it returns
        host: a loopback address: the page has no password
        port: port to listen on; 0 takes any free one
        speed: "realtime" keeps to the wall clock, "max" runs as fast as it goes
        duration_s: simulated time to run [s]; None means until Ctrl-C
        on_ready: called with the page's address once it is served and time flows
        loop: the world's loop, when others talk to it, too; not running yet, and ended here
        pictures: draws what the cameras of the loop's world see; None: the page shows none
        driving: what it offers to hands: keys, handles, pedals
        access: which web pages may connect; when omitted, the page itself
        note: HTML that is shown above the table of joints, asked for five times a second

    Raises:
        InputError: the host or the port cannot be used
        DivergedError: the simulation left the finite numbers
    """
    sockets = [] if driving is None or driving.websocket is None else [_socket(driving.websocket)]
    with serving(host, port, f"trocar: {world.rig.name}", access, sockets) as server:
        loop = loop or Loop(world, speed=speed)
        page = run_there(server, lambda: Page(server, world, loop, pictures, driving))
        page.note(note)
        with page.notices.listening(), closing(loop), suppress(KeyboardInterrupt):
            loop.start(duration_s)
            if on_ready is not None:
                on_ready(address(server))
            _show_until_the_end(server, page, loop)


def _socket(url: str) -> str:
    """Return where a WebSocket is, without what is shown to it."""
    return "{0.scheme}://{0.netloc}".format(urlsplit(url))


def _show_until_the_end(server: LocalServer, page: Page, loop: Loop) -> None:
    try:
        while not loop.wait(PERIOD_S):
            run_there(server, page.refresh)
    except TrocarError as error:
        failure = error
        run_there(server, lambda: page.fail(failure))
        threading.Event().wait(FAREWELL_S)
        raise


def _tools_first(world: World) -> list[str]:
    """Order the arms' names as people look for them: setup arms last."""
    return sorted(world.arms, key=lambda name: world.arms[name].type == "SUJ")


def _theme(gui: viser.GuiApi) -> None:
    gui.configure_theme(
        dark_mode=False, show_logo=False, show_share_button=False, brand_color=(28, 110, 164)
    )
    gui.main_panel.dock_right()
    gui.main_panel.set_width(PANEL_WIDTH)
