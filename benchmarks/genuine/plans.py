"""The plans that were recorded on the dVRK's own software."""

from __future__ import annotations

from dataclasses import dataclass, field

from benchmarks.genuine import psm
from benchmarks.genuine.steps import Parts
from benchmarks.genuine.walks import WALKS

#: Topics of a PSM beside those of every arm.
JAW = {"jaw/setpoint_js": "sensor_msgs/JointState"}
PSM1 = "system-PSM1_Classic_KIN_SIMULATED.json"
#: Seeds of walks that were recorded.
SEEDS = tuple(str(seed) for seed in range(6))


@dataclass(frozen=True)
class Plan:
    """A plan and the robot that it is for.

    Attributes:
        arm: name of the arm whose answers are recorded
        rig: of the simulation
        system: configuration file of the dVRK's own software
        parts: steps by the name of their part
        more: {topic: type} recorded beside those of every arm
        usual: the parts that are run unless others are named; empty: all
    """

    arm: str
    rig: str
    system: str
    parts: Parts
    more: dict[str, str] = field(default_factory=dict)
    usual: tuple[str, ...] = ()


PLANS = {
    "psm": Plan("PSM1", "psm", PSM1, psm.PARTS, JAW),
    **{name: Plan("PSM1", "psm", PSM1, parts, JAW, SEEDS) for name, parts in WALKS.items()},
}
