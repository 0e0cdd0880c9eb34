"""The kinds of sensors: for each its keys in a rig's file, its reading, and how it is sampled.

`KINDS` at the end is the registry. docs/extending.md shows how to add a kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.frames import read_pose
from trocar.descriptions.keys import key
from trocar.descriptions.records import ArmDescription, Band, Prop, RigArm
from trocar.descriptions.sensor_records import (
    Contact,
    Physics,
    Place,
    SensorDescription,
    SensorReading,
    Values,
    shown,
)
from trocar.descriptions.table import Table
from trocar.geometry.se3 import translation
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]


class SensorTable:
    """A `[[sensor]]` table and the arm or prop that its sensor is on.

    Args:
        table: the table
        arms, props, bands: of the rig
        kind: of the sensor: whether it may be on no arm, and on a prop

    Attributes:
        table: the table
        head: the arguments that every sensor takes, noise apart

    Raises:
        DescriptionError: no name, no such arm or prop, or a rate that is not above 0
    """

    def __init__(
        self,
        table: Table,
        arms: Sequence[RigArm],
        props: Sequence[Prop],
        bands: Sequence[Band],
        kind: type[SensorDescription],
    ) -> None:
        self.table = table
        self.head = table.values(SensorDescription, "on props" if kind.on_props else "")
        prop, owner = self.head.get("prop", ""), self.head["arm"]
        if not owner and not (kind.armless or prop):
            owner = table.text("arm")
        self._bands = [band.name for band in bands]
        if prop:
            if owner:
                raise table.fail("prop", f"contradicts arm = {owner!r}; give one of them")
            table.known("prop", prop, [p.name for p in props], "this rig has no such prop")
        elif owner or not kind.armless:
            table.known("arm", owner, [a.name for a in arms], "this rig has no such arm")
        self._arm = next((a.arm for a in arms if a.name == owner), None)

    def arm(self, key: str) -> ArmDescription:
        """Return the arm, which a key refers to."""
        if self._arm is None:
            raise self.table.fail(key, f"needs arm = NAME, whose {key} it is")
        return self._arm

    def mechanism(self, key: str) -> Mechanism:
        """Return the arm's mechanism, which a key refers to."""
        return self.arm(key).mechanism

    def joint(self, key: str) -> str:
        """Return the name of a joint of the arm."""
        known, joint = self.mechanism(key).joint_names, self.table.text(key)
        return self.table.known(key, joint, known, f"{self.head['arm']} has no such joint")

    def frame(self, key: str, default: str | None = None) -> str:
        """Return the name of a frame of the arm, or the prop that the sensor is on."""
        if self.head.get("prop"):
            return self.head["prop"]
        known, frame = self.mechanism(key).frame_index, self.table.text(key, default)
        return self.table.known(key, frame, known, f"{self.head['arm']} has no such frame")

    def band(self, key: str) -> str:
        """Return the name of an elastic band of the rig."""
        return self.table.known(key, self.table.text(key), self._bands, "this rig has no such band")

    def noise(self, dimension: str) -> float:
        """Return a standard deviation in SI, 0 when absent."""
        return self.table.not_negative("noise", dimension)

    def noises(self, kind: type[SensorDescription]) -> dict[str, float]:
        """Return the standard deviation of each value of a kind that has noise, in SI."""
        return {value: self.noise(d) for value, (d, _) in kind.values.items() if d}


# ------------------------------------------------------------------ joint_effort


@dataclass(frozen=True, eq=False)
class EffortReading(SensorReading):
    """The effort of a motor on its joint [N m or N]."""

    effort: float


