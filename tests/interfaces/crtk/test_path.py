"""How far a set-point is from the socket to the inbox."""

from __future__ import annotations

import sys

from trocar.interfaces.crtk.messages import from_json

from .asking import HOME, joints, stamped
from .served import Served

SENT = stamped(joints(*HOME), (0, 0)) | {"header": {"stamp": {"secs": 0, "nsecs": 0}}}


def test_a_set_point_takes_few_calls_from_json_to_the_inbox() -> None:
    """Of at most 25 in all; reading the request and finding its topic takes a transport six."""
    served = Served(wanted=())

    def take() -> None:
        served.core.receive("PSM1/servo_jp", from_json("sensor_msgs/JointState", SENT), "peer")

    take()
    served.run()
    called: list[str] = []
    before = sys.getprofile()
    sys.setprofile(
        lambda frame, event, _: called.append(frame.f_code.co_name) if event == "call" else None
    )
    try:
        take()
    finally:
        sys.setprofile(before)
    assert len(called) - 1 <= 16, called
    served.run()
    assert served.world.arm("PSM1").setpoint_js().position.tolist() == HOME
