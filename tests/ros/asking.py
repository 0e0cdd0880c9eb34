"""Messages as clients send them, for tests."""

from __future__ import annotations

import numpy as np

HOME = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]
NEAR = [0.1, 0.1, 0.12, 0.0, 0.1, 0.1]


def state(command: str) -> dict:
    return {"string": command}


def joints(*position: float, name=(), velocity=(), effort=()) -> dict:
    return {
        "name": list(name),
        "position": list(position),
        "velocity": list(velocity),
        "effort": list(effort),
    }


def stamped(message: dict, stamp: tuple[int, int], frame_id: str = "") -> dict:
    return {"header": {"stamp": stamp, "frame_id": frame_id}, **message}


def xyz(x: float, y: float, z: float) -> dict:
    return {"x": x, "y": y, "z": z}


def quaternion(x: float = 0.0, y: float = 0.0, z: float = 0.0, w: float = 1.0) -> dict:
    return {"x": x, "y": y, "z": z, "w": w}


def pose(position: dict, orientation: dict | None = None, frame_id: str = "") -> dict:
    inner = {"position": position, "orientation": orientation or quaternion()}
    return stamped({"pose": inner}, (0, 0), frame_id)


def wrench(force: dict, torque: dict | None = None) -> dict:
    return {"wrench": {"force": force, "torque": torque or xyz(0.0, 0.0, 0.0)}}


def setpoints(served, arm: str = "PSM1") -> np.ndarray:
    return served.world.arm(arm).setpoint_js().position
