"""The plan of one PSM: states, moves, Cartesian commands, limits, jaw, frames, services, tools."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks.genuine.steps import HOME, Act, Driven, Parts, Step, quaternion, recover, rotation

#: Steps of a servo_jp that each joint is tried with until the arm faults. [rad, m]
JUMPS = {
    "yaw": (0.45, 0.49, 0.51, 0.55),
    "pitch": (0.45, 0.49, 0.51, 0.55),
    "insertion": (0.045, 0.049, 0.051, 0.055),
    "roll": (0.3, 0.38, 0.45, 0.58, 0.62, 1.0),
    "wrist_pitch": (0.4, 0.5, 0.58, 0.62, 0.7, 0.9),
    "wrist_yaw": (0.3, 0.4, 0.5, 0.58, 0.62, 0.7, 0.9),
    "jaw": (0.3, 0.5, 0.58, 0.62, 0.8, 1.0, 1.2),
}
#: Poses near `HOME`, first joint turned. [rad, m]
ASIDE = (0.1, *HOME[1:])
FAR = (0.8, *HOME[1:])


class Commands:
    """Makes the commands of steps, to be called when a step runs.

    Args:
        arm: the arm
        home: its posture after `home`
    """

    def __init__(self, arm: Driven, home: Sequence[float] = HOME) -> None:
        self.arm, self.home = arm, tuple(home)

    def state(self, command: str) -> Act:
        """Publish a state_command."""
        self.arm.advertise("state_command", "crtk_msgs/StringStamped")
        return partial(self.arm.state, command)

    def jp(self, topic: str, q: Any, **fields: Any) -> Act:
        """Publish joint positions."""
        self.arm.advertise(topic, "sensor_msgs/JointState")
        return partial(self.arm.joints, topic, q, **fields)

    def cp(self, topic: str, p: Any, R: Any, frame: str = "") -> Act:
        """Publish a pose."""
        self.arm.advertise(topic, "geometry_msgs/PoseStamped")
        return partial(self.arm.pose, topic, p, R, frame)

    def number(self, topic: str, value: float) -> Act:
        """Publish a Float64."""
        self.arm.advertise(topic, "std_msgs/Float64")
        return partial(self.arm.send, topic, "std_msgs/Float64", data=value)

    def empty(self, topic: str) -> Act:
        """Publish an Empty."""
        self.arm.advertise(topic, "std_msgs/Empty")
        return partial(self.arm.send, topic, "std_msgs/Empty")

    def text(self, topic: str, value: str) -> Act:
        """Publish a String."""
        self.arm.advertise(topic, "std_msgs/String")
        return partial(self.arm.send, topic, "std_msgs/String", data=value)

    def bool(self, topic: str, value: bool) -> Act:
        """Publish a Bool."""
        self.arm.advertise(topic, "std_msgs/Bool")
        return partial(self.arm.send, topic, "std_msgs/Bool", data=value)

    def wait(self, seconds: float) -> Act:
        """Let time pass."""
        return partial(self.arm.sleep, seconds)

    def together(self, *acts: Act) -> Act:
        """Run commands one after the other."""

        def run() -> None:
            for act in acts:
                act()

        return run

    def move(self, name: str, q: Any = None) -> Step:
        """Move joints, to `home` by default, and wait for the end."""
        return Step(name, self.jp("move_jp", self.home if q is None else q), None)

    def fix(self, part: str) -> Step:
        """Recover."""
        return Step(f"{part} fix", partial(recover, self.arm), 0.1)

    def begin(self, part: str) -> Iterator[Step]:
        """Recover and go to `home`."""
        yield self.fix(part)
        yield self.move(f"{part} back")

    def to(self, value: Any, delay: float, then: Act) -> Act:
        """Begin a move_jp and run another command after a delay."""
        return self.together(self.jp("move_jp", value), self.wait(delay), then)


def states(arm: Driven) -> Iterator[Step]:
    """Yield state commands in every state."""
    c = Commands(arm)
    aside = c.jp("move_jp", ASIDE)
    home = c.jp("move_jp", HOME)
    yield Step("A0 initial", None, 1.0)
    if (seen := arm.get("operating_state")) and seen["state"] != "DISABLED":
        yield Step("A0 disable", c.state("disable"), 1.0)
    yield Step("A1 move_jp while DISABLED", home)
    pose = c.cp("servo_cp", [0, 0, -0.1], rotation([1, 0, 0], math.pi))
    yield Step("A2 servo_cp while DISABLED", pose)
    yield Step("A3 bogus state_command", c.state("bogus"))
    yield Step("A4 pause while DISABLED", c.state("pause"))
    yield Step("A5 resume while DISABLED", c.state("resume"))
    yield Step("A6 unhome while DISABLED", c.state("unhome"))
    yield Step("A7 enable", c.state("enable"), 2.0)
    yield Step("A8 move_jp ENABLED not homed", aside, 1.5)
    yield Step("A9 home", c.state("home"), 5.0)
    yield Step("A10 home again", c.state("home"), 1.0)
    yield Step("A11 enable when homed", c.state("enable"), 1.0)
    yield Step("A12 home after enable", c.state("home"), 3.0)
    yield Step("A13 pause", c.state("pause"), 1.0)
    yield Step("A14 move_jp while PAUSED", aside, 1.0)
    yield Step("A15 home while PAUSED", c.state("home"), 1.0)
    yield Step("A16 enable while PAUSED", c.state("enable"), 1.0)
    yield Step("A17 resume", c.state("resume"), 1.0)
    yield Step("A18 move_jp after resume", aside, None)
    yield c.fix("A18")
    yield Step("A19 resume when not paused", c.state("resume"))
    yield Step("A20 unhome", c.state("unhome"), 1.5)
    yield Step("A21 move_jp after unhome", home, 2.0)
    yield Step("A22 home", c.state("home"), 4.0)
    yield c.move("A22 move_jp")
    yield c.fix("A22")
    yield Step("A23 disable", c.state("disable"), 1.0)
    yield Step("A24 disable again", c.state("disable"), 0.5)
    yield Step("A25 home from DISABLED", c.state("home"), 4.0)
    yield Step("A25 enable", c.state("enable"), 2.0)
    yield Step("A25 move_jp after enable", aside, 2.0)
    yield c.fix("A25")
    yield Step("A26 disable during a move", c.to(FAR, 0.5, c.state("disable")), 1.0)
    yield Step("A27 enable", c.state("enable"), 2.0)
    yield Step("A27 home", c.state("home"), 5.0)
    yield Step("A28 pause during a move", c.to(FAR, 0.5, c.state("pause")), 1.5)
    yield Step("A29 resume", c.state("resume"), 3.0)
    yield c.move("A29 move_jp")
    yield c.fix("A29")
    yield Step("A30 empty state_command", c.state(""))
    yield Step("A31 HOME upper case", c.state("HOME"))
    yield Step("A32 pause", c.state("pause"), 0.5)
    yield Step("A32 pause again", c.state("pause"), 0.5)
    yield Step("A32 resume", c.state("resume"), 0.5)
    yield Step("A32 move_jp", aside, 1.5)
    yield c.fix("A32")
    both = c.together(c.state("enable"), c.wait(0.01), c.state("home"))
    both = c.together(c.state("disable"), c.wait(1.0), both)
    yield Step("A33 enable+home within 10 ms", both, 4.0)
    yield c.fix("A33")
    jump = c.jp("servo_jp", (0.9, *HOME[1:]))
    yield Step("A34 fault", c.to(HOME, 2.5, jump), 1.0)
    yield Step("A34 home in FAULT", c.state("home"), 1.0)
    yield Step("A34 pause in FAULT", c.state("pause"), 0.5)
    yield Step("A34 enable in FAULT", c.state("enable"), 2.0)
    yield Step("A34 move_jp", home, 2.5)
    yield Step("A34 home", c.state("home"), 4.0)
    yield Step("A34 move_jp", home, 2.5)
    yield c.fix("A34")


def moves(arm: Driven) -> Iterator[Step]:
    """Yield moves: of each joint, replaced, interrupted, of wrong sizes, slower."""
    c = Commands(arm)
    yield c.fix("B")
    yield c.move("B0 to start")
    deltas = {
        "yaw": (0.02, 0.2, 1.0), "pitch": (0.2, 0.8), "insertion": (0.005, 0.05, 0.1),
        "roll": (0.3, 2.0), "wrist_pitch": (0.3, 1.2), "wrist_yaw": (0.3, 1.2),
    }  # fmt: skip
    for i, (name, each) in enumerate(deltas.items()):
        for delta in each:
            goal = list(HOME)
            goal[i] += delta
            yield c.move(f"B1 move_jp {name} {delta:+g}", goal)
            yield c.move("B1 back")
    yield c.move("B2 move_jp all joints", [0.3, -0.2, 0.17, 1.0, 0.4, -0.3])
    yield c.move("B2 back")
    turned = c.jp("move_jp", (-0.2, *HOME[1:]))
    yield Step("B3 reversed on the way", c.to(FAR, 0.6, turned), None)
    yield c.move("B3 back")
    jr = c.jp("move_jr", [0.2, 0, 0, 0, 0, 0])
    yield Step("B4 move_jr +0.2 twice", c.together(jr, c.wait(0.1), jr), None)
    yield c.move("B4 back")
    stay = c.to(FAR, 0.6, lambda: arm.joints("servo_jp", arm.q()))
    yield Step("B5 servo_jp in a move", stay, 1.5)
    yield c.move("B5 back")
    yield Step("B6 hold in a move", c.to(FAR, 0.6, c.empty("hold")), 1.5)
    yield c.move("B6 back")
    yield Step("B7 move_jp to here", c.jp("move_jp", HOME), 1.0)
    yield c.move("B8 move_jp beyond yaw limit", (2.0, *HOME[1:]))
    yield c.move("B8 back")
    yield Step("B9 move_jp 5 values", c.jp("move_jp", ASIDE[:5]), 2.0)
    yield Step("B10 move_jp 7 values", c.jp("move_jp", (*ASIDE, 0.3)), 2.0)
    yield Step("B11 move_jp no values", c.jp("move_jp", ()), 1.0)
    yield Step("B12 servo_jp 5 values", c.jp("servo_jp", (0.05, *HOME[1:5])), 1.0)
    yield Step("B13 servo_jp 7 values", c.jp("servo_jp", (0.05, *HOME[1:], 0.3)), 1.0)
    yield Step("B15 state", None, 0.5)
    yield from c.begin("B15")
    half = (0.5, *HOME[1:])
    for ratio in (0.5, 0.1):
        yield Step(f"B16 set_ratio {ratio:g}", c.number("trajectory_j/set_ratio", ratio))
        yield c.move(f"B16 move_jp yaw +0.5 at {ratio:g}", half)
        full = c.number("trajectory_j/set_ratio", 1.0)
        yield Step("B16 back", c.together(full, c.wait(0.2), c.jp("move_jp", HOME)), None)
    yield Step("B17 set_ratio_v 0.2", c.number("trajectory_j/set_ratio_v", 0.2))
    yield c.move("B17 move_jp", half)
    for ratio in (0, 1.5, 0.001, 1):
        yield Step(f"B18 set_ratio {ratio:g}", c.number("trajectory_j/set_ratio", float(ratio)))
    slower = c.to(HOME, 0.3, c.number("trajectory_j/set_ratio", 0.2))
    yield Step("B18 ratio in a move", slower, None)
    yield Step("B18 set_ratio 1", c.number("trajectory_j/set_ratio", 1.0))
    yield c.move("B19 back")


def poses(arm: Driven) -> Iterator[Step]:
    """Yield Cartesian commands within and out of range."""
    c = Commands(arm)
    yield c.fix("C")
    yield c.move("C0 back")
    p, R = arm.tip()

    def cp(name: str, topic: str, to: Any, turned: Any = R, wait: float | None = None) -> Step:
        return Step(name, c.cp(topic, to, turned), wait)

    def about(axis: int, degrees: float) -> Any:
        return R @ rotation(np.eye(3)[axis].tolist(), math.radians(degrees))

    yield cp("C1 move_cp +3 cm x", "move_cp", p + np.array([0.03, 0, 0]))
    yield cp("C2 move_cp rotated 0.6 about x", "move_cp", p, R @ rotation([1, 0, 0], 0.6))
    yield cp("C3 move_cp 1 m away", "move_cp", p + np.array([1.0, 0, 0]))
    yield cp("C4 move_cp 0.3 m deeper", "move_cp", p + np.array([0, 0, -0.3]))
    yield c.move("C4 back")
    yield cp("C5 move_cp 5 mm from the RCM", "move_cp", [0, 0, -0.005])
    yield c.move("C5 back")
    yield cp("C6 move_cp turned over (180 deg about x)", "move_cp", p, about(0, 180))
    yield c.move("C6 back")
    yield cp("C7 servo_cp +1 mm x", "servo_cp", p + np.array([0.001, 0, 0]), wait=0.8)
    yield cp("C8 servo_cp +50 mm x jump", "servo_cp", p + np.array([0.05, 0, 0]), wait=0.8)
    yield cp("C9 servo_cp 1 m away", "servo_cp", p + np.array([1.0, 0, 0]), wait=1.0)
    yield cp("C10 servo_cp 0.3 m deeper", "servo_cp", p + np.array([0, 0, -0.3]), wait=1.0)
    yield from c.begin("C10")
    yield cp("C11 servo_cp wrist 120 deg about x", "servo_cp", p, about(0, 120), 1.0)
    yield from c.begin("C11")

    def turn(name: str, sign: int) -> None:
        rolls: list[float] = []
        seen: list[str] = []
        for k in range(721):
            arm.pose("servo_cp", p, about(2, sign * k))
            arm.sleep(0.008)
            if k % 30 == 0:
                state = (arm.get("operating_state") or {})["state"]
                rolls.append(arm.q()[3])
                seen += [state] if seen[-1:] != [state] else []
        arm.fact(f"{name} farthest roll", max(rolls, key=abs))
        arm.fact(f"{name} states", seen)

    for number, sign in ((12, 1), (13, -1)):
        name = f"C{number} servo_cp rolled 2 turns {'+' if sign > 0 else '-'}"
        yield Step(name, partial(turn, f"C{number}", sign), 1.0)
        yield c.fix(f"C{number}")
        yield c.move(f"C{number} back")
    for degrees in (170, 190, 300):
        on = "" if degrees == 170 else " (on)"
        yield cp(f"C14 move_cp rolled {degrees}{on}", "move_cp", p, about(2, degrees))
    yield c.move("C14 back")
    double = [2 * x for x in quaternion(R)]
    yield cp("C15 servo_cp quaternion x2", "servo_cp", p + np.array([0.001, 0, 0]), double, 0.8)
    yield cp(
        "C16 servo_cp quaternion zero", "servo_cp", p + np.array([0.002, 0, 0]), [0, 0, 0, 0], 0.8
    )
    yield Step("C17 state", None, 0.5)
    yield from c.begin("C17")
    yield c.move("C18 insertion to 0.03 (wrist in cannula)", [0, 0, 0.03, 0, 0, 0])
    yield Step("C19 servo_cp there", lambda: arm.pose("servo_cp", *arm.tip()), 1.0)

    def deeper() -> None:
        at, turned = arm.tip()
        arm.pose("move_cp", at - np.array([0, 0, 0.05]), turned)

    yield Step("C20 move_cp there, 5 cm deeper", deeper, None)
    yield c.move("C20 back")

    def withdraw() -> None:
        for k in range(121):
            arm.pose("servo_cp", p * [1, 1, 1 - k / 120.0], R)
            arm.sleep(0.01)

    yield Step("C21 servo_cp then withdrawn to RCM in steps", withdraw, 1.0)
    yield c.move("C21 back")


def limits(arm: Driven) -> Iterator[Step]:
    """Yield set-points ramped past each limit, jumps and relative set-points."""
    c = Commands(arm)
    yield c.fix("D")
    yield c.move("D0 back")
    ends = (
        ("yaw", 1.7, -1.7), ("pitch", 1.1, -1.1), ("insertion", 0.26, -0.03),
        ("roll", 5.0, -5.0), ("wrist_pitch", 2.0, -2.0), ("wrist_yaw", 2.0, -2.0),
    )  # fmt: skip

    def ramp(i: int, end: float) -> None:
        for k in range(101):
            q = list(HOME)
            q[i] += (end - HOME[i]) * k / 100.0
            arm.joints("servo_jp", q)
            arm.sleep(0.02)

    for i, (name, *both) in enumerate(ends):
        for end in both:
            yield Step(f"D1 servo_jp {name} to {end:+g}", partial(ramp, i, end), 0.5)
            yield c.move("D1 back")
            if (arm.get("operating_state") or {})["state"] != "ENABLED":
                yield from c.begin("D1")
    yield Step("D2 servo_jp jump yaw +0.3", c.jp("servo_jp", (0.3, *HOME[1:])), 1.0)
    yield c.move("D2 back")
    yield Step("D3 servo_jp jump yaw +0.7", c.jp("servo_jp", (0.7, *HOME[1:])), 1.0)
    yield from c.begin("D3")
    moving = c.jp("servo_jp", (0.01, *HOME[1:]), velocity=[0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    yield Step("D4 servo_jp with velocities", moving, 0.6)
    jr = c.jp("servo_jr", [0.05, 0, 0, 0, 0, 0])
    yield Step("D5 servo_jr 0.05", jr, 0.6)
    yield Step("D5 servo_jr 0.05 twice quickly", c.together(jr, jr), 0.6)
    yield c.move("D5 back")


def jaw(arm: Driven) -> Iterator[Step]:
    """Yield commands of the jaw, alone and beside the arm's."""
    c = Commands(arm)
    yield from c.begin("E")

    def move(name: str, q: float) -> Step:
        return Step(name, c.jp("jaw/move_jp", [q]), None)

    def servo(name: str, q: float) -> Step:
        return Step(name, c.jp("jaw/servo_jp", [q]), 0.8)

    yield move("E1 jaw move 1.0", 1.0)
    yield move("E2 jaw move 0.2", 0.2)
    yield servo("E3 jaw servo 0.5", 0.5)
    yield servo("E4 jaw servo 3.0", 3.0)
    yield c.fix("E4")
    yield move("E4 jaw move 0.2", 0.2)
    yield servo("E5 jaw servo -0.1", -0.1)
    yield c.fix("E5")
    yield servo("E6 jaw servo -1.0", -1.0)
    yield c.fix("E6")
    yield move("E7 jaw move 3.0", 3.0)
    yield move("E8 jaw move -1.0", -1.0)
    yield move("E9 jaw move 0", 0.0)
    yield c.fix("E9")
    aside = (0.4, *HOME[1:])
    beside = c.to(aside, 0.2, c.jp("jaw/move_jp", [0.8]))
    yield Step("E10 jaw move in an arm move", beside, None)
    closing = c.together(c.jp("jaw/move_jp", [0.0]), c.wait(0.05))
    yield Step("E10 arm move in a jaw move", c.together(closing, c.jp("move_jp", HOME)), None)
    yield Step("E11 jaw servo in an arm move", c.to(aside, 0.3, c.jp("jaw/servo_jp", [0.3])), 2.0)
    yield c.move("E11 back")
    opening = c.together(c.jp("jaw/move_jp", [1.2]), c.wait(0.05))
    yield Step("E12 servo_jp in a jaw move", c.together(opening, c.jp("servo_jp", HOME)), 1.5)
    yield c.fix("E12")
    effort = partial(arm.send, "jaw/servo_jf", "sensor_msgs/JointState", effort=[-0.1])
    yield Step("E13 jaw servo_jf -0.1", effort, 1.0)
    yield move("E13 jaw move 0.3", 0.3)
    yield c.fix("E13")
    yield Step("E14 jaw move empty", c.jp("jaw/move_jp", ()), 1.0)
    yield Step("E15 jaw move 2 values", c.jp("jaw/move_jp", (0.4, 0.1)), 1.0)
    yield c.fix("E15")
    kept = c.together(c.jp("jaw/servo_jp", [0.6]), c.wait(0.5), c.jp("move_jp", ASIDE))
    yield Step("E16 jaw at 0.6 then move_jp: jaw kept?", kept, None)
    yield c.move("E16 back")


