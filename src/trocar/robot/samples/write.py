"""Write sample files: copies of those beside this one, and recordings of a simulated PSM."""

from __future__ import annotations

import gzip
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import MissingExtraError
from trocar.recording.mcap_file import JOINT_STATE
from trocar.simulation import World
from trocar.simulation.records import Recording

Array = NDArray[np.float64]

ARM = "PSM1"
#: Sample rate [Hz], duration [s] and base frequency of the motion [Hz]. Source: our own choice; the
#: rate is that of the dVRK's logs.
RATE_HZ, DURATION_S, FREQUENCY_HZ = 200.0, 8.0, 0.125
#: Middle and amplitude [rad or m] and frequency of the motion of each joint. Source: our own
#: choice; joints that swing at different rates excite the dynamics enough to identify them.
START = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.2)
SWING = (0.3, -0.25, 0.05, 0.5, 0.3, -0.3, 0.2)
SWINGS = (3, 4, 5, 7, 6, 8, 9)
#: Joints that logs have as motor positions. Source: dvrk_dynamics_identification.
MOTOR_SIDE = ("wrist_pitch", "wrist_yaw", "jaw")
#: Stamp of the bag's first message [ns]. Source: our own choice, the size of the dVRK's stamps.
BEGIN_NS = 1_700_000_000 * 10**9


def write_samples(folder: Path) -> dict[str, str]:
    """Write a PSM's log, a bag of the same motion, a URDF and a lab's configuration.

    Args:
        folder: exists; files of the same names are replaced

    Returns:
        {file name: what it is}

    Raises:
        MissingExtraError: rosbags is not installed (extra bags)
    """
    moved = _move()
    _write_log(folder / "psm_log.csv.gz", moved)
    _write_bag(folder / "psm.bag", moved)
    here = Path(__file__).parent
    shutil.copyfile(here / "pointer.urdf", folder / "pointer.urdf")
    shutil.copytree(here / "lab", folder / "lab", dirs_exist_ok=True)
    return {
        "psm_log.csv.gz": "log of a simulated PSM: positions, velocities, efforts",
        "psm.bag": "rosbag of the same simulated motion, of arm PSM1",
        "pointer.urdf": "URDF of a robot with two joints",
        "lab/system-lab.json": "example of a lab's dVRK configuration, with its other files",
    }


def _move() -> Recording:
    """Simulate a PSM whose joints swing, and sample it.

    Set-points are new in each step: of efforts that follow steps of 5 ms, samples show one phase.
    """
    world = World("psm")
    every = round(1.0 / RATE_HZ / world.timestep)
    omega = 2.0 * np.pi * FREQUENCY_HZ * np.array(SWINGS)
    angle = np.outer(np.arange(round(DURATION_S / world.timestep)) * world.timestep, omega)
    positions = np.array(START) + (1.0 - np.cos(angle)) * SWING
    velocities = np.sin(angle) * omega * SWING
    world.set_state(ARM, positions[0])
    moved = world.play({ARM: positions}, {ARM: velocities}, every=1)
    kept = ("positions", "velocities", "efforts", "coordinates")
    samples = {name: {ARM: getattr(moved, name)[ARM][::every]} for name in kept}
    return replace(moved, time=moved.time[::every], **samples)


def _write_log(path: Path, moved: Recording) -> None:
    """Write a row per sample: positions, velocities, efforts; wrist and jaw motor-side."""
    arm = World("psm").rig.arm(ARM).arm
    position, velocity, effort = (
        samples[ARM].copy() for samples in (moved.positions, moved.velocities, moved.efforts)
    )
    if arm.coupling is not None:
        joints = [arm.mechanism.joint_index[name] for name in MOTOR_SIDE]
        coupled = [arm.coupling.joints.index(name) for name in MOTOR_SIDE]
        joint_from_motor = arm.coupling.actuator_to_joint[np.ix_(coupled, coupled)]
        motor_from_joint = np.linalg.inv(joint_from_motor)
        position[:, joints] = position[:, joints] @ motor_from_joint.T
        velocity[:, joints] = velocity[:, joints] @ motor_from_joint.T
        effort[:, joints] = effort[:, joints] @ joint_from_motor
    rows = np.hstack([position, velocity, effort])
    text = "".join(",".join(f"{value:.9g}" for value in row) + "\n" for row in rows)
    path.write_bytes(gzip.compress(text.encode(), mtime=0))


def _write_bag(path: Path, moved: Recording) -> None:
    """Write a ROS 1 bag with the joints and the jaw on topics of their own, as the dVRK has."""
    try:
        from rosbags.rosbag1 import Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingExtraError("rosbags", "bags", "writing a sample bag") from None
    store = get_typestore(Stores.ROS1_NOETIC)
    kinds: Any = store.types
    names = World("psm").rig.arm(ARM).arm.mechanism.joint_names
    topics = {f"/{ARM}/measured_js": slice(0, 6), f"/{ARM}/jaw/measured_js": slice(6, 7)}
    path.unlink(missing_ok=True)
    with Writer(path) as writer:
        to = {topic: writer.add_connection(topic, JOINT_STATE, typestore=store) for topic in topics}
        for k, time in enumerate(moved.time):
            ns = BEGIN_NS + round(1e9 * float(time))
            stamp = kinds["builtin_interfaces/msg/Time"](*divmod(ns, 10**9))
            header = kinds["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="")
            for topic, part in topics.items():
                quantities = (moved.positions, moved.velocities, moved.efforts)
                values = (np.array(quantity[ARM][k, part]) for quantity in quantities)
                message = kinds[JOINT_STATE](header, list(names[part]), *values)
                writer.write(to[topic], ns, store.serialize_ros1(message, JOINT_STATE))
