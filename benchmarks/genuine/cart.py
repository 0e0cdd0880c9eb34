"""The plan of an Si's patient cart: frames, tips and gravity compensation at random postures."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.genuine.steps import Driven, Parts, Step

ARMS = ("PSM1", "PSM2", "PSM3", "ECM")
#: Topics of each arm and of its setup joints.
TOPICS = {
    topic.format(name): kind
    for topic, kind in {
        "/{}/setpoint_js": "sensor_msgs/JointState",
        "/{}/setpoint_cp": "geometry_msgs/PoseStamped",
        "/{}/local/setpoint_cp": "geometry_msgs/PoseStamped",
        "/{}/gravity_compensation/setpoint_js": "sensor_msgs/JointState",
        "/SUJ/{}/measured_js": "sensor_msgs/JointState",
        "/SUJ/{}/measured_cp": "geometry_msgs/PoseStamped",
        "/SUJ/{}/local/measured_cp": "geometry_msgs/PoseStamped",
    }.items()
    for name in ARMS
}
#: Middles and halves of the ranges of random postures. Source: our own choice. [rad, m]
PSM = ((0.0, 0.0, 0.155, 0.0, 0.0, 0.0), (1.4, 0.9, 0.095, 2.5, 1.0, 1.0))
ECM = ((0.0, 0.0, 0.13, 0.0), (1.4, 0.9, 0.11, 1.4))
SETUP = (0.1, 0.3, 0.3, 0.3, 0.3)
POSTURES = 10
#: Time in which a move ends, and a set-point that is near its goal. [s, rad or m]
LATE_S, NEAR = 15.0, 1e-6


def _still(arm: Driven, topic: str, goal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Wait until joints (n,) are at a goal; return the greatest speed of each on the way, (n,)."""
    peak = np.zeros(len(goal))
    for _ in range(round(LATE_S / 0.002)):
        arm.sleep(0.002)
        seen = arm.get(topic)
        if seen is None:
            continue
        if seen["velocity"]:
            peak = np.maximum(peak, np.abs(seen["velocity"]))
        if np.abs(np.array(seen["position"]) - goal).max() < NEAR:
            break
    return peak


def _power(arm: Driven) -> None:
    """Enable and home every arm."""
    for verb in ("enable", "home"):
        for name in (*ARMS, "SUJ/PSM1"):
            arm.send(f"/{name}/state_command", "crtk_msgs/StringStamped", string=verb)
        arm.sleep(4.0)


def _go(arm: Driven, goals: dict[str, NDArray[np.float64]]) -> None:
    """Set joints of the cart and move its arms, and wait for them."""
    for name, goal in goals.items():
        arm.joints(f"/{name}/{'servo_jp' if name.startswith('SUJ') else 'move_jp'}", goal)
    for name, goal in goals.items():
        _still(arm, f"/{name}/{'measured_js' if name.startswith('SUJ') else 'setpoint_js'}", goal)


def postures(arm: Driven) -> Iterator[Step]:
    """Go to random postures, and record joints, frames, tips and efforts there."""
    rng = np.random.default_rng(0)
    yield Step("T0 power", partial(_power, arm), 8.0)
    start = {name: arm.q(f"/SUJ/{name}/measured_js") for name in ARMS}
    for k in range(POSTURES):
        goals = {}
        for name in ARMS:
            middle, half = map(np.array, ECM if name == "ECM" else PSM)
            goals[name] = middle + half * rng.uniform(-1.0, 1.0, len(middle))
            half = np.array(SETUP[: len(start[name])])
            goals[f"SUJ/{name}"] = start[name] + half * rng.uniform(-1.0, 1.0, len(half))
        yield Step(f"T1 posture {k}", partial(_go, arm, goals), 1.5)
        for topic in TOPICS:
            arm.fact(f"{k} {topic}", arm.get(topic))


def speeds(arm: Driven) -> Iterator[Step]:
    """Move each joint through its range, and record its greatest speed."""
    for name in ARMS:
        middle, half = map(np.array, ECM if name == "ECM" else PSM)
        yield Step(f"V0 {name}", partial(_go, arm, {name: middle}), 0.5)
        for j in range(len(middle)):
            ends = [middle + sign * half * (np.arange(len(middle)) == j) for sign in (-1.0, 1.0)]
            yield Step(f"V1 {name} joint {j}", partial(_go, arm, {name: ends[0]}), 0.5)
            arm.joints(f"/{name}/move_jp", ends[1])
            arm.fact(f"peak {name} joint {j}", _still(arm, f"/{name}/setpoint_js", ends[1])[j])
            yield Step(f"V2 {name} back", partial(_go, arm, {name: middle}), 0.5)


CART: Parts = {"T": postures, "V": speeds}
