"""The dVRK's endoscopes: positions of their tips, and their masses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import rotation_x, rotation_z
from trocar.geometry.se3 import transform

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EndoscopeType:
    """An endoscope that an ECM holds.

    Attributes:
        name: as the dVRK spells it
        bend: direction of view against the shaft, above 0 down, below 0 up [rad]
        reach: from the ECM's last DH row along the shaft to the tip [m]
        mass: with the camera head [kg]
    """

    name: str
    bend: float
    reach: float
    mass: float

    @property
    def T_row_tip(self) -> Array:
        """Its tip in the ECM's last DH row, (4, 4): x left, y up and z ahead in the picture."""
        turn = np.round(rotation_z(-pi / 2.0)) @ rotation_x(self.bend)
        return transform(turn, np.array([0.0, 0.0, self.reach]))


#: {name: endoscope}. Source: jhu-dvrk/sawIntuitiveResearchKit@9e535e6
#: mtsIntuitiveResearchKitEndoscopeTypes.cdg (names), mtsIntuitiveResearchKitECM.cpp,
#: set_endoscope_type (tips), mtsIntuitiveResearchKit.h (masses).
ENDOSCOPES: Mapping[str, EndoscopeType] = {
    "NONE": EndoscopeType("NONE", 0.0, 0.0, 0.1),
    **{
        f"{make}_{way}": EndoscopeType(f"{make}_{way}", bend, reach, mass)
        for make, reach, mass in (
            ("Classic_SD", 0.0, 1.5),
            ("Classic_HD", 0.0, 2.5),
            ("Si_HD", 0.0, 1.8),
            ("Custom", 0.18, 0.8),
        )
        for way, bend in (("STRAIGHT", 0.0), ("UP", -pi / 6.0), ("DOWN", pi / 6.0))
    },
}
