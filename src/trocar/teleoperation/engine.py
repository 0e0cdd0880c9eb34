"""Teleoperation of a world: its components, the console that switches them, and their ticks.

Commands are the arms' own verbs, given between two ticks, so a recording of them repeats the
motion exactly, and the same motion of masters makes the same motion of slaves.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from math import isfinite
from typing import Any, Protocol

from trocar.descriptions.teleops import TeleopDescription
from trocar.errors import InputError, UnknownNameError
from trocar.live.inbox import Command
from trocar.live.loop import Loop
from trocar.live.state import PATIENT, Elapsed
from trocar.ros import message_builders as build
from trocar.simulation.journal import WORLD
from trocar.teleoperation.component import (
    ALIGNING,
    DISABLED,
    ENABLED,
    Publish,
    TeleopComponent,
    publish_nothing,
)
from trocar.teleoperation.devices import PEDAL_KEYS
from trocar.teleoperation.ecm import EcmTeleoperation
from trocar.teleoperation.force_feedback import FeedbackSettings, ForceFeedback
from trocar.teleoperation.masters import ArmMaster, Master
from trocar.teleoperation.psm import PsmTeleoperation
from trocar.teleoperation.slave import HandleMover
from trocar.teleoperation.virtual_fixtures import Fixtures

KINDS = {"psm": PsmTeleoperation, "ecm": EcmTeleoperation}


class Console:
    """Switches components by what the surgeon does; in the loop's thread.

    Switched on and with an operator present the selected tools follow; while the camera pedal is
    pressed the endoscope does, also without an operator. Source: SAW console.cpp,
    update_teleop_state.

    Args:
        components: by name, in the order in which they are preferred

    Attributes:
        enabled: whether teleoperation is switched on
        present, camera: whether an operator is there, and the camera pedal is pressed
        selected: names of the components that are used; no arm is in two that move tools
        publish: called with what changes
    """

    def __init__(self, components: Mapping[str, TeleopComponent]) -> None:
        self._components = components
        self.enabled = self.present = self.camera = False
        self.selected: list[str] = []
        self.scale = min((c.scale for c in components.values()), default=0.2)
        self.publish: Publish = publish_nothing
        #: Names of the components that were requested to follow, until they are switched off.
        self._engaged: set[str] = set()
        for name in components:
            if not self._rivals(name):
                self.selected.append(name)

    def enable(self, on: bool) -> None:
        """Switch teleoperation."""
        self.enabled = on
        self.publish("enabled", on)
        self._update()

    def set_operator_present(self, present: bool) -> None:
        """Note whether an operator is there."""
        self.present = present
        self._update()

    def press_camera(self, pressed: bool) -> None:
        """Press or release the camera pedal."""
        self.camera = pressed
        self._update()

    def press_clutch(self, pressed: bool) -> None:
        """Press or release the clutch of every component."""
        for component in self._components.values():
            component.press_clutch(pressed)

    def select(self, name: str) -> None:
        """Use a component, and no longer those that move tools with an arm of it.

        Raises:
            UnknownNameError: no such component
        """
        self._check(name)
        for rival in self._rivals(name):
            self.unselect(rival)
        if name not in self.selected:
            self.selected.append(name)
        self.publish("selected", name)
        self._update()

    def unselect(self, name: str) -> None:
        """Use a component no longer.

        Raises:
            UnknownNameError: no such component
        """
        self._check(name)
        if name in self.selected:
            self.selected.remove(name)
        self.publish("unselected", name)
        self._update()

    def set_scale(self, scale: float) -> None:
        """Change the scale of every component.

        Raises:
            InputError: not finite
        """
        if not isfinite(scale):
            raise InputError(f"got a scale of {scale:g}; allowed: finite")
        self.scale = scale
        for component in self._components.values():
            component.set_scale(scale)
        self.publish("scale", scale)

    def _update(self) -> None:
        """Request of each component the state that follows from switch, operator and pedal.

        A state that is requested already is requested and published again, as on the robot.
        """
        for name, component in self._components.items():
            is_ecm = component.description.kind == "ecm"
            if self.enabled and name in self.selected and is_ecm == self.camera:
                if self.present or is_ecm:
                    self._engaged.add(name)
                    component.request(ENABLED)
                else:
                    component.request(ALIGNING)
            elif not self.enabled or not self.present or name in self._engaged:
                self._engaged.discard(name)
                component.request(DISABLED)

    def _rivals(self, name: str) -> list[str]:
        """Return the selected components that move tools with an arm of this one."""

        def arms(one: str) -> set[str]:
            description = self._components[one].description
            tools = description.kind == "psm"
            return {description.slave, *description.masters} if tools else set()

        return [other for other in self.selected if other != name and arms(name) & arms(other)]

    def _check(self, name: str) -> None:
        if name not in self._components:
            raise UnknownNameError("component", name, self._components, "teleoperation")


class Pedals:
    """The foot pedals and the head sensor of the console, pressed in the page or by keys.

    A pedal is published under every name that there is for it, as `footpedals/coag`; clutch,
    camera and the operator's presence act on teleoperation, too.

    Args:
        console: of the teleoperation
        call: calls a function in the loop's thread

    Attributes:
        pressed: names of those that are pressed
    """

    #: Those that act on teleoperation.
    ACTIVE = ("operator_present", "clutch", "camera")

    def __init__(self, console: Console, call: Callable[[Callable[[], object]], bool]) -> None:
        self._console, self._call = console, call
        self._topics: Collection[str] = ()
        self._publish: Callable[[str, Mapping[str, Any]], None] = lambda topic, fields: None  # noqa: ARG005
        self.pressed: set[str] = set()

    def connect(
        self, topics: Collection[str], publish: Callable[[str, Mapping[str, Any]], None]
    ) -> None:
        """Publish from now on; `topics` are the names of those that are served."""
        self._topics, self._publish = topics, publish

    @property
    def names(self) -> list[str]:
        """The pedals that are published, in the order of their keys."""
        return [name for name in PEDAL_KEYS if self._topics_of(name)]

    def press(self, name: str, on: bool) -> None:
        """Press or release a pedal; from any thread."""
        self.note(name, on)
        if name in self.ACTIVE:
            self._call(partial(self.act, name, on))
        for topic in self._topics_of(name):
            self._publish(topic, build.joy(int(on)))

    def note(self, name: str, on: bool) -> None:
        """Note that a pedal is pressed or released."""
        (self.pressed.add if on else self.pressed.discard)(name)

    def act(self, name: str, on: bool) -> None:
        """Do what a pedal does to teleoperation; in the loop's thread."""
        if name == "operator_present":
            self._console.set_operator_present(on)
        elif name == "clutch":
            self._console.press_clutch(on)
        elif name == "camera":
            self._console.press_camera(on)

    def _topics_of(self, name: str) -> list[str]:
        return [t for t in (f"console/{name}", f"footpedals/{name}") if t in self._topics]


