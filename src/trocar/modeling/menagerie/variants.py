"""The files that one robot becomes: same bodies, other servos or another integrator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from trocar.modeling.options import STIFF_PERIODS

#: Time constant of loops in MJX, in physics periods. Source: MuJoCo raises it to two periods by
#: itself under every integrator but `discrete` (flag refsafe); written so that a reader sees it.
SAFE_PERIODS = 2.0


@dataclass(frozen=True)
class Variant:
    """One of the files.

    Attributes:
        suffix: of its name
        title: what it is for
        servo: "position": `ctrl` is the joints' positions, and bodies weigh nothing; "pid": `ctrl`
            is position, velocity and fed-forward effort of each joint, bodies have their weight and
            setup joints their brakes
        integrator, cone: MuJoCo's
        loop_periods: time constant of loops, in physics periods
        minimum: the oldest MuJoCo that it is tested with
    """

    suffix: str
    title: str
    servo: Literal["position", "pid"]
    integrator: str
    cone: str
    loop_periods: float
    minimum: str


#: Source of the oldest versions: the changelog of MuJoCo (`discrete`: 3.13.0, `pid`: 3.12.0), and
#: 60 s of random control with each (docs/exports.md).
POSITION = Variant(
    "", "servos that take joint positions", "position", "discrete", "elliptic", STIFF_PERIODS,
    "3.13.0",
)  # fmt: skip
PID = Variant(
    "_pid", "servos as the simulation of trocar has them", "pid", "discrete", "elliptic",
    STIFF_PERIODS, "3.13.0",
)  # fmt: skip
MJX = Variant(
    "_mjx", "what MJX (JAX) supports", "position", "implicitfast", "pyramidal", SAFE_PERIODS,
    "3.8.0",
)  # fmt: skip
VARIANTS = (POSITION, PID, MJX)