def jumps(arm: Driven) -> Iterator[Step]:
    """Yield ever larger jumps of each joint's set-point until the arm faults."""
    c = Commands(arm)

    def jump(i: int, size: float) -> None:
        recover(arm)
        arm.joints("move_jp", HOME)
        arm.wait_busy(8.0, 0.1)
        arm.joints("jaw/move_jp", [0.0])
        arm.wait_busy(8.0, 0.2)
        q = list(HOME)
        if i < 6:
            q[i] += size
        arm.joints("servo_jp" if i < 6 else "jaw/servo_jp", q if i < 6 else [size])

    for i, (name, sizes) in enumerate(JUMPS.items()):
        for size in sizes:
            yield Step(f"K {name} {size:g}", partial(jump, i, size), 0.5)
            state = (arm.get("operating_state") or {})["state"]
            arm.fact(f"K {name} {size:g}", state)
            if state == "FAULT":
                break
    yield c.fix("K")


def efforts(arm: Driven) -> Iterator[Step]:
    """Yield efforts, free and hold."""
    c = Commands(arm)
    yield from c.begin("F")
    yield c.move("F1 move_jp, all measured", [0.3, -0.2, 0.15, 0.5, 0.2, 0.3])

    def effort(yaw: float) -> Act:
        values = [yaw, 0.0, 0.0, 0.0, 0.0, 0.0]
        return partial(arm.send, "servo_jf", "sensor_msgs/JointState", effort=values)

    yield Step("F2 servo_jf zero", effort(0.0), 1.0)
    yield Step("F3 servo_jf yaw 0.5", effort(0.5), 0.5)
    wrench = partial(arm.send, "body/servo_cf", "geometry_msgs/WrenchStamped")
    yield Step("F4 body/servo_cf 0", wrench, 0.6)
    yield Step("F5 free", c.empty("free"), 0.6)
    yield Step("F6 hold", c.empty("hold"), 0.6)
    yield c.move("F7 move_jp after effort")
    yield Step("F8 use_gravity_compensation", c.bool("use_gravity_compensation", True), 0.6)


