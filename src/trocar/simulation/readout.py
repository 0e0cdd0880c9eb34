"""Readings of the arms of a sampled world: each computed once, away from the physics."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import skew
from trocar.geometry.se3 import adjoint, inverse, relative
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.jacobian import jacobian_spatial
from trocar.modeling.build import RigModel
from trocar.simulation.controllers import WrenchFrame
from trocar.simulation.frames import Frames
from trocar.simulation.records import WorldSample

Array = NDArray[np.float64]

#: Singular values of a Jacobian below this share of the largest count as 0. Source: our own choice;
#: motors' efforts do not show directions in which a tip moves so little.
RCOND = 1e-9


def turned(R: Array, twist: Array) -> Array:
    """Turn both halves of twists (linear; angular) by rotations, (..., 6) by (..., 3, 3)."""
    return (
        (R @ twist.reshape(*twist.shape[:-1], 2, 3).swapaxes(-1, -2))
        .swapaxes(-1, -2)
        .reshape(twist.shape)
    )


def least_wrench(jacobian: Array, effort: Array) -> Array:
    """Compute the smallest wrench w with the least |J^T w - effort|, (..., 6).

    Directions weaker than RCOND are left out. Square matrices far from singular are inverted,
    which takes half the time.

    Args:
        jacobian: (linear; angular) = J @ qd, (..., 6, n)
        effort: (..., n) [N m or N]
    """
    A = jacobian.swapaxes(-1, -2)
    if A.shape[-2] == A.shape[-1]:
        try:
            back = np.linalg.inv(A)
        except np.linalg.LinAlgError:
            back = np.full_like(A, np.inf)
        if A.ndim == 2:  # one arm's, in few calls
            if np.vdot(A, A) * np.vdot(back, back) < RCOND**-2:
                return back.dot(effort)
        elif (np.square(A).sum((-2, -1)) * np.square(back).sum((-2, -1)) < RCOND**-2).all():
            return (back @ effort[..., None])[..., 0]
    return (np.linalg.pinv(A, rcond=RCOND) @ effort[..., None])[..., 0]


class PoseViews(NamedTuple):
    """Origins of the public poses of arms, arm by arm.

    Attributes:
        origins: rows of the origins among the sites of `Reader.measured`, (A,) of 2 A
        own: whether the origin is the arm's own reference frame, (A,)
        before: poses of the origins in the frames of public poses, (A, 4, 4)
        frames: names of these frames
        local: whether all public poses are those in the arms' own reference frames
    """

    origins: NDArray[np.intp]
    own: NDArray[np.bool_]
    before: Array
    frames: tuple[str, ...]
    local: bool


class Reader:
    """Reads samples of one compiled rig out, on an MjData of its own; in one thread at a time.

    Args:
        model: the compiled rig, which nothing writes to

    Attributes:
        model: as given
        names: of the arms, in the order of the rig
        prepared: {arm: its row among poses}, of arms whose poses are computed together: those whose
            loops are parallelograms
        moving: {arm: its row among Jacobians}: those of them that are no setup joints
        columns: joints of the widest of these, jaw or gripper left out
    """

    def __init__(self, model: RigModel) -> None:
        self.model = model
        rig, table, mj = model.rig, model.joints, model.mj
        self._state, self._posed = mujoco.MjData(mj), mujoco.MjData(mj)
        self._frames = frames = Frames(rig, table, mj, self._state)
        self.names = tuple(arm.name for arm in rig.arms)
        rows = {name: row for row, name in enumerate(self.names) if table.arms[name].parallel}
        self.prepared = rows
        movers = [a for a in rig.arms if a.name in rows and a.arm.type != "SUJ"]
        self.moving = {arm.name: row for row, arm in enumerate(movers)}
        self.moving_rows = np.array([rows[name] for name in self.moving], dtype=np.intp)
        self.columns = max((arm.arm.own_joints for arm in movers), default=0)
        self._tips = [frames.tip_view(name) for name in self.names]
        self._sites = np.array(self._tips + [frames.own_view(name) for name in self.names])
        self._views: dict[str, PoseViews] = {}
        self._unposed = np.tile(np.eye(4), (len(self._sites), 1, 1))
        self._turns = np.zeros((len(movers), 6, mj.nv))
        # Columns of the moving arms' joints among those of the table, one of zeros behind them.
        self._shares = np.vstack([table.share, np.zeros(mj.nv)]).T
        self._joints = np.full((len(movers), self.columns), len(table), dtype=np.intp)
        for row, arm in enumerate(movers):
            first, count = table.arms[arm.name].rows.start, arm.arm.own_joints
            self._joints[row, :count] = range(first, first + count)
        self._registration: Mapping[str, Array] | None = None
        self._shown: object = None
        self._tipped = self._posed

    def read(self, sample: WorldSample) -> Readout:
        """Return the readings of a sample; nothing is computed before it is read."""
        return Readout(self, sample)

    def measured(self, sample: WorldSample) -> Array:
        """Return tips, then reference frames, of all arms in the world, (2, A, 4, 4)."""
        return self._poses(self._show(sample))

    def setpoint(self, sample: WorldSample) -> Array:
        """Return the same with every arm that is `prepared` at its set-points."""
        self._show(sample)
        q = {name: arm.setpoint_q for name, arm in sample.arms.items()}
        return self._poses(self._frames.posed(q, self._posed))

    def views(self, sample: WorldSample) -> PoseViews:
        """Return the origins of public poses."""
        if self._registration is not sample.registration:
            self._registration = sample.registration
            self._frames.register(sample.registration)
            self._views.clear()
        found = self._views.get(sample.reference_arm)
        if found is None:
            self._shown = None
            each = [self._frames.view(name, sample.reference_arm) for name in self.names]
            sites: list[int] = self._sites.tolist()
            row = {site: row for row, site in reversed([*enumerate(sites)])}
            origins = np.array([row[site] for site, _, _ in each], dtype=np.intp)
            own = origins == np.arange(len(each), 2 * len(each))
            before = np.array([T for _, T, _ in each])
            local = bool(own.all() and (before == np.eye(4)).all())
            found = PoseViews(origins, own, before, tuple(frame for _, _, frame in each), local)
            self._views[sample.reference_arm] = found
        return found

    def jacobians(self, sample: WorldSample) -> Array:
        """Return J with (linear; angular) = J @ qd of the tips in axes of the world, (M, 6, n).

        Rows as in `moving`; an arm with fewer joints than others has zeros behind its own.
        """
        posed, mj = self._show(sample), self.model.mj
        mujoco.mj_comPos(mj, posed)
        for row, turns in zip(self.moving_rows, self._turns, strict=True):
            site = self._tips[int(row)]
            at, body = posed.site_xpos[site], int(mj.site_bodyid[site])
            mujoco.mj_jac(mj, posed, turns[:3], turns[3:], at, body)
        every = self._turns @ self._shares
        return np.take_along_axis(every, self._joints[:, None, :], axis=2)

    def _show(self, sample: WorldSample) -> mujoco.MjData:
        """Return the MjData with frames where the measured joints of a sample have them."""
        if self._shown is not sample:
            self._state.qpos[:], self._shown = sample.qpos, sample
            self._tipped = self._frames.tips()
        return self._tipped

    def _poses(self, shown: mujoco.MjData) -> Array:
        found = self._unposed.copy()
        found[:, :3, :3] = shown.site_xmat.take(self._sites, axis=0).reshape(-1, 3, 3)
        found[:, :3, 3] = shown.site_xpos.take(self._sites, axis=0)
        return found.reshape(2, -1, 4, 4)


class Readout:
    """The figures of every arm of a sample, as the verbs of `Arm` return them.

    Those of arms that are `prepared` are computed together: it takes little longer than for one.

    Args:
        reader: of the sample's rig
        sample: a world at one moment
    """

    def __init__(self, reader: Reader, sample: WorldSample) -> None:
        self.reader, self.sample = reader, sample
        self._arms: dict[str, ArmReadout] = {}

    def arm(self, name: str) -> ArmReadout:
        """Return an arm's figures."""
        found = self._arms.get(name)
        if found is None:
            found = self._arms[name] = ArmReadout(self, name)
        return found

    def let_go(self) -> None:
        """Break the reference cycle with the arms; the object is freed at once."""
        self._arms.clear()

    @cached_property
    def sites(self) -> Array:
        """Measured tips, then reference frames, of all arms in the world, (2, A, 4, 4)."""
        return self.reader.measured(self.sample)

    @cached_property
    def base_frames(self) -> tuple[str, ...]:
        """Names of the frames of public poses, arm by arm."""
        frames = self._views.frames
        if not self._placed:
            return frames
        return tuple(self._placed.get(row, (None, frame))[1] for row, frame in enumerate(frames))

    @cached_property
    def bases(self) -> Array:
        """Reference frames of all arms in the frames of their public poses, (A, 4, 4)."""
        own, before = self._views.own, self._views.before
        found = before @ relative(self._origins, self.sites[1])
        found[own] = before[own]  # what stands in itself is not rounded
        for row, (T, _) in self._placed.items():
            found[row] = T
        return found

    @cached_property
    def measured(self) -> Array:
        """Measured tips in the arms' own reference frames, (A, 4, 4)."""
        return relative(self.sites[1], self.sites[0])

    @cached_property
    def measured_public(self) -> Array:
        """Measured tips in the frames of public poses, (A, 4, 4)."""
        if self._views.local and not self._placed:
            return self.measured
        found = self._views.before @ relative(self._origins, self.sites[0])
        for row, (T, _) in self._placed.items():
            found[row] = T @ self.measured[row]
        return found

    @cached_property
    def setpoint(self) -> Array:
        """Tips at the set-points in the arms' own reference frames, (A, 4, 4)."""
        tips, references = self.reader.setpoint(self.sample)
        return relative(references, tips)

    @cached_property
    def setpoint_public(self) -> Array:
        """Tips at the set-points in the frames of public poses, (A, 4, 4)."""
        return self.bases @ self.setpoint

    @cached_property
    def _views(self) -> PoseViews:
        return self.reader.views(self.sample)

    @cached_property
    def _origins(self) -> Array:
        """Origins of public poses in the world, (A, 4, 4)."""
        return self.sites.reshape(-1, 4, 4).take(self._views.origins, axis=0)

    @cached_property
    def _placed(self) -> dict[int, tuple[Array, str]]:
        """{row of an arm: its base and frame as `set_base_frame` set them}."""
        arms = self.sample.arms
        bases = [(row, arms[name].status.base) for row, name in enumerate(self.reader.names)]
        return {row: base for row, base in bases if base is not None}

    @cached_property
    def jacobians(self) -> Array:
        """Jacobians as `Arm.jacobian`: body, then spatial, of the moving arms, (2, M, 6, n)."""
        tips, references = self.sites[:, self.reader.moving_rows]
        change = np.zeros((2, len(tips), 6, 6))
        change[0, :, :3, :3] = change[0, :, 3:, 3:] = tips[:, :3, :3].swapaxes(1, 2)
        back = references[:, :3, :3].swapaxes(1, 2)
        change[1, :, :3, :3] = change[1, :, 3:, 3:] = back
        change[1, :, :3, 3:] = back @ skew(tips[:, :3, 3] - references[:, :3, 3])
        return change @ self._world_jacobians

    @cached_property
    def twists(self) -> Array:
        """Velocities of the tips: local, then public, of the moving arms, (2, M, 6)."""
        arms, reader = self.sample.arms, self.reader
        qd = np.zeros((len(reader.moving), reader.columns, 1))
        for row, name in enumerate(reader.moving):
            own = reader.model.rig.arm(name).arm.own_joints
            qd[row, :own, 0] = arms[name].qd[:own]
        inside = reader.moving_rows
        moved = (self._world_jacobians @ qd)[..., 0]
        local = turned(self.sites[1, inside, :3, :3].swapaxes(1, 2), moved)
        return np.stack([local, turned(self.bases[inside, :3, :3], local)])

    @cached_property
    def wrenches(self) -> Array:
        """Wrenches of the motors at the tips: body, then spatial, of the moving arms, (2, M, 6)."""
        arms, reader = self.sample.arms, self.reader
        effort = np.zeros((len(reader.moving), reader.columns))
        for row, name in enumerate(reader.moving):
            own = reader.model.rig.arm(name).arm.own_joints
            effort[row, :own] = arms[name].effort[:own] - arms[name].load[:own]
        return least_wrench(self.jacobians, effort)

    @cached_property
    def _world_jacobians(self) -> Array:
        return self.reader.jacobians(self.sample)


