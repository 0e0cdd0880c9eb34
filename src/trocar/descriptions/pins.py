"""Closing hinges whose pin may shift along its own axis, so that loops with skew axes close.

Four hinges whose axes are not parallel cannot turn unless something gives. In a real linkage it
is the play along the pins; here it is a passive frame, the pin, that slides along frame_b's z axis
from point_b and carries the point that both sides share.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trocar.descriptions.records import Body
from trocar.geometry.se3 import translation
from trocar.kinematics.mechanism import Closure, Frame

#: A pin's own mass, and what resists its slide besides, as a rotor does [kg]. Source: measured on a
#: PSM and an ECM with skew axes under 10 N: with 0.2 kg loops gape by half as much again, with 5 kg
#: as little; a pin slides by parts of a millimetre, so neither is felt.
PIN_MASS_KG = 0.001
PIN_ROTOR_KG = 1.0
#: Inertia of a ball of 1 g and 10 mm. [kg m^2]
PIN_INERTIA = 4e-8


def pin_name(closure: str) -> str:
    """Return the name of a closure's pin."""
    return f"{closure}_pin"


def pinned(closure: Closure) -> Closure:
    """Return a closure whose side b is its pin."""
    pin = pin_name(closure.name)
    passive = (*closure.passive[:2], pin)
    return replace(closure, frame_b=pin, point_b=np.zeros(3), passive=passive)


def pin_frame(closure: Closure) -> Frame:
    """Return the frame of a closure's pin: slides along z of frame_b, from point_b."""
    at = translation(closure.point_b)
    return Frame(pin_name(closure.name), closure.frame_b, "prismatic", at, np.eye(4))


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
