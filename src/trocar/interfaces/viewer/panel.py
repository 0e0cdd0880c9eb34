"""The control panel: time, the choice of an arm, and everything that drives that arm."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from typing import TYPE_CHECKING

import viser

from trocar.interfaces.commands import Hold, MoveTo, Pause, Reset, Resume
from trocar.interfaces.loop import Loop
from trocar.interfaces.viewer.instrument import InstrumentChoice
from trocar.interfaces.viewer.markers import RemoteCentres, ToolFrames
from trocar.interfaces.viewer.own_thread import when_pressed, when_touched
from trocar.interfaces.viewer.power import PowerButtons
from trocar.interfaces.viewer.sheet import ArmSheet, read_sheet
from trocar.interfaces.viewer.sliders import JointSliders
from trocar.interfaces.viewer.tuning import BrakeButtons, GainsTable, GravityChoice, ModeChoice

if TYPE_CHECKING:
    from trocar.simulation.records import Snapshot

HOME, HOLD = "home", "hold here"


class ArmControls:
    """Everything that drives one arm; made anew when another arm is chosen."""

    def __init__(self, gui: viser.GuiApi, loop: Loop, sheet: ArmSheet, now: Snapshot) -> None:
        self._loop, self._name = loop, sheet.name
        arm = now.arms[sheet.name]
        self._folders: list[viser.GuiFolderHandle] = []
        self._instrument: InstrumentChoice | None = None
        with self._folder(gui, f"{sheet.name} joints"):
            self._power = PowerButtons(gui, loop, sheet.name, arm)
            self._sliders = JointSliders(gui, loop, sheet, arm)
            self._poses(gui, sheet)
            if sheet.has_brakes:
                BrakeButtons(gui, loop, sheet)
        with self._folder(gui, "Control"):
            if sheet.tools:
                self._instrument = InstrumentChoice(gui, loop, sheet)
            self._mode = ModeChoice(gui, loop, sheet, arm)
            self._gravity = None if sheet.has_brakes else GravityChoice(gui, loop, sheet)
            with gui.add_folder("Gains P, I, D", expand_by_default=False):
                self._gains = GainsTable(gui, loop, sheet)
        self.follow_sheet(sheet)

    def follow(self, now: Snapshot) -> None:
        """Show where the arm is."""
        arm = now.arms[self._name]
        self._power.follow(arm)
        self._sliders.follow(arm)
        self._mode.follow(arm)

    def follow_sheet(self, sheet: ArmSheet) -> None:
        """Show what is set, whoever set it."""
        if self._instrument is not None:
            self._instrument.follow(sheet)
        if self._gravity is not None:
            self._gravity.follow(sheet)
        self._gains.follow(sheet)

    def remove(self) -> None:
        """Take everything off the page."""
        for folder in self._folders:
            folder.remove()

    def _folder(self, gui: viser.GuiApi, label: str) -> viser.GuiFolderHandle:
        self._folders.append(gui.add_folder(label))
        return self._folders[-1]

    def _poses(self, gui: viser.GuiApi, sheet: ArmSheet) -> None:
        names = sorted(sheet.poses, key=lambda name: name != HOME)
        buttons = gui.add_button_group("Move to", (*names, HOLD))

        when_pressed(buttons, self._move_to)

    def _move_to(self, choice: str) -> None:
        self._loop.post(Hold(self._name) if choice == HOLD else MoveTo(self._name, choice))
        self._sliders.let_go()


class Panel:
    """The whole control panel."""

    def __init__(
        self,
        gui: viser.GuiApi,
        loop: Loop,
        sheets: dict[str, ArmSheet],
        poses: Mapping[str, Mapping[str, object]],
        *,
        marks: tuple[RemoteCentres, ToolFrames],
    ) -> None:
        self._gui, self._loop, self._sheets = gui, loop, sheets
        self._asked: Future[ArmSheet] | None = None
        _time_buttons(gui, loop)
        _rig_poses(gui, loop, poses, sheets)
        self._choice = gui.add_dropdown("Arm", list(sheets))
        when_touched(self._choice, lambda _: self._choose())
        self._controls: ArmControls | None = None
        self._choose()
        _view_switches(gui, marks)

    @property
    def arm(self) -> str:
        """The chosen arm's name."""
        return self._choice.value

    @property
    def sheet(self) -> ArmSheet:
        """The chosen arm's sheet."""
        return self._sheets[self.arm]

    def knows(self, now: Snapshot) -> bool:
        """Tell whether the sheet is of the tool that the chosen arm has now."""
        return now.arms[self.arm].tool == self.sheet.tool

    def follow(self, now: Snapshot) -> None:
        """Show where the chosen arm is and what is set."""
        if self._controls is not None and self.knows(now):
            self._controls.follow(now)
        if self._asked is None:
            name = self.arm
            self._asked = self._loop.ask(lambda world: read_sheet(world, name))
        elif self._asked.done():
            self._take_answer(self._asked)
            self._asked = None

    def _take_answer(self, answer: Future[ArmSheet]) -> None:
        if answer.cancelled() or answer.exception() is not None:
            return
        sheet = answer.result()
        other = self._sheets[sheet.name].tool != sheet.tool
        self._sheets[sheet.name] = sheet
        if sheet.name != self.arm:
            return
        if other or self._controls is None:
            self._choose()
        else:
            self._controls.follow_sheet(sheet)

    def _choose(self) -> None:
        """Make the chosen arm's controls, once its sheet is of the tool that it has now."""
        if self._controls is not None:
            self._controls.remove()
            self._controls = None
        now = self._loop.latest
        if self.knows(now):
            self._controls = ArmControls(self._gui, self._loop, self.sheet, now)


def _time_buttons(gui: viser.GuiApi, loop: Loop) -> None:
    commands = {"Pause": Pause(), "Resume": Resume(), "Reset": Reset()}
    buttons = gui.add_button_group("Time", tuple(commands))
    when_pressed(buttons, lambda name: loop.post(commands[name]))


def _rig_poses(
    gui: viser.GuiApi,
    loop: Loop,
    poses: Mapping[str, Mapping[str, object]],
    sheets: Mapping[str, ArmSheet],
) -> None:
    """Move every arm at once; setup arms stay where their brakes hold them."""
    buttons = gui.add_button_group("All arms to", tuple(poses))

    def move(pose: str) -> None:
        for arm in poses[pose]:
            if not sheets[arm].has_brakes:
                loop.post(MoveTo(arm, pose))

    when_pressed(buttons, move)


def _view_switches(gui: viser.GuiApi, marks: tuple[RemoteCentres, ToolFrames]) -> None:
    centres, tools = marks
    with gui.add_folder("Show", order=1e9):
        show_centres = gui.add_checkbox("Remote centres", True)
        show_tools = gui.add_checkbox("Tool frames", False)
    when_touched(show_centres, centres.set_visible)
    when_touched(show_tools, tools.set_visible)
