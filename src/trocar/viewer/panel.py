"""The control panel: time, the choice of an arm, and everything that drives that arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
import viser

from trocar.descriptions import fitting_tools
from trocar.live.inbox import Command
from trocar.live.loop import Loop
from trocar.simulation.journal import WORLD
from trocar.simulation.records import ArmSnapshot, Snapshot
from trocar.viewer.help import hint
from trocar.viewer.server import Buttons, when_touched

if TYPE_CHECKING:
    from trocar.simulation import World

T = TypeVar("T")

HOME, HOLD, NONE = "home", "hold here", "none"
RELEASE = "Release"
POWER = {"Enable": "enable", "Home": "home", "Disable": "disable"}
MODES = {"position (PID)": "position", "effort (open loop)": "effort", "set (kinematic)": "set"}
ALL_JOINTS = "all joints"
STILL = "this arm stands still in this scene; trocar play --policy none lets it move"

UNLIMITED = 100.0
"""Largest effort offered when efforts are not limited [N m or N]. Source: our own choice."""

HANDS_OFF = 5
"""Refreshes without a touch after which the sliders follow the arm: half a second at 10 Hz."""

SETTLED = 4
"""Updates of an input without a touch after which it shows what is in force again, or typing is
over. Source: most of a second at 5 Hz."""


@dataclass(frozen=True)
class Unit:
    """The unit of a quantity on the page: shown is the SI value times `scale`."""

    text: str
    scale: float
    effort_text: str
    gain_text: str


ANGLE = Unit("deg", 180 / np.pi, "N m", "N m/rad")
LENGTH = Unit("mm", 1000.0, "N", "N/m")


@dataclass(frozen=True)
class JointInfo:
    """One joint: limits [rad or m], largest effort [N m or N], gains (p, i, d) in SI units.

    A gripper has no motor; its slider is a person's fingers.
    """

    name: str
    unit: Unit
    lower: float
    upper: float
    effort_max: float
    gains: tuple[float, float, float]
    is_gripper: bool = False

    @property
    def is_jaw(self) -> bool:
        """Whether this is the jaw, which has separate commands."""
        return self.name == "jaw"


@dataclass(frozen=True)
class ArmInfo:
    """One arm: its joints with the jaw last, the names of its poses, whether it has brakes.

    `tool` is the mounted one, "" without one; `tools` are those that fit, none for an arm that
    takes no tool. One that stands `still` is welded into the model, as idle arms of a scene are.
    """

    name: str
    type: str
    joints: tuple[JointInfo, ...]
    poses: tuple[str, ...]
    has_brakes: bool
    gravity_compensation: bool
    tool: str
    tools: tuple[str, ...]
    still: bool


def read_arm(world: World, name: str) -> ArmInfo:
    """Read the limits, modes and tools of an arm for the page; call it through `Loop.ask`."""
    arm = world.arm(name)
    kinds = [joint.kind for joint in arm.description.mechanism.joints]
    joints = tuple(
        JointInfo(
            name=joint,
            unit=LENGTH if kinds[k] == "prismatic" else ANGLE,
            lower=float(arm.joints.lower[k]),
            upper=float(arm.joints.upper[k]),
            effort_max=min(float(arm.joints.effort_limit[k]), UNLIMITED),
            gains=arm.joints.gains(joint),
            is_gripper=arm.gripper is not None and joint == arm.joints.names[-1],
        )
        for k, joint in enumerate(arm.joints.names)
    )
    return ArmInfo(
        name=arm.name,
        type=arm.description.type,
        joints=joints,
        poses=tuple(arm.joints.poses),
        has_brakes=bool(arm.brakes),
        gravity_compensation=arm.joints.gravity_compensation,
        tool=arm.description.tool,
        tools=fitting_tools(arm.description),
        still=arm.runtime.motors.welded,
    )


class Setting(Generic[T]):
    """An input for a setting of an arm; it follows the simulation except just after a touch.

    Args:
        handle: the input
        post: called with the value that a person chose
        delayed: post once typing has settled: a number that is being typed passes through others
            (on the way to 120 it is 1 and 12), and an arm with P = 1 drops
    """

    def __init__(
        self,
        handle: viser.GuiInputHandle[Any],
        post: Callable[[T], object],
        *,
        delayed: bool = False,
    ) -> None:
        self.handle, self._post, self._delayed = handle, post, delayed
        self._pending: T | None = None
        self._untouched = SETTLED
        when_touched(handle, self.touch)

    def touch(self, value: T) -> None:
        """Take the value that a person chose or typed."""
        self._untouched = 0
        if self._delayed:
            self._pending = value
        else:
            self._post(value)

    def show(self, value: T) -> None:
        """Show the value in force, or post a typed one; nothing just after a touch."""
        self._untouched += 1
        if self._untouched < SETTLED:
            return
        if self._pending is not None:
            pending, self._pending, self._untouched = self._pending, None, 0
            self._post(pending)
        elif self.handle.value != value:
            self.handle.value = value


class JointSliders:
    """The sliders of one arm, inside the GUI container that is open when it is made.

    A slider posts a move, so that the arm keeps its velocity limits however fast it is dragged; of
    a joint in effort mode it is an effort. A touch changes the goal of its own joint only. While
    they are not touched and the arm is at rest, or moves for another reason (a named pose, a
    script), the sliders follow the set-points.

    Args:
        gui: the page's widgets
        loop: takes the commands
        info: the arm
        now: the arm's state; the sliders start at its set-points

    Attributes:
        handles: the sliders, in the order of the joints
    """

    def __init__(self, gui: viser.GuiApi, loop: Loop, info: ArmInfo, now: ArmSnapshot) -> None:
        self._gui, self._loop, self._info = gui, loop, info
        self._goal = np.array(now.setpoint, dtype=float)
        self._effort = np.zeros_like(self._goal)
        self._mine = False
        self._untouched = 0
        self._folder = gui.add_folder(None)
        self.handles: list[viser.GuiSliderHandle[float]] = []
        self._build(tuple(now.modes))

    def follow(self, now: ArmSnapshot, *, blocked: bool = False) -> None:
        """Bring the sliders in line with the arm; to be called about ten times a second.

        Args:
            now: the arm's state
            blocked: whether they are greyed out
        """
        if tuple(now.modes) != self._modes:
            self._effort[:] = 0.0
            self._build(tuple(now.modes))
        for handle, locked in zip(self.handles, now.locked, strict=True):
            handle.disabled = locked or blocked  # a brake holds
        self._untouched += 1
        if self._untouched > HANDS_OFF and not now.busy:
            self._mine = False
        if self._mine:
            return
        self._goal[:] = now.setpoint
        for k, handle in enumerate(self.handles):
            value = self._goal[k] * self._info.joints[k].unit.scale
            if not self._in_effort(k) and abs(value - handle.value) > 0.6 * handle.step:
                handle.value = _rounded(value, handle.min, handle.max, handle.step)

    def let_go(self) -> None:
        """Follow the arm from now on: something else than a slider commanded it."""
        self._mine = False

    def touch(self, k: int, value: float) -> None:
        """Command joint k to its slider's value, in the shown unit."""
        joint, own = self._info.joints[k], self._own
        self._untouched, self._mine = 0, True
        if self._in_effort(k):
            self._effort[k] = value
            if joint.is_jaw:
                self._post("jaw.servo_jf", effort=(value,))
            else:
                self._post("servo_jf", effort=own(self._effort))
            return
        goal = float(np.clip(value / joint.unit.scale, joint.lower, joint.upper))
        self._goal[k] = goal
        if joint.is_gripper and goal >= joint.upper:
            self._post("gripper.release")
        elif joint.is_gripper:
            self._post("gripper.squeeze_to", angle=goal)
        elif joint.is_jaw:
            self._post("jaw.move_jp", q=(goal,))
        else:
            self._post("move_jp", q=own(self._goal))

    def _post(self, verb: str, **values: object) -> None:
        self._loop.post(Command(self._info.name, verb, values))

    def _build(self, modes: tuple[str, ...]) -> None:
        self._modes = modes
        for handle in self.handles:
            handle.remove()
        with self._folder:
            self.handles = [self._slider(k) for k in range(len(self._info.joints))]

    def _slider(self, k: int) -> viser.GuiSliderHandle[float]:
        joint = self._info.joints[k]
        if self._in_effort(k):
            low, high, step = effort_range(joint)
            label, value = f"{joint.name} {joint.unit.effort_text}", float(self._effort[k])
            told = hint("effort", unit=joint.unit.effort_text)
        else:
            low, high, step = goal_range(joint)
            label, value = f"{joint.name} {joint.unit.text}", self._goal[k] * joint.unit.scale
            told = hint("slider", unit=joint.unit.text, lower=low, upper=high)
        begin = _rounded(value, low, high, step)
        handle = self._gui.add_slider(
            label, min=low, max=high, step=step, initial_value=begin, hint=told
        )
        when_touched(handle, lambda value: self.touch(k, value))
        return handle

    def _in_effort(self, k: int) -> bool:
        """Test whether a slider is an effort; fingers have an opening in every mode."""
        return self._modes[k] == "effort" and not self._info.joints[k].is_gripper

    def _own(self, values: np.ndarray) -> tuple[float, ...]:
        """Return values of the joints without jaw and gripper."""
        pairs = zip(self._info.joints, values, strict=True)
        return tuple(float(v) for joint, v in pairs if not (joint.is_jaw or joint.is_gripper))