def frames(arm: Driven) -> Iterator[Step]:
    """Yield base frames."""
    c = Commands(arm)
    yield c.fix("G")
    yield c.move("G0 back")
    read = ("setpoint_cp", "local/setpoint_cp")
    at, turned = [0.1, 0.2, 0.3], rotation([0, 0, 1], math.pi / 2)

    def read_as(name: str) -> None:
        for topic in read:
            arm.fact(f"{name}: {topic}", arm.get(topic))

    yield Step("G1 set_base_frame", c.cp("set_base_frame", at, turned, "world"), 0.8)
    read_as("G1")

    def aside() -> None:
        p, R = arm.tip()
        arm.pose("servo_cp", p + np.array([0.002, 0, 0]), R)

    yield Step("G2 servo_cp in it", aside, 0.8)
    read_as("G2")
    double = c.cp("set_base_frame", at, [0, 0, 2, 0], "world")
    yield Step("G3 set_base_frame not normalised", double, 0.8)
    read_as("G3")
    zero = c.cp("set_base_frame", [0.5, 0.2, 0.3], [0, 0, 0, 0], "world")
    yield Step("G4 set_base_frame zero quaternion", zero, 0.8)
    read_as("G4")
    own = c.cp("set_base_frame", [0, 0, 0], np.eye(3), f"{arm.name}_base")
    yield Step("G5 set_base_frame identity", own, 0.8)


