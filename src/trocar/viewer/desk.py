"""One browser's page: its panels, its light, and what it may drive."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, Protocol

import numpy as np
import viser
from numpy.typing import NDArray

from trocar.live.images import Pictures
from trocar.live.loop import Loop
from trocar.live.player import Player
from trocar.live.state import LoopState
from trocar.viewer.cameras import WIDTH as CAMERAS_WIDTH
from trocar.viewer.cameras import CameraWindow
from trocar.viewer.channel import BrowserReport, Channel
from trocar.viewer.drawing import Drawing
from trocar.viewer.drawing import names as drawing_names
from trocar.viewer.driving import Driving, DrivingTab
from trocar.viewer.gallery import Gallery
from trocar.viewer.help import hint, show_help
from trocar.viewer.look_back import LookBack
from trocar.viewer.measurements import STYLE, History, JointPlots, StatusTables
from trocar.viewer.notices import Notices
from trocar.viewer.panel import ArmInfo, Panel
from trocar.viewer.scene import RemoteCentres, ToolFrames, camera_above_sheet
from trocar.viewer.scoreboard import SceneControls, Scoreboard, driver_of
from trocar.viewer.seats import Seats
from trocar.viewer.server import Buttons, when_touched

Floats = NDArray[np.float64]

WIDE_PX, PHONE_PX = 1300, 576
"""Widths of a window from which measurements stand on the left, and below which viser has one sheet
at the bottom, with the score, the cameras and what drives [CSS px]. Source: by eye; viser's own
breakpoint."""

PANEL_WIDTH, NARROW_WIDTH = 370, 330
"""Width of each panel in CSS pixels, and in a window that is not wide. Source: chosen by eye."""

NARROW_CAMERAS = 300
"""Width of the window of cameras in a window that is not wide [CSS px]. Source: chosen by eye."""

SILENT_S = 1.0
"""Time after which a browser that reports nothing gets the page of a wide one [s]: a program of
viser's, for instance. Source: our own choice, longer than client.js takes."""

NUMBERS_EVERY = 6
"""Refreshes between two updates of the tables: five a second can still be read."""

PLOTS_EVERY = 3
"""Refreshes between two updates of the plots and the sliders: ten a second."""

FEW_HZ = 20.0
"""Frames a second below which the page shows their number. Source: our own choice."""

REQUEST, GIVE, KEEP = "Request control", "Give", "Keep"


class Folder(Protocol):
    """A part of the page in a file of its own, which stands in the panel of commands.

    It is made by a function of `Contents.folders`, in viser's thread, in the container that is
    open, and adds its widgets to `desk.browser.gui` and its nodes to `desk.browser.scene`.
    """

    def show(self, state: LoopState) -> None:
        """Show the newest state; called ten times a second."""
        ...

    def close(self) -> None:
        """Let go of what is not a widget, as nodes of the scene."""
        ...


@dataclass(frozen=True)
class Contents:
    """Contents of the page, the same in all browsers.

    Attributes:
        rig: name of the rig or scene
        camera: position and point that a new browser looks from and at, (3,) each [m]
        loop: of the world
        arms: {name: its description when the page was made}
        poses: named poses of the rig
        notices, history: the messages, and the last seconds of motion
        nonce: of the scripts that may run
        seats: who drives
        tips: arms with a tip
        eyes: {camera: number of eyes}
        pictures: of the cameras; None: none
        driving: controls for hands; None: none
        scene: the scene that is served; None: a rig
        gallery: what may be loaded; None: nothing
        note: returns HTML to show above the table of joints
        folders: make further parts of the page, in their order
        past: the moment that is shown in place of the present
        player: of the recording that is shown; None: the world is a simulation
        waits: returns whether time waits for the first browser
        is_console: returns whether a browser's page may drive by itself, of its query
    """

    rig: str
    camera: tuple[Floats, Floats]
    loop: Loop
    arms: Mapping[str, ArmInfo]
    poses: Mapping[str, Mapping[str, object]]
    notices: Notices
    history: History
    nonce: str
    seats: Seats
    tips: tuple[str, ...]
    eyes: Mapping[str, int]
    pictures: Pictures | None = None
    driving: Driving | None = None
    scene: SceneControls | None = None
    gallery: Gallery | None = None
    note: Callable[[], str] | None = None
    folders: Sequence[Callable[[Desk], Folder]] = ()
    past: LookBack | None = None
    player: Player | None = None
    waits: Callable[[], bool] = lambda: False
    is_console: Callable[[str], bool] = lambda _: True


