"""Poses of the links of a serial chain, counted as the dVRK counts them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError
from trocar.geometry.dh import modified_dh
from trocar.kinematics.forward import pose
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]

#: (alpha, theta at zero) of the rows of arms with a remote centre: yaw, pitch, insertion, roll,
#: wrist pitch, wrist yaw. Source: SAW share/kinematic/PSM.json and ECM.json.
QUARTER = np.pi / 2
ROWS = (
    (QUARTER, QUARTER),
    (-QUARTER, -QUARTER),
    (QUARTER, 0.0),
    (0.0, 0.0),
    (-QUARTER, -QUARTER),
    (-QUARTER, -QUARTER),
)
CENTRED = ("rcm_arm", "rcm_scope")


def link_pose(mechanism: Mechanism, structure: str, q: ArrayLike) -> Array:
    """Return the pose of the k-th link of the dVRK's serial chain, (4, 4).

    The paper's linkage and instrument have other axes than the dVRK's table of a PSM or an ECM, so
    its rows give the axes, and the origins are frames of the mechanism (yaw and pitch turn
    about the remote centre). The frames of other arms are those of the table already.

    Args:
        mechanism: the arm, its joints in the chain's order
        structure: how it is built, as its description has it
        q: positions of the first k joints [rad or m]; none gives the reference frame

    Raises:
        InputError: no vector of finite numbers, or more of them than there are joints
    """
    given = np.asarray(q, dtype=np.float64)
    names = mechanism.joint_names
    most = len(ROWS) if structure in CENTRED else len(names)
    if given.ndim != 1 or len(given) > min(most, len(names)) or not np.isfinite(given).all():
        raise InputError(
            f"{mechanism.name}: got joint positions of shape {given.shape}; allowed: up to "
            f"{min(most, len(names))} finite numbers, for {', '.join(names[:most])}"
        )
    count = len(given)
    if count == 0:
        return np.eye(4)
    whole = np.zeros(len(names))
    whole[:count] = given
    if structure not in CENTRED:
        return pose(mechanism, whole, names[count - 1])
    found = np.eye(4)
    for k, (alpha, zero) in enumerate(ROWS[:count]):
        slides = mechanism.joints[k].kind == "prismatic"
        found = found @ modified_dh(0.0, alpha, 0.0, zero + (0.0 if slides else given[k]))
    if count > 2:
        found[:3, 3] = pose(mechanism, whole, names[count - 1])[:3, 3]
    return found