def services(arm: Driven) -> Iterator[Step]:
    """Yield the way home; record answers of services."""
    c = Commands(arm)
    yield from c.begin("I")
    tried = (HOME, (0.3, -0.2, 0.15, 0.5, 0.2, 0.3), (0.3, -0.2, 0.15, 0.5, 0.2))
    for q in (*tried, (2.0, *HOME[1:]), HOME[:3], ()):
        for name in ("forward_kinematics", "local/forward_kinematics"):
            answer = arm.call(name, "crtk_msgs/QueryForwardKinematics", jp=list(q))
            arm.fact(f"{name} {' '.join(f'{x:g}' for x in q)}", answer)
    p, R = arm.tip()
    shifts = {"here": (0, 0, 0), "+2 cm x": (0.02, 0, 0), "1 m": (1, 0, 0), "deeper": (0, 0, -0.3)}
    for name, shift in shifts.items():
        answer = arm.inverse(list(HOME), p + shift, R)
        arm.fact(f"inverse_kinematics {name}", answer)
    actuators = [0.1, 0.2, 0.1, 0.1, 0.2, 0.3, 0.4]
    answer = arm.call(
        "actuator_to_joint_position", "cisst_msgs/ConvertFloat64Array", input=actuators
    )
    arm.fact("actuator_to_joint_position", answer)


