"""A surgeon's minute at a dVRK console over ROS 1: align, follow, clutch, scale, camera, jaw.

Moves the masters through their own topics, whoever serves them, presses pedals by the console's
emulated ones, and measures what the instrument does. It needs rospy and crtk_msgs alone:

    python3 benchmarks/genuine/console.py [--gripper] [--camera] [--jaw-scale 1.333]

docs/how-to/drive-from-a-dvrk-console.md starts the console and the arms that it moves.
"""

# pyright: reportMissingImports=false, reportUnknownVariableType=false
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from typing import Any

import crtk_msgs.msg
import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState, Joy
from std_msgs.msg import Bool, Float64, String

Array = NDArray[np.float64]

#: Rate of the hand's commands. Source: our own choice, as of the dVRK's topics. [Hz]
RATE_HZ = 100.0
#: Way of the hand and duration of one motion. Source: our own choice. [m, s]
WAY, MOTION_S = 0.02, 2.0
#: Swing of both masters that moves the endoscope [rad], in steps. Source: our own choice.
SWING, STEPS = 0.05, 5
#: In trocar's warnings of two programs that command one arm.
BESIDE = "the newest command counts"
#: Time in which a state must come. Source: our own choice. [s]
LATE_S = 20.0
#: What moved less than this for so long rests. Source: our own choice. [s, m]
REST_S, STILL_M = 1.0, 1e-6


class Topics:
    """The last message of each topic, all texts of messages, and publishers.

    Attributes:
        last: {topic: its newest message}
        said: (topic, text) of errors and warnings, in their order
    """

    def __init__(self) -> None:
        self.last: dict[str, Any] = {}
        self.said: list[tuple[str, str]] = []
        self._publishers: dict[str, Any] = {}

    def read(self, topic: str, kind: Any) -> None:
        """Subscribe to a topic."""
        rospy.Subscriber(topic, kind, lambda m: self.last.__setitem__(topic, m), queue_size=10)

    def hear(self, topic: str) -> None:
        """Note the texts of a topic of errors or warnings."""
        rospy.Subscriber(topic, String, lambda m: self.said.append((topic, m.data)))

    def open(self, topic: str, kind: Any) -> None:
        """Advertise a topic."""
        self._publishers[topic] = rospy.Publisher(topic, kind, queue_size=10)

    def send(self, topic: str, message: Any) -> None:
        """Publish a message."""
        self._publishers[topic].publish(message)

    def joints(self, topic: str) -> Array:
        """Return positions of a JointState, (n,)."""
        return np.array(self.last[topic].position)

    def pose(self, topic: str) -> tuple[Array, Array]:
        """Return position (3,) [m] and quaternion xyzw (4,) of a PoseStamped."""
        p, q = self.last[topic].pose.position, self.last[topic].pose.orientation
        return np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w])


