"""A script as it is written for the robot: enable, home, move, wait for the end of the move.

usage: move.py PSM1
"""

# It runs under the Python that has rospy, which is not the one that checks it.
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import sys
import time

import rospy
from crtk_msgs.msg import OperatingState, StringStamped
from sensor_msgs.msg import JointState

arm = sys.argv[1]
goal = [0.2, -0.1, 0.14, 0.3, 0.1, -0.1]
states, joints = [], []

rospy.init_node("mover", anonymous=True)
rospy.Subscriber(f"/{arm}/operating_state", OperatingState, states.append)
rospy.Subscriber(f"/{arm}/measured_js", JointState, joints.append, tcp_nodelay=True)
command = rospy.Publisher(f"/{arm}/state_command", StringStamped, queue_size=10)
move = rospy.Publisher(f"/{arm}/move_jp", JointState, queue_size=10)
end = time.time() + 40.0


def wait_until(holds):
    while not holds():
        if time.time() > end or rospy.is_shutdown():
            sys.exit(f"in vain: {states[-1:]} {joints[-1:]}")
        time.sleep(0.005)


def tell(word):
    """Send a command, and wait for a state that is newer, as clients of CRTK do."""
    stamped = StringStamped(string=word)
    stamped.header.stamp = rospy.Time.now()
    command.publish(stamped)
    wait_until(lambda: states[-1].header.stamp > stamped.header.stamp and not states[-1].is_busy)


wait_until(lambda: command.get_num_connections() and move.get_num_connections())
wait_until(lambda: states and joints)
tell("enable")
tell("home")
wait_until(lambda: states[-1].state == "ENABLED" and states[-1].is_homed)

seen = len(states)
move.publish(JointState(position=goal))
wait_until(lambda: any(state.is_busy for state in states[seen:]))
wait_until(lambda: not states[-1].is_busy)
wait_until(lambda: all(abs(joints[-1].position[k] - goal[k]) < 0.01 for k in range(6)))
sys.stdout.write(f"at the goal {[round(value, 3) for value in joints[-1].position]}\n")