@dataclass(frozen=True, eq=False)
class JointEffort(SensorDescription):
    """The effort of a motor.

    Attributes:
        joint: of the arm
        unit: of its effort, "N m" or "N"
    """

    kind: ClassVar[str] = "joint_effort"
    reading: ClassVar[type[SensorReading]] = EffortReading

    joint: str = field(metadata=key())
    unit: str

    @classmethod
    def read(cls, row: SensorTable) -> JointEffort:
        """Return the sensor of a table."""
        joint = row.joint("joint")
        turns = row.arm("joint").joint(joint).kind == "revolute"
        noise = {"effort": row.noise("torque" if turns else "force")}
        return cls(**row.head, noise=noise, joint=joint, unit="N m" if turns else "N")

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints of the arm that a tool must have for this sensor."""
        return (self.joint,)

    @property
    def frame_id(self) -> str:
        """The frame of its vectors."""
        return f"{self.arm}/{self.joint}"

    @property
    def units(self) -> dict[str, str]:
        """{value of a reading: unit}."""
        return {"effort": self.unit}

    def measure(self, physics: Physics) -> dict[str, object]:
        """Return the effort now."""
        return {"effort": physics.effort(self.arm, self.joint)}


# ------------------------------------------------------------------ on a frame


@dataclass(frozen=True, eq=False)
class PlacedSensor(SensorDescription):
    """A sensor at a place on a link of an arm, or on a prop.

    Attributes:
        frame: that carries it; default: of a `tip_wrench` the tip, of a `proximity` the jaw's first
            finger
        pose: T_frame_sensor (4, 4)
    """

    on_props: ClassVar[bool] = True

    frame: str = field(metadata=key(default=""))
    pose: Array

    @classmethod
    def read(cls, row: SensorTable) -> PlacedSensor:
        """Return the sensor of a table."""
        frame = row.frame("frame")
        return cls(**row.head, noise=row.noises(cls), frame=frame, pose=read_pose(row.table))

    @property
    def place(self) -> Place:
        """Its place on the arm or prop, with its pose there."""
        return Place(self.arm, self.frame, self.pose)

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames of the arm that a tool must have for this sensor."""
        return (self.frame,) if self.arm else ()


@dataclass(frozen=True, eq=False)
class WrenchReading(SensorReading):
    """The wrench of the environment on an instrument, at the sensor's origin in its axes.

    Attributes:
        force: (3,) [N]
        torque: about the sensor's origin, (3,) [N m]
    """

    force: Array
    torque: Array


