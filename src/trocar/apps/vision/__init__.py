"""What the endoscope's pictures are used for."""

from trocar.apps.vision.needle_tracking import JAWS, Holder, NeedleEstimate, NeedleTracker
from trocar.apps.vision.servoing import ServoSettings, VisualServo

__all__ = [
    "JAWS",
    "Holder",
    "NeedleEstimate",
    "NeedleTracker",
    "ServoSettings",
    "VisualServo",
]
