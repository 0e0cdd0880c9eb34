"""What is copied in the loop's thread, so that everything else can be computed outside of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from trocar.descriptions.records import RigDescription
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.scene import Scene
from trocar.simulation.readout import ArmReadout, Readout
from trocar.simulation.records import ArmSample, WorldSample

if TYPE_CHECKING:
    from trocar.simulation import World


@dataclass(frozen=True)
class Event:
    """Something that happened.

    Attributes:
        name: the topic that tells of it
        fields: its message without a header
        stamp: when; the sample's own where it is None
    """

    name: str
    fields: Mapping[str, Any]
    stamp: Stamp | None = None


@dataclass(frozen=True, eq=False)
class Sample:
    """A world at one moment.

    Attributes:
        stamp: of every message that is made from it
        elapsed: time since the loop began, pauses included [s]
        world: what readings are computed from
        events: what happened since the sample before, oldest first
        scene: objects, and those contacts and sensors that somebody asked for
        cameras: {name: where it is}, when pictures of this moment are to come; tf is told then
        due_s: when its messages are to go out, by the loop's clock; None: at once [s]
    """

    stamp: Stamp
    elapsed: float
    world: WorldSample
    events: tuple[Event, ...] = ()
    scene: Scene | None = None
    cameras: Mapping[str, Any] = field(default_factory=dict[str, Any])
    due_s: float | None = None

    @property
    def rig(self) -> RigDescription:
        """The rig, as its tools were."""
        return self.world.model.rig

    @property
    def arms(self) -> Mapping[str, ArmSample]:
        """{name: what its readings are computed from}."""
        return self.world.arms


@dataclass(frozen=True, eq=False)
class RigFigures:
    """What messages are made from: a sample and what its arms read out."""

    sample: Sample
    readout: Readout

    def arm(self, name: str) -> ArmReadout:
        """Return an arm's figures."""
        return self.readout.arm(name)


def take(
    world: World,
    stamp: Stamp,
    elapsed: float,
    beside: tuple[tuple[Event, ...], Scene],
    waits: Callable[[str], bool],
) -> Sample:
    """Copy a world, in the thread that steps it; arms for which commands wait are busy."""
    events, scene = beside
    seen = world.sample()
    waiting = {name: replace(arm, busy=True) for name, arm in seen.arms.items() if waits(name)}
    if waiting:
        seen = replace(seen, arms={**seen.arms, **waiting})
    return Sample(stamp, elapsed, seen, events, scene)
