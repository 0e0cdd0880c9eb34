"""What the services of an arm answer; each is asked in the loop's thread, where it only reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError
from concurrent.futures import TimeoutError as FutureTimeoutError
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, TrocarError
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.geometry.se3 import inverse
from trocar.interfaces.crtk.fields import Message, vector
from trocar.interfaces.crtk.places import pose
from trocar.kinematics.coupling import Coupling, joint_from_actuator
from trocar.kinematics.links import link_pose

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.topics import Service
    from trocar.simulation import World
    from trocar.simulation.arm import Arm

Array = NDArray[np.float64]
Answer = dict[str, Any]

#: Source: CRTK as the dVRK 2.4 tells it.
CRTK_VERSION = "1.1.0"
#: Joints 3 and 4 of a master hang on its motors 2 and 3. Source: SAW share/kinematic/MTML.json.
MTM_ACTUATORS = np.eye(7)
MTM_ACTUATORS[2, 1] = -1.0
MTM_ACTUATORS[3, 1:3] = 0.6697, -0.6697


def answer(core: Core, service: Service, request: Message, timeout_s: float = 5.0) -> Answer:
    """Answer a call; from any thread but the loop's.

    Raises:
        InputError: what is wrong with the request, or no answer in time
    """
    reply = ANSWERS.get(service.key)
    if reply is None:
        raise InputError(f"{service.name}: is not answered")

    def ask(world: World) -> Answer:
        found = reply(world.arm(service.arm), request)
        if "operating_state" in found:
            state = found["operating_state"]
            state["is_busy"] |= core.incoming.waits(service.arm)
            state["header"] = {"stamp": core.stamper.stamp(), "frame_id": ""}
        return found

    if not core.loop.running:
        return ask(core.loop.world)
    late = InputError(f"{service.name}: no answer within {timeout_s:g} s")
    if not core.incoming.asking.acquire(timeout=timeout_s):
        raise late
    try:
        return core.loop.ask(ask).result(timeout_s)
    except (FutureTimeoutError, CancelledError):
        raise late from None
    finally:
        core.incoming.asking.release()


def _forward(local: bool) -> Callable[[Arm, Message], Answer]:
    def answer(arm: Arm, request: Message) -> Answer:
        """Return the pose of the link that as many joints lead to as there are numbers."""
        try:
            q = vector(request, "jp")
            T = _link(arm, q)
            if not local:
                T = arm.base_frame()[0] @ T
        except TrocarError as problem:
            return {"cp": _pose(np.eye(4)), "result": False, "message": str(problem)}
        return {"cp": _pose(T), "result": True, "message": ""}

    return answer


def _link(arm: Arm, q: Array) -> Array:
    own = arm.description.own_joints
    if len(q) > own:
        names = arm.joint_names[:own]
        raise InputError(
            f"got {len(q)} numbers in jp; allowed: up to {own}, for {', '.join(names)}"
        )
    if len(q) == own:
        return inverse(arm.base_frame()[0]) @ arm.forward_kinematics(q).T
    return link_pose(arm.description.mechanism, arm.description.inverse_kinematics, q)


def _inverse(arm: Arm, request: Message) -> Answer:
    """Return the joints nearest to those of the request, or to the set-points without any."""
    try:
        seed = vector(request, "jp")
        q = arm.inverse_kinematics(pose(request, "cp"), seed if len(seed) else None)
    except TrocarError as problem:
        return {"jp": np.zeros(0), "result": False, "message": str(problem)}
    return {"jp": q, "result": True, "message": ""}


def _version(arm: Arm, request: Message) -> Answer:  # noqa: ARG001  as every answer
    return {"success": True, "message": CRTK_VERSION}


def _state(arm: Arm, request: Message) -> Answer:  # noqa: ARG001
    """Return the operating state; whoever sends it adds the header."""
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
        which = [arm.joint_names.index(name) for name in described.coupling.joints]
        A[np.ix_(which, which)] = described.coupling.actuator_to_joint
    return A


def _pose(T: Array) -> Message:
    w, x, y, z = (float(v) for v in quaternion_from_matrix(T[:3, :3]))
    return {
        "position": dict(zip("xyz", (float(v) for v in T[:3, 3]), strict=True)),
        "orientation": {"x": x, "y": y, "z": z, "w": w},
    }


#: {service without the arm's name: its answer}.
ANSWERS: Mapping[str, Callable[[Arm, Message], Answer]] = {
    "forward_kinematics": _forward(local=False),
    "local/forward_kinematics": _forward(local=True),
    "inverse_kinematics": _inverse,
    "operating_state": _state,
    "crtk_version": _version,
    "actuator_to_joint_position": _joints_of_actuators,
}
