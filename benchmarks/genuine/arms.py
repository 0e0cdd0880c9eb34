"""Short plans of masters, the ECM, a setup joint arm and a PSM of the Si."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from benchmarks.genuine.psm import Commands
from benchmarks.genuine.steps import HOME, Driven, Parts, Step, matrix, rotation

MTM_HOME = (0.0,) * 7
ECM_HOME = (0.0, 0.0, 0.12, 0.0)
#: Motion of each joint. [rad, m]
MTM_MOVES = (0.4, 0.3, 0.3, 0.4, 0.4, 0.3, 0.4)
ECM_MOVES = (0.4, 0.3, 0.04, 0.5)
#: Postures of a PSM for kinematics. [rad, m]
POSTURES = (
    HOME, (0.4, -0.3, 0.17, 1.0, 0.4, -0.3), (-1.2, 0.6, 0.07, -2.0, -0.8, 0.9),
    (0.0, 0.0, 0.2, 0.0, 1.2, 0.0), (1.0, 0.8, 0.1, 3.0, 0.0, -1.2),
)  # fmt: skip


def states(home: Sequence[float], arm: Driven) -> Iterator[Step]:
    """Yield state commands in every state."""
    c = Commands(arm, home)
    aside = c.jp("move_jp", (0.1, *home[1:]))
    yield Step("S0 disable", c.state("disable"), 1.0)
    yield Step("S1 move_jp while DISABLED", aside)
    yield Step("S2 home while DISABLED", c.state("home"), 1.0)
    yield Step("S3 pause while DISABLED", c.state("pause"))
    yield Step("S4 enable", c.state("enable"), 2.0)
    yield Step("S5 home", c.state("home"), 6.0)
    yield Step("S6 home again", c.state("home"), 1.0)
    yield Step("S7 pause", c.state("pause"))
    yield Step("S8 move_jp while PAUSED", aside)
    yield Step("S9 enable while PAUSED", c.state("enable"))
    yield Step("S10 resume", c.state("resume"))
    yield c.move("S11 move_jp", (0.1, *home[1:]))
    yield Step("S12 unhome", c.state("unhome"), 1.0)
    yield Step("S13 home", c.state("home"), 2.0)
    yield c.fix("S14")
    yield c.move("S15 back")


def moves(home: Sequence[float], sizes: Sequence[float], arm: Driven) -> Iterator[Step]:
    """Yield moves of each joint, of all, past limits, and relative ones."""
    c = Commands(arm, home)
    yield from c.begin("M")
    for i, size in enumerate(sizes):
        goal = list(home)
        goal[i] += size
        yield c.move(f"M1 move_jp joint {i} {size:+g}", goal)
        yield c.move("M1 back")
    yield c.move("M2 move_jp all joints", np.add(home, np.multiply(sizes, 0.6)))
    yield c.move("M2 back")
    for sign in (1, -1):
        yield c.move(
            f"M3 move_jp past the limits {sign:+d}", np.add(home, np.full(len(home), sign * 12.0))
        )
        yield c.move("M3 back")
    jr = c.jp("move_jr", [0.1, *[0.0] * (len(home) - 1)])
    yield Step("M4 move_jr twice", c.together(jr, c.wait(0.1), jr), None)
    jr = c.jp("servo_jr", [0.02, *[0.0] * (len(home) - 1)])
    yield Step("M5 servo_jr", jr, 0.6)
    yield Step("M6 move_jp too few values", c.jp("move_jp", home[:2]), 1.5)
    yield from c.begin("M7")


def poses(home: Sequence[float], sizes: Sequence[float], arm: Driven) -> Iterator[Step]:
    """Yield Cartesian commands."""
    c = Commands(arm, home)
    yield c.fix("P")
    own = c.cp("set_base_frame", [0.0, 0.0, 0.0], np.eye(3), f"{arm.name}_base")
    yield Step("P0 set_base_frame identity", own, 0.8)
    yield c.move("P0 aside", np.add(home, np.multiply(sizes, 0.4)))
    p, R = arm.tip()
    arm.fact("P0 tip", [p, R])
    yield Step("P1 move_cp +2 cm x", c.cp("move_cp", p + np.array([0.02, 0, 0]), R), None)
    turned = R @ rotation([0, 0, 1], 0.3)
    yield Step("P2 move_cp turned 0.3 about z", c.cp("move_cp", p, turned), None)
    yield Step("P3 move_cp back", c.cp("move_cp", p, R), None)
    yield Step("P4 servo_cp +1 mm y", c.cp("servo_cp", p + np.array([0, 0.001, 0]), R), 0.8)
    yield c.move("P5 back")


def master(arm: Driven) -> Iterator[Step]:
    """Yield commands that masters alone have."""
    c = Commands(arm, MTM_HOME)
    yield from c.begin("G")
    lock = partial(arm.send, "lock_orientation", "geometry_msgs/Quaternion", w=1.0)
    yield Step("G1 lock_orientation without effort", lock, 1.0)
    zero = partial(arm.send, "body/servo_cf", "geometry_msgs/WrenchStamped")
    yield Step("G2 body/servo_cf 0", zero, 1.0)
    yield Step("G3 lock_orientation", lock, 1.0)
    yield Step("G4 unlock_orientation", c.empty("unlock_orientation"), 1.0)
    yield Step("G5 use_gravity_compensation", c.bool("use_gravity_compensation", True), 0.6)
    yield c.move("G6 move_jp")


def setup(arm: Driven) -> Iterator[Step]:
    """Yield commands of a setup joint arm."""
    c = Commands(arm)
    yield Step("U0 disable", c.state("disable"), 1.0)
    yield Step("U1 enable", c.state("enable"), 1.0)
    yield Step("U2 home", c.state("home"), 1.0)
    yield Step("U3 pause", c.state("pause"), 0.6)
    yield Step("U4 resume", c.state("resume"), 0.6)
    yield Step("U5 bogus", c.state("bogus"), 0.6)
    q = arm.q("measured_js")
    for i, size in enumerate((0.05, 0.1, 0.1)):
        goal = q.copy()
        goal[i] += size
        yield Step(f"U6 move_jp joint {i}", c.jp("move_jp", goal), 2.0)
        arm.fact(f"U6 joint {i}", arm.q("measured_js") - q)
    yield Step("U7 servo_jp", c.jp("servo_jp", q), 2.0)
    arm.fact("U7 joints", arm.q("measured_js") - q)
    yield Step("U8 disable", c.state("disable"), 1.0)


def kinematics(arm: Driven) -> Iterator[Step]:
    """Yield the way home; record forward and inverse kinematics."""
    yield from Commands(arm).begin("K")
    for q in POSTURES:
        name = " ".join(f"{x:g}" for x in q)
        answer = arm.call(
            "local/forward_kinematics", "crtk_msgs/QueryForwardKinematics", jp=list(q)
        )
        arm.fact(f"local/forward_kinematics {name}", answer)
        if isinstance(answer, dict):
            p = np.array([answer["cp"]["position"][k] for k in "xyz"])
            R = matrix([answer["cp"]["orientation"][k] for k in "xyzw"])
            arm.fact(f"inverse_kinematics {name}", arm.inverse(list(HOME), p, R))


def _parts(home: Sequence[float], sizes: Sequence[float]) -> dict[str, partial[Iterator[Step]]]:
    return {
        "S": partial(states, home),
        "M": partial(moves, home, sizes),
        "P": partial(poses, home, sizes),
    }


MTM: Parts = {**_parts(MTM_HOME, MTM_MOVES), "G": master}
ECM: Parts = _parts(ECM_HOME, ECM_MOVES)
KINEMATICS: Parts = {"K": kinematics}
SUJ: Parts = {"U": setup}
