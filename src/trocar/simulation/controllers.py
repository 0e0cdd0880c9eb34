"""Controllers that compute an arm's efforts from its state, at every physics step while active.

A controller gets joint positions and velocities without the jaw, and the tip's pose; it answers
with efforts, and with set-points of joints that stay under position control.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, TrocarError
from trocar.geometry.rotations import check_rotation, rotation_vector_from_matrix

Array = NDArray[np.float64]
#: "body": at the tip in the tip's axes; "spatial": about the reference frame's origin in its axes.
WrenchFrame = Literal["body", "spatial"]


@dataclass(frozen=True, eq=False)
class TipState:
    """State of an arm, for a controller; n joints without the jaw.

    Attributes:
        q, qd: joint positions and velocities, (n,) [rad or m, per s]
        T: tip in the frame of measured_cp, (4, 4)
        base: the arm's reference frame in that frame, (4, 4)
        body, spatial: Jacobians in the tip's and the reference frame, (6, n)
        time: simulation time [s]
    """

    q: Array
    qd: Array
    T: Array
    base: Array
    body: Array
    spatial: Array
    time: float = 0.0


@dataclass(frozen=True, eq=False)
class Action:
    """Output of a controller: efforts, summed over controllers, and set-points, NaN where none.

    All are (n,); set-points may have velocities.
    """

    effort: Array
    position: Array | None = None
    velocity: Array | None = None


class Controller(Protocol):
    """Computes efforts at every physics step while active."""

    def act(self, now: TipState) -> Action:
        """Return efforts (and set-points) for the next step."""
        ...


class ControllerError(TrocarError):
    """A controller of another package that raised, or answered with no efforts."""


@dataclass(frozen=True, eq=False)
class RegisteredController:
    """A controller of an installed package, whose answers are checked.

    Attributes:
        name: as the package registers it
        inner: the controller
    """

    name: str
    inner: Controller

    def act(self, now: TipState) -> Action:
        """Return the controller's action, checked.

        Raises:
            ControllerError: it raises, or its efforts are not (n,) finite numbers
        """
        try:
            action = self.inner.act(now)
            efforts = np.asarray(action.effort, dtype=np.float64)
        except Exception as problem:
            what = f"{type(problem).__name__}: {problem}"
            raise ControllerError(f"controller {self.name}: {what}") from problem
        if efforts.shape != now.q.shape or not np.isfinite(efforts).all():
            raise ControllerError(
                f"controller {self.name}: got efforts {efforts.tolist()}; allowed: {len(now.q)}"
                " finite numbers"
            )
        return action


@dataclass(frozen=True, eq=False)
class CartesianForce:
    """A constant wrench that the arm exerts at its tip: tau = J^T w.

    Attributes:
        wrench: (force; torque), (6,) [N, N m]
        frame: where it is expressed
        absolute: with "body": it acts at the tip, but in the axes of the frame of measured_cp
    """

    wrench: Array
    frame: WrenchFrame
    absolute: bool = False

    def act(self, now: TipState) -> Action:
        """Return the joint efforts of the wrench where the arm is now."""
        if self.frame == "spatial":
            return Action(now.spatial.T @ self.wrench)
        if not self.absolute:
            return Action(now.body.T @ self.wrench)
        back = now.T[:3, :3].T
        return Action(now.body.T @ np.concatenate([back @ self.wrench[:3], back @ self.wrench[3:]]))


def _zeros() -> Array:
    return np.zeros(3)


@dataclass(frozen=True, eq=False)
class HalfPlaneGains:
    """Gains on one side of each axis, (3,) each; crtk_msgs/CartesianImpedanceHalfPlaneGains.

    Attributes:
        p: [N/m or N m/rad], negative pulls back
        d: [N s/m or N m s/rad], negative damps
        bias: [N or N m]
        deadband: errors smaller than this count as none [m or rad]
    """

    p: Array = field(default_factory=_zeros)
    d: Array = field(default_factory=_zeros)
    bias: Array = field(default_factory=_zeros)
    deadband: Array = field(default_factory=_zeros)


#: Fields of `CartesianImpedance` and of `HalfPlaneGains`.
SIDES = tuple(
    f"{of}_{way}" for of in ("position", "orientation") for way in ("positive", "negative")
)
GAINS = ("p", "d", "bias", "deadband")


@dataclass(frozen=True, eq=False)
class CartesianImpedance:
    """A spring, damper and bias about a pose, in the frame of measured_cp.

    Source: crtk_msgs/CartesianImpedance (names); the dVRK's examples (gains are negative).

    Attributes:
        force_position: where the springs pull to, (3,) [m]
        force_orientation: axes of the springs, (3, 3)
        torque_orientation: orientation that the springs turn to, and their axes, (3, 3)
        position_positive, position_negative: gains where the error along an axis is above or below
        orientation_positive, orientation_negative: the same about an axis
    """

    force_position: Array
    force_orientation: Array = field(default_factory=lambda: np.eye(3))
    torque_orientation: Array = field(default_factory=lambda: np.eye(3))
    position_positive: HalfPlaneGains = field(default_factory=HalfPlaneGains)
    position_negative: HalfPlaneGains = field(default_factory=HalfPlaneGains)
    orientation_positive: HalfPlaneGains = field(default_factory=HalfPlaneGains)
    orientation_negative: HalfPlaneGains = field(default_factory=HalfPlaneGains)

    def check(self, largest: float) -> None:
        """Check every number.

        Raises:
            InputError: one that is not finite or larger, a wrong shape, axes that are no rotation,
                a deadband below 0
        """
        check_rotation(self.force_orientation, "force_orientation")
        check_rotation(self.torque_orientation, "torque_orientation")
        vectors: dict[str, Array] = {"force_position": self.force_position}
        for side in SIDES:
            gains = getattr(self, side)
            vectors |= {f"{side}.{name}": getattr(gains, name) for name in GAINS}
        for name, value in vectors.items():
            if np.shape(value) != (3,) or not (np.abs(value) <= largest).all():
                raise InputError(
                    f"{name}: got {value!r}; allowed: 3 finite numbers, magnitude up to {largest:g}"
                )
            if name.endswith("deadband") and np.min(value) < 0.0:
                raise InputError(f"{name}: got {value!r}; allowed: 0 or more")

    def act(self, now: TipState) -> Action:
        """Return the joint efforts of springs and dampers where the arm is now."""
        R = now.T[:3, :3]
        twist = now.body @ now.qd
        F, G = self.force_orientation, self.torque_orientation
        force = _half_plane(
            F.T @ (now.T[:3, 3] - self.force_position),
            F.T @ R @ twist[:3],
            self.position_positive,
            self.position_negative,
        )
        torque = _half_plane(
            rotation_vector_from_matrix(G.T @ R),
            G.T @ R @ twist[3:],
            self.orientation_positive,
            self.orientation_negative,
        )
        return Action(now.body.T @ np.concatenate([R.T @ F @ force, R.T @ G @ torque]))


def _half_plane(
    error: Array, rate: Array, positive: HalfPlaneGains, negative: HalfPlaneGains
) -> Array:
    above = error > 0.0

    def side(up: Array, down: Array) -> Array:
        return np.where(above, up, down)

    band = side(positive.deadband, negative.deadband)
    beyond = np.sign(error) * np.maximum(np.abs(error) - band, 0.0)
    gains = side(positive.p, negative.p), side(positive.d, negative.d)
    effort = gains[0] * beyond + gains[1] * rate + side(positive.bias, negative.bias)
    return np.where(np.abs(error) > band, effort, 0.0)
