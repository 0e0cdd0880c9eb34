"""What sensors tell: frozen copies, a record per kind of sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SensorReading:
    """What every reading has.

    Attributes:
        name, kind: of the sensor
        time: simulation time of the sample [s]
        frame_id: the frame of its vectors: the sensor's own name, "world", or "ARM/joint"
        units: {value: unit}
    """

    name: str
    kind: str
    time: float
    frame_id: str
    units: Mapping[str, str]

    def __str__(self) -> str:
        """Say who tells what, such as "tip: force (0, 0, -9.88) N"."""
        told = (f"{value} {_text(getattr(self, value))} {u}" for value, u in self.units.items())
        return f"{self.name}: {', '.join(told)}"


@dataclass(frozen=True, eq=False)
class EffortReading(SensorReading):
    """What a motor exerts on its joint [N m or N]."""

    effort: float


@dataclass(frozen=True, eq=False)
class WrenchReading(SensorReading):
    """What the environment does to an instrument, at the sensor's origin in its axes.

    Attributes:
        force: (3,) [N]
        torque: about the sensor's origin, (3,) [N m]
    """

    force: Array
    torque: Array


@dataclass(frozen=True, eq=False)
class Contact:
    """A place where two bodies touch; vectors in the world.

    Attributes:
        body, other: names of the bodies; `body` is the sensor's arm's where one of them is
        shape, other_shape: names of the shapes that touch
        point: (3,) [m]
        normal: unit vector from `other` into `body`, (3,)
        force: what `other` does to `body`, (3,) [N]; `body` does the opposite to `other`
        torque: likewise about `point`: friction that resists turning about the normal, (3,) [N m]
        depth: how far the shapes overlap [m]
    """

    body: str
    other: str
    shape: str
    other_shape: str
    point: Array
    normal: Array
    force: Array
    torque: Array
    depth: float


@dataclass(frozen=True, eq=False)
class ContactsReading(SensorReading):
    """Every place where the sensor's bodies touch others."""

    contacts: tuple[Contact, ...]

    def __str__(self) -> str:
        """Say who touches whom, and how hard."""
        told = (f"{c.body} on {c.other}: {_text(c.force)} N" for c in self.contacts)
        return f"{self.name}: {', '.join(told) or 'nothing'}"


@dataclass(frozen=True, eq=False)
class ContactTable:
    """Every place where two bodies touch, a row each; vectors in the world.

    Attributes:
        time: [s]
        names: of all bodies
        bodies: which two touch, `body` and `other` as in `Contact`, (n, 2)
        points: (n, 3) [m]
        normals: from `other` into `body`, (n, 3)
        forces: what `other` does to `body`, (n, 3) [N]
        depths: how far the shapes overlap, (n,) [m]
    """

    time: float
    names: tuple[str, ...]
    bodies: NDArray[np.intp]
    points: Array
    normals: Array
    forces: Array
    depths: Array


@dataclass(frozen=True, eq=False)
class ProximityReading(SensorReading):
    """How far a ray goes.

    Attributes:
        distance: from the first pad to what lies between the pads, inf when nothing does [m]
        gap: from pad to pad [m]
    """

    distance: float
    gap: float


@dataclass(frozen=True, eq=False)
class ImuReading(SensorReading):
    """What an inertial measurement unit feels, in its own axes.

    Attributes:
        angular_velocity: (3,) [rad/s]
        linear_acceleration: acceleration minus gravity, (3,) [m/s^2]; at rest 9.81 upward
    """

    angular_velocity: Array
    linear_acceleration: Array


def _text(value: ArrayLike) -> str:
    """Return numbers to six decimals at most, without a sign of zero."""
    numbers = [f"{round(x, 6) + 0.0:.6g}" for x in np.ravel(value)]
    return numbers[0] if np.ndim(value) == 0 else f"({', '.join(numbers)})"


Reading = EffortReading | WrenchReading | ContactsReading | ProximityReading | ImuReading
