"""Services of arms."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError
from concurrent.futures import TimeoutError as FutureTimeoutError
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError, TrocarError, UnreachableError
from trocar.geometry.se3 import inverse
from trocar.kinematics.coupling import Coupling, joint_from_actuator
from trocar.kinematics.links import link_pose
from trocar.live.loop import Loop
from trocar.messages import ServiceType, blank, cdr_decode, cdr_encode
from trocar.ros import message_builders as build
from trocar.ros.clock import Stamper
from trocar.ros.message_fields import Message, pose, vector
from trocar.ros.topic import Service

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.arm import Arm

_log = logging.getLogger("trocar")

Array = NDArray[np.float64]
Answer = dict[str, Any]

#: Largest command or call in bytes of ROS. Source: our own choice; a JointState has a few hundred.
LARGEST = 1_000_000
#: Source: CRTK as reported by the dVRK 2.4.
CRTK_VERSION = "1.1.0"
#: Joints 3 and 4 of a master hang on its motors 2 and 3. Source: SAW share/kinematic/MTML.json.
MTM_ACTUATORS = np.eye(7)
MTM_ACTUATORS[2, 1] = -1.0
MTM_ACTUATORS[3, 1:3] = 0.6697, -0.6697


class Services:
    """Answer calls, each in the loop's thread, where it only reads.

    Args:
        loop: of the world
        stamper: gives the stamps of answers
    """

    def __init__(self, loop: Loop, stamper: Stamper) -> None:
        self._loop, self._stamper = loop, stamper
        #: Held by the one call that the loop answers at a time, so that many take no tick.
        self._asking = threading.Lock()

    def answer(self, service: Service, request: Message, timeout_s: float = 5.0) -> Answer:
        """Answer a call; from any thread but the loop's.

        Raises:
            InputError: what is wrong with the request, or no answer in time
        """
        reply = service.answer
        if reply is None:
            raise InputError(f"{service.name}: service is not available")

        def ask(world: World) -> Answer:
            found = reply(world.arm(service.arm), request)
            if "operating_state" in found:
                state = found["operating_state"]
                state["is_busy"] |= service.arm in self._loop.held
                state["header"] = {"stamp": self._stamper.stamp(), "frame_id": ""}
            return found

        if not self._loop.running:
            return ask(self._loop.world)
        late = InputError(f"{service.name}: no answer within {timeout_s:g} s")
        if not self._asking.acquire(timeout=timeout_s):
            raise late
        try:
            return self._loop.ask(ask).result(timeout_s)
        except (FutureTimeoutError, CancelledError):
            raise late from None
        finally:
            self._asking.release()


def answered(
    call: Callable[[str, dict[str, Any], float], dict[str, Any]],
    name: str,
    kind: ServiceType,
    request: bytes,
    timeout_s: float,
) -> bytes | None:
    """Answer a call in CDR, which has no errors: the reason stands in the field `message`.

    Args:
        call: `Core.call`
        name: of the service
        kind: its type
        request: as CDR
        timeout_s: how long it may take [s]

    Returns:
        the response as CDR, None where it would be an error that has no such field
    """
    try:
        if len(request) > LARGEST:
            raise InputError(f"got a request of {len(request)} bytes; allowed: up to {LARGEST}")
        found = call(name, cdr_decode(kind.request, request), timeout_s)
    except InputError as problem:
        _log.warning("ROS 2: %s: %s", name, problem)
        found = {**blank(kind.response)}
        if "message" not in found:
            return None
        found["message"] = str(problem)
    return cdr_encode(kind.response, found)


def _forward(local: bool) -> Callable[[Arm, Message], Answer]:
    def answer(arm: Arm, request: Message) -> Answer:
        """Return the pose of the link that as many joints lead to as there are numbers."""
        try:
            q = vector(request, "jp")
            T_base_link = _link(arm, q)
            T = T_base_link if local else arm.local.base_frame()[0] @ T_base_link
        except TrocarError as problem:
            return {"cp": build.pose(np.eye(4)), "result": False, "message": str(problem)}
        return {"cp": build.pose(T), "result": True, "message": ""}

    return answer


def _link(arm: Arm, q: Array) -> Array:
    own = arm.description.own_joints
    if len(q) > own:
        names = arm.joints.names[:own]
        raise InputError(
            f"got {len(q)} numbers in jp; allowed: up to {own}, for {', '.join(names)}"
        )
    if len(q) == own:
        return inverse(arm.local.base_frame()[0]) @ arm.forward_kinematics(q).matrix
    return link_pose(arm.description.mechanism, arm.description.inverse_kinematics, q)


def _inverse(arm: Arm, request: Message) -> Answer:
    """Return the joints of a pose in the arm's own base frame, searched from the request's.

    Source: mtsIntuitiveResearchKitArm.cpp:2327-2342, 9e535e6.
    """
    try:
        seed = vector(request, "jp")
        if len(seed) != arm.description.own_joints:
            return {"jp": np.zeros(0), "result": False, "message": "incorrect number of joints"}
        q = arm.inverse_kinematics(pose(request, "cp"), seed)
    except UnreachableError:
        return {"jp": np.zeros(0), "result": False, "message": "inverse kinematics failed"}
    except TrocarError as problem:
        return {"jp": np.zeros(0), "result": False, "message": str(problem)}
    return {"jp": q, "result": True, "message": ""}


def _version(arm: Arm, request: Message) -> Answer:  # noqa: ARG001  as every answer
    return {"success": True, "message": CRTK_VERSION}


def _state(arm: Arm, request: Message) -> Answer:  # noqa: ARG001
    """Return the operating state without its header."""
    now = arm.operating_state()
    fields = {"state": now.state, "is_homed": now.is_homed, "is_busy": now.is_busy}
    return {"operating_state": fields}


def _joints_of_actuators(arm: Arm, request: Message) -> Answer:
    """Return joint positions, the jaw's too, for as many actuators."""
    actuators = vector(request, "input")
    A = actuator_matrix(arm)
    if len(actuators) != len(A):
        raise InputError(
            f"{arm.name}: got {len(actuators)} numbers in input; allowed: {len(A)} actuators"
        )
    return {"output": joint_from_actuator(Coupling(A), actuators)}


