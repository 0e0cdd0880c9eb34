"""Shake a slider: called before each physics step with the object and the world."""

import math

AMPLITUDE_N = 0.05
FREQUENCY_HZ = 1.3


def before_step(slider, world) -> None:
    """Push it along x."""
    force = AMPLITUDE_N * math.sin(2.0 * math.pi * FREQUENCY_HZ * world.time)
    slider.servo_cf([force, 0.0, 0.0, 0.0, 0.0, 0.0])
