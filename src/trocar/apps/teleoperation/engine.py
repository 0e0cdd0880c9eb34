"""Teleoperation of a world: looks on in its loop's thread and moves slaves after masters.

Commands are the arms' own verbs, given between two ticks, so a recording of them repeats the
motion exactly, and the same motion of masters makes the same motion of slaves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from trocar.apps.teleoperation.arm_master import ArmMaster
from trocar.apps.teleoperation.carrier import Carrier
from trocar.apps.teleoperation.component import Component
from trocar.apps.teleoperation.console import Console
from trocar.apps.teleoperation.reading import Master
from trocar.apps.teleoperation.scope import ScopeTeleoperation
from trocar.apps.teleoperation.states import DISABLED
from trocar.apps.teleoperation.tool import ToolTeleoperation
from trocar.descriptions.teleop_records import TeleopDescription
from trocar.errors import InputError
from trocar.interfaces.commands import Command
from trocar.interfaces.loop import Loop
from trocar.interfaces.state import Elapsed

if TYPE_CHECKING:
    from trocar.simulation import World

#: Ticks until the next look while nothing is enabled. Source: our own choice.
PATIENT = 1000
KINDS = {"psm": ToolTeleoperation, "ecm": ScopeTeleoperation}


@dataclass(frozen=True)
class Ask:
    """Something that is asked of teleoperation, done in the loop's thread.

    Attributes:
        act: does it
        stream: of those with the same only the newest counts; None: each does
    """

    act: Callable[[], object]
    stream: tuple[str, str] | None = None

    def apply(self, world: World) -> None:  # noqa: ARG002  as every command
        """Do it."""
        self.act()


class Player(Protocol):
    """Moves masters by itself."""

    def tick(self, period_s: float) -> None:
        """Go on by a period [s]."""
        ...

    def begin_anew(self) -> None:
        """Begin anew, after a reset put the masters somewhere else."""
        ...


class Teleoperation:
    """Every component of a rig, and the console that switches them.

    Args:
        loop: of a world; components follow at each of its ticks
        teleops: what there is; the rig's own when omitted
        masters: {name: where it is read}, of those that are no arms of the rig

    Attributes:
        world: the loop's
        components: {name: component}, in the order in which they were described
        masters: {name: master}
        console: switches them
        players: what moves masters by itself

    Raises:
        InputError: a master that is neither an arm of the rig nor given
    """

    def __init__(
        self,
        loop: Loop,
        teleops: tuple[TeleopDescription, ...] | None = None,
        masters: Mapping[str, Master] | None = None,
    ) -> None:
        self._loop, self.world = loop, loop.world
        given = dict(masters or {})
        self.masters: dict[str, Master] = {}
        self.components: dict[str, Component] = {}
        for says in self.world.rig.teleops if teleops is None else teleops:
            own = [self._master(name, given) for name in says.masters]
            self.components[says.name] = KINDS[says.kind](self.world, says, own)
        #: Hands that carry simulated masters, by their names.
        self.carriers = {
            name: Carrier(self.world, name)
            for name, master in self.masters.items()
            if isinstance(master, ArmMaster)
        }
        self.players: list[Player] = []
        self.console = Console(self.components)
        self._periods = self.world.periods

    def start(self) -> Callable[[], None]:
        """Look on from now on; call the result to stop."""
        return self._loop.watch(self)

    def ask(self, act: Callable[[], object]) -> bool:
        """Do something at the next tick, in the loop's thread; from any thread.

        Returns:
            False when too much waits already
        """
        return self._loop.post(Ask(act))

    # ------------------------------------------------------------------ in the loop's thread

    def rest(self) -> None:
        """Let every component hold its slave, until it is wanted again."""
        for component in self.components.values():
            component.desire(DISABLED)

    def ticked(self, elapsed: Elapsed) -> None:  # noqa: ARG002  the world's own time counts
        """Let every component do what is due after the periods that passed."""
        passed = self.world.periods - self._periods
        self._periods = self.world.periods
        if passed < 0:
            for carrier in self.carriers.values():
                carrier.let_go()
            for component in self.components.values():
                component.begin_anew()
            for player in self.players:
                player.begin_anew()
        elif passed:
            for player in self.players:
                player.tick(passed * self.world.timestep)
            for carrier in self.carriers.values():
                carrier.tick(passed * self.world.timestep)
            for component in self.components.values():
                component.tick(passed * self.world.timestep)

    def patience(self) -> int:
        """Return 1 while something is enabled."""
        resting = all(component.resting for component in self.components.values())
        resting = resting and not any(carrier.busy for carrier in self.carriers.values())
        return PATIENT if resting else 1

    def refused(self, command: Command, reason: str) -> None:
        """Do nothing: who asked learns of it."""

    def _master(self, name: str, given: Mapping[str, Master]) -> Master:
        if name not in self.masters:
            if name in given:
                self.masters[name] = given[name]
            elif name in self.world.arms:
                self.masters[name] = ArmMaster(name)
            else:
                raise InputError(
                    f"teleoperation: got the master {name!r}; allowed: an arm of the rig, or one "
                    "that is read from elsewhere"
                )
        return self.masters[name]
