"""What is published of the rig as a whole: tf, the clock."""

from __future__ import annotations

from trocar.interfaces.crtk import say
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.figures import RigFigures
from trocar.interfaces.crtk.publishing import Figure
from trocar.interfaces.crtk.transport import Message


def tf(rig: RigFigures, stamp: Stamp) -> Message:
    """Return every arm's base in the frame of its poses, and its tip in its base."""
    found: list[Message] = []
    for rig_arm in rig.sample.rig.arms:
        arm = rig.arm(rig_arm.name)
        base, frame = arm.base
        found.append(say.transform_stamped(stamp, frame, rig_arm.name, arm.measured))
        if arm.own_frame != frame:
            found.append(say.transform_stamped(stamp, frame, arm.own_frame, base))
    return {"transforms": found}


def clock(rig: RigFigures, stamp: Stamp) -> Message:  # noqa: ARG001  as every maker
    """Return a rosgraph_msgs/Clock."""
    return {"clock": stamp}


def makers(simulated: bool) -> dict[str, Figure]:
    """Return how to make the messages of the rig; the clock's only where time is simulated."""
    return {"tf": tf, **({"clock": clock} if simulated else {})}