class Surgeon:
    """Two hands, two feet and an eye.

    Args:
        tool: "PSM1"
        master: "MTMR"
        camera: whether the console moves an ECM, too
        gripper: whether the master takes gripper/servo_jp

    Attributes:
        figures: {name: value}, as measured
    """

    def __init__(self, tool: str, master: str, *, camera: bool, gripper: bool) -> None:
        self.tool, self.master, self.camera, self.gripper = tool, master, camera, gripper
        self.component = f"{master}_{tool}"
        self.topics = topics = Topics()
        self.figures: dict[str, Any] = {}
        self.masters = ["MTML", "MTMR"] if camera else [master]
        self.arms = [tool, "ECM"] if camera else [tool]
        for arm in (*self.masters, *self.arms):
            topics.read(f"{arm}/setpoint_cp", PoseStamped)
            topics.read(f"{arm}/measured_cp", PoseStamped)
            topics.read(f"{arm}/setpoint_js", JointState)
            topics.read(f"{arm}/measured_js", JointState)
            topics.read(f"{arm}/operating_state", crtk_msgs.msg.OperatingState)
            topics.hear(f"{arm}/error")
            topics.hear(f"{arm}/warning")
            topics.open(f"{arm}/state_command", crtk_msgs.msg.StringStamped)
        for arm in self.masters:
            topics.open(f"{arm}/servo_cp", PoseStamped)
            topics.open(f"{arm}/servo_jp", JointState)
        topics.read(f"{master}/gripper/measured_js", JointState)
        topics.read(f"{tool}/jaw/setpoint_js", JointState)
        topics.read(f"{tool}/jaw/measured_js", JointState)
        topics.open(f"{master}/gripper/servo_jp", JointState)
        for name in (self.component, *(["MTML_MTMR_ECM"] if camera else [])):
            topics.read(f"{name}/current_state", String)
            topics.read(f"{name}/following", Bool)
        if camera:
            topics.read("ECM/servo_jp", JointState)  # the console's
        topics.hear("system/warning")
        topics.open(f"{self.component}/set_scale", Float64)
        topics.open("console/teleop/enable", Bool)
        topics.open("console/teleop/set_scale", Float64)
        for pedal in ("operator_present", "clutch", "camera"):
            topics.open(f"console/emulate_{pedal}", Joy)

    # ------------------------------------------------------------------ waiting

    def until(self, what: str, done: Callable[[], bool], late_s: float = LATE_S) -> float:
        """Wait until something holds; return the time that took [s].

        Raises:
            SystemExit: it did not come in time
        """
        begun = time.monotonic()
        while not self._holds(done):
            if time.monotonic() - begun > late_s or rospy.is_shutdown():
                self.report()
                sys.exit(f"waited {late_s:g} s in vain: {what}")
            time.sleep(0.01)
        return time.monotonic() - begun

    @staticmethod
    def _holds(done: Callable[[], bool]) -> bool:
        try:
            return done()
        except KeyError:  # no message yet
            return False

    def ready(self, arm: str) -> bool:
        """Return whether an arm is enabled and homed, and rests."""
        state = self.topics.last[f"{arm}/operating_state"]
        return state.state == "ENABLED" and state.is_homed and not state.is_busy

    def follows(self, component: str = "") -> bool:
        """Return whether a component follows."""
        return bool(self.topics.last[f"{component or self.component}/following"].data)

    def tip(self) -> Array:
        """Return the instrument's commanded tip, (3,) [m]."""
        return self.topics.pose(f"{self.tool}/setpoint_cp")[0]

    # ------------------------------------------------------------------ acting

    def press(self, pedal: str, on: bool) -> None:
        """Press or release a pedal of the console."""
        self.topics.send(f"console/emulate_{pedal}", Joy(buttons=[int(on)]))

    def move(
        self, ways: dict[str, tuple[float, float, float]], turn: float = 0.0, s: float = MOTION_S
    ) -> None:
        """Carry masters evenly: by ways [m], and about their own z by an angle [rad]."""
        start = {arm: self.topics.pose(f"{arm}/measured_cp") for arm in ways}
        count = round(s * RATE_HZ)
        rate = rospy.Rate(RATE_HZ)
        for k in range(1, count + 1):
            part = k / count
            part = part * part * (3.0 - 2.0 * part)
            for arm, way in ways.items():
                p, q = start[arm]
                message = PoseStamped()
                at, to = message.pose.position, message.pose.orientation
                at.x, at.y, at.z = p + part * np.array(way)
                half = 0.5 * part * turn
                to.x, to.y, to.z, to.w = _multiplied(q, (0.0, 0.0, math.sin(half), math.cos(half)))
                self.topics.send(f"{arm}/servo_cp", message)
            rate.sleep()
        self.rest()

    def rest(self) -> None:
        """Wait until the tip has stood still for a while: a loaded machine may lag by seconds."""
        last, since = self.tip(), time.monotonic()
        while time.monotonic() - since < REST_S:
            time.sleep(0.05)
            now = self.tip()
            if float(np.linalg.norm(now - last)) > STILL_M:
                last, since = now, time.monotonic()

    def swing(self, angle: float) -> None:
        """Swing every master about its base, by joint positions in few steps, by an angle [rad].

        The console commands wrenches and orientations of the masters in between: a simulated MTM
        of the dVRK jumps by decimetres for some of the commands, the oftener the more there are.
        """
        start = {arm: self.topics.joints(f"{arm}/measured_js") for arm in self.masters}
        for k in range(1, STEPS + 1):
            for _ in range(3):  # one may be lost between two commands of the console
                for arm, q in start.items():
                    position = [q[0] + k / STEPS * angle, *q[1:]]
                    self.topics.send(f"{arm}/servo_jp", JointState(position=position))
                time.sleep(MOTION_S / STEPS / 3)
        time.sleep(REST_S)

    def squeeze(self, opening: float) -> None:
        """Set the master's gripper [rad]."""
        self.topics.send(f"{self.master}/gripper/servo_jp", JointState(position=[opening]))

    # ------------------------------------------------------------------ the minute

    def begin(self) -> None:
        """Enable and home every arm, switch the console on and wait until the tool follows."""
        for arm in (*self.masters, *self.arms):
            self.until(f"{arm} publishes", lambda arm=arm: f"{arm}/setpoint_cp" in self.topics.last)
            for verb in ("enable", "home"):
                self.topics.send(f"{arm}/state_command", crtk_msgs.msg.StringStamped(string=verb))
                time.sleep(0.5)
        for arm in (*self.masters, *self.arms):
            self.until(f"{arm} is homed", lambda arm=arm: self.ready(arm))
        self.topics.said.clear()  # of commands of states that they were in
        time.sleep(REST_S)
        self.topics.send("console/teleop/enable", Bool(data=True))
        self.topics.send("console/teleop/set_scale", Float64(data=0.2))
        self.press("operator_present", True)
        self.figures["align_s"] = self.until("the tool follows", self.follows)
        handle = self.topics.pose(f"{self.master}/measured_cp")[1]
        tip = self.topics.pose(f"{self.tool}/setpoint_cp")[1]
        self.figures["misalignment_deg"] = math.degrees(_angle(handle, tip))

    def follow(self, name: str, scale: float) -> None:
        """Move the hand there and back along each axis; note how far the tip went."""
        ways: list[float] = []
        for axis in range(3):
            for sign in (1.0, -1.0):
                way = [0.0, 0.0, 0.0]
                way[axis] = sign * WAY
                hand, tip = self.topics.pose(f"{self.master}/measured_cp")[0], self.tip()
                self.move({self.master: (way[0], way[1], way[2])})
                moved = self.topics.pose(f"{self.master}/measured_cp")[0] - hand
                ways.append(float(np.linalg.norm(self.tip() - tip) / np.linalg.norm(moved) * WAY))
        self.figures[f"{name}_mm"] = [round(1e3 * way, 4) for way in ways]
        self.figures[f"{name}_off_um"] = 1e6 * max(abs(way - scale * WAY) for way in ways)

    def turn(self) -> None:
        """Roll the handle by 20 degrees and back; note the tool's turn."""
        before = self.topics.pose(f"{self.tool}/setpoint_cp")[1]
        self.move({self.master: (0.0, 0.0, 0.0)}, turn=math.radians(20.0))
        now = self.topics.pose(f"{self.tool}/setpoint_cp")[1]
        self.figures["turn_deg"] = math.degrees(_angle(before, now))
        self.move({self.master: (0.0, 0.0, 0.0)}, turn=math.radians(-20.0))

    def clutch(self) -> None:
        """Move the hand with the clutch pressed; note how far the tip went."""
        self.press("clutch", True)
        self.until("the clutch ends following", lambda: not self.follows())
        tip = self.tip()
        self.move({self.master: (WAY, 0.0, 0.0)})
        self.press("clutch", False)
        self.figures["back_from_clutch_s"] = self.until("it follows again", self.follows)
        self.figures["clutch_tip_um"] = 1e6 * float(np.linalg.norm(self.tip() - tip))

    def look(self) -> None:
        """Move the endoscope with the camera pedal pressed; note what tool and endoscope did.

        The endoscope is compared with what the console commands.
        """
        self.press("camera", True)
        self.until("the endoscope follows", lambda: self.follows("MTML_MTMR_ECM"))
        joints = self.topics.joints("ECM/setpoint_js")
        before = self.topics.joints(f"{self.tool}/setpoint_js")
        self.swing(SWING)
        changed = self.topics.joints("ECM/setpoint_js") - joints
        self.figures["camera_joints_mrad"] = [round(1e3 * float(x), 3) for x in changed]
        off = self.topics.joints("ECM/setpoint_js") - self.topics.joints("ECM/servo_jp")
        self.figures["camera_off_mrad"] = 1e3 * float(np.abs(off).max())
        self.swing(-SWING)
        self.figures["camera_tool_rad"] = float(
            np.abs(self.topics.joints(f"{self.tool}/setpoint_js") - before).max()
        )
        self.press("camera", False)
        self.figures["back_from_camera_s"] = self.until("the tool follows again", self.follows)

    def grip(self, scale: float) -> None:
        """Close and open the gripper slowly; note how far the jaw is from it, while and after."""
        if not self.gripper:
            time.sleep(3.0)
            jaw = float(self.topics.joints(f"{self.tool}/jaw/measured_js")[0])
            self.figures["jaw_deg"] = math.degrees(jaw)
            gripper = float(self.topics.joints(f"{self.master}/gripper/measured_js")[0])
            self.figures["jaw_rests_off_deg"] = abs(math.degrees(jaw - scale * gripper))
            return
        moving: list[float] = []
        resting: list[float] = []

        def off() -> float:
            gripper = float(self.topics.joints(f"{self.master}/gripper/measured_js")[0])
            jaw = float(self.topics.joints(f"{self.tool}/jaw/measured_js")[0])
            return abs(math.degrees(jaw - scale * gripper))

        rate = rospy.Rate(RATE_HZ)
        self.squeeze(math.radians(40.0))
        time.sleep(4.0)  # the jaw catches up at 36 deg/s
        for a, b in ((40.0, 10.0), (10.0, 50.0), (50.0, 25.0)):
            count = round(abs(b - a) / 20.0 * RATE_HZ)  # 20 deg/s
            for k in range(1, count + 1):
                self.squeeze(math.radians(a + (b - a) * k / count))
                rate.sleep()
                moving.append(off())
            time.sleep(REST_S)
            resting.append(off())
        self.figures["jaw_moving_off_deg"] = max(moving)
        self.figures["jaw_rests_off_deg"] = max(resting)

    def leave(self) -> None:
        """Take the head out and put it in again; note that the tool waits meanwhile."""
        self.press("operator_present", False)
        self.until("it stops", lambda: not self.follows())
        self.press("operator_present", True)
        self.figures["back_from_outside_s"] = self.until("it follows again", self.follows)

    def end(self) -> None:
        """Switch the console off."""
        self.topics.send("console/teleop/enable", Bool(data=False))
        self.until("it ends", lambda: not self.follows())

    def report(self) -> None:
        """Print the figures and what arms said."""
        said = [f"{topic}: {text}" for topic, text in self.topics.said]
        beside = [text for text in said if BESIDE in text]  # this program and the console, in turn
        self.figures["beside"] = len(beside)
        self.figures["messages"] = sorted({text for text in said if text not in beside})
        print(json.dumps(self.figures, indent=2), flush=True)


