"""Differences from the dVRK's own software that are intended."""

from __future__ import annotations

from benchmarks.genuine.compare import HANG, RESUME, UNSET

NAN = "NaN: ours is rejected; the robot's set-points become NaN, and it disables"
EFFORT = "efforts: the arm moves by its dynamics; the robot's simulation has none"
HOMED = "a new simulation: ours is enabled and homed; the robot's software starts DISABLED"
MASTER = "teleoperation: a simulated master yields to its load; the robot's simulation has none"
TOOL = "no instrument: an arm has three joints; the robot's set-points keep those of the instrument"
LINE = (
    "moves of several joints: each keeps its own limits; some of the robot's take a straight line"
)
BRAKES = "setup joints: brakes and links yield by a millimetre; the robot's simulation has no load"

#: {plan: {step or fact: reason}}. A reason is a row of docs/as-on-the-robot.md.
PURPOSE: dict[str, dict[str, str]] = {
    "psm": {
        "A32 fix": RESUME,
        "T4 emulate_tool_present false": TOOL, "T5 move_cp without tool": TOOL,
        "T5 move_jp without tool": TOOL,
        "F2 servo_jf zero": EFFORT, "F6 hold": EFFORT,
        "N1 servo_jp NaN": NAN, "N2 move_jp home": NAN, "N3 move_jp NaN": NAN,
        "N4 disable": NAN, "N5 home": NAN,
    },
    "walk-moves": {
        "44.14 move_jp jaw/servo_jp": LINE, "51.18 move_jp jaw/servo_jp jaw/move_jp": LINE,
    },
    "mtm": {
        "S0 disable": HOMED, "S1 move_jp while DISABLED": HOMED, "S2 home while DISABLED": HOMED,
        "S3 pause while DISABLED": HOMED, "P fix": HOMED, "G2 body/servo_cf 0": EFFORT,
        "G3 lock_orientation": EFFORT, "G4 unlock_orientation": EFFORT, "G6 move_jp": EFFORT,
    },
    "ecm": {
        "S0 disable": HOMED, "S1 move_jp while DISABLED": HOMED, "S2 home while DISABLED": HOMED,
        "S3 pause while DISABLED": HOMED, "P fix": HOMED,
    },
    "suj": {
        "U6 joint 0": BRAKES, "U6 joint 1": BRAKES, "U6 joint 2": BRAKES, "U7 joints": BRAKES,
    },
    "teleoperation": {
        "L0 system/power_on": HOMED, "L5 operator present": MASTER, "L6 master 2 cm x": MASTER,
        "L7 master 2 cm y": MASTER, "L10 clutch released": MASTER,
        "L12 master 2 cm z at 0.4": MASTER,
        "L14 master 2 cm back, locked": MASTER, "L16 lock_rotation": MASTER,
        "L20 operator back": MASTER, "L12 master 2 cm z at 0.4: tip": MASTER,
    },
}  # fmt: skip
#: Reasons that the comparison finds by a rule.
RULES = (HANG, RESUME, UNSET)
