"""Random walks: seeded commands whose answers part where a rule differs."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from benchmarks.genuine.psm import Commands
from benchmarks.genuine.steps import HOME, Act, Driven, Parts, Step, rotation

#: Lengths of walks: commands of states, moves and streams of poses.
STATES, MOVES, POSES = 80, 20, 12
#: Half ranges about `HOME` of random goals. [rad, m]
SPAN = (0.8, 0.6, 0.06, 1.5, 0.8, 0.8)
COMMANDS = ("enable", "disable", "home", "unhome", "pause", "resume", "bogus")
#: Period of a stream. [s]
STREAM_S = 0.02


def states(seed: int, arm: Driven) -> Iterator[Step]:
    """Yield state commands, and moves and set-points between them."""
    c, draw = Commands(arm), random.Random(f"states {seed}")
    yield from _begin(c, seed)
    for k in range(STATES):
        word = draw.choices(
            (*COMMANDS, "move_jp", "servo_jp", "jump", "jaw/move_jp", "move_cp"),
            (14, 10, 18, 4, 8, 8, 1, 18, 8, 4, 4, 3),
        )[0]
        name = f"{seed}.{k:02d} {word}"
        if word in COMMANDS:
            yield Step(name, c.state(word), 3.0 if word == "home" else 0.8)
        elif word == "move_jp":
            yield Step(name, c.jp("move_jp", _goal(draw)), None, 4.0)
        elif word == "jaw/move_jp":
            yield Step(name, c.jp("jaw/move_jp", [draw.uniform(0.0, 1.0)]), None, 4.0)
        elif word == "move_cp":
            yield Step(name, partial(_shift_tip, arm, draw.uniform(-0.01, 0.01)), None, 4.0)
        else:
            size = 0.9 if word == "jump" else draw.uniform(-0.03, 0.03)
            yield Step(name, partial(_shift_yaw, arm, size), 0.8)


def moves(seed: int, arm: Driven) -> Iterator[Step]:
    """Yield one to three commands of arm and jaw, each sent while the one before moves."""
    c, draw = Commands(arm), random.Random(f"moves {seed}")
    yield from _begin(c, seed)
    k = 0
    while k < MOVES:
        words = draw.choices(
            ("move_jp", "jaw/move_jp", "servo_jp", "jaw/servo_jp", "move_jr", "ratio", "hold"),
            (8, 6, 2, 3, 2, 3, 1),
            k=draw.choice((1, 2, 2, 3)),
        )
        acts: list[Act] = []
        for word in words:
            acts += [c.wait(draw.uniform(0.08, 0.4))] if acts else []
            acts.append(_command(word, c, draw))
        name = f"{seed}.{k:02d} {' '.join(words)}"
        yield Step(name, c.together(*acts), None, 30.0)
        k += len(words)
    yield Step(f"{seed}.{k:02d} ratio 1", c.number("trajectory_j/set_ratio", 1.0))


def _command(word: str, c: Commands, draw: random.Random) -> Act:
    if word == "move_jp":
        return c.jp(word, _goal(draw))
    if word == "move_jr":
        return c.jp(word, [draw.uniform(-0.2, 0.2), 0, 0, 0, 0, draw.uniform(-0.2, 0.2)])
    if word == "ratio":
        return c.number("trajectory_j/set_ratio", draw.choice((0.2, 0.5, 0.8, 1.0)))
    if word == "jaw/move_jp":
        return c.jp(word, [draw.uniform(-0.3, 1.2)])
    if word == "hold":
        return c.empty(word)
    shift = draw.uniform(-0.05, 0.05)
    c.arm.advertise(word, "sensor_msgs/JointState")
    if word == "servo_jp":
        return partial(_shift_yaw, c.arm, shift)
    return lambda: c.arm.joints(word, c.arm.q("jaw/setpoint_js") + shift)


def poses(seed: int, arm: Driven) -> Iterator[Step]:
    """Yield streams of servo_cp out of range and back, and some goals of move_cp."""
    c, draw = Commands(arm), random.Random(f"poses {seed}")
    yield from _begin(c, seed)
    p, R = arm.tip()
    last = (p, R)
    for k in range(POSES):
        word = draw.choices(("near", "far", "back", "move_cp"), (4, 4, 3, 2))[0]
        at, turned = (p, R) if word == "back" else _pose(draw, p, R, 1.0 if word == "near" else 2.5)
        name = f"{seed}.{k:02d} {word}"
        if word == "move_cp":
            yield Step(name, c.cp("move_cp", at, turned), None, 8.0)
            last = arm.tip()
        else:
            yield Step(name, partial(_stream, arm, last, (at, turned)), 0.6)
            last = (at, turned)


def _begin(c: Commands, seed: int) -> Iterator[Step]:
    yield Step(f"{seed}.fix", partial(_ready, c), 0.1)
    yield Step(f"{seed}.jaw", c.jp("jaw/move_jp", [0.2]), None)
    yield Step(f"{seed}.start", c.jp("move_jp", HOME), None)


def _ready(c: Commands) -> None:
    """Disable, enable and home, whatever the walk before left."""
    for command, wait in (("disable", 1.0), ("enable", 2.0), ("home", 5.0)):
        c.arm.state(command)
        c.arm.sleep(wait)


def _goal(draw: random.Random) -> list[float]:
    """Return a random posture about `HOME`, of one joint or of all."""
    joints = range(6) if draw.random() < 0.4 else [draw.randrange(6)]
    shifts = [draw.uniform(-span, span) if i in joints else 0.0 for i, span in enumerate(SPAN)]
    return [q + shift for q, shift in zip(HOME, shifts, strict=True)]


def _pose(draw: random.Random, p: np.ndarray, R: np.ndarray, far: float) -> tuple[np.ndarray, ...]:
    """Return a random pose about another, at most 6 cm and 60 degrees away times `far`."""
    shift = [draw.uniform(-0.06, 0.06) * far for _ in range(3)]
    axis = [draw.gauss(0.0, 1.0) for _ in range(3)]
    angle = draw.uniform(0.0, math.pi / 3.0) * far
    return p + np.array(shift), R @ rotation(axis, angle)


def _shift_yaw(arm: Driven, shift: float) -> None:
    q = arm.q()
    q[0] += shift
    arm.joints("servo_jp", q)


def _shift_tip(arm: Driven, shift: float) -> None:
    p, R = arm.tip()
    arm.pose("move_cp", p + np.array([shift, 0.0, 0.0]), R)


def _stream(
    arm: Driven, begin: tuple[np.ndarray, ...], end: tuple[np.ndarray, ...]
) -> None:  # fmt: skip
    """Stream servo_cp along a line and one axis, at most 1.5 mm and 2 degrees a message."""
    turn = begin[1].T @ end[1]
    angle = math.acos(min(1.0, max(-1.0, (float(np.trace(turn)) - 1.0) / 2.0)))
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    if not np.any(axis):
        axis = np.array([1.0, 0.0, 0.0])
    way = end[0] - begin[0]
    count = math.ceil(max(np.linalg.norm(way) / 0.0015, angle / math.radians(2.0), 1.0))
    for k in range(1, count + 1):
        s = k / count
        arm.pose("servo_cp", begin[0] + s * way, begin[1] @ rotation(axis.tolist(), s * angle))
        arm.sleep(STREAM_S)


def _seeds(walk: Callable[[int, Driven], Iterator[Step]]) -> Parts:
    return {str(seed): partial(walk, seed) for seed in range(100)}


#: Walks by name; each part is a seed.
WALKS = {"walk-states": _seeds(states), "walk-moves": _seeds(moves), "walk-poses": _seeds(poses)}
