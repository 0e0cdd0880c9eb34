"""Visual servoing: an ECM that keeps an object in the middle of its pictures, and at a depth.

Both eyes' pixels of the object give its place in the camera, p = (x, y, z), and the joints at the
picture's stamp its place in the arm's base, where an alpha-beta filter follows it. With the joints
of now, the error

    e = (x/z, y/z, ln(z / depth))

is driven to 0 by joint velocities that solve L J qd = -gain e - L (its own velocity), L being the
interaction matrix of e and J the camera's Jacobian; damped and weighted, as there are four joints
for three errors. Source: Chaumette and Hutchinson, "Visual servo control, part I", 2006.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.cameras import StereoCalibration
from trocar.descriptions import ArmDescription
from trocar.errors import InputError
from trocar.geometry import adjoint, inverse, skew, transform_points
from trocar.inputs import check_numbers, check_type
from trocar.kinematics import jacobian_body, pose
from trocar.tasks.vision.eyes import Eyes, checked_pose

Array = NDArray[np.float64]

#: The filter's gains of position and velocity. Source: prototypes on the simulated endoscope, tried
#: at 30 and 60 Hz: 0.5 px of noise stays below 0.5 px, an object at 10 mm/s below 8 px.
ALPHA, BETA = 0.5, 0.1
#: Weights of the three errors, and costs of the joints: a roll is avoided, a metre of insertion
#: counts as 6.7 rad. Source: our own choice.
ERRORS = np.array([1.0, 1.0, 0.3])
JOINTS = np.array([1.0, 1.0, 0.15, 1.5])
#: Damping of the least squares. Source: our own choice.
DAMPING = 1e-5


@dataclass(frozen=True)
class ServoSettings:
    """Settings of a visual servo.

    Attributes:
        depth: from the camera [m]
        gain: of the errors in the picture; half of it for the depth [1/s]
        lost_after: time without a picture of the object after which the arm stops [s]
    """

    depth: float = 0.1
    gain: float = 6.0
    lost_after: float = 0.5

    def __post_init__(self) -> None:
        for name, low, high in (
            ("depth", 0.005, 1.0),
            ("gain", 0.1, 20.0),
            ("lost_after", 0.0, 60.0),
        ):
            check_numbers(getattr(self, name), (), name, low, high)


class VisualServo:
    """Joint velocities of an ECM that centre an object.

    Args:
        arm: the ECM
        calibration: its eyes, with lenses
        T_tip_left: the left eye in the arm's tip frame, (4, 4), as of `trocar calibrate-camera`
        settings: depth and gain

    Raises:
        InputError: an arm that is not an ECM
    """

    def __init__(
        self,
        arm: ArmDescription,
        calibration: StereoCalibration,
        T_tip_left: Array,
        settings: ServoSettings | None = None,
    ) -> None:
        if check_type(arm, ArmDescription, "arm").type != "ECM":
            raise InputError(f"{arm.name}: is of type {arm.type}; allowed: an ECM")
        self.settings = check_type(
            ServoSettings() if settings is None else settings, ServoSettings, "settings"
        )
        self._arm, self._eyes, self._both = arm, calibration, Eyes(calibration)
        self._mount = checked_pose(T_tip_left, "T_tip_left") @ inverse(calibration.mounts[0])
        joints = arm.joints
        self._fastest = np.array([joint.velocity_max for joint in joints])
        self._steepest = np.array([joint.acceleration_max for joint in joints])
        self._seen: tuple[float, Array, Array] | None = None  # time, place and velocity in the base
        self._velocity = np.zeros(len(joints))
        self._time: float | None = None

    def see(self, time: float, q: ArrayLike, left: ArrayLike, right: ArrayLike) -> Array:
        """Take in the object's pixels in both eyes.

        Args:
            time: stamp of the pictures, later than of those before [s]
            q: joint positions at that time, (4,) [rad or m]
            left, right: of the object, (2,) [px]

        Returns:
            its place in the camera's frame, (3,) [m]

        Raises:
            InputError: pictures out of order, pixels outside the picture, or a point that is not
                ahead of both eyes (eyes exchanged?)
        """
        time = float(check_numbers(time, (), "time of the pictures [s]"))
        p = self._triangulated(*(check_numbers(pixel, (2,), "pixel") for pixel in (left, right)))
        q = check_numbers(q, (len(self._velocity),), "joint positions")
        at = (pose(self._arm.mechanism, q) @ self._mount @ np.append(p, 1.0))[:3]
        if self._seen is None or time - self._seen[0] > self.settings.lost_after:
            self._seen = time, at, np.zeros(3)
            return p
        before, place, velocity = self._seen
        if time <= before:
            raise InputError(f"pictures: got {time:g} s after {before:g} s; allowed: in order")
        expected = place + velocity * (time - before)
        miss = at - expected
        self._seen = time, expected + ALPHA * miss, velocity + BETA / (time - before) * miss
        return p

    def velocity(self, time: float, q: ArrayLike) -> Array:
        """Return joint velocities for `servo_jv`, (4,) [rad/s or m/s]; within all limits.

        They brake to 0 while the object is not seen.

        Args:
            time: now [s]; called every few milliseconds
            q: joint positions now, (4,) [rad or m]
        """
        time = float(check_numbers(time, (), "time [s]"))
        q = check_numbers(q, (len(self._velocity),), "joint positions")
        period = 0.0 if self._time is None else max(time - self._time, 0.0)
        self._time = time
        wanted = self._wanted(time, q)
        wanted = wanted / max(1.0, float(np.abs(wanted / self._fastest).max()))
        step = self._steepest * period
        wanted = np.clip(wanted, self._velocity - step, self._velocity + step)
        # So much that the arm can still brake before a limit.
        limits = self._arm.mechanism
        room = np.maximum(np.stack([q - limits.lower, limits.upper - q]), 0.0)
        slowest, fastest = np.sqrt(2.0 * self._steepest * room)
        self._velocity = np.clip(wanted, -slowest, fastest)
        return self._velocity.copy()

    def _wanted(self, time: float, q: Array) -> Array:
        if self._seen is None or time - self._seen[0] > self.settings.lost_after:
            return np.zeros(len(q))
        stamp, place, drift = self._seen
        T = pose(self._arm.mechanism, q) @ self._mount
        to_camera = inverse(T)
        x, y, z = p = (to_camera @ np.append(place + drift * (time - stamp), 1.0))[:3]
        if z <= 0.0:
            return np.zeros(len(q))
        J = adjoint(inverse(self._mount)) @ jacobian_body(self._arm.mechanism, q)
        by_point = np.array([[1.0 / z, 0.0, -x / z**2], [0.0, 1.0 / z, -y / z**2], [0, 0, 1.0 / z]])
        gain = self.settings.gain * np.array([1.0, 1.0, 0.5])
        error = np.array([x / z, y / z, np.log(z / self.settings.depth)])
        goal = ERRORS * (-gain * error - by_point @ to_camera[:3, :3] @ drift)
        A = ERRORS[:, None] * (by_point @ np.hstack([-np.eye(3), skew(p)]) @ J)
        cheap = A * JOINTS**2
        return np.asarray(cheap.T @ np.linalg.solve(cheap @ A.T + DAMPING * np.eye(3), goal))

    def _triangulated(self, left: Array, right: Array) -> Array:
        """Return the point nearest to both eyes' rays, in the camera's frame, (3,) [m]."""
        for pixel, eye in zip((left, right), self._eyes.eyes, strict=True):
            if (np.abs(pixel - 0.5 * np.array(eye.size)) > 0.5 * np.array(eye.size) + 0.5).any():
                raise InputError(
                    f"pixel: got {pixel.tolist()}; allowed: within {eye.width}x{eye.height}. Are"
                    " the pictures of another size than the calibration?"
                )
        return transform_points(self._eyes.mounts[0], self._both.triangulate(left, right))
