"""A minute of a PSM's work, as a script for the robot: home, moves, servo loops, the jaw.

usage: minute.py FILE [SECONDS], where each of three loops lasts so long; FILE gets what was
measured, part by part: six joints and the jaw, the stamp, and the time.
"""

# crtk, dvrk and PyKDL come from ROS, or from `trocar run`.
# pyright: reportMissingImports=false

import json
import math
import sys
import time

import crtk
import dvrk
import numpy as np

RATE = 100
HOME = np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])
STEPS = ([0.2, 0.1, 0.03, 0.5, 0.3, -0.3], [-0.2, -0.1, 0.0, -0.5, -0.3, 0.3])
SWING = np.array([0.2, 0.1, 0.02, 0.4, 0.2, 0.2])


class Minute:
    def __init__(self, ral, seconds):
        self.ral, self.arm, self.seconds = ral, dvrk.psm(ral, "PSM1"), seconds
        self.parts = {}

    def rest(self, name):
        """Note where a move ended, once the arm has settled."""
        self.ral.create_rate(2).sleep()
        self.note(name)

    def note(self, name):
        position, when = self.arm.measured_jp()
        row = [*position, *self.arm.jaw.measured_jp()[0], when, time.time()]
        self.parts.setdefault(name, []).append([float(value) for value in row])

    def servo(self, name, send):
        """Swing forth and back, so that the loop ends where it begins."""
        rate, count = self.ral.create_rate(RATE), round(RATE * self.seconds)
        swings = max(1, round(self.seconds / 5.0))
        for k in range(count + 1):
            send(0.5 * (1.0 - math.cos(2.0 * math.pi * swings * k / count)))
            self.note(name)
            rate.sleep()

    def run(self):
        self.ral.check_connections()
        if not (self.arm.enable(10) and self.arm.home(10)):
            sys.exit("the arm does not come home")
        for k, step in enumerate(STEPS):
            assert self.arm.move_jp(HOME + step).wait()
            self.rest(f"move {k}")
            assert self.arm.jaw.open().wait()
            self.rest(f"open {k}")
            assert self.arm.jaw.close().wait()
        assert self.arm.move_jp(HOME).wait()
        self.rest("home")
        self.servo("joints", lambda s: self.arm.servo_jp(HOME + s * SWING))
        assert self.arm.move_jp(HOME).wait()
        self.line()
        assert self.arm.jaw.open(0.2).wait()
        self.servo("jaw", lambda s: self.arm.jaw.servo_jp(np.array([0.2 + 0.6 * s])))
        self.rest("end")

    def line(self):
        goal, _ = self.arm.setpoint_cp()
        x, y = goal.p[0], goal.p[1]

        def send(s):
            goal.p[0], goal.p[1] = x + 0.02 * s, y - 0.01 * s
            self.arm.servo_cp(goal)

        self.servo("tip", send)


arguments = crtk.ral.parse_argv(sys.argv[1:])
ral = crtk.ral("minute")
work = Minute(ral, float(arguments[1]) if len(arguments) > 1 else 15.0)
ral.spin_and_execute(work.run)
with open(arguments[0], "w", encoding="utf-8") as file:
    json.dump(work.parts, file)