class Desk:
    """The page of one browser; made when it connects, refreshed in viser's thread.

    Panels are made when the browser has reported its width, and anew when it becomes a phone's, a
    narrow or a wide one.

    Args:
        browser: has widgets and a scene of its own
        who: its number
        contents: to show
        console: whether it may drive by itself; otherwise its report decides

    Attributes:
        browser: as given
        panel, tables, cameras: parts of the page; None where it has none
        tools: the frames of the tips
        drawing: how richly the scene is drawn
        seen: whether the scene is on its screen
        folders: further parts of the panel of commands
        pressers: {first word that an element with `data-trocar-send` sends: takes the rest}
    """

    def __init__(
        self,
        browser: viser.ClientHandle | viser.ViserServer,
        who: int,
        contents: Contents,
        *,
        console: bool = True,
    ) -> None:
        self.browser, self._who, self._contents = browser, who, contents
        self._began_s = time.monotonic()
        self._layout, self._console = "", console
        self._refreshes = 0
        self.seen = False
        self.panel: Panel | None = None
        self.tables: StatusTables | None = None
        self.cameras: CameraWindow | None = None
        self.folders: list[Folder] = []
        self.pressers: dict[str, Callable[[str], object]] = {}
        self._plots: JointPlots | None = None
        self._scoreboard: Scoreboard | None = None
        self._seat: Buttons | None = None
        self._hands: DrivingTab | None = None
        self._panels: list[Any] = []
        self.drawing = Drawing(browser.scene)
        self._centres = RemoteCentres(browser.scene, contents.loop.latest)
        self.tools = ToolFrames(browser.scene, contents.tips)
        self._channel = Channel(browser.gui, self._report, self._press)

    # ------------------------------------------------------------------ making

    def build(self, width: int) -> None:
        """Make the panels for a window of a width [CSS px]; keep those that fit it."""
        wide, phone = width >= WIDE_PX, width < PHONE_PX
        layout = "phone" if phone else "wide" if wide else "narrow"
        if layout == self._layout:
            return
        self._remove()
        self._layout = layout
        gui, all_ = self.browser.gui, self._contents
        panel_width = PANEL_WIDTH if wide else NARROW_WIDTH
        if isinstance(self.browser, viser.ClientHandle):
            gui.main_panel.dock_right()
            gui.main_panel.set_width(panel_width)
        self._begin()
        if not phone:
            self.panel = Panel(gui, all_.loop, all_.arms, all_.poses, self.blocked)
            self.folders = [make(self) for make in all_.folders]
            self._folder_show()
            self._window(panel_width, docked=wide)
            self._show_controls(all_.loop.state)  # greys out what this browser may not use
        elif all_.driving is not None and all_.driving.tables:
            self._window(panel_width, docked=False)
        if all_.pictures is not None:
            width = CAMERAS_WIDTH if wide else NARROW_CAMERAS
            self.cameras = CameraWindow(gui, all_.pictures, all_.eyes, width, self._save)
            self.pressers["cameras"] = self.cameras.press
            self._panels.append(self.cameras.window)
            if phone:
                self.cameras.window.expand()
        if phone and isinstance(self.browser, viser.ClientHandle):
            camera, begin = self.browser.camera, all_.camera
            camera.position, camera.look_at = camera_above_sheet(*begin, camera.aspect)

    def _begin(self) -> None:
        """Add what stands first: who drives, the gallery, the scene."""
        gui, all_ = self.browser.gui, self._contents
        gui.add_html(STYLE)
        self._seat = Buttons(gui, "Driver", (REQUEST,), self._press_seat, hint("Driver"))
        self._seat.set_visible(visible=False)
        if all_.gallery is not None:
            gallery = all_.gallery
            Buttons(
                gui,
                "Load",
                ("Scenes and rigs",),
                lambda _: gallery.open(gui, all_.seats.blocked(self._who)),
                hint("Load"),
            )
        if all_.scene is not None:
            self._scoreboard = Scoreboard(gui, all_.scene)

    def _folder_show(self) -> None:
        gui = self.browser.gui
        with gui.add_folder("Show", order=1e9):
            level = gui.add_dropdown(
                "Drawing",
                drawing_names(),
                initial_value=self.drawing.choice,
                hint=hint("Drawing"),
            )
            when_touched(level, self.drawing.choose)
            centres = gui.add_checkbox(
                "Remote centres", self._centres.visible, hint=hint("Remote centres")
            )
            when_touched(centres, self._centres.set_visible)
            frames = gui.add_checkbox("Tool frames", self.tools.visible, hint=hint("Tool frames"))
            when_touched(frames, self.tools.set_visible)

    def _window(self, width: int, *, docked: bool) -> None:
        """Add the window of measurements, and of hands."""
        gui, all_, driving = self.browser.gui, self._contents, self._contents.driving
        window = gui.add_panel()
        titles = ["Measurements"] if self.panel is not None else []
        if driving is not None:  # before the measurements where keys drive: open at first
            titles.insert(0 if driving.tables else 1, driving.title)
        for title in titles:
            with window.add_tab(title):
                if driving is not None and title == driving.title:
                    nonce = all_.nonce if self._console else ""
                    self._hands = DrivingTab(self.browser, driving, nonce, lambda: self.seat)
                elif self.panel is not None:
                    self.tables = StatusTables(gui, all_.notices)
                    self.tables.note = all_.note
                    self._plots = JointPlots(gui, self.panel.arm)
        window.dock_left()
        window.set_width(width)
        if not docked and not (driving and driving.tables):
            window.minimize()
        self._panels.append(window)

    def _remove(self) -> None:
        """Take all panels off the page, but for the channel."""
        self.close()
        if self._hands is not None:
            self._hands.remove()
        if self._layout:
            self.browser.gui.reset()
            self._channel = Channel(self.browser.gui, self._report, self._press)
        self._panels.clear()
        self.panel = self.tables = self.cameras = self._plots = self._hands = None
        self._scoreboard = self._seat = None

    def close(self) -> None:
        """Let go of what outlives the panels."""
        if self.cameras is not None:
            self.cameras.leave()
        for folder in self.folders:
            folder.close()
        self.folders.clear()
        self.pressers.clear()

    # ------------------------------------------------------------------ refreshing

    @property
    def wants_tips(self) -> bool:
        """Whether it shows where the tips are."""
        return self.tools.visible or self._hands is not None

    def refresh(self, state: LoopState, tips: Mapping[str, Floats], banner: str = "") -> None:
        """Send what changed.

        Args:
            state: of the loop
            tips: {arm: T_world_tip (4, 4)}
            banner: something that all have to see; "": nothing
        """
        if not self._layout:
            if time.monotonic() - self._began_s < SILENT_S:
                return
            self._report(BrowserReport())
        now, count = state.snapshot, self._refreshes
        self._refreshes += 1
        self._centres.show(now)
        if tips and self.tools.visible:
            self.tools.show(tips)
        if self._hands is not None:
            self._hands.show(tips)
        if self.cameras is not None:
            self.cameras.show(time.perf_counter())
        if count % PLOTS_EVERY == 0:
            self._show_controls(state)
        if count % NUMBERS_EVERY == 0:
            self._show_numbers(state, banner)

    def fail(self, error: Exception) -> None:
        """Show the error that stopped the simulation."""
        if self.tables is not None:
            self.tables.fail(error)
        self._channel.send({"bar": "", "banner": f"The simulation stopped: {error}"})

    @property
    def watching(self) -> str:
        """The reason that keeps this person from driving, where another does; "" for none."""
        return self._contents.seats.blocked(self._who)

    @property
    def seat(self) -> str:
        """The reason that keeps this browser from driving; "" for none."""
        player = self._contents.player
        if player is None or not player.active:
            return self.watching
        return self.watching or (
            "a recording is shown: Continue from here"
            if player.source.continues
            else "a recording is shown"
        )

    def blocked(self, arm: str) -> str:
        """Return the reason that keeps an arm from this person; "" for none."""
        all_ = self._contents
        if self.seat:
            return self.seat
        if all_.past is not None and all_.past.looked is not None:
            return "a moment of before is shown: Continue from here, or Now"
        scene = all_.scene
        if scene is not None and arm in scene.arms and (driver := scene.drives()):
            return f"the {driver} drives {arm}: Take control above"
        return ""

    def _show_controls(self, state: LoopState) -> None:
        if self.panel is not None:
            self.panel.show_time(paused=state.paused, blocked=self.seat)
            self.panel.follow(state.snapshot)
            if self._plots is not None and self.panel.is_current(state.snapshot):
                self._plots.show(self._contents.history, self.panel.arm)
        for folder in self.folders:
            folder.show(state)

    def _show_numbers(self, state: LoopState, banner: str) -> None:
        seats, panel = self._contents.seats, self.panel
        if self.tables is not None and panel is not None and panel.is_current(state.snapshot):
            self.tables.show(state, panel.arm)
        if self.cameras is not None:
            self.cameras.show_status()
        if self._scoreboard is not None:
            self._scoreboard.show(seats.blocked(self._who))
        if self._seat is not None:
            self._show_seat(self._seat, seats)
        self._channel.send(
            {
                "bar": self._bar(state),
                "banner": banner,
                "scale": self.drawing.level.scale,
                "plain": self.drawing.level.joined if self.drawing.index >= 0 else None,
                "beat": int(time.monotonic()),
            }
        )

    def _show_seat(self, seat: Buttons, seats: Seats) -> None:
        """Show who drives, where several browsers are open."""
        seat.set_visible(visible=seats.shown)
        drives = seats.driver == self._who
        if seats.answers(self._who):
            seat.show((GIVE, KEEP))
        elif drives:
            seat.show(("this browser drives",), disabled=True)
        else:
            waits = seats.asking == self._who
            seat.show(("requested",) if waits else (REQUEST,), disabled=waits)

    def _bar(self, state: LoopState) -> str:
        """Return the line above the scene: what runs, its score, its speed."""
        all_, scene = self._contents, self._contents.scene
        chips = [f"<b>{escape(scene.name if scene else all_.rig)}</b>"]
        if scene is not None:
            now = scene.score()
            chips += [
                f"{escape(driver_of(scene, now))}",
                f"{now.time_s:.1f} of {scene.limit_s:g} s",
                f"goals {now.met} of {now.goals}",
                f"score {now.score:.0f}",
            ]
        else:
            chips.append(f"{state.snapshot.time:.1f} s")
        if all_.waits():
            chips.append("waits until the first page is drawn")
        elif all_.player is not None and all_.player.active:
            chips.append("<b>recording</b>")
        elif state.paused:
            chips.append("<b>paused</b>")
        else:
            chips.append(f"{state.real_time_factor:.2f} x real time")
        if all_.seats.shown:
            who = all_.seats.number(all_.seats.driver)
            if all_.seats.driver == self._who:
                chips.append("you drive")
            else:
                chips.append(f"browser {who} drives, you watch" if who else "you watch")
            if all_.seats.answers(self._who):
                number = all_.seats.number(all_.seats.asking)
                chips.append(f"<b>browser {number} requests control</b>")
        frames = self.drawing.frames_hz
        if self.drawing.index > 0 or (frames is not None and frames < FEW_HZ):
            how = ("", "without shadows", "plainly")[max(self.drawing.index, 0)]
            rate = "" if frames is None else f"{frames:.0f} frames/s"
            chips.append(", ".join(filter(None, (f"drawn {how}" if how else "", rate))))
        return "".join(f"<span>{chip}</span>" for chip in chips)

    def _save(self, name: str, data: bytes) -> None:
        """Have the browser save a file."""
        if isinstance(self.browser, viser.ClientHandle):
            self.browser.send_file_download(name, data, save_immediately=True)

    # ------------------------------------------------------------------ from the browser

    def _report(self, report: BrowserReport) -> None:
        if not self._console and self._contents.is_console(report.query):
            self._console = True
            self._contents.seats.admit(self._who)
        self.drawing.follow(report)
        self.build(report.width)
        self.seen = self.seen or report.drawn

    def _press(self, words: str) -> None:
        all_ = self._contents
        kind, _, rest = words.partition("/")
        if kind == "help":
            show_help(self.browser.gui, {} if all_.driving is None else all_.driving.tables)
        elif kind == "load" and all_.gallery and not all_.seats.blocked(self._who):
            all_.gallery.choose(rest)
        elif kind in self.pressers:
            self.pressers[kind](rest)

    def _press_seat(self, name: str) -> None:
        seats = self._contents.seats
        if name == REQUEST:
            seats.request(self._who)
        elif seats.answers(self._who):
            seats.answer(granted=name == GIVE)
