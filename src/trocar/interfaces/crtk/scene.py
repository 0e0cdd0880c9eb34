"""What a sample has of a scene, and what the scene is told: objects, contacts, sensors, time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.geometry.se3 import transform
from trocar.interfaces.commands import Command, Pause, Reset, Resume, Step, Verb
from trocar.interfaces.crtk.fields import Message, RefusedError, field, shown, text
from trocar.interfaces.crtk.places import pose
from trocar.interfaces.crtk.sensor_rows import sensor_topic

if TYPE_CHECKING:
    from trocar.interfaces.crtk.topics import Topic
    from trocar.simulation import SensorReading, World
    from trocar.simulation.objects import ObjectStates
    from trocar.simulation.probes import ContactTable

Array = NDArray[np.float64]

#: The frame of objects and contacts: that of the rig, the root of tf.
WORLD = "world"
CONTACTS = "scene/contacts"


@dataclass(frozen=True, eq=False)
class Scene:
    """What a sample has of a scene.

    Attributes:
        objects: all of them, None where the rig has none
        contacts: all of them, None where nobody asked
        readings: {sensor: what it tells}, of those that somebody asked for
    """

    objects: ObjectStates | None = None
    contacts: ContactTable | None = None
    readings: Mapping[str, SensorReading] | None = None


def look(world: World, asked: frozenset[str]) -> Scene:
    """Copy a scene, in the thread that steps it.

    Args:
        world: whose
        asked: topics that somebody wants; contacts and sensors cost only where they are
    """
    wanted = [name for name in world.sensors if sensor_topic(name) in asked]
    return Scene(
        world.object_states() if world.objects else None,
        world.contact_table() if CONTACTS in asked else None,
        {name: world.sensor(name) for name in wanted},
    )


def object_poses(scene: Scene | None) -> dict[str, Array]:
    """Return where objects are in the world, {name: (4, 4)}."""
    if scene is None or scene.objects is None:
        return {}
    at = transform(matrix_from_quaternion(scene.objects.quaternions), scene.objects.positions)
    return dict(zip(scene.objects.names, at, strict=True))


def commands(rig: RigDescription) -> dict[str, Callable[[Topic, Message], Command]]:
    """Return what messages ask for, {topic: its command}; a message that is none is refused."""
    found: dict[str, Callable[[Topic, Message], Command]] = {
        "scene/reset": _plain(Reset()),
        "scene/pause": _plain(Pause()),
        "scene/resume": _plain(Resume()),
        "scene/step": _step,
    }
    for prop in rig.objects:
        found[f"scene/{prop.name}/set_cp"] = _put(prop.name)
    return found


def _plain(command: Command) -> Callable[[Topic, Message], Command]:
    def ask(topic: Topic, message: Message) -> Command:  # noqa: ARG001  as every command
        return command

    return ask


def _put(name: str) -> Callable[[Topic, Message], Command]:
    def command(topic: Topic, message: Message) -> Command:  # noqa: ARG001  as every command
        frame = text(message, "header.frame_id").lstrip("/")
        if frame not in ("", WORLD):
            raise RefusedError("frame", f"got the frame {frame!r}; allowed: {WORLD}, or none")
        return Verb(name, "set_cp", {"T": pose(message, "pose")})

    return command


def _step(topic: Topic, message: Message) -> Command:  # noqa: ARG001  as every command
    periods = field(message, "data")
    if isinstance(periods, bool) or not isinstance(periods, int | np.integer):
        raise RefusedError("type", f"got data {shown(periods)}; allowed: a whole number")
    return Step(int(periods))
