"""A node of ROS 2: move PSM1's tip on a small circle by set-points, as measured 100 times a second.

Run it without ROS: trocar run examples/scripts/follow.py --speed max
"""

# rclpy comes from ROS 2, or from `trocar run`.
# pyright: reportMissingImports=false

import math

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node


class Circle(Node):
    """Follows a circle about the first measured pose."""

    def __init__(self):
        super().__init__("circle")
        self.declare_parameter("radius", 0.01)  # [m]
        self.radius = self.get_parameter("radius").value
        self.start, self.worst = None, 0.0
        self.command = self.create_publisher(PoseStamped, "/PSM1/servo_cp", 1)
        self.create_subscription(PoseStamped, "/PSM1/measured_cp", self.measured, 1)
        self.create_timer(0.01, self.beat)

    def measured(self, message):
        if self.start is None:
            self.start, self.goal = message.pose, PoseStamped(pose=message.pose)
            self.x, self.y = self.start.position.x, self.start.position.y
            self.begun = self.get_clock().now()
        here, there = message.pose.position, self.goal.pose.position
        self.worst = max(self.worst, math.dist((here.x, here.y), (there.x, there.y)))

    def beat(self):
        if self.start is None:
            return
        seconds = (self.get_clock().now() - self.begun).nanoseconds / 1e9
        angle = math.pi * seconds  # a turn in 2 s
        self.goal.pose.position.x = self.x + self.radius * math.sin(angle)
        self.goal.pose.position.y = self.y + self.radius * (1.0 - math.cos(angle))
        self.goal.header.stamp = self.get_clock().now().to_msg()
        self.command.publish(self.goal)
        if seconds > 4.0:
            rclpy.shutdown()


rclpy.init()
node = Circle()
rclpy.spin(node)
print(f"two turns of {1e3 * node.radius:g} mm, at most {1e3 * node.worst:.2f} mm behind")