def tools(arm: Driven) -> Iterator[Step]:
    """Yield tool exchanges."""
    c = Commands(arm)
    yield from c.begin("T")
    yield Step("T1 set_tool_type unknown", c.text("set_tool_type", "FOO:123"), 1.0)
    name = "MARYLAND_BIPOLAR_FORCEPS:400172"
    yield Step(f"T2 set_tool_type {name}", c.text("set_tool_type", name), 3.0)
    yield c.move("T3 move_jp after")
    absent = c.bool("emulate_tool_present", False)
    yield Step("T4 emulate_tool_present false", absent, 1.5)

    def aside() -> None:
        p, R = arm.tip()
        arm.pose("move_cp", p + np.array([0.01, 0, 0]), R)

    yield Step("T5 move_cp without tool", aside, 1.5)
    yield Step("T5 move_jp without tool", c.jp("move_jp", ASIDE), 2.0)
    name = "LARGE_NEEDLE_DRIVER:400006"
    yield Step(f"T6 set_tool_type {name}", c.text("set_tool_type", name), 3.0)
    present = c.bool("emulate_tool_present", True)
    yield Step("T7 emulate_tool_present true", present, 3.0)
    yield Step("T8 home", c.state("home"), 4.0)
    yield c.move("T9 move_jp")


