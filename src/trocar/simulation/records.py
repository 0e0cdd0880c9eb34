"""Frozen copies of a world's state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError
from trocar.geometry.se3 import check_transform
from trocar.modeling.build import RigModel

Array = NDArray[np.float64]
Mode = Literal["position", "effort", "set"]

#: No object or tip is put farther from the origin. Source: our own choice; MuJoCo calls a position
#: of 1e10 diverged. [m]
FARTHEST_M = 1e3


class JointState(NamedTuple):
    """Joint positions, velocities and efforts at a time [rad or m, per s, N m or N, s]."""

    name: tuple[str, ...]
    position: Array
    velocity: Array
    effort: Array
    time: float


class Pose(NamedTuple):
    """A pose, `matrix` (4, 4), in the frame `frame_id` at a time [s]."""

    matrix: Array
    frame_id: str
    time: float


class Twist(NamedTuple):
    """A velocity: of a point and of rotation, (3,) each, in axes of `frame_id` [m/s, rad/s]."""

    linear: Array
    angular: Array
    frame_id: str
    time: float


class Wrench(NamedTuple):
    """A force and a torque, (3,) each, in `frame_id` [N, N m]."""

    force: Array
    torque: Array
    frame_id: str
    time: float


class ArmSnapshot(NamedTuple):
    """One arm at a time; arrays follow `joint_names`, the jaw last."""

    joint_names: tuple[str, ...]
    q: Array
    qd: Array
    effort: Array
    setpoint: Array
    modes: tuple[Mode, ...]
    locked: tuple[bool, ...]
    busy: bool
    remote_centre: Array | None
    warnings: int
    last_warning: str
    state: str = "ENABLED"
    homed: bool = True
    tool: str = ""


@dataclass(frozen=True, eq=False)
class ArmStatus:
    """The part of an arm's state that only commands and events change.

    Attributes:
        balanced: whether gravity compensation is on
        state, homed, busy: the operating state
        phase: within the operating state, as `OperatingState.phase`
        desired: where the last accepted state command or a fault leads
        base: as `set_base_frame` set it, T (4, 4) and frame; None where the rig determines it
        tool: name of the mounted tool, "" without one
        ratios: shares of the velocity and acceleration limits that moves keep to
        closed: whether a master's gripper is shut
        orientation_locked: whether a master's gimbal holds an orientation
        brakes_locked: whether every brake is locked; False without brakes
    """

    balanced: bool
    state: str
    homed: bool
    busy: bool
    phase: str
    desired: str
    base: tuple[Array, str] | None
    tool: str
    ratios: tuple[float, float]
    closed: bool
    orientation_locked: bool
    brakes_locked: bool


class ArmSample(NamedTuple):
    """Source of an arm's readings.

    Attributes:
        status: the same object until something in it may have changed
        joints: measured positions, velocities and efforts, efforts that hold the links' weight,
            set-points of positions, velocities and efforts, (7, n) [rad or m, per s, N m or N]
    """

    status: ArmStatus
    joints: Array

    @property
    def q(self) -> Array:
        """Measured positions, (n,) [rad or m]."""
        return self.joints[0]

    @property
    def qd(self) -> Array:
        """Measured velocities, (n,) [rad/s or m/s]."""
        return self.joints[1]

    @property
    def effort(self) -> Array:
        """Measured efforts, (n,) [N m or N]."""
        return self.joints[2]

    @property
    def load(self) -> Array:
        """Efforts that hold the links' weight, (n,) [N m or N]."""
        return self.joints[3]

    @property
    def setpoint_q(self) -> Array:
        """Set-points of positions, (n,) [rad or m]."""
        return self.joints[4]

    @property
    def setpoint_qd(self) -> Array:
        """Set-points of velocities, (n,) [rad/s or m/s]."""
        return self.joints[5]

    @property
    def setpoint_effort(self) -> Array:
        """Set-points of efforts, (n,) [N m or N]."""
        return self.joints[6]


@dataclass(frozen=True, eq=False)
class WorldSample:
    """Source of a world's readings, copied in a few microseconds.

    Attributes:
        time: simulation time [s]
        model: the rig with its tools, as compiled then; nothing writes to it
        qpos: MuJoCo's coordinates, (nq,)
        arms: {name: what else its readings are computed from}
        reference_arm: arm on setup joints whose tip frame the poses of the others are in
        registration: where cameras' frames are reported, {arm: (4, 4)}, None: where they are; the
            same mapping until the next reset
    """

    time: float
    model: RigModel
    qpos: Array
    arms: Mapping[str, ArmSample]
    reference_arm: str
    registration: Mapping[str, Array] | None = None


@dataclass(frozen=True, eq=False)
class TrueState:
    """True state of an arm, whatever its sensors report.

    Attributes:
        q, qd: joint positions and velocities, (n,) [rad or m, per s]
        effort: of the motors, (n,) [N m or N]
        cp: pose of the tip, in the true frame of `measured_cp`
        world: the same in the world, (4, 4)
    """

    q: Array
    qd: Array
    effort: Array
    cp: Pose
    world: Array