def actuator_matrix(arm: Arm) -> Array:
    """Return A with q_joint = A q_actuator, (n, n), the jaw included."""
    described = arm.description
    if described.type == "MTM":
        return MTM_ACTUATORS.copy()
    A = np.eye(len(described.joints))
    if described.coupling is not None:
        which = [arm.joints.names.index(name) for name in described.coupling.joints]
        A[np.ix_(which, which)] = described.coupling.actuator_to_joint
    return A


FORWARD = "crtk_msgs/QueryForwardKinematics"


def service_rows(arm: ArmDescription) -> tuple[Service, ...]:
    """Return the services of an arm, without its name."""
    return SERVICES[3:5] if arm.type == "SUJ" else SERVICES


SERVICES = tuple(
    Service(key, kind, text, key=key, answer=answer)
    for key, kind, text, answer in (
        (
            "forward_kinematics",
            FORWARD,
            "the pose of the tip at joint positions, as measured_cp",
            _forward(local=False),
        ),
        (
            "local/forward_kinematics",
            FORWARD,
            "the same in the arm's own base frame",
            _forward(local=True),
        ),
        (
            "inverse_kinematics",
            "crtk_msgs/QueryInverseKinematics",
            "joint positions for a pose in the arm's own base frame, whatever the limits",
            _inverse,
        ),
        ("operating_state", "crtk_msgs/TriggerOperatingState", "the operating state now", _state),
        ("crtk_version", "std_srvs/Trigger", "the version of CRTK", _version),
        (
            "actuator_to_joint_position",
            "cisst_msgs/ConvertFloat64Array",
            "joint positions of actuators' positions",
            _joints_of_actuators,
        ),
    )
)
