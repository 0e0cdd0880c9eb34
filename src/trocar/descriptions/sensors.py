"""Sensors from TOML: what they measure, and where on an arm they stand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast, get_args

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.frames import read_pose
from trocar.descriptions.records import ArmDescription, RigArm
from trocar.descriptions.sensor_records import SensorDescription, SensorKind
from trocar.descriptions.table import Table
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]

KINDS: tuple[str, ...] = get_args(SensorKind)


@dataclass(frozen=True, eq=False)
class _Place:
    """Where a sensor of some kind stands, and how noisy it is."""

    joint: str = ""
    frame: str = ""
    pose: Array = field(default_factory=lambda: np.eye(4))
    beyond: str = ""
    to_frame: str = ""
    to_point: Array = field(default_factory=lambda: np.zeros(3))
    noise: Mapping[str, float] = field(default_factory=dict[str, float])


def read_sensors(rows: Iterable[Table], arms: Sequence[RigArm]) -> tuple[SensorDescription, ...]:
    """Return a rig's sensors.

    Raises:
        DescriptionError: an unknown kind, key or unit, a name used twice, or an arm, joint or frame
            that is not there
    """
    found: list[SensorDescription] = []
    for row in rows:
        sensor = _read_sensor(row, arms)
        if sensor.name in [other.name for other in found]:
            raise row.fail("name", f"got {sensor.name!r} a second time")
        found.append(sensor)
    return tuple(found)


def _read_sensor(row: Table, arms: Sequence[RigArm]) -> SensorDescription:
    name = row.text("name")
    if not name:
        raise row.fail("name", "got an empty text; allowed: a name")
    kind = row.text("kind", allowed=KINDS)
    source = row.text("source", "")
    rate = row.quantity("rate", "frequency", default=0.0)
    if rate <= 0.0 and row.has("rate", "frequency"):
        raise row.fail("rate_hz", f"got {rate:g}; allowed: above 0")
    owner = row.text("arm", "" if kind == "contacts" else None)
    if owner or kind != "contacts":
        _check_owned(row, "arm", owner, [a.name for a in arms], "this rig")
    arm = next((a.arm for a in arms if a.name == owner), None)
    place = _read_contacts(row, owner, arm) if arm is None else _read_place(row, kind, owner, arm)
    row.done()
    return SensorDescription(
        name,
        cast(SensorKind, kind),
        owner,
        place.joint,
        place.frame,
        place.pose,
        place.beyond,
        place.to_frame,
        place.to_point,
        rate,
        place.noise,
        source,
    )


def _read_place(row: Table, kind: str, owner: str, arm: ArmDescription) -> _Place:
    if kind == "joint_effort":
        return _read_joint_effort(row, owner, arm)
    if kind == "tip_wrench":
        return _read_tip_wrench(row, owner, arm)
    if kind == "proximity":
        return _read_proximity(row, owner, arm)
    if kind == "imu":
        frame = _frame(row, "frame", owner, arm.mechanism, None)
        noise = {
            "angular_velocity": _noise(row, "angular velocity"),
            "linear_acceleration": _noise(row, "linear acceleration"),
        }
        return _Place(frame=frame, pose=read_pose(row), noise=noise)
    return _read_contacts(row, owner, arm)


def _read_joint_effort(row: Table, owner: str, arm: ArmDescription) -> _Place:
    joint = row.text("joint")
    _check_owned(row, "joint", joint, arm.mechanism.joint_names, owner)
    turns = arm.joint(joint).kind == "revolute"
    return _Place(joint=joint, noise={"effort": _noise(row, "torque" if turns else "force")})


def _read_tip_wrench(row: Table, owner: str, arm: ArmDescription) -> _Place:
    mechanism = arm.mechanism
    frame = _frame(row, "frame", owner, mechanism, mechanism.tip)
    beyond = _frame(row, "beyond", owner, mechanism, frame)
    noise = {"force": _noise(row, "force"), "torque": _noise(row, "torque")}
    return _Place(frame=frame, pose=read_pose(row), beyond=beyond, noise=noise)


def _read_proximity(row: Table, owner: str, arm: ArmDescription) -> _Place:
    """Read a ray; between the pads of a jaw unless other frames are named."""
    mechanism = arm.mechanism
    pads = [f.name for f in mechanism.frames if "jaw" in dict(f.couplings)]
    frame = _frame(row, "frame", owner, mechanism, pads[0] if pads else None)
    other = next((pad for pad in pads if pad != frame), None)
    to_frame = _frame(row, "to_frame", owner, mechanism, other)
    pose = np.eye(4)
    pose[:3, 3] = row.vector("xyz", 3, "length")
    to_point = row.vector("to_xyz", 3, "length", default=pose[:3, 3].copy())
    noise = {"distance": _noise(row, "length")}
    return _Place(frame=frame, pose=pose, to_frame=to_frame, to_point=to_point, noise=noise)


def _read_contacts(row: Table, owner: str, arm: ArmDescription | None) -> _Place:
    frame = ""
    if "frame" in row:
        if arm is None:
            raise row.fail("frame", "needs arm = NAME, whose frame it is")
        frame = _frame(row, "frame", owner, arm.mechanism, None)
    else:
        row.text("frame", "")
    return _Place(frame=frame, noise={"force": _noise(row, "force")})


def _frame(row: Table, key: str, owner: str, mechanism: Mechanism, default: str | None) -> str:
    frame = row.text(key, default)
    _check_owned(row, key, frame, mechanism.frame_index, owner, "frame")
    return frame


def _check_owned(
    row: Table, key: str, name: str, known: Iterable[str], owner: str, what: str = ""
) -> None:
    """Refuse what an arm or a rig does not have, and list what it has."""
    if name not in known:
        missing = f"{owner} has no such {what or key}"
        raise row.fail(key, f"got {name!r}; {missing}; allowed: {', '.join(known)}")


def _noise(row: Table, dimension: str) -> float:
    """Return a standard deviation in SI, 0 when absent."""
    deviation = row.quantity("noise", dimension, default=0.0)
    if deviation < 0.0:
        raise row.fail("noise", f"got {deviation:g}; allowed: 0 or more")
    return deviation