def _multiplied(a: Array, b: tuple[float, float, float, float]) -> Array:
    """Return the product of quaternions xyzw, (4,)."""
    (x, y, z, w), (i, j, k, r) = a, b
    return np.array(
        [
            w * i + x * r + y * k - z * j,
            w * j - x * k + y * r + z * i,
            w * k + x * j - y * i + z * r,
            w * r - x * i - y * j - z * k,
        ]
    )


def _angle(a: Array, b: Array) -> float:
    """Return the angle between orientations given as quaternions [rad]."""
    return 2.0 * math.acos(min(1.0, abs(float(a @ b))))


def main() -> int:
    """Run it and print the figures as JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tool", default="PSM1")
    parser.add_argument("--master", default="MTMR")
    parser.add_argument("--camera", action="store_true", help="the console moves an ECM, too")
    parser.add_argument("--gripper", action="store_true", help="the master takes gripper/servo_jp")
    parser.add_argument("--jaw-scale", type=float, default=1.0, help="jaw over gripper")
    parser.add_argument("--minutes", type=float, default=1.0, help="follow for at least so long")
    args = parser.parse_args()
    rospy.init_node("surgeon")
    surgeon = Surgeon(args.tool, args.master, camera=args.camera, gripper=args.gripper)
    time.sleep(2.0)
    surgeon.begin()
    begun = time.monotonic()
    surgeon.follow("scale_0.2", 0.2)
    surgeon.turn()
    surgeon.clutch()
    surgeon.topics.send("console/teleop/set_scale", Float64(data=0.5))
    time.sleep(REST_S)
    surgeon.follow("scale_0.5", 0.5)
    surgeon.topics.send("console/teleop/set_scale", Float64(data=0.2))
    time.sleep(REST_S)
    surgeon.grip(args.jaw_scale)
    if args.camera:
        surgeon.look()
    surgeon.leave()
    while time.monotonic() - begun < 60.0 * args.minutes:
        surgeon.follow("again", 0.2)
    surgeon.figures["minute_s"] = time.monotonic() - begun
    surgeon.end()
    surgeon.report()
    return 0


if __name__ == "__main__":
    sys.exit(main())
