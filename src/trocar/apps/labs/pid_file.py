"""Gains from the dVRK's PID files."""

from __future__ import annotations

from collections.abc import Mapping

from trocar.apps.labs.json_file import Node
from trocar.apps.labs.records import Gains

#: Joints in the order of the file's indices. The dVRK closes a tool's loops on its four discs;
#: trocar on the joint that each moves most, with the same gains. Source: docs/simulation.md.
JOINTS = {
    "PSM": ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw"),
    "ECM": ("yaw", "pitch", "insertion", "roll"),
    "MTM": (
        *("outer_yaw", "shoulder_pitch", "elbow_pitch", "wrist_platform"),
        *("wrist_pitch", "wrist_yaw", "wrist_roll"),
    ),
}
IDLE = (
    *("pid_max_output", "p_measured_setpoint_tolerance", "p_deadband"),
    *("i_forget_rate", "i_limit", "use_disturbance_observer", "nominal_mass"),
    *("disturbance_cutoff", "position_limit_min", "position_limit_max", "effort_cut_off"),
)


def read_gains(root: Node, kind: str) -> Mapping[str, Gains]:
    """Return {joint: (P, I, D)} of a PSM, ECM or MTM.

    Raises:
        DescriptionError: another number of joints, an index twice, a gain below 0
    """
    joints, found = JOINTS[kind], dict[str, Gains]()
    rows = root.nodes("pid")
    if len(rows) != len(joints):
        raise root.fail("pid", f"has {len(rows)} entries; allowed: {len(joints)} for a {kind}")
    for row in rows:
        index = row.number("index")
        if index not in range(len(joints)) or joints[int(index)] in found:
            raise row.fail("index", f"got {index:g}; allowed: 0 to {len(joints) - 1}, each once")
        gains = (row.number("p_gain"), row.number("i_gain", 0.0), row.number("d_gain", 0.0))
        for key, gain in zip(("p_gain", "i_gain", "d_gain"), gains, strict=True):
            if gain < 0.0:
                raise row.fail(key, f"got {gain:g}; allowed: 0 or more")
        row.raw("name")
        row.raw("type")
        row.without_use(*IDLE)
        found[joints[int(index)]] = gains
    return found
