"""The web viewer's page as a whole, and the function that serves it."""

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
from trocar.live.access import PageAccess
from trocar.live.images import Pictures
from trocar.live.loop import Loop
from trocar.viewer.cameras import CameraWindow
from trocar.viewer.driving import Driving, DrivingTab
from trocar.viewer.measurements import History, JointPlots, Notices, StatusTables
from trocar.viewer.panel import Panel, read_arm
from trocar.viewer.scene import Bodies, Drawings, RemoteCentres, ToolFrames, stage, tips_of
from trocar.viewer.server import LocalServer, entrance, run_there, serving

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.records import ShapeRecord, Snapshot

Floats = NDArray[np.float64]

PERIOD_S = 1 / 30
"""Time between two refreshes [s]. Source: a fifth of a core for 73 bodies."""

NUMBERS_EVERY = 6
"""Refreshes between two updates of the tables: five a second can still be read."""

PLOTS_EVERY = 3
"""Refreshes between two updates of the plots and the sliders: ten a second."""

FAREWELL_S = 1.0
"""Time for which the page shows the error that stopped the simulation before it closes [s]."""

PANEL_WIDTH = 370
"""Width of each panel in CSS pixels. Source: chosen by eye."""


class Page:
    """The whole page; made in viser's thread while the world stands still.

    Attributes:
        panel, tables, bodies, tools: its parts
        cameras: the window of the rig's cameras; None without pictures
        notices: the last warnings
    """

    def __init__(
        self,
        server: LocalServer,
        world: World,
        loop: Loop,
        pictures: Pictures | None = None,
        driving: Driving | None = None,
    ) -> None:
        self._server, self._loop = server, loop
        self._refreshes = 0
        self.notices = Notices()
        shapes, now = world.shapes(), loop.latest
        stage(server, shapes, now)
        self.bodies = Bodies(server.scene, shapes)
        self._drawings = Drawings(server.scene)
        self._build = now.build
        self._shapes: Future[tuple[int, tuple[ShapeRecord, ...]]] | None = None
        self._centres = RemoteCentres(server.scene, now)
        self.tools = ToolFrames(server.scene, tips_of(world))
        self._tips: Future[dict[str, Floats]] | None = None
        self._last_tips: dict[str, Floats] = {}
        self._history = History()
        names = sorted(
            world.arms, key=lambda name: world.arms[name].description.type == "SUJ"
        )  # those last
        arms = {name: read_arm(world, name) for name in names}
        _theme(server.gui)
        self.panel = Panel(
            server.gui, loop, arms, world.rig.poses, marks=(self._centres, self.tools)
        )
        window = server.gui.add_panel()
        self._driving: DrivingTab | None = None
        titles = ["Measurements"]
        if driving is not None:  # before the measurements where keys drive: open at first
            titles.insert(0 if driving.tables else 1, driving.title)
        for title in titles:
            with window.add_tab(title):
                if driving is not None and title == driving.title:
                    self._driving = DrivingTab(server, driving)
                else:
                    self.tables = StatusTables(server.gui, self.notices)
                    self._plots = JointPlots(server.gui, self.panel.arm)
        window.dock_left()
        window.set_width(PANEL_WIDTH)
        self.cameras: CameraWindow | None = None
        if pictures is not None:
            eyes = {name: len(c.calibration.eyes) for name, c in pictures.cameras(world).items()}
            self.cameras = CameraWindow(server.gui, pictures, eyes)

    def refresh(self) -> None:
        """Send all changes, if the page is open; called in viser's thread every PERIOD_S."""
        state = self._loop.state
        self._history.add(state.snapshot)
        if not self._server.get_clients():
            return
        with self._server.atomic():
            self._show_bodies(state.snapshot)
            self._drawings.show(state.snapshot)
            self._centres.show(state.snapshot)
            self._show_tools()
            if self._driving is not None:
                self._driving.show(self._last_tips)
            if self.cameras is not None:
                self.cameras.show(time.perf_counter())
        if self._refreshes % PLOTS_EVERY == 0:
            self.panel.follow(state.snapshot)
            if self.panel.is_current(state.snapshot):
                self._plots.show(self._history, self.panel.arm)
        if self._refreshes % NUMBERS_EVERY == 0:
            if self.panel.is_current(state.snapshot):
                self.tables.show(state, self.panel.arm)
            if self.cameras is not None:
                self.cameras.show_status()
        self._refreshes += 1

    def _show_bodies(self, now: Snapshot) -> None:
        """Move the bodies; request their shapes first after a tool exchange."""
        if self._shapes is not None and self._shapes.done():
            answer, self._shapes = self._shapes, None
            if not answer.cancelled():
                self._build, shapes = answer.result()
                self.bodies.renew(shapes)
        if now.build == self._build:
            self.bodies.show(now)
        elif self._shapes is None:
            self._shapes = self._loop.ask(lambda world: (world.snapshot().build, world.shapes()))

    def _show_tools(self) -> None:
        if not self.tools.visible and self._driving is None:
            return
        if self._tips is not None and self._tips.done() and not self._tips.cancelled():
            self._last_tips = self._tips.result()
            self.tools.show(self._last_tips)
        if self._tips is None or self._tips.done():
            self._tips = self._loop.ask(tips_of)

    def fail(self, error: Exception) -> None:
        """Show the error that stopped the simulation."""
        self.tables.fail(error)
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
        world: the world to run; it belongs to this function until it returns
        host: a loopback address: the page has no password
        port: port to listen on; 0 takes any free one
        speed: "realtime" keeps to the wall clock, "max" runs as fast as it goes
        duration_s: simulated time to run [s]; None means until Ctrl-C
        on_ready: called with the page's address once it is served and time flows
        loop: the world's loop, when others use it, too; not running yet, and ended here
        pictures: of the cameras of the loop's world; None: the page shows none
        note: returns HTML to show above the table of joints, called five times a second
        driving: controls for hands: keys, handles, pedals
        access: which web pages may connect; when omitted, the page itself

    Raises:
        InputError: the host or the port cannot be used
        DivergedError: the simulation left the finite numbers
    """
    sockets: list[str] = []
    if driving is not None and driving.websocket is not None:
        sockets = ["{0.scheme}://{0.netloc}".format(urlsplit(driving.websocket))]
    with serving(host, port, f"trocar: {world.rig.name}", access, sockets) as server:
        loop = loop or Loop(world, speed=speed)
        page = run_there(server, lambda: Page(server, world, loop, pictures, driving))
        page.tables.note = note
        with page.notices.listening(), closing(loop), suppress(KeyboardInterrupt):
            loop.start(duration_s)
            if on_ready is not None:
                on_ready(entrance(server))
            try:
                while not loop.wait(PERIOD_S):
                    run_there(server, page.refresh)
            except TrocarError as error:
                failure = error
                run_there(server, lambda: page.fail(failure))
                threading.Event().wait(FAREWELL_S)
                raise


def _theme(gui: viser.GuiApi) -> None:
    gui.configure_theme(
        dark_mode=False, show_logo=False, show_share_button=False, brand_color=(28, 110, 164)
    )
    gui.main_panel.dock_right()
    gui.main_panel.set_width(PANEL_WIDTH)
