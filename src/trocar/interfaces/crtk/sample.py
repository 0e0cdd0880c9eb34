"""What is copied in the loop's thread, so that everything else can be computed outside of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from trocar.descriptions.records import RigDescription
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.scene import Scene
from trocar.simulation.records import ArmSample

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
        time: simulation time [s]
        rig: the rig, as its tools are now
        arms: {name: what its readings are computed from}
        events: what happened since the sample before, oldest first
        scene: objects, and those contacts and sensors that somebody asked for
        cameras: {name: where it is}, when pictures of this moment are to come; tf is told then
        reference_arm: arm on setup joints whose tip frame the poses of the others are in
        due_s: when its messages are to go out, by the loop's clock; None: at once [s]
    """

    stamp: Stamp
    elapsed: float
    time: float
    rig: RigDescription
    arms: Mapping[str, ArmSample]
    reference_arm: str
    events: tuple[Event, ...] = ()
    scene: Scene | None = None
    cameras: Mapping[str, Any] = field(default_factory=dict[str, Any])
    due_s: float | None = None


def take(
    world: World,
    stamp: Stamp,
    elapsed: float,
    beside: tuple[tuple[Event, ...], Scene],
    waits: Callable[[str], bool],
) -> Sample:
    """Copy a world, in the thread that steps it; arms for which commands wait are busy."""
    events, scene = beside
    arms = world.samples()
    arms |= {name: replace(arm, busy=True) for name, arm in arms.items() if waits(name)}
    return Sample(stamp, elapsed, world.time, world.rig, arms, world.reference_arm, events, scene)
