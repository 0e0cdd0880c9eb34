"""The transport: a node that publishes, listens and serves what the core's table names."""

from __future__ import annotations

import logging
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from trocar.errors import InputError, TrocarError
from trocar.interfaces.crtk.messages.forms import ROS1_PACKING
from trocar.interfaces.crtk.sorter import Sorter
from trocar.interfaces.crtk.transports.ros1 import library as ros
from trocar.interfaces.crtk.transports.ros1.intake import greet_in_threads, serve, subscribe
from trocar.interfaces.crtk.transports.ros1.master import MasterError, find_master, settle_address
from trocar.interfaces.crtk.transports.ros1.outlets import Outlet
from trocar.interfaces.crtk.transports.ros1.parameters import Parameters
from trocar.interfaces.crtk.transports.ros1.sender import Sender

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.transport import Batch

_log = logging.getLogger("trocar")

NODE = "trocar"

LOOK_S = 0.05
"""How often it is looked who subscribes [s]. Source: our own choice."""

WATCH_S = 2.0
"""How often the master is asked whether it knows us [s]. Source: our own choice."""

GONE = (
    "the master at {uri} does not answer any more; the simulation goes on, and so do those who"
    " are connected"
)

FAREWELL_S = 10.0
"""How long unregistering may take [s]. Source: our own choice; it takes tenths of a second."""


class Ros1Transport:
    """Serve the core over ROS 1. A process can have one such node, once.

    Args:
        node: its name

    Attributes:
        greeting: what to tell the user once it has started: which master, which address
    """

    name = "ros1"
    packing = ROS1_PACKING

    def __init__(self, node: str = NODE) -> None:
        self.node = node
        self.greeting = ""
        self._outlets: dict[str, Outlet] = {}
        self._heard: frozenset[str] = frozenset()
        self._looked = 0.0
        self._over = threading.Event()
        self._sorter = Sorter()
        self._started = False

    # ------------------------------------------------------------------ what the core calls

    def start(self, core: Core) -> None:
        """Join the master, and register every topic and service.

        Raises:
            MissingRospyError: this Python has no rospy
            MasterError, InputError: no master
            TrocarError: rospy refuses
        """
        self._core = core
        self._ros = ros.load()
        self._master = find_master()
        address = settle_address(self._master)
        self._join()
        self._sorter.start()
        self._register()
        self._parameters = Parameters(core, self._master, self._ros)
        self._sender = Sender(self._outlets)
        self._sender.start()
        self._watcher = threading.Thread(target=self._watch, name="trocar-ros1-watch", daemon=True)
        self._watcher.start()
        self._started = True
        self.greeting = f"ROS 1: node /{self.node} at the master {self._master.uri}; it {address}"

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics that somebody subscribes to."""
        now = time.monotonic()
        if now - self._looked >= LOOK_S:
            self._looked = now
            self._heard = frozenset(name for name, out in self._outlets.items() if out.heard)
        return self._heard

    def send(self, batch: Batch) -> None:
        """Let messages be written to their subscribers."""
        if not self._over.is_set():
            self._sender.put(batch)

    def close(self) -> None:
        """Unregister, and delete the parameters that were set."""
        if not self._started:
            return
        self._over.set()
        self._sorter.close()
        self._sender.close()
        farewell = threading.Thread(target=self._part, name="trocar-ros1-farewell", daemon=True)
        farewell.start()
        farewell.join(FAREWELL_S)

    # ------------------------------------------------------------------ inside

    def _join(self) -> None:
        """Become a node; rospy neither handles signals nor sets up logging of its own."""
        rospy = self._ros.rospy
        if rospy.core.is_initialized():
            raise InputError("--ros1: this process is a ROS 1 node already, and can be only once")
        logging.getLogger("rospy").setLevel(logging.CRITICAL)
        rospy.core.configure_logging = lambda *_, **__: None
        try:
            rospy.init_node(
                self.node,
                argv=[],
                disable_signals=True,
                disable_rosout=True,
                disable_rostime=True,  # clients may live by our clock; we do not
            )
        except (rospy.ROSException, ValueError, OSError) as error:
            raise TrocarError(f"--ros1: rospy cannot start its node: {error}") from error
        greet_in_threads(self._ros)

    def _register(self) -> None:
        core = self._core
        for topic in core.topics.values():
            if topic.later:
                continue
            if topic.direction == "pub":
                self._outlets[topic.name] = Outlet(self._ros, topic)
            else:
                subscribe(self._ros, core, topic, self._sorter)
        for service in core.services.values():
            serve(self._ros, core, service)
        for name, outlet in self._outlets.items():
            last = core.latched(name)
            if last is not None:
                outlet.send(last)

    def _watch(self) -> None:
        """Set parameters, and see to it that the master knows us; what changes is said once."""
        answers, announced = True, False
        while True:
            if answers:
                announced = self._announce(announced)
            if self._over.wait(WATCH_S):
                return
            if self._ros.rospy.is_shutdown():
                _log.warning("ROS 1 has ended: another node is called /%s now", self.node)
                self._over.set()
                return
            known = self._known()
            if known is None:
                if answers:
                    _log.warning("ROS 1: %s", GONE.format(uri=self._master.uri))
            elif not known:
                self._register_again()
                announced = False
                _log.warning("ROS 1: all is registered with the new master at %s", self._master.uri)
            elif not answers:
                _log.warning("ROS 1: the master at %s answers again", self._master.uri)
            answers = known is not None

    def _announce(self, announced: bool) -> bool:
        """Set parameters, those that change when all are set; return whether that is done with."""
        try:
            if announced:
                self._parameters.follow()
            else:
                self._parameters.start()
        except MasterError:
            return False
        except TrocarError as error:
            _log.warning("ROS 1: parameters are not set: %s", error)
        return True

    def _known(self) -> bool | None:
        """Tell whether the master knows us; None when it does not answer."""
        try:
            return self._master.ask("lookupNode", f"/{self.node}")[0] == 1
        except MasterError:
            return None

    def _register_again(self) -> None:
        registration: Any = ros.inner(self._ros, "impl.registration")
        listeners, topics = (
            registration.get_registration_listeners(),
            registration.get_topic_manager(),
        )
        for kind, rows in (
            (registration.Registration.PUB, topics.get_publications()),
            (registration.Registration.SUB, topics.get_subscriptions()),
            (registration.Registration.SRV, registration.get_service_manager().get_services()),
        ):
            for name, described in rows:
                listeners.notify_added(name, described, kind)

    def _part(self) -> None:
        self._watcher.join()  # it may be setting parameters
        with suppress(TrocarError):
            self._parameters.forget()
        self._ros.rospy.signal_shutdown("the simulation has ended")
