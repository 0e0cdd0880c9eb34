"""A script as it is written for the robot: home, go in, draw a circle with the tip, grip.

usage: trocar run examples/scripts/circle.py --speed max [PSM2]

One sees: the arm's states, how well the tip keeps to the circle, and the jaw.
"""

# crtk, dvrk and PyKDL come from ROS, or from `trocar run`.
# pyright: reportMissingImports=false

import math
import sys
import time

import crtk
import dvrk
import numpy as np

RADIUS = 0.015
RATE = 100


class Circle:
    def __init__(self, ral, name):
        self.ral, self.arm = ral, dvrk.psm(ral, name)

    def home(self):
        self.ral.check_connections()
        if not (self.arm.enable(10) and self.arm.home(10)):
            sys.exit("the arm does not come home")
        print(f"{self.arm.name()} is {self.arm.operating_state()}")
        self.arm.move_jp(np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])).wait()

    def draw(self):
        goal, _ = self.arm.setpoint_cp()
        x, y = goal.p[0], goal.p[1]
        rate, worst = self.ral.create_rate(RATE), 0.0
        for k in range(5 * RATE + 1):
            angle = 2.0 * math.pi * k / (5 * RATE)
            goal.p[0] = x + RADIUS * math.sin(angle)
            goal.p[1] = y + RADIUS * (1.0 - math.cos(angle))
            self.arm.servo_cp(goal)
            rate.sleep()
            worst = max(worst, (self.arm.measured_cp()[0].p - goal.p).Norm())
        print(f"a circle of {2e3 * RADIUS:.0f} mm, off by {1e3 * worst:.2f} mm at most")

    def run(self):
        self.home()
        start = time.time()
        self.draw()
        self.arm.jaw.open().wait()
        self.arm.jaw.close().wait()
        told, _ = self.arm.jaw.setpoint_jp()
        print(f"the jaw grips ({math.degrees(told[0]):.0f} deg), {time.time() - start:.2f} s later")


arguments = crtk.ral.parse_argv(sys.argv[1:])
ral = crtk.ral("circle")
ral.spin_and_execute(Circle(ral, (arguments or ["PSM1"])[0]).run)
