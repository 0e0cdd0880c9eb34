"""Force feedback of a bilateral teleoperation: the instrument's contact at the hand, kept passive.

Position-force: the hand gets the force on the instrument, scaled. Position-position: a spring and a
damper lead the handle to where the instrument is. Both pass a channel with a delay each way, and
then a passivity observer and controller: the energy that the teleoperation gave to the hand never
exceeds the energy that it took.

Source: Lawrence, Stability and transparency in bilateral teleoperation, IEEE Trans. Robotics and
Automation 9(5), 1993; Hannaford and Ryu, Time-domain passivity control of haptic interfaces, IEEE
Trans. Robotics and Automation 18(1), 2002, with impedance causality and for three axes at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from trocar.simulation import World

Array = NDArray[np.float64]
Architecture = Literal["position-force", "position-position"]
ForceSource = Literal["contact", "efforts"]
S = TypeVar("S")

ARCHITECTURES: tuple[str, ...] = get_args(Architecture)
FORCE_SOURCES: tuple[str, ...] = get_args(ForceSource)
#: Largest scale and delay. Source: our own choice: a surgeon's hand, a link by satellite. [1, s]
MOST_SCALE, MOST_DELAY_S = 10.0, 2.0
#: Largest force on the hand. Source: our own choice. [N]
MOST_N = 8.0
#: Spring and damper between handle and instrument, at the handle. Source: our own choice, as stiff
#: and damped as a hand that holds it, Tsuji et al., Biological Cybernetics 72, 1995.
COUPLING_N_M, COUPLING_NS_M = 400.0, 10.0
#: Energy that is not given back, for a handle that turns round within a period. Source: our own
#: choice: 2 N over the 0.05 mm that 50 m/s^2 make in a period of 1 ms. [J]
RESERVE_J = 1e-4
#: Largest damping by which energy given in excess is taken back. Source: our own choice, below the
#: 2 m / T of Colgate and Schenkel, J. Robotic Systems 14, 1997, of 0.1 kg at 1 kHz. [N s/m]
MOST_DAMPING_NS_M = 50.0


@dataclass(frozen=True)
class FeedbackSettings:
    """Settings of a force feedback.

    Attributes:
        architecture: "position-force" or "position-position"
        scale: force at the hand over that at the instrument
        delay: of the channel, each way [s]
        source: of the force on the instrument: "contact", which a simulation has, or "efforts", the
            estimate of the motors' efforts, which a robot has
        passive: whether the passivity controller acts
        real_masters: whether masters that are no arms of the rig exert it

    Raises:
        InputError: a value out of range, or an unknown name
    """

    architecture: Architecture = "position-force"
    scale: float = 1.0
    delay: float = 0.0
    source: ForceSource = "contact"
    passive: bool = True
    real_masters: bool = False

    def __post_init__(self) -> None:
        """Check the settings."""
        if self.architecture not in ARCHITECTURES:
            raise UnknownNameError("architecture", self.architecture, ARCHITECTURES)
        if self.source not in FORCE_SOURCES:
            raise UnknownNameError("source of forces", self.source, FORCE_SOURCES)
        if not 0.0 < self.scale <= MOST_SCALE:
            raise InputError(
                f"force feedback: got a scale of {self.scale:g}; allowed: above 0 to {MOST_SCALE:g}"
            )
        if not 0.0 <= self.delay <= MOST_DELAY_S:
            raise InputError(
                f"force feedback: got a delay of {self.delay:g} s; allowed: 0 to {MOST_DELAY_S:g} s"
            )


class DelayLine(Generic[S]):
    """Deliver values after a delay; before the first arrives, that one.

    Args:
        delay: [s]
    """

    def __init__(self, delay: float) -> None:
        self._delay = delay
        self._sent: deque[tuple[float, S]] = deque()

    def restart(self) -> None:
        """Forget everything on its way."""
        self._sent.clear()

    def send(self, now: float, value: S) -> S:
        """Send a value, and return the one that arrives.

        Args:
            now: simulated time, not before that of the last call [s]
            value: sent
        """
        self._sent.append((now, value))
        due = now - self._delay + 1e-9
        while len(self._sent) > 1 and self._sent[1][0] <= due:
            self._sent.popleft()
        return self._sent[0][1]


class PassivityController:
    """Observe the energy at the hand, and dissipate what would be generated.

    The force of a period is constant over it, so the observed energy is exact but for turns of the
    handle: E += -f (x - x_before). Before a force acts for the next period, what it gives back on
    the handle's next way, at its present acceleration, is predicted; what E cannot pay for is taken
    from the force along that way, f - alpha v.

    Attributes:
        energy: that the hand gave to the teleoperation, and has not got back [J]
        lowest: least energy since the start [J]
        dissipated: by the controller since the start [J]
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin with no energy."""
        self.energy = self.lowest = self.dissipated = 0.0
        self._x: Array | None = None
        self._moved = self._force = self._wanted = np.zeros(3)

    def corrected(self, force: Array, x: Array, period_s: float, *, acting: bool = True) -> Array:
        """Return the force that acts on the hand for the next period, (3,) [N].

        Args:
            force: without the controller, (3,) [N]
            x: position of the handle, (3,) [m]
            period_s: since the last call [s]
            acting: whether the controller corrects; else it observes
        """
        moved = np.zeros(3) if self._x is None else x - self._x
        ahead = 2.0 * moved - self._moved  # the next period's way, at the same acceleration
        self._x, self._moved = x.copy(), moved
        self.energy -= float(self._force @ moved)
        self.dissipated += float((self._wanted - self._force) @ moved)
        self.lowest = min(self.lowest, self.energy)
        self._wanted = force
        self._force = self._passive(force, ahead, period_s) if acting else force
        return self._force

    def _passive(self, force: Array, ahead: Array, period_s: float) -> Array:
        way = float(np.linalg.norm(ahead))
        if way == 0.0:
            return force
        back = float(force @ ahead)  # what the next period gives to the hand, as things go
        lacks = back + RESERVE_J - self.energy if back > 0.0 else -self.energy
        if lacks <= 0.0:
            return force
        most = max(back, 0.0) / way
        if self.energy < 0.0:
            most += MOST_DAMPING_NS_M * way / period_s
        return force - min(lacks / way, most) * ahead / way


class ForceFeedback:
    """Force feedback from one instrument to the hand that leads it.

    Args:
        world: the instrument is an arm of its rig
        slave: the instrument's arm
        settings: how

    Attributes:
        settings: as given
        passivity: observer and controller at the handle
        contact: returns the force of contacts on the instrument, in axes of the world, (3,) [N]
        force: on the hand now, in the surgeon's axes, (3,) [N]
    """

    def __init__(self, world: World, slave: str, settings: FeedbackSettings) -> None:
        self.settings, self.passivity = settings, PassivityController()
        self.contact: Callable[[], Array] = lambda: world.contact_forces()[slave]
        self.force = np.zeros(3)
        self._world, self._arm = world, world.arm(slave)
        self._out: DelayLine[Array] = DelayLine(settings.delay)
        self._back: DelayLine[Array] = DelayLine(settings.delay)
        self._gap: Array | None = None
        self._R_world_view, self._scale = np.eye(3), 1.0

    def restart(self, R_world_view: Array, scale: float) -> None:
        """Begin anew: the channel is empty, and so is the store of energy.

        Args:
            R_world_view: the surgeon's axes in the world, (3, 3)
            scale: the instrument's translation over the handle's
        """
        self._out.restart()
        self._back.restart()
        self.passivity.restart()
        self.force, self._gap = np.zeros(3), None
        self._R_world_view, self._scale = R_world_view, scale

    def arriving(self, goal: Array) -> Array:
        """Send where the hand leads the tip, and return what arrives at the instrument.

        Args:
            goal: any vector: a pose and an opening, flat
        """
        return self._out.send(self._world.time, goal)

    def on_hand(self, hand: Array, goal: Array, tip: Array, period_s: float) -> Array:
        """Return the force on the hand for the next period, in the surgeon's axes, (3,) [N].

        Args:
            hand: position of the handle, in the surgeon's frame, (3,) [m]
            goal: where it leads the tip without delay, in the same, (3,) [m]
            tip: the measured tip, in the same, (3,) [m]
            period_s: since the last call [s]
        """
        if self.settings.architecture == "position-force":
            arrived = self._back.send(self._world.time, self._R_world_view.T @ self._on_tip())
        else:
            gap = (self._back.send(self._world.time, tip.copy()) - goal) / self._scale
            rate = np.zeros(3) if self._gap is None else (gap - self._gap) / period_s
            self._gap = gap
            arrived = COUPLING_N_M * gap + COUPLING_NS_M * rate
        force = self.settings.scale * arrived
        size = float(np.linalg.norm(force))
        if size > MOST_N:
            force = force * (MOST_N / size)
        self.force = self.passivity.corrected(force, hand, period_s, acting=self.settings.passive)
        return self.force

    def _on_tip(self) -> Array:
        """Return the force of the environment on the instrument, in the world, (3,) [N]."""
        if self.settings.source == "contact":
            return self.contact()
        name = self._arm.name
        T_world_tip = self._world.reference_pose(name) @ self._world.frames.measured(name)
        return -T_world_tip[:3, :3] @ self._arm.body.measured_cf().force
