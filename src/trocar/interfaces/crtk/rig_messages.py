"""What is published of the rig as a whole: tf, the clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import DISPLAY
from trocar.interfaces.crtk import say
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.figures import RigFigures
from trocar.interfaces.crtk.publishing import Figure
from trocar.interfaces.crtk.transport import Message

Array = NDArray[np.float64]


#: The root of tf. Source: that of the URDF that is exported.
WORLD = "world"


def tf(rig: RigFigures, stamp: Stamp) -> Message:
    """Return every arm's base and tip in the frame of its poses, and in the world what else is."""
    found: dict[str, Message] = {}

    def add(parent: str, child: str, T: Array) -> None:
        if child not in found and child != parent:
            found[child] = say.transform_stamped(stamp, parent, child, T)

    display = rig.sample.rig.display
    if display is not None:
        add(WORLD, DISPLAY, display)
    for rig_arm in rig.sample.rig.arms:
        arm = rig.arm(rig_arm.name)
        base, frame = arm.base
        if frame == arm.own_frame:
            add(WORLD, frame, arm.reference_in_world)
        add(frame, arm.own_frame, base)
        add(frame, rig_arm.name, arm.measured)
    return {"transforms": list(found.values())}


def clock(rig: RigFigures, stamp: Stamp) -> Message:  # noqa: ARG001  as every maker
    """Return a rosgraph_msgs/Clock."""
    return {"clock": stamp}


def makers(simulated: bool) -> dict[str, Figure]:
    """Return how to make the messages of the rig; the clock's only where time is simulated."""
    return {"tf": tf, **({"clock": clock} if simulated else {})}