@dataclass(frozen=True, eq=False)
class TipWrench(PlacedSensor):
    """The wrench that the environment exerts on an instrument.

    Attributes:
        beyond: frame whose loads, with its descendants', count
    """

    kind: ClassVar[str] = "tip_wrench"
    on_props: ClassVar[bool] = False
    reading: ClassVar[type[SensorReading]] = WrenchReading
    values: ClassVar[Values] = {"force": ("force", "N"), "torque": ("torque", "N m")}

    beyond: str = field(metadata=key(like="frame"))

    @classmethod
    def read(cls, row: SensorTable) -> TipWrench:
        """Return the sensor of a table."""
        frame = row.frame("frame", row.mechanism("frame").tip)
        beyond, at = row.frame("beyond", frame), read_pose(row.table)
        return cls(**row.head, noise=row.noises(cls), frame=frame, pose=at, beyond=beyond)

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames of the arm that a tool must have for this sensor."""
        return (self.frame, self.beyond)

    def measure(self, physics: Physics) -> dict[str, object]:
        """Return the wrench of the last physics step."""
        force, torque = physics.wrench(physics.bodies(self.arm, self.beyond), self.place)
        return {"force": force, "torque": torque}


@dataclass(frozen=True, eq=False)
class ImuReading(SensorReading):
    """The measurement of an inertial measurement unit, in its own axes.

    Attributes:
        angular_velocity: (3,) [rad/s]
        linear_acceleration: acceleration minus gravity, (3,) [m/s^2]; at rest 9.81 upward
    """

    angular_velocity: Array
    linear_acceleration: Array


@dataclass(frozen=True, eq=False)
class Imu(PlacedSensor):
    """An inertial measurement unit on a link."""

    kind: ClassVar[str] = "imu"
    reading: ClassVar[type[SensorReading]] = ImuReading
    values: ClassVar[Values] = {
        "angular_velocity": ("angular velocity", "rad/s"),
        "linear_acceleration": ("linear acceleration", "m/s^2"),
    }

    def measure(self, physics: Physics) -> dict[str, object]:
        """Return the velocity now and the acceleration of the last physics step."""
        motion = physics.motion(self.place)
        return {"angular_velocity": motion.angular, "linear_acceleration": motion.proper}


@dataclass(frozen=True, eq=False)
class TwistReading(SensorReading):
    """The velocity of a place on a link in the world, in the sensor's own axes.

    Attributes:
        linear: of the sensor's origin, (3,) [m/s]
        angular: (3,) [rad/s]
    """

    linear: Array
    angular: Array


@dataclass(frozen=True, eq=False)
class TwistSensor(PlacedSensor):
    """The velocity of a place on a link."""

    kind: ClassVar[str] = "twist"
    reading: ClassVar[type[SensorReading]] = TwistReading
    values: ClassVar[Values] = {
        "linear": ("linear velocity", "m/s"),
        "angular": ("angular velocity", "rad/s"),
    }

    def measure(self, physics: Physics) -> dict[str, object]:
        """Return the velocity now."""
        motion = physics.motion(self.place)
        return {"linear": motion.linear, "angular": motion.angular}


@dataclass(frozen=True, eq=False)
class ProximityReading(SensorReading):
    """The length of a ray.

    Attributes:
        distance: from the first pad to what lies between the pads, inf when nothing does [m]
        gap: from pad to pad [m]
        body: what lies there, "" for nothing
    """

    distance: float
    gap: float
    body: str


@dataclass(frozen=True, eq=False)
class Proximity(PlacedSensor):
    """A ray from one frame to another, such as between the pads of a jaw, or across a prop.

    Attributes:
        pose: start of the ray
        to_frame, to_point: end of the ray; default: the other finger, the point of its start,
            (3,) [m]
    """

    kind: ClassVar[str] = "proximity"
    reading: ClassVar[type[SensorReading]] = ProximityReading
    values: ClassVar[Values] = {"distance": ("length", "m"), "gap": ("", "m")}

    to_frame: str = field(metadata=key(default=""))
    to_point: Array = field(metadata=key("length", name="to_xyz", size=3, default=""))

    @classmethod
    def read(cls, row: SensorTable) -> Proximity:
        """Return the sensor of a table; between the pads of a jaw unless frames are named."""
        on_prop, pads = bool(row.head.get("prop")), list[str]()
        if not on_prop:
            pads = [f.name for f in row.mechanism("frame").frames if "jaw" in dict(f.couplings)]
        frame = row.frame("frame", pads[0] if pads else None)
        to_frame = row.frame("to_frame", next((pad for pad in pads if pad != frame), None))
        start = row.table.vector("xyz", 3, "length")
        end = row.table.vector("to_xyz", 3, "length", default=None if on_prop else start.copy())
        return cls(**row.head, noise=row.noises(cls), frame=frame,
                   pose=translation(start), to_frame=to_frame, to_point=end)  # fmt: skip

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames of the arm that a tool must have for this sensor."""
        return (self.frame, self.to_frame) if self.arm else ()

    def measure(self, physics: Physics) -> dict[str, object]:
        """Return the distance now."""
        end = Place(self.arm, self.to_frame, translation(self.to_point))
        own = physics.bodies(self.arm, "" if self.arm else self.frame)
        distance, gap, body = physics.ray(self.place, end, own)
        return {"distance": distance, "gap": gap, "body": body}

    def sample(self, physics: Physics, rng: np.random.Generator) -> ProximityReading:
        """Return a reading, whose noise makes no distance negative."""
        reading = cast(ProximityReading, super().sample(physics, rng))
        return replace(reading, distance=max(0.0, reading.distance))


# ------------------------------------------------------------------ contacts


@dataclass(frozen=True, eq=False)
class ContactsReading(SensorReading):
    """Every place where the sensor's bodies touch others."""

    contacts: tuple[Contact, ...]

    def __str__(self) -> str:
        """Return the bodies that touch and their forces."""
        pairs = (f"{c.body} on {c.other}: {shown(c.force)} N" for c in self.contacts)
        return f"{self.name}: {', '.join(pairs) or 'nothing'}"