def goal_range(joint: JointInfo) -> tuple[float, float, float]:
    """Return a slider's ends and step in shown units: tenths, never beyond the limits."""
    step, scale = 0.1, joint.unit.scale
    low = np.ceil(joint.lower * scale / step - 1e-6) * step
    high = np.floor(joint.upper * scale / step + 1e-6) * step
    return round(float(low), 1), round(float(high), 1), step


def effort_range(joint: JointInfo) -> tuple[float, float, float]:
    """Return an effort slider's ends and step [N m or N]: a step is a hundredth, rounded down."""
    high = joint.effort_max
    step = 10.0 ** np.floor(np.log10(high / 100.0))
    high = float(np.floor(high / step + 1e-6) * step)
    return -high, high, float(step)


def _rounded(value: float, low: float, high: float, step: float) -> float:
    return float(np.clip(round(round(value / step) * step, 6), low, high))


class ArmControls:
    """Everything that drives one arm; made anew when another arm or tool is chosen.

    Attributes:
        sliders: of its joints
        clients: names of the clients that command the arm
        instrument: the choice of a tool; None for an arm that takes none
        gains: {joint: its gains}
    """

    def __init__(self, gui: viser.GuiApi, loop: Loop, info: ArmInfo, now: Snapshot) -> None:
        self._gui, self._loop, self._info = gui, loop, info
        arm = now.arms[info.name]
        self.instrument: Setting[str] | None = None
        self._gravity: Setting[bool] | None = None
        self._folders = gui.add_folder(f"{info.name} joints"), gui.add_folder("Control")
        self._why = ""
        self._movers: list[Buttons] = []
        with self._folders[0]:
            self._reason = gui.add_html("", visible=False)
            self._state = gui.add_text(
                "State", initial_value=state_line(arm), disabled=True, hint=hint("State")
            )
            self.clients = gui.add_text(
                "Clients", initial_value=NONE, disabled=True, hint=hint("Clients")
            )
            self._power = self._buttons("Power", power_of(arm), lambda n: self._post(POWER[n]))
            self.sliders = JointSliders(gui, loop, info, arm)
            names = sorted(info.poses, key=lambda name: name != HOME)
            self._movers.append(self._buttons("Move to", (*names, HOLD), self._move_to))
            if info.has_brakes:
                self._movers.append(self._buttons("Brakes", (RELEASE, "Lock"), self._brake))
        with self._folders[1]:
            if info.tools:
                names = dict.fromkeys((*info.tools, info.tool or NONE, NONE))  # an own file, too
                choice = gui.add_dropdown(
                    "Instrument",
                    list(names),
                    initial_value=info.tool or NONE,
                    hint=hint("Instrument"),
                )
                self.instrument = Setting(choice, self._exchange)
            motors = [joint for joint in info.joints if not joint.is_gripper]
            mode = gui.add_dropdown(
                "Mode", list(MODES), initial_value=_mode_title(arm.modes[0]), hint=hint("Mode")
            )
            self._mode = Setting(mode, self._set_mode)
            self._scope = gui.add_dropdown(
                "Applies to", [ALL_JOINTS, *(j.name for j in motors)], hint=hint("Applies to")
            )
            if not info.has_brakes:
                box = gui.add_checkbox(
                    "Gravity comp.", info.gravity_compensation, hint=hint("Gravity comp.")
                )
                self._gravity = Setting(
                    box, lambda on: self._post("use_gravity_compensation", on=on)
                )
            with gui.add_folder("Gains P, I, D", expand_by_default=False):
                self.gains = {joint.name: self._gains_row(joint) for joint in motors}

    def follow(self, now: Snapshot, blocked: str = "") -> None:
        """Show the arm's position and state.

        Args:
            now: of the world
            blocked: why the arm is not a person's now; "": it is
        """
        arm = now.arms[self._info.name]
        self._block(arm, blocked or (STILL if self._info.still else ""))
        if (line := state_line(arm)) != self._state.value:
            self._state.value = line
        clients = ", ".join(self._loop.commanders.of(self._info.name)) or NONE
        if clients != self.clients.value:
            self.clients.value = clients
        self.sliders.follow(arm, blocked=bool(self._why))
        scope = self._scope.value
        index = 0 if scope == ALL_JOINTS else [j.name for j in self._info.joints].index(scope)
        self._mode.show(_mode_title(arm.modes[index]))

    def show(self, info: ArmInfo) -> None:
        """Show the settings in force."""
        if self.instrument is not None:
            self.instrument.show(info.tool or NONE)
        if self._gravity is not None:
            self._gravity.show(info.gravity_compensation)
        for joint in info.joints:
            if joint.name in self.gains:
                self.gains[joint.name].show(joint.gains)

    def remove(self) -> None:
        """Take everything off the page."""
        for folder in self._folders:
            folder.remove()

    def _block(self, arm: ArmSnapshot, blocked: str) -> None:
        """Grey out what cannot act, and show why."""
        self._power.show(power_of(arm), disabled=bool(blocked))
        why = blocked or idle_reason(arm)
        for buttons in self._movers:
            buttons.show(buttons.names, disabled=bool(why))
        inputs = [self._mode.handle, *(row.handle for row in self.gains.values())]
        inputs += [s.handle for s in (self.instrument, self._gravity) if s is not None]
        for handle in inputs:
            if handle.disabled != bool(blocked):
                handle.disabled = bool(blocked)
        if why != self._why:
            self._why = why
            self._reason.content = (
                f'<div class="trocar"><div class="why" data-trocar="why">{escape(why)}</div></div>'
            )
            self._reason.visible = bool(why)

    def _post(self, verb: str, **values: object) -> None:
        self._loop.post(Command(self._info.name, verb, values))

    def _buttons(self, label: str, names: Sequence[str], act: Callable[[str], object]) -> Buttons:
        return Buttons(self._gui, label, names, act, hint(label))

    def _move_to(self, pose: str) -> None:
        if pose == HOLD:
            self._post("hold")
        else:
            self._post("move_to", name=pose)
        self.sliders.let_go()

    def _brake(self, button: str) -> None:
        self._post("release_brakes" if button == RELEASE else "lock_brakes")

    def _exchange(self, tool: str) -> None:
        self._loop.post(Command(WORLD, "exchange_tool", {"name": self._info.name, "tool": tool}))

    def _set_mode(self, title: str) -> None:
        scope = self._scope.value
        joints = None if scope == ALL_JOINTS else (scope,)
        self._post("set_mode", mode=MODES[title], joints=joints)

    def _gains_row(self, joint: JointInfo) -> Setting[tuple[float, float, float]]:
        told = hint("gains", gain=joint.unit.gain_text)
        row = self._gui.add_vector3(
            joint.name, joint.gains, min=(0.0, 0.0, 0.0), step=0.01, hint=told
        )

        def post(gains: tuple[float, float, float]) -> None:
            p, i, d = gains
            self._post("set_gains", joint=joint.name, p=p, i=i, d=d)

        return Setting(row, post, delayed=True)


