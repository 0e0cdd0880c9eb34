"""The rows of teleoperation, in the form of `arm_rows`; names are whole.

They are marked `later` until something serves them: see `component`.
"""

from __future__ import annotations

from collections.abc import Sequence

from trocar.descriptions.teleop_records import TeleopDescription
from trocar.interfaces.crtk.arm_rows import BOOL, COMMAND, FLOAT, JOY, STRING, Row

CONSOLE: tuple[Row, ...] = (
    ("sub later", "console/teleop/enable", BOOL, "", "switch teleoperation"),
    ("pub latched later", "console/teleop/enabled", BOOL, "", "whether it is on"),
    ("sub later", "console/teleop/select", STRING, "", "a component to use"),
    ("sub later", "console/teleop/unselect", STRING, "", "a component not to use"),
    ("pub later", "console/teleop/selected", STRING, "", "a component that was selected"),
    ("pub later", "console/teleop/unselected", STRING, "", "a component that was unselected"),
    ("sub later", "console/teleop/set_scale", FLOAT, "", "motion of instruments per masters'"),
    ("pub latched later", "console/teleop/scale", FLOAT, "", "motion of instruments per masters'"),
)

#: Of a component that moves an instrument or the endoscope by masters.
EVERY: tuple[Row, ...] = (
    ("sub later", "state_command", COMMAND, "", "enable, disable, align_mtm"),
    ("pub latched later", "current_state", STRING, "", "where the component is"),
    ("pub latched later", "desired_state", STRING, "", "where it is to go"),
    ("pub latched later", "following", BOOL, "", "whether the instrument follows"),
    ("pub latched later", "scale", FLOAT, "", "motion of the instrument per master's"),
    ("sub later", "set_scale", FLOAT, "", "motion of the instrument per master's"),
    ("pub later", "error", STRING, "", "why the component is DISABLED"),
    ("pub later", "warning", STRING, "", "what keeps it from following"),
    ("pub later", "status", STRING, "", "what else happened"),
)

#: Of one that moves an instrument.
TOOL: tuple[Row, ...] = (
    ("sub later", "lock_rotation", BOOL, "", "keep the instrument's orientation"),
    ("sub later", "lock_translation", BOOL, "", "keep the instrument's position"),
    ("sub later", "set_align_MTM", BOOL, "", "whether the master is aligned first"),
    ("pub latched later", "rotation_locked", JOY, "", "whether the orientation is kept"),
    ("pub latched later", "translation_locked", JOY, "", "whether the position is kept"),
    ("pub latched later", "align_mtm", BOOL, "", "whether the master is aligned first"),
    (
        "pub state later",
        "alignment_offset",
        "geometry_msgs/QuaternionStamped",
        "xyzw",
        "master to tip",
    ),
)


def topics_of(teleops: Sequence[TeleopDescription]) -> tuple[Row, ...]:
    """Return the rows of components, and of the console that switches them."""
    rows = CONSOLE
    for says in teleops:
        own = EVERY + TOOL if says.kind == "psm" else EVERY
        rows += tuple((m, f"{says.name}/{name}", kind, u, text) for m, name, kind, u, text in own)
    return rows
