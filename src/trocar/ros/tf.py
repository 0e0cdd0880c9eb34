"""Frames and hinges for viewers of ROS: tf, joint_states, the clock.

Each eye of a camera has a frame: x right, y down, z ahead. An eye at an arm's tip is fixed in the
arm's frame, and one of the room in the world; both are published once. Others go out with every
image.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.records import bend
from trocar.descriptions.records import RigDescription
from trocar.kinematics.forward import pose
from trocar.kinematics.mechanism import Mechanism
from trocar.ros import message_builders as build
from trocar.ros.clock import Stamp
from trocar.ros.robot_model import WORLD, fixed_frames, hinge_states
from trocar.ros.sample import SampleReadings
from trocar.ros.topic import JOINTS, STRING, Message, Topic, latched, state
from trocar.simulation.cameras import CameraRecord

Array = NDArray[np.float64]
#: Parent, child, and the child's pose in the parent (4, 4).
Frame = tuple[str, str, Array]
TF = "tf2_msgs/TFMessage"
EYES = ("left", "right")


def frame_name(camera: str, eye: str = "") -> str:
    """Return the name of an eye's frame."""
    return f"{camera}_{eye}_frame" if eye else f"{camera}_frame"


def eyes_of(kind: str) -> tuple[str, ...]:
    """Return the eyes of a kind of camera."""
    return EYES if kind == "endoscope" else ("",)


def _tf(readings: SampleReadings, stamp: Stamp) -> Message:
    """Return arms' bases and tips in the frames of their poses, and objects; nothing fixed."""
    found: dict[str, Message] = {}
    sample = readings.sample
    fixed = fixed_frames(sample.rig)

    def add(parent: str, child: str, T: Array) -> None:
        if child not in found and child not in fixed and child != parent:
            found[child] = build.transform_stamped(stamp, parent, child, T)

    for rig_arm in sample.rig.arms:
        arm = readings.arm(rig_arm.name)
        base, frame = arm.base
        if frame == arm.own_frame:
            add(WORLD, frame, arm.reference_in_world)
        add(frame, arm.own_frame, base)
        add(frame, rig_arm.name, arm.measured)
    for name, at in sample.scene.object_poses().items():
        add(WORLD, name, at)
    for name, record in sample.cameras.items():
        if not _carrier(sample.rig, record):
            for frame in _eyes(WORLD, record, record.T_world_camera, name):
                add(*frame)
    return {"transforms": list(found.values())}


def tf_static(rig: RigDescription, stamp: Stamp, cameras: Mapping[str, CameraRecord]) -> Message:
    """Return the fixed frames: the roots of `tf`, and eyes that are fixed in one of its frames."""
    found = [(WORLD, name, at) for name, at in fixed_frames(rig).items()]
    for name, record in cameras.items():
        parent = _carrier(rig, record)
        if parent:
            found += _eyes(parent, record, _mounted(rig, record), name)
    return {"transforms": [build.transform_stamped(stamp, *frame) for frame in found]}


def _carrier(rig: RigDescription, record: CameraRecord) -> str:
    """Return the frame of tf in which a camera is fixed, "" without one."""
    if not record.arm:
        return WORLD
    mechanism = rig.arm(record.arm).arm.mechanism
    together = _moved_by(mechanism, record.frame) == _moved_by(mechanism, mechanism.tip)
    return record.arm if together else ""


def _moved_by(mechanism: Mechanism, frame: str) -> int:
    """Return the last frame before this one, or it, that moves in its parent."""
    chain = mechanism.chain(frame)
    return next((i for i in reversed(chain) if mechanism.frames[i].motion != "fixed"), chain[0])


def _mounted(rig: RigDescription, record: CameraRecord) -> Array:
    """Return the pose of a camera in the frame of tf that carries it, (4, 4)."""
    described = next(camera for camera in rig.cameras if camera.name == record.name)
    T_frame_camera = described.pose @ bend(record.angle)
    if not record.arm:
        return T_frame_camera
    mechanism = rig.arm(record.arm).arm.mechanism
    rest = np.zeros(len(mechanism.joints))
    return pose(mechanism, rest, record.frame, mechanism.tip) @ T_frame_camera


def _eyes(parent: str, record: CameraRecord, T_parent_camera: Array, name: str) -> Iterator[Frame]:
    for eye, mount in zip(eyes_of(record.kind), record.calibration.mounts, strict=True):
        yield parent, frame_name(name, eye), T_parent_camera @ mount


def _joint_states(readings: SampleReadings, stamp: Stamp) -> Message:
    """Return every hinge of the rig's URDF that follows no other."""
    arms = readings.sample.arms
    q, qd = ({name: getattr(arm, key) for name, arm in arms.items()} for key in ("q", "qd"))
    names, position, velocity = hinge_states(readings.sample.rig, q, qd)
    return build.joints(stamp, names, position, velocity, np.zeros(0))


def clock(readings: SampleReadings, stamp: Stamp) -> Message:  # noqa: ARG001  as every make
    """Return a rosgraph_msgs/Clock."""
    return {"clock": stamp}


def viewer_topics() -> tuple[Topic, ...]:
    """Return the topics of ROS viewers; `clock` has a maker only where time is simulated."""
    says = "simulated time, with --clock sim"
    return (
        state("tf", TF, "m, quaternion xyzw", "every frame in its parent", _tf, "tf"),
        latched("tf_static", TF, "the fixed frames", "m, quaternion xyzw"),
        state("joint_states", JOINTS, "rad, m", "every hinge of robot_description", _joint_states),
        latched("robot_description", STRING, "the rig as URDF"),
        state("clock", "rosgraph_msgs/Clock", "s", says, None, "clock"),
    )
