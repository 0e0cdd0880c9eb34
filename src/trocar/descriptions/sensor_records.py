"""The parts that sensors of all kinds share: description, reading, and the physics they sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol, TypedDict, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.keys import key

Array = NDArray[np.float64]
#: {value of a reading: dimension of its noise, "" for none, and unit}.
Values = Mapping[str, tuple[str, str]]
#: Mask over the bodies and flexes of the model, (n_bodies + n_flexes,).
Bodies = NDArray[np.bool_]


class ReadingHead(TypedDict):
    """The arguments that every reading takes."""

    name: str
    kind: str
    time: float
    frame_id: str
    units: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class SensorReading:
    """The part of a reading that all kinds have.

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
        """Return the name and the values, such as "tip: force (0, 0, -9.88) N"."""
        values = (f"{value} {shown(getattr(self, value))} {u}" for value, u in self.units.items())
        return f"{self.name}: {', '.join(values)}"


@dataclass(frozen=True, eq=False)
class SensorDescription:
    """A sensor that a rig places. `sensors` has a class for each kind.

    Attributes:
        kind: name of the kind, as files have it
        armless: whether a sensor of this kind may be on no arm
        on_props: whether it may be on a prop instead of an arm
        reading: class of its readings
        values: numbers of these
        name: of the sensor
        arm: of this rig; `contacts` without one include everything
        prop: instead of `arm`
        rate: samples per second; 0: one per read [Hz]
        source: of the numbers
        noise: {value: standard deviation} of its noise, in SI
    """

    kind: ClassVar[str]
    armless: ClassVar[bool] = False
    on_props: ClassVar[bool] = False
    reading: ClassVar[type[SensorReading]] = SensorReading
    values: ClassVar[Values] = {}

    name: str = field(metadata=key(form="name"))
    arm: str = field(metadata=key(default=""))
    rate: float = field(metadata=key(name="rate_hz", above=0.0, default=0.0))
    source: str = field(metadata=key(default=""))
    noise: Mapping[str, float]
    prop: str = field(default="", kw_only=True, metadata=key(of=("on props",)))

    @property
    def frame_id(self) -> str:
        """The frame of its vectors."""
        return self.name

    @property
    def units(self) -> dict[str, str]:
        """{value of a reading: unit}."""
        return {value: unit for value, (_, unit) in self.values.items()}

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints of the arm that a tool must have for this sensor."""
        return ()

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames of the arm that a tool must have for this sensor."""
        return ()

    def sample(self, physics: Physics, rng: np.random.Generator) -> SensorReading:
        """Return a reading of the physics as it is now.

        Args:
            physics: the simulation
            rng: noise is drawn from it
        """
        found = {
            name: self.noisy(name, cast(ArrayLike, value), rng) if name in self.noise else value
            for name, value in self.measure(physics).items()
        }
        return self.reading(**self.head(physics), **found)

    def measure(self, physics: Physics) -> dict[str, object]:
        """Return the values of a reading without noise, by name."""
        raise NotImplementedError

    def head(self, physics: Physics) -> ReadingHead:
        """Return the arguments that every reading takes."""
        return {
            "name": self.name,
            "kind": self.kind,
            "time": physics.time,
            "frame_id": self.frame_id,
            "units": self.units,
        }

    def noisy(self, value: str, exact: ArrayLike, rng: np.random.Generator) -> Any:
        """Return a value with its normal noise; without noise nothing is drawn.

        Returns:
            a number, or a read-only array
        """
        result, deviation = np.asarray(exact, dtype=np.float64), self.noise[value]
        if deviation > 0.0:
            result = np.asarray(result + rng.normal(0.0, deviation, result.shape))
        result.setflags(write=False)
        return result if result.ndim else float(result)


@dataclass(frozen=True, eq=False)
class Contact:
    """A place where two bodies touch; vectors in the world. A flex counts as a body.

    Attributes:
        body, other: names of the bodies; `body` is the sensor's arm's where one of them is
        shape, other_shape: names of the shapes that touch; of a flex its own name
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
class Place:
    """A place on an arm's frame, or on a prop where `arm` is "": T_frame_place (4, 4)."""

    arm: str
    frame: str
    pose: Array


@dataclass(frozen=True, eq=False)
class PlaceMotion:
    """The motion of a place in the world, in the place's own axes.

    Attributes:
        linear: velocity of its origin, (3,) [m/s]
        angular: angular velocity, (3,) [rad/s]
        proper: acceleration of its origin minus gravity, (3,) [m/s^2]
    """

    linear: Array
    angular: Array
    proper: Array


class Physics(Protocol):
    """The quantities that sensors sample; `trocar.simulation.probes` computes them.

    The protocol stands here because descriptions may not import the simulation, and a kind of
    sensor is read and sampled in one place.
    """

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        ...

    def effort(self, arm: str, joint: str) -> float:
        """Return the effort of a motor on its joint [N m or N]."""
        ...

    def bodies(self, arm: str = "", frame: str = "") -> Bodies:
        """Return the bodies on a frame and beyond it, all of an arm, a prop's, or everything."""
        ...

    def contacts(self, mine: Bodies) -> tuple[Contact, ...]:
        """Return the contacts of some bodies with others or with each other."""
        ...

    def wrench(self, mine: Bodies, at: Place) -> tuple[Array, Array]:
        """Return force and torque on some bodies from outside, at a place in its axes."""
        ...

    def ray(self, start: Place, end: Place, through: Bodies) -> tuple[float, float, str]:
        """Return the distance from a place towards another to a body, and that of the places.

        Args:
            start, end: of the ray
            through: bodies that the ray passes through

        Returns:
            distance, below 0 where it reaches behind the start, inf when nothing lies between the
            places; from place to place [m]; name of the body, "" for nothing
        """
        ...

    def band(self, name: str) -> tuple[float, float]:
        """Return the length of an elastic band and its tension [m, N]."""
        ...

    def motion(self, at: Place) -> PlaceMotion:
        """Return the motion of a place in its own axes."""
        ...


def shown(value: ArrayLike) -> str:
    """Return numbers to six decimals at most, without a sign of zero."""
    numbers = [f"{round(x, 6) + 0.0:.6g}" for x in np.ravel(value)]
    return numbers[0] if np.ndim(value) == 0 else f"({', '.join(numbers)})"