class DrawnSurface(NamedTuple):
    """A surface that bends, as tissue: triangles in the world at one time.

    Only the front of a triangle is seen, from where its corners run anticlockwise. Shading is
    smooth across shared vertices; an edge is sharp where its vertices are doubled.

    Attributes:
        name: in id images
        vertices: in the world, (n, 3) [m]
        faces: (m, 3); the same array object while the triangles stay the same
        rgba, gloss, metal: as of `ShapeRecord`
        material: "tissue" where its surface has that structure, "" without
        rest: vertices before it bent, to which that structure sticks, (n, 3) [m]; the vertices when
            omitted
    """

    name: str
    vertices: Array
    faces: NDArray[np.integer]
    rgba: tuple[float, float, float, float] = (0.75, 0.35, 0.32, 1.0)
    gloss: float = 0.4
    metal: float = 0.0
    material: str = ""
    rest: Array | None = None


class DrawnCurve(NamedTuple):
    """A round line that bends, as a thread: points in the world at one time.

    Attributes:
        name: in id images
        points: in the world, (k, 3), k > 1 [m]
        radius: [m]
        rgba, gloss, metal: as of `ShapeRecord`
    """

    name: str
    points: Array
    radius: float
    rgba: tuple[float, float, float, float] = (0.15, 0.1, 0.45, 1.0)
    gloss: float = 0.3
    metal: float = 0.0


Drawing = DrawnSurface | DrawnCurve


class Snapshot(NamedTuple):
    """A world at a time: where every body is, and every arm.

    `build` counts how often the rig was compiled: bodies of another build are others, as after an
    exchange of a tool. `arms` is empty where they were not requested. The rods that draw elastic
    bands follow the model's bodies. `drawings` are those of `World.draw`.
    """

    time: float
    positions: Array
    quaternions: Array
    arms: Mapping[str, ArmSnapshot]
    build: int = 1
    drawings: tuple[Drawing, ...] = ()


@dataclass(frozen=True)
class ArmHealth:
    """Errors of an arm's loops.

    Attributes:
        loop_gap_m: largest distance between the two sides of a closing hinge [m]
        rcm_error_m: distance of the shaft's line from the remote centre [m], NaN without one
        branch_ok: whether every loop is on the branch it was built on
        flattening_margin_rad: distance of the joint range from a flat loop [rad], inf without loops
        rcm_wander_m: how much of rcm_error_m the arm's own geometry may account for: the largest
            over the joint range, loops closed. 0 to rounding on a nominal arm, 0 without a centre
    """

    loop_gap_m: float
    rcm_error_m: float
    branch_ok: bool
    flattening_margin_rad: float
    rcm_wander_m: float = 0.0


@dataclass(frozen=True)
class Health:
    """The worst over all arms, and each arm's."""

    loop_gap_m: float
    rcm_error_m: float
    branch_ok: bool
    flattening_margin_rad: float
    per_arm: Mapping[str, ArmHealth]
    rcm_wander_m: float = 0.0

    @classmethod
    def of(cls, per_arm: Mapping[str, ArmHealth]) -> Health:
        """Return the worst of arms' health, {arm: its own}."""
        each = per_arm.values()
        rcm = [h.rcm_error_m for h in each if np.isfinite(h.rcm_error_m)]
        return cls(
            max((h.loop_gap_m for h in each), default=0.0),
            max(rcm, default=0.0),
            all(h.branch_ok for h in each),
            min((h.flattening_margin_rad for h in each), default=np.inf),
            per_arm,
            max((h.rcm_wander_m for h in each), default=0.0),
        )


@dataclass(frozen=True, eq=False)
class ShapeRecord:
    """A shape to draw: on which body, how big, which colour; pieces that only touch are left out.

    `size` as in `descriptions.Shape`: half edges of a box, (radius, half length, 0) of a capsule
    or cylinder, (radius, 0, 0) of a sphere, farthest from its origin of a mesh [m]. `triangles`
    of a mesh: vertices (n, 3) [m] and faces (m, 3); `normals`: its surface's at the vertices.
    `material`: name of a row of `descriptions.materials`.
    """

    body: int
    name: str
    kind: str
    size: Array
    pose: Array
    rgba: tuple[float, float, float, float]
    gloss: float
    metal: float
    rounding: float
    arm: str | None
    frame: str
    collide: bool
    triangles: tuple[Array, NDArray[np.int64]] | None = None
    normals: Array | None = None
    material: str = ""


@dataclass(frozen=True, eq=False)
class Recording:
    """Samples of a played trajectory.

    Attributes:
        time: (k,) [s]
        positions, velocities, efforts: {arm: (k, n_joints)}
        coordinates: {arm: (k, n_frames)}: every frame's own coordinate, as the simulation had it
        clipped: {arm: number of samples that lay beyond a limit}
    """

    time: Array
    positions: Mapping[str, Array]
    velocities: Mapping[str, Array]
    efforts: Mapping[str, Array]
    coordinates: Mapping[str, Array]
    clipped: Mapping[str, int]


def checked_pose(name: str, T: ArrayLike) -> Array:
    """Return a pose that is given to an object or an arm, (4, 4).

    Raises:
        InputError: no pose, or one too far away
    """
    try:
        at = check_transform(T, f"{name}: pose")
    except (TypeError, ValueError, OverflowError) as problem:
        raise InputError(f"{name}: got the pose {T!r}; allowed: (4, 4) finite numbers") from problem
    if at.shape != (4, 4):
        raise InputError(f"{name}: got a pose of shape {at.shape}; allowed: (4, 4)")
    place: list[float] = at[:3, 3].tolist()
    if max(map(abs, place)) > FARTHEST_M:
        raise InputError(f"{name}: got a pose at {place} m; allowed: up to {FARTHEST_M:g} m away")
    return at
