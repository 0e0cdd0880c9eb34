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
from functools import partial
from types import SimpleNamespace

import rospy

from trocar.scripts.crtk_client import ral
from trocar.scripts.modules import client_modules


def find(kind, folder):
    package, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), name)


class Latest:
    """The newest message of a topic."""

    fresh = False

    def __init__(self, name, kind):
        self.message = None
        self.end = rospy.Subscriber(name, kind, self.heard, tcp_nodelay=True)
        self.name, self.get_num_connections = self.end.name, self.end.get_num_connections

    def heard(self, message):
        self.message = message

    def get(self):
        return self.message


class RosNode:
    """rospy, without delays of small messages, and with waiting."""

    flow = SimpleNamespace(look=lambda: None, core=SimpleNamespace(prefixes={}))
    Subscriber = staticmethod(partial(rospy.Subscriber, tcp_nodelay=True))
    Publisher = staticmethod(partial(rospy.Publisher, tcp_nodelay=True))

    def __getattr__(self, name):
        return getattr(rospy, name)

    def wait(self, ready, timeout_s=None):
        end = time.monotonic() + (timeout_s or 0.0)
        while not ready():
            if time.monotonic() > end or rospy.is_shutdown():
                return False
            time.sleep(0.001)
        return True


class RosRal(ral):
    _node_of_run = RosNode()

    @staticmethod
    def _message(kind):
        return find(kind, "msg")

    @staticmethod
    def _service_type(kind):
        return find(kind, "srv")

    def _latest(self, topic, kind):
        made = Latest(f"/{self._named(topic)}", self._message(kind))
        self._subscribers.append(made)
        return made

    def _listen(self, topic, kind, heard):
        return self.subscriber(topic, self._message(kind), heard)


rospy.init_node("script", anonymous=True, disable_signals=True)
sys.modules.update(client_modules(RosRal))
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
