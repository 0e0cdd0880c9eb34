"""What an endoscope's pictures are used for."""

from trocar.apps.vision.needle_tracking import JAWS, Holder, NeedleEstimate, NeedleTracker
from trocar.apps.vision.overlay import View, overlaid
from trocar.apps.vision.servoing import ServoSettings, VisualServo
from trocar.apps.vision.wound import Wound, find_wound

__all__ = [
    "JAWS",
    "Holder",
    "NeedleEstimate",
    "NeedleTracker",
    "ServoSettings",
    "View",
    "VisualServo",
    "Wound",
    "find_wound",
    "overlaid",
]
