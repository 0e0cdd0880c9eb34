"""What an endoscope's pictures are used for."""

from trocar.apps.vision.servoing import ServoSettings, VisualServo

__all__ = ["ServoSettings", "VisualServo"]