def state_line(now: ArmSnapshot) -> str:
    """Return the operating state in a few words."""
    words = [now.state, "homed" if now.homed else "not homed"]
    return ", ".join([*words, "busy"] if now.busy else words)


def power_of(now: ArmSnapshot) -> tuple[str, ...]:
    """Return the buttons of the power that act in a state."""
    if now.state == "DISABLED":
        return ("Enable",)
    if now.state == "FAULT":
        return ("Enable", "Disable")
    return ("Home", "Disable")


def idle_reason(now: ArmSnapshot) -> str:
    """Return the reason that keeps an arm still, with the remedy; "" when it moves."""
    if now.state == "DISABLED":
        return "no power: Enable, then Home"
    if now.state == "FAULT":
        return "FAULT: Disable, Enable, then Home"
    return "" if now.homed or now.busy else "not homed: Home"


def _mode_title(mode: str) -> str:
    return next(title for title, name in MODES.items() if name == mode)


class Panel:
    """The controls of the rig: time, named poses, the choice of an arm, and that arm's controls.

    Args:
        gui: the page's widgets
        loop: takes the commands
        arms: {name: its description}
        poses: named poses of the rig, {name: {arm: joints}}
        blocked: returns why an arm is not a person's now; "" when it is

    Attributes:
        choice: the list of arms
        controls: of the chosen arm; None until the description fits its tool
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        loop: Loop,
        arms: Mapping[str, ArmInfo],
        poses: Mapping[str, Mapping[str, object]],
        blocked: Callable[[str], str] = lambda _: "",
    ) -> None:
        self._gui, self._loop, self._arms, self._blocked = gui, loop, dict(arms), blocked
        self._answer: Future[ArmInfo] | None = None
        self._time = Buttons(gui, "Time", ("Pause", "Reset"), self._press_time, hint("Time"))

        def move_all(pose: str) -> None:  # setup arms stay where their brakes hold them
            for arm in poses[pose]:
                if not (self._arms[arm].has_brakes or self._arms[arm].still):
                    loop.post(Command(arm, "move_to", {"name": pose}))

        self._poses = Buttons(gui, "All arms to", tuple(poses), move_all, hint("All arms to"))
        self._posed = tuple({arm for pose in poses.values() for arm in pose})
        self.choice = gui.add_dropdown("Arm", list(arms), hint=hint("Arm"))
        when_touched(self.choice, lambda _: self.choose())
        self.controls: ArmControls | None = None
        self.choose()

    @property
    def arm(self) -> ArmInfo:
        """The chosen arm."""
        return self._arms[self.choice.value]

    def is_current(self, now: Snapshot) -> bool:
        """Test whether the description of the chosen arm is of the tool that it has now."""
        return now.arms[self.arm.name].tool == self.arm.tool

    def show_time(self, *, paused: bool, blocked: str = "") -> None:
        """Show the buttons of time that act: one of Pause and Resume, and Reset."""
        self._time.show(("Resume" if paused else "Pause", "Reset"), disabled=bool(blocked))

    def follow(self, now: Snapshot) -> None:
        """Show the chosen arm's position, state and settings."""
        self._poses.show(self._poses.names, disabled=any(map(self._blocked, self._posed)))
        if self.controls is not None and self.is_current(now):
            self.controls.follow(now, self._blocked(self.arm.name))
        if self._answer is None:
            name = self.arm.name
            self._answer = self._loop.ask(lambda world: read_arm(world, name))
        elif self._answer.done():
            answer, self._answer = self._answer, None
            if not answer.cancelled() and answer.exception() is None:
                self._renew(answer.result())

    def choose(self) -> None:
        """Make the chosen arm's controls, once its description is of the tool that it has now."""
        if self.controls is not None:
            self.controls.remove()
            self.controls = None
        now = self._loop.latest
        if self.is_current(now):
            self.controls = ArmControls(self._gui, self._loop, self.arm, now)

    def _press_time(self, name: str) -> None:
        self._loop.post(Command(WORLD, name.lower()))

    def _renew(self, info: ArmInfo) -> None:
        exchanged = self._arms[info.name].tool != info.tool
        self._arms[info.name] = info
        if info.name != self.arm.name:
            return
        if exchanged or self.controls is None:
            self.choose()
        else:
            self.controls.show(info)
