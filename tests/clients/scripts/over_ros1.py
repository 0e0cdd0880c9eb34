"""Run a script over ROS 1 with our own crtk and dvrk, which stand on rospy here.

usage: over_ros1.py SCRIPT ..., under a Python that has rospy, crtk_msgs and trocar.
"""

# It runs under the Python that has rospy, which is not the one that checks it.
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
# pyright: reportAssignmentType=false

import importlib
import runpy
import sys
import time
from types import SimpleNamespace

import rospy

from trocar.interfaces.crtk.scripts.modules import client_modules
from trocar.interfaces.crtk.scripts.ral import ral


def find(kind, folder):
    package, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), name)


class Latest:
    """The newest message of a topic."""

    fresh = False

    def __init__(self, name, kind):
        self.message = None
        self.end = rospy.Subscriber(f"/{name}", kind, self.heard, tcp_nodelay=True)
        self.name, self.get_num_connections = self.end.name, self.end.get_num_connections

    def heard(self, message):
        self.message = message

    def get(self):
        return self.message


class RosNode:
    """What our `crtk.ral` asks of a node, done by rospy."""

    flow = SimpleNamespace(look=lambda: None, core=SimpleNamespace(prefixes={}))
    now = staticmethod(rospy.Time.now)
    rate = staticmethod(rospy.Rate)
    on_shutdown = staticmethod(rospy.on_shutdown)
    latest = staticmethod(Latest)
    ended = property(lambda _: rospy.is_shutdown())

    def publisher(self, name, kind):
        return rospy.Publisher(f"/{name}", kind, queue_size=10, tcp_nodelay=True)

    def subscriber(self, name, kind, heard, size=None):
        return rospy.Subscriber(f"/{name}", kind, heard, queue_size=size, tcp_nodelay=True)

    listener = subscriber

    def service(self, name, kind):
        return rospy.ServiceProxy(f"/{name}", kind)

    def wait(self, ready, timeout_s=None):
        end = time.monotonic() + (timeout_s or 0.0)
        while not ready():
            if time.monotonic() > end or rospy.is_shutdown():
                return False
            time.sleep(0.001)
        return True

    def shutdown(self):
        rospy.signal_shutdown("done")


class RosRal(ral):
    _node_of_run = RosNode()

    @staticmethod
    def message(kind):
        return find(kind, "msg")

    @staticmethod
    def service_type(kind):
        return find(kind, "srv")

    def create_duration(self, d):
        return rospy.Duration(d)

    def create_time(self):
        return rospy.Time()


rospy.init_node("script", anonymous=True, disable_signals=True)
sys.modules.update(client_modules(RosRal))
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