def not_numbers(arm: Driven) -> Iterator[Step]:
    """Yield NaN."""
    c = Commands(arm)
    yield c.fix("N")
    yield c.move("N0 back")
    bad = (math.nan, *HOME[1:])
    yield Step("N1 servo_jp NaN", c.jp("servo_jp", bad), 1.0)
    yield Step("N2 move_jp home", c.jp("move_jp", HOME), None, timeout=6.0)
    yield Step("N3 move_jp NaN", c.jp("move_jp", bad), 2.0)
    yield Step("N4 disable", c.state("disable"), 1.0)
    yield Step("N5 home", c.state("home"), 6.0)


def system(arm: Driven) -> Iterator[Step]:
    """Yield commands of the whole system."""
    c = Commands(arm)
    yield c.fix("P")
    yield Step("P1 system/power_off", c.empty("/system/power_off"), 1.5)
    yield Step("P2 system/power_on", c.empty("/system/power_on"), 3.0)
    yield Step("P3 system/home", c.empty("/system/home"), 5.0)


#: Parts of the plan by letter. Source: the plan of the first comparison, step by step.
PARTS: Parts = {
    "A": states, "B": moves, "C": poses, "D": limits, "E": jaw, "P": system, "K": jumps,
    "F": efforts, "G": frames, "I": services, "T": tools, "N": not_numbers,
}  # fmt: skip
