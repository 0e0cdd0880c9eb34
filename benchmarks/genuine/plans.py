"""The plans that were recorded on the dVRK's own software."""

from __future__ import annotations

from dataclasses import dataclass, field

from benchmarks.genuine import arms, cart, psm, teleoperation
from benchmarks.genuine.steps import Parts
from benchmarks.genuine.walks import WALKS

#: Topics of a PSM beside those of every arm.
JAW = {"jaw/setpoint_js": "sensor_msgs/JointState"}
PSM1 = "system-PSM1_Classic_KIN_SIMULATED.json"
#: Topics of a master beside those of every arm.
MASTER = {"orientation_locked": "std_msgs/Bool", "gripper/closed": "std_msgs/Bool"}
FULL = "system-full-system-simulated.json"
#: Seeds of walks that were recorded; those from 20 on are of unseen ones that parted first.
SEEDS = {
    "walk-states": ("0", "1", "2", "3", "20", "21", "23", "27"),
    "walk-moves": ("0", "1", "2", "3", "4", "5", "26", "43", "44", "51", "52"),
    "walk-poses": ("0", "1", "2", "3", "4", "5", "23", "26"),
}


@dataclass(frozen=True)
class Plan:
    """A plan and the robot that it is for.

    Attributes:
        arm: name of the arm whose answers are recorded
        rig: of the simulation; empty: kinematics alone are in trocar, and a test compares them
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
    "mtm": Plan("MTMR", "mtm", "system-MTMR_Classic_KIN_SIMULATED.json", arms.MTM, MASTER),
    "ecm": Plan("ECM", "ecm", "system-ECM_Classic_KIN_SIMULATED.json", arms.ECM),
    "psm-si": Plan("PSM1", "", "system-PSM1_Si_KIN_SIMULATED.json", arms.KINEMATICS),
    "cart-si": Plan("PSM1", "", "system-patient-cart-Si-simulated.json", cart.CART, cart.TOPICS),
    "suj": Plan("SUJ/PSM1", "full_cart_mtm", FULL, arms.SUJ),
    "teleoperation": Plan("PSM1", "full_cart_mtm", FULL, teleoperation.PARTS, teleoperation.TOPICS),
    **{name: Plan("PSM1", "psm", PSM1, parts, JAW, SEEDS[name]) for name, parts in WALKS.items()},
}
