"""Random messages: good ones, good ones with a leaf that is broken, and plain rubbish."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.ros.asking import joints, pose, quaternion, stamped, wrench, xyz
from trocar.ros.topic import Topic

STATES = ("enable", "disable", "home", "unhome", "pause", "resume")
LEAVES: Sequence[object] = (
    None, True, -1, 0, 10**400, float("nan"), float("inf"), "", "x" * 5000, b"\x00",
    -1e308, 1e308, 1e150, -1e9, 1e-6, 1e-13, 1e-300, 5e-324, -5e-324,
    [], {}, [[1.0]], {"x": {}}, np.zeros((2, 2)), np.full(6, np.nan), (1, 2, 3), object(),
)  # fmt: skip


def message(rng: np.random.Generator, topic: Topic, count: int) -> object:
    """Return a message for a topic of an arm with `count` joints, or for one of nobody's."""
    kind = rng.integers(10)
    if kind == 0:
        return leaf(rng)
    if kind == 1:
        return {
            str(key): leaf(rng) for key in rng.choice(["position", "pose", "data", "header"], 2)
        }
    good = likely(rng, topic, count)
    return broken(rng, good) if kind < 4 else good


def likely(rng: np.random.Generator, topic: Topic, count: int) -> dict:
    """Return a message of the topic's type."""
    q = 0.2 * rng.standard_normal(1 if topic.key.startswith("jaw/") else count)
    step = xyz(*(0.02 * rng.standard_normal(3)))
    turn = rng.standard_normal(4)
    axes = quaternion(*(turn / np.linalg.norm(turn)))
    data = [True, False, 0.5, "LARGE_NEEDLE_DRIVER:400006", "none", [0.1, 440.0, 0.5]]
    makers = {
        "sensor_msgs/JointState": lambda: joints(*q, effort=q),
        "geometry_msgs/PoseStamped": lambda: pose(step, axes if rng.random() < 0.5 else None),
        "geometry_msgs/WrenchStamped": lambda: wrench(step, step),
        "geometry_msgs/Quaternion": lambda: axes,
        "crtk_msgs/StringStamped": lambda: {"string": str(rng.choice(STATES))},
        "crtk_msgs/CartesianState": lambda: {
            **pose(step, axes),
            **wrench(step),
            **{
                f"{k}_is_valid": {"data": bool(rng.integers(2))}
                for k in ("pose", "twist", "wrench")
            },
        },
        "crtk_msgs/CartesianImpedance": lambda: impedance(rng, step, axes),
        "sensor_msgs/Joy": lambda: {"axes": [], "buttons": [int(rng.integers(4))]},
        "std_msgs/Empty": dict,
    }
    made = makers.get(topic.type, lambda: {"data": data[rng.integers(len(data))]})()
    if rng.random() < 0.3:
        made = stamped(made, (int(rng.integers(100)), int(rng.integers(10**9))))
    return made


def impedance(rng: np.random.Generator, place: dict, axes: dict) -> dict:
    names = ("p", "d", "bias", "deadband")
    sides = [f"{a}_{b}" for a in ("position", "orientation") for b in ("positive", "negative")]
    return {
        "force_position": place,
        "force_orientation": axes,
        "torque_orientation": axes,
        **{s: {n: xyz(*(100.0 * rng.standard_normal(3))) for n in names} for s in sides},
    }


def broken(rng: np.random.Generator, good: dict) -> dict:
    """Return a message with one of its leaves replaced, or left out."""
    inner = dict(good)
    if not inner:
        return inner
    key = str(rng.choice(list(inner)))
    value = inner[key]
    if isinstance(value, dict) and rng.random() < 0.7:
        inner[key] = broken(rng, value)
    elif isinstance(value, list) and value and rng.random() < 0.7:
        inner[key] = [*value[:-1], leaf(rng)]
    elif rng.random() < 0.2:
        del inner[key]
    else:
        inner[key] = leaf(rng)
    return inner


def leaf(rng: np.random.Generator) -> object:
    return LEAVES[int(rng.integers(len(LEAVES)))]
