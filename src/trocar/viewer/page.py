"""The web viewer's page as a whole, and the function that serves it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import closing, suppress
from functools import partial
from typing import TYPE_CHECKING, Literal
from urllib.parse import urlsplit

import numpy as np
import viser
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.live.access import PageAccess
from trocar.live.images import Pictures
from trocar.live.inbox import Command
from trocar.live.loop import Loop
from trocar.live.player import Player
from trocar.live.state import LoopState
from trocar.live.timeline import Timeline
from trocar.live.tip_goals import TipGoals
from trocar.simulation.journal import WORLD
from trocar.viewer.desk import Contents, Desk, Folder
from trocar.viewer.driving import Driving
from trocar.viewer.gallery import Choice, Gallery
from trocar.viewer.handles import TipHandles, free_objects
from trocar.viewer.look_back import LookBack
from trocar.viewer.measurements import History
from trocar.viewer.notices import Notices
from trocar.viewer.outline import Outline
from trocar.viewer.overlays import Overlays
from trocar.viewer.own_things import BESIDE_M, OwnThings
from trocar.viewer.panel import read_arm
from trocar.viewer.playback import PlaybackFolder
from trocar.viewer.plots import LastMinute, QuantityPlots
from trocar.viewer.scene import Bodies, Drawings, stage, tips_of
from trocar.viewer.scoreboard import SceneControls
from trocar.viewer.seats import Seats
from trocar.viewer.server import LocalServer, entrance, run_there, serving
from trocar.viewer.timeline import TimelineFolder

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.records import ShapeRecord, Snapshot

Floats = NDArray[np.float64]

PERIOD_S = 1 / 30
"""Time between two refreshes [s]. Source: a fifth of a core for 73 bodies."""

REST_S = 0.5 * PERIOD_S
"""Least time between two refreshes, which leaves the arms theirs [s]. Source: our own choice."""

FAREWELL_S = 1.0
"""Time for which the page shows the error that stopped the simulation before it closes [s]."""

PART_S = 0.3
"""Time for which a message reaches the browsers before their connection ends [s]."""

DRAWN_S = 20.0
"""Time after which the scene begins for a browser that has not reported that it drew it [s].
Source: our own choice: shaders take 5 to 12 s to compile without a graphics card."""

STALE_S = 3.0
"""Time without a new state after which the page says so [s]. Source: our own choice."""


class Page:
    """The whole page; made in viser's thread while the world stands still.

    Args:
        server: of the page
        world, loop: what is shown, and its loop
        pictures: of the rig's cameras; None: none are shown
        driving: controls for hands
        scene: the scene that is served
        gallery: what may be loaded in place of it
        note: returns HTML to show above the table of joints
        folders: make further parts of each browser's page
        past: the moment that is shown in place of the present
        player: of the recording that is shown
        last: takes the readings of all arms

    Attributes:
        server: as given
        bodies: of the arms and objects, for all browsers
        desks: {browser: its page}
        notices: the last warnings
        waits: whether time waits for the first browser that has drawn the scene
    """

    def __init__(
        self,
        server: LocalServer,
        world: World,
        loop: Loop,
        pictures: Pictures | None = None,
        driving: Driving | None = None,
        *,
        scene: SceneControls | None = None,
        gallery: Gallery | None = None,
        note: Callable[[], str] | None = None,
        folders: Sequence[Callable[[Desk], Folder]] = (),
        past: LookBack | None = None,
        player: Player | None = None,
        last: LastMinute | None = None,
    ) -> None:
        self.server, self._loop, self._last = server, loop, last
        self._waits_since_s: float | None = None
        self.waits = False
        self.notices = Notices()
        shapes, now = world.shapes(), loop.latest
        stage(server, shapes, now)
        self.bodies = Bodies(server.scene, shapes)
        self._drawings = Drawings(server.scene)
        self._build, self._time_s = now.build, now.time
        self._shapes: Future[tuple[int, tuple[ShapeRecord, ...]]] | None = None
        self._tips: Future[dict[str, Floats]] | None = None
        self._last_tips: dict[str, Floats] = {}
        self._stale: tuple[LoopState | None, float] = None, 0.0
        names = sorted(
            world.arms, key=lambda name: world.arms[name].description.type == "SUJ"
        )  # those last
        eyes = {} if pictures is None else pictures.cameras(world)
        self._contents = Contents(
            rig=world.rig.name,
            camera=(server.initial_camera.position, server.initial_camera.look_at),
            loop=loop,
            arms={name: read_arm(world, name) for name in names},
            poses=world.rig.poses,
            notices=self.notices,
            history=History(),
            nonce=server.page.nonce,
            seats=Seats(),
            tips=tuple(tips_of(world)),
            eyes={name: len(camera.calibration.eyes) for name, camera in eyes.items()},
            pictures=pictures,
            driving=driving,
            scene=scene,
            gallery=gallery,
            note=note,
            folders=folders,
            past=past,
            player=player,
            waits=lambda: self.waits,
            is_console=server.page.access.is_console,
        )
        server.gui.configure_theme(
            dark_mode=False, show_logo=False, show_share_button=False, brand_color=(28, 110, 164)
        )
        self.desks: dict[int, Desk] = {}

        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            self.open(client, client.client_id)

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            self.leave(client.client_id)

    def open(self, browser: viser.ClientHandle | viser.ViserServer, who: int = 0) -> Desk:
        """Show everything to a browser."""
        console = not self.server.page.networked
        self._contents.seats.come(who, console=console)
        desk = self.desks[who] = Desk(browser, who, self._contents, console=console)
        return desk

    def leave(self, who: int) -> None:
        """Forget a browser that has gone."""
        desk = self.desks.pop(who, None)
        if desk is not None:
            self._contents.seats.leave(who)
            desk.close()

    def refresh(self) -> None:
        """Send all changes, if the page is open; called in viser's thread every PERIOD_S."""
        state = self._loop.state
        now = state.snapshot
        past = self._contents.past
        if now.time < self._time_s and not (past and past.sets_back_to(now.time)):
            self.notices.clear()
        self._time_s = now.time
        self._contents.history.add(now)
        if self._last is not None:
            self._last.add(state)
        if not self.desks:
            return
        self._contents.seats.follow()
        self._begin_when_seen()
        self.notices.follow({name: arm.state == "ENABLED" for name, arm in now.arms.items()})
        banner = self._banner(state)
        if past is not None:
            state = past.shown(state)
            now = state.snapshot
        with self.server.atomic():
            self._show_bodies(now)
            self._drawings.show(now)
        self._ask_tips()
        for desk in tuple(self.desks.values()):
            desk.refresh(state, self._last_tips, banner)

    def _begin_when_seen(self) -> None:
        """Let time flow once a browser has drawn the scene, or has had time for it."""
        if not self.waits:
            return
        now_s = time.monotonic()
        if self._waits_since_s is None:
            self._waits_since_s = now_s
        late = now_s - self._waits_since_s > DRAWN_S
        if late or any(desk.seen for desk in self.desks.values()):
            self.waits = False
            self._loop.post(Command(WORLD, "resume"))

    def _banner(self, state: LoopState) -> str:
        """Return a text for all browsers while the simulation is stuck; "" while it is not."""
        last, since_s = self._stale
        now_s = time.monotonic()
        if state is not last:
            self._stale = state, now_s
        elif now_s - since_s > STALE_S:
            return f"The simulation is busy since {now_s - since_s:.0f} s: nothing moves."
        return ""

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

    def _ask_tips(self) -> None:
        if not any(desk.wants_tips for desk in self.desks.values()):
            return
        if self._tips is not None and self._tips.done() and not self._tips.cancelled():
            self._last_tips = self._tips.result()
        if self._tips is None or self._tips.done():
            self._tips = self._loop.ask(tips_of)

    def fail(self, error: Exception) -> None:
        """Show the error that stopped the simulation."""
        for desk in self.desks.values():
            desk.fail(error)
        self.server.flush()

    def part(self, text: str) -> None:
        """Show why the page closes."""
        for desk in self.desks.values():
            desk.fail(TrocarError(text))
        self.server.flush()