class ArmReadout:
    """Figures of one arm of a sample.

    An arm with general loops computes its own, each once.

    Attributes:
        arm, sample: its description and sample
        name, own_frame: its own, and that of its reference frame
        names, own: of its joints, and which of them are not a jaw's or gripper's
    """

    def __init__(self, rig: Readout, name: str) -> None:
        rig_arm = rig.reader.model.rig.arm(name)
        self._rig, self._row = rig, rig.reader.names.index(name)
        self.name, self.arm, self.own_frame = name, rig_arm.arm, rig_arm.own_frame
        self.sample = rig.sample.arms[name]
        self.own, self.names = slice(0, self.arm.own_joints), self.arm.mechanism.joint_names
        self._prepared = name in rig.reader.prepared

    @property
    def base(self) -> tuple[Array, str]:
        """The arm's reference frame in the frame of its public poses, (4, 4), and that one."""
        return self._rig.bases[self._row], self.base_frame

    @property
    def base_frame(self) -> str:
        """Name of the frame of its public poses."""
        return self._rig.base_frames[self._row]

    @property
    def reference_in_world(self) -> Array:
        """The arm's reference frame in the world, (4, 4)."""
        return self._rig.sites[1, self._row]

    @property
    def measured(self) -> Array:
        """The tip in the frame of its public poses, (4, 4)."""
        return self.tip(setpoint=False, local=False)

    def tip(self, *, setpoint: bool, local: bool) -> Array:
        """Return the pose of the tip, (4, 4).

        Args:
            setpoint: at the set-points, else measured
            local: in the arm's own reference frame, else as public poses
        """
        if self._prepared:
            rig = self._rig
            if setpoint:
                return (rig.setpoint if local else rig.setpoint_public)[self._row]
            return (rig.measured if local else rig.measured_public)[self._row]
        T = self._tips[int(setpoint)]
        return T if local else self.base[0] @ T

    def jacobian(self, frame: WrenchFrame) -> Array:
        """Return J with (linear; angular) = J @ qd as `Arm.jacobian` does, (6, n)."""
        which, row = int(frame == "spatial"), self._rig.reader.moving.get(self.name)
        if row is None:
            return self._jacobians[which][:, self.own]
        return self._rig.jacobians[which, row, :, self.own]

    def twist(self, *, local: bool) -> Array:
        """Return the velocity of the tip: (linear; angular), (6,) [m/s, rad/s].

        Args:
            local: in axes of the arm's own reference frame, else of the frame of public poses
        """
        row = self._rig.reader.moving.get(self.name)
        if row is not None:
            return self._rig.twists[0 if local else 1, row]
        R = self._tips[0][:3, :3] if local else self.measured[:3, :3]
        return turned(R, self._jacobians[0] @ self.sample.qd)

    def wrench(self, frame: WrenchFrame) -> Array:
        """Return the motors' wrench, what carries the links not counted: (force; torque), (6,)."""
        row = self._rig.reader.moving.get(self.name)
        if row is not None:
            return self._rig.wrenches[int(frame == "spatial"), row]
        effort = (self.sample.effort - self.sample.load)[self.own]
        return least_wrench(self.jacobian(frame), effort)

    @cached_property
    def _tips(self) -> Array:
        """Both tips in the own reference frame, measured and at the set-points, (2, 4, 4)."""
        return chain_pose(self.arm.mechanism)(np.stack([self.sample.q, self.sample.setpoint_q]))

    @cached_property
    def _jacobians(self) -> tuple[Array, Array]:
        spatial = jacobian_spatial(self.arm.mechanism, self.sample.q)
        return adjoint(inverse(self._tips[0])) @ spatial, spatial
