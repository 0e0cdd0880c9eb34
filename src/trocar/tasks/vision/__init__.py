"""Vision: needles, instruments, wounds and objects in an endoscope's images, and overlays."""

from trocar.tasks.vision.instruments import TipFix, find_marker, find_tip
from trocar.tasks.vision.needle_tracking import JAWS, Holder, NeedleEstimate, NeedleTracker
from trocar.tasks.vision.overlay import View, overlaid
from trocar.tasks.vision.servoing import ServoSettings, VisualServo
from trocar.tasks.vision.wound import Wound, find_wound

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