def _own_things(world: World, gallery: Gallery) -> Callable[[Desk], Folder]:
    """Return the maker of the folder of a person's own files, for the rig of a world."""
    tips = [pose[:3, 3] for pose in tips_of(world).values()]
    place = np.mean(tips, axis=0) + BESIDE_M if tips else BESIDE_M
    taken = (*world.arms, *(prop.name for prop in world.rig.props))
    return partial(OwnThings, gallery=gallery, rig=world.rig.file, taken=taken, place=place)


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
    scene: SceneControls | None = None,
    gallery: Gallery | None = None,
    player: Player | None = None,
    start: Literal["viewer", "now"] = "now",
    framed: bool = False,
) -> Choice | None:
    """Run a world and serve the page that shows and drives it, until Ctrl-C or the time is over.

    Args:
        world: the world to run; it belongs to this function until it returns
        host: address to listen on; browsers of other machines need a token, and watch
        port: port to listen on; 0 takes any free one
        speed: "realtime" keeps to the wall clock, "max" runs as fast as it goes
        duration_s: simulated time to run [s]; None means until Ctrl-C
        on_ready: called with the page's address once it is served and time flows
        loop: the world's loop, when others use it, too; not running yet, and ended here
        pictures: of the cameras of the loop's world; None: the page shows none
        note: returns HTML to show above the table of joints, called five times a second
        driving: controls for hands: keys, handles, pedals
        access: which web pages may connect; when omitted, the page itself
        framed: whether pages of this machine, as notebooks, may show it in a frame
        scene: the scene of the world, with its score and its policy
        gallery: what may be loaded in place of the world; None: nothing
        player: of a recording, which is shown in place of a simulation; a watcher of `loop`
        start: "viewer" keeps time still until a browser has drawn the scene

    Returns:
        what a person chose in the gallery, which ends the loop; None otherwise

    Raises:
        InputError: the host or the port cannot be used
        DivergedError: the simulation left the finite numbers
    """
    sockets: list[str] = []
    if driving is not None and driving.websocket is not None:
        sockets = ["{0.scheme}://{0.netloc}".format(urlsplit(driving.websocket))]
    title = f"trocar: {world.rig.name}"
    with serving(host, port, title, access, sockets, framed=framed) as server:
        loop = loop or Loop(world, speed=speed)
        past = None
        if player is None:
            timeline = Timeline(world, loop.tick_s)
            loop.watch(timeline)
            past = LookBack(loop, timeline, lambda: scene and scene.drives() and scene.take())
        goals = TipGoals(loop)
        loop.watch(goals)
        handled = tuple(
            name
            for name, arm in world.arms.items()
            if arm.description.inverse_kinematics and not arm.runtime.motors.welded
        )
        things = tuple(free_objects(world))
        hands = partial(TipHandles, goals=goals, arms=handled, things=things, loop=loop)
        last = LastMinute()
        described = {name: read_arm(world, name) for name in world.arms}
        folders = (
            *((partial(TimelineFolder, past=past),) if past is not None else ()),
            *((partial(PlaybackFolder, player=player),) if player is not None else ()),
            *((hands,) if handled or things else ()),
            partial(Overlays, loop=loop),
            partial(Outline, loop=loop),
            partial(QuantityPlots, arms=described, last=last),
            *((_own_things(world, gallery),) if gallery is not None else ()),
        )
        page = run_there(
            server,
            lambda: Page(
                server,
                world,
                loop,
                pictures,
                driving,
                scene=scene,
                gallery=gallery,
                note=note,
                folders=folders,
                past=past,
                player=player,
                last=last,
            ),
        )
        with page.notices.listening(), closing(loop), suppress(KeyboardInterrupt):
            if player is not None:
                loop.post(Command(WORLD, "pause"))
            if start == "viewer":
                page.waits = loop.post(Command(WORLD, "pause"))
            loop.start(duration_s)
            if on_ready is not None:
                on_ready(entrance(server))
            try:
                due_s = time.monotonic()
                while not loop.wait(max(due_s - time.monotonic(), REST_S)):
                    due_s = max(due_s + PERIOD_S, time.monotonic())
                    run_there(server, page.refresh)
                    if gallery is not None and gallery.chosen is not None:
                        text = f"Loading {gallery.chosen.name} ..."
                        run_there(server, partial(page.part, text))
                        threading.Event().wait(PART_S)
                        return gallery.chosen
            except TrocarError as error:
                failure = error
                run_there(server, lambda: page.fail(failure))
                threading.Event().wait(FAREWELL_S)
                raise
    return None
