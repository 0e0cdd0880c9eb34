"""Differences from the dVRK's own software that are intended."""

from __future__ import annotations

#: {plan: {step or fact: reason}}; docs/as-on-the-robot.md has the same rows.
PURPOSE: dict[str, dict[str, str]] = {
    "psm": {
        "N1 servo_jp NaN": "NaN is rejected; the robot's set-points become NaN, and it disables",
    },
}
