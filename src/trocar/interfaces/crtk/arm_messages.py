"""Which message each topic of an arm carries, made from its figures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trocar.interfaces.crtk import say
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.transport import Message
from trocar.simulation.readout import ArmReadout

#: None: there is nothing to tell, as of the jaw of an arm whose tool has none.
Maker = Callable[[ArmReadout, Stamp], Message | None]


def _measured_js(arm: ArmReadout, stamp: Stamp) -> Message:
    s, own = arm.sample, arm.own
    return say.joints(stamp, arm.names[own], s.q[own], s.qd[own], s.effort[own])


def _setpoint_js(arm: ArmReadout, stamp: Stamp) -> Message:
    s, own = arm.sample, arm.own
    return say.joints(stamp, arm.names[own], s.told_q[own], s.told_qd[own], s.told_effort[own])


def _end_measured_js(arm: ArmReadout, stamp: Stamp) -> Message | None:
    s = arm.sample
    if arm.own.stop == len(arm.names):
        return None
    return say.joints(stamp, arm.names[-1:], s.q[-1:], s.qd[-1:], s.effort[-1:])


def _end_setpoint_js(arm: ArmReadout, stamp: Stamp) -> Message | None:
    s = arm.sample
    if arm.own.stop == len(arm.names):
        return None
    return say.joints(stamp, arm.names[-1:], s.told_q[-1:], s.told_qd[-1:], s.told_effort[-1:])


def _gravity(arm: ArmReadout, stamp: Stamp) -> Message:
    s, own = arm.sample, arm.own
    load = s.load[own] if s.balanced else np.zeros(own.stop)
    return say.joints(stamp, arm.names[own], np.zeros(0), np.zeros(0), load)


def _measured_cp(arm: ArmReadout, stamp: Stamp) -> Message:
    return say.row_stamped(stamp, arm.base_frame, arm.tip_row(setpoint=False, local=False))


def _setpoint_cp(arm: ArmReadout, stamp: Stamp) -> Message:
    return say.row_stamped(stamp, arm.base_frame, arm.tip_row(setpoint=True, local=False))


def _local_measured_cp(arm: ArmReadout, stamp: Stamp) -> Message:
    return say.row_stamped(stamp, arm.own_frame, arm.tip_row(setpoint=False, local=True))


def _local_setpoint_cp(arm: ArmReadout, stamp: Stamp) -> Message:
    return say.row_stamped(stamp, arm.own_frame, arm.tip_row(setpoint=True, local=True))


def _measured_cv(arm: ArmReadout, stamp: Stamp) -> Message:
    return say.twist_stamped(stamp, arm.base_frame, arm.twist(local=False))


def _local_measured_cv(arm: ArmReadout, stamp: Stamp) -> Message:
    return say.twist_stamped(stamp, arm.own_frame, arm.twist(local=True))


def _body_cf(arm: ArmReadout, stamp: Stamp) -> Message:
    return say.wrench_stamped(stamp, arm.name, arm.wrench("body"))


def _spatial_cf(arm: ArmReadout, stamp: Stamp) -> Message:
    return say.wrench_stamped(stamp, arm.own_frame, arm.wrench("spatial"))


def _body_jacobian(arm: ArmReadout, stamp: Stamp) -> Message:  # noqa: ARG001  as every maker
    return say.matrix(arm.jacobian("body"))


def _spatial_jacobian(arm: ArmReadout, stamp: Stamp) -> Message:  # noqa: ARG001  as every maker
    return say.matrix(arm.jacobian("spatial"))


#: {topic without the arm: how to make it}.
MAKERS: dict[str, Maker] = {
    "measured_js": _measured_js,
    "setpoint_js": _setpoint_js,
    "gravity_compensation/setpoint_js": _gravity,
    "measured_cp": _measured_cp,
    "setpoint_cp": _setpoint_cp,
    "local/measured_cp": _local_measured_cp,
    "local/setpoint_cp": _local_setpoint_cp,
    "measured_cv": _measured_cv,
    "local/measured_cv": _local_measured_cv,
    "body/measured_cf": _body_cf,
    "spatial/measured_cf": _spatial_cf,
    "body/jacobian": _body_jacobian,
    "spatial/jacobian": _spatial_jacobian,
    "jaw/measured_js": _end_measured_js,
    "jaw/setpoint_js": _end_setpoint_js,
    "gripper/measured_js": _end_measured_js,
    "potentiometers/measured_js": _measured_js,
}
