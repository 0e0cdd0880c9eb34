"""What a rig says of a sensor: a frozen record in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SensorKind = Literal["joint_effort", "tip_wrench", "contacts", "proximity", "imu"]


@dataclass(frozen=True, eq=False)
class SensorDescription:
    """A sensor that a rig places.

    Attributes:
        name: what readings are asked for by
        kind: what it measures
        arm: name of the arm it is on, "" for contacts of the whole rig
        joint: of a joint_effort, else ""
        frame: the frame of the arm that it stands on, "" where it stands on none
        pose: T_frame_sensor (4, 4)
        beyond: of a tip_wrench: the frame that, with all that hangs on it, is pushed
        to_frame, to_point: of a proximity: where its ray ends, (3,) [m]
        rate: samples per second, 0 for one each time that it is read [Hz]
        noise: {value: standard deviation} of its noise, in SI
        source: where the numbers are from
    """

    name: str
    kind: SensorKind
    arm: str
    joint: str
    frame: str
    pose: Array
    beyond: str
    to_frame: str
    to_point: Array
    rate: float
    noise: Mapping[str, float]
    source: str
