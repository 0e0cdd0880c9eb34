"""Closing hinges whose pin may shift along its own axis, so that loops with skew axes close.

Four hinges whose axes are not parallel cannot turn unless something gives. In a real linkage it
is the play along the pins; here it is a passive frame that slides along frame_a's z axis, ahead of
the point that both sides share.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trocar.descriptions.records import Body
from trocar.geometry.se3 import translation
from trocar.kinematics.mechanism import Closure, Frame

#: A pin's own mass, and what resists its slide besides, as a rotor does. Source: our own choice:
#: too little to be felt; the physics solves loops of very light bodies less well. [kg]
PIN_MASS_KG = 0.001
PIN_ROTOR_KG = 0.2
#: Inertia of a ball of 1 g and 10 mm. [kg m^2]
PIN_INERTIA = 4e-8


def pin_name(closure: str) -> str:
    """Return the name of a closure's pin."""
    return f"{closure}_pin"


def pinned(closure: Closure) -> Closure:
    """Return a closure whose side a is its pin."""
    pin = pin_name(closure.name)
    passive = (*closure.passive[:2], pin)
    return replace(closure, frame_a=pin, point_a=np.zeros(3), passive=passive)


def pin_frame(closure: Closure) -> Frame:
    """Return the frame of a closure's pin: slides along z of frame_a, from point_a."""
    at = translation(closure.point_a)
    return Frame(pin_name(closure.name), closure.frame_a, "prismatic", at, np.eye(4))


def pin_body(closure: str, part: str) -> Body:
    """Return what a pin weighs."""
    return Body(
        frame=pin_name(closure),
        mass=PIN_MASS_KG,
        com=np.zeros(3),
        inertia=PIN_INERTIA * np.eye(3),
        shapes=(),
        inertia_from="shape",
        source="our own choice: a pin too light to be felt",
        part=part,
    )
