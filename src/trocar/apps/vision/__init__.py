"""What an endoscope's pictures are used for."""

from trocar.apps.vision.instruments import TipFix, find_marker, find_tip
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
    "TipFix",
    "View",
    "VisualServo",
    "Wound",
    "find_marker",
    "find_tip",
    "find_wound",
    "overlaid",
]