@dataclass(frozen=True, eq=False)
class Contacts(SensorDescription):
    """The contacts of an arm, of a frame and what hangs on it, of a prop, or of everything.

    Attributes:
        frame: whose bodies, with its descendants', count; default: the whole arm
    """

    kind: ClassVar[str] = "contacts"
    armless: ClassVar[bool] = True
    on_props: ClassVar[bool] = True
    values: ClassVar[Values] = {
        "point": ("", "m"),
        "normal": ("", "1"),
        "force": ("force", "N"),
        "torque": ("", "N m"),
        "depth": ("", "m"),
    }

    frame: str = field(metadata=key(default=""))

    @classmethod
    def read(cls, row: SensorTable) -> Contacts:
        """Return the sensor of a table."""
        given = row.table.raw("frame") is not None or bool(row.head.get("prop"))
        frame = row.frame("frame") if given else ""
        return cls(**row.head, noise=row.noises(cls), frame=frame)

    @property
    def frame_id(self) -> str:
        """The frame of its vectors."""
        return "world"

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames of the arm that a tool must have for this sensor."""
        return (self.frame,) if self.arm and self.frame else ()

    def sample(self, physics: Physics, rng: np.random.Generator) -> ContactsReading:
        """Return the contacts of the last physics step."""
        found = physics.contacts(physics.bodies(self.arm, self.frame))
        contacts = (replace(one, force=self.noisy("force", one.force, rng)) for one in found)
        return ContactsReading(**self.head(physics), contacts=tuple(contacts))


#: All contacts of a rig, without noise.
ALL_CONTACTS = Contacts("contacts", "", 0.0, "", {"force": 0.0}, "")


# ------------------------------------------------------------------ tension


@dataclass(frozen=True, eq=False)
class TensionReading(SensorReading):
    """The state of an elastic band.

    Attributes:
        length: through all its points [m]
        tension: 0 while it is slack, its damping apart [N]
    """

    length: float
    tension: float


@dataclass(frozen=True, eq=False)
class Tension(SensorDescription):
    """The tension of an elastic band.

    Attributes:
        band: of the rig
    """

    kind: ClassVar[str] = "tension"
    armless: ClassVar[bool] = True
    reading: ClassVar[type[SensorReading]] = TensionReading
    values: ClassVar[Values] = {"length": ("length", "m"), "tension": ("force", "N")}

    band: str = field(metadata=key())

    @classmethod
    def read(cls, row: SensorTable) -> Tension:
        """Return the sensor of a table."""
        if arm := row.head["arm"]:
            raise row.table.fail("arm", f"got {arm!r}; allowed: none, a band has no arm")
        return cls(**row.head, noise=row.noises(cls), band=row.band("band"))

    @property
    def frame_id(self) -> str:
        """The frame of its vectors."""
        return self.band

    def measure(self, physics: Physics) -> dict[str, object]:
        """Return length and tension now."""
        length, tension = physics.band(self.band)
        return {"length": length, "tension": tension}


# ------------------------------------------------------------------ all of them

_CLASSES = (JointEffort, TipWrench, Contacts, Proximity, Imu, TwistSensor, Tension)
#: {kind: its class}, in the order in which errors list them.
KINDS = {kind.kind: kind for kind in _CLASSES}


def read_sensors(
    rig: Table,
    arms: Sequence[RigArm],
    props: Sequence[Prop] = (),
    bands: Sequence[Band] = (),
) -> tuple[SensorDescription, ...]:
    """Return a rig's sensors.

    Raises:
        DescriptionError: an unknown kind, key or unit, a name used twice, or an arm, joint or frame
            that is not there
    """

    def read(table: Table) -> SensorDescription:
        kind = KINDS[table.text("kind", allowed=tuple(KINDS))]
        return kind.read(SensorTable(table, arms, props, bands, kind))

    return rig.each("sensor", read, again="name")