class MasterDriver(Protocol):
    """Moves masters by itself."""

    def tick(self, period_s: float) -> None:
        """Go on by a period [s]."""
        ...

    def restart(self) -> None:
        """Start again, after a reset put the masters somewhere else."""
        ...


class Teleoperation:
    """Every component of a rig, and the console that switches them.

    Args:
        loop: of a world; components follow at each of its ticks
        teleops: their descriptions; the rig's own when omitted
        masters: {name: master}, of those that are no arms of the rig
        fixtures: virtual fixtures that act on instruments and masters

    Attributes:
        world: the loop's
        components: {name: component}, in the order in which they were described
        masters: {name: master}
        console: switches them
        pedals: of the console
        carriers: {MTM of the rig: a hand that carries it}
        players: move masters by themselves

    Raises:
        InputError: a master that is neither an arm of the rig nor given
        DescriptionError: a fixture with a force that no master exerts
    """

    def __init__(
        self,
        loop: Loop,
        teleops: tuple[TeleopDescription, ...] | None = None,
        masters: Mapping[str, Master] | None = None,
        fixtures: Fixtures | None = None,
    ) -> None:
        self._loop, self.world = loop, loop.world
        self.masters: dict[str, Master] = {}
        self.components: dict[str, TeleopComponent] = {}
        for description in self.world.rig.teleops if teleops is None else teleops:
            for name in description.masters:
                if name not in self.masters:
                    self.masters[name] = self._master(name, masters or {})
            own = [self.masters[name] for name in description.masters]
            kind = KINDS[description.kind]
            self.components[description.name] = kind(self.world, description, own)
        if fixtures is not None:
            tools = [c for c in self.components.values() if isinstance(c, PsmTeleoperation)]
            fixtures.check_masters([c.description.slave for c in tools if c.masters[0].exerts])
            for tool in tools:
                tool.fixtures = fixtures
        self.carriers = {
            name: HandleMover(self.world, name)
            for name, arm in self.world.arms.items()
            if arm.description.type == "MTM"
        }
        for one in self.components.values():
            if isinstance(one, PsmTeleoperation):
                one.carried = partial(self._carried, one.masters[0].name)
        self.players: list[MasterDriver] = []
        self.console = Console(self.components)
        self.pedals = Pedals(self.console, self.call)
        self._periods = self.world.periods

    def start(self) -> Callable[[], None]:
        """Follow the loop's ticks from now on; call the result to stop."""
        return self._loop.watch(self)

    def call(self, act: Callable[[], object], stream: str = "") -> bool:
        """Call a function at the next tick, in the loop's thread; from any thread.

        Args:
            act: the function
            stream: of those with the same only the newest counts; "": each does

        Returns:
            False when too much waits already
        """
        return self._loop.post(self.command(act, stream))

    def command(self, act: Callable[[], object], stream: str = "") -> Command:
        """Return the command that calls a function in the loop's thread; arguments as of `call`."""
        return Command(WORLD, "teleoperate", stream=stream, act=lambda _: act())

    def set_feedback(self, settings: FeedbackSettings | None) -> list[str]:
        """Switch force feedback to every master that exerts forces; call it before the loop runs.

        Args:
            settings: None switches it off

        Returns:
            names of the components that have it

        Raises:
            InputError: no master of an instrument may exert it
        """
        able: list[PsmTeleoperation] = []
        for one in self.components.values():
            if isinstance(one, PsmTeleoperation):
                one.feedback, master = None, one.masters[0]
                real = master.name not in self.world.arms
                if settings is not None and master.exerts and (settings.real_masters or not real):
                    one.feedback = ForceFeedback(self.world, one.description.slave, settings)
                    able.append(one)
        if settings is not None and not able:
            raise InputError(
                f"force feedback: rig {self.world.rig.name} has no simulated master that moves an"
                " instrument; allowed: a rig with [[teleop]], e.g. full_cart_mtm, or real masters"
                " with --feedback-real"
            )
        return [one.name for one in able]

    # ------------------------------------------------------------------ in the loop's thread

    def rest(self) -> None:
        """Let every component hold its slave, until it is requested again."""
        for component in self.components.values():
            component.request(DISABLED)

    def ticked(self, elapsed: Elapsed) -> None:  # noqa: ARG002  the world's own time counts
        """Let every component do what is due after the periods that passed."""
        passed = self.world.periods - self._periods
        self._periods = self.world.periods
        if passed < 0:
            for carrier in self.carriers.values():
                carrier.let_go()
            for each in (*self.components.values(), *self.players):
                each.restart()
        elif passed:
            for each in (*self.players, *self.carriers.values(), *self.components.values()):
                each.tick(passed * self.world.timestep)

    def patience(self) -> int:
        """Return 1 while something is enabled."""
        resting = all(component.resting for component in self.components.values())
        resting = resting and not any(carrier.busy for carrier in self.carriers.values())
        return PATIENT if resting else 1

    def refused(self, command: Command, reason: str) -> None:
        """Do nothing: the loop warns the sender."""

    def _carried(self, name: str) -> bool:
        return name in self.carriers and self.carriers[name].busy

    def _master(self, name: str, given: Mapping[str, Master]) -> Master:
        if name in given:
            return given[name]
        if name in self.world.arms:
            return ArmMaster(name)
        raise InputError(
            f"teleoperation: got the master {name!r}; allowed: an arm of the rig, or one "
            "that is read from a client"
        )
