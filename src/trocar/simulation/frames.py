"""Poses of frames, tips and bodies, computed from the present coordinates.

MuJoCo leaves poses where the last step began. Everything that is read is computed anew on two
MjData of its own that are never stepped: one has bodies as the physics has them, the other frames
as the measured joints have them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigArm, RigDescription
from trocar.descriptions.rig_frames import pose_origin
from trocar.errors import LoopError
from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import coordinates
from trocar.kinematics.inverse import newton
from trocar.kinematics.loops import LoopTable, coordinate_rates, folding_table, passive_frames
from trocar.modeling import naming
from trocar.modeling.joints import JointTable
from trocar.simulation.controllers import WrenchFrame
from trocar.simulation.reading_errors import ReadingErrors

Array = NDArray[np.float64]

IDENTITY = np.eye(4)
#: Newton's method brings a tip to a pose to this [m or rad]. Source: our own choice; rounding is
#: some 1e-15, and 1e-9 is promised.
REACHED = 1e-11
#: It takes at most so many steps. Source: our own choice; from a closed form that is off by some mm
#: it takes three.
NEWTON_STEPS = 10


class Frames:
    """Poses of one rig's frames in the world and in each other.

    Tips are where the measured joints have them (forward kinematics, loops closed), so that they
    agree with `trocar fk`; bodies are where the physics has them, which is off by the loops'
    compliance (0.3 to 0.6 um in motion, measured). Without `follows` an arm's tip is where the
    physics has it.

    Args:
        rig: its description
        table: its joints
        model, data: the physics
        errors: by which all of this is where the robots report it; None: where it is

    Attributes:
        project: coordinates by the measured joints = project @ qpos, but for skew loops, (nq, nq)
    """

    def __init__(
        self,
        rig: RigDescription,
        table: JointTable,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        errors: ReadingErrors | None = None,
    ) -> None:
        self._rig, self._table, self._model, self._data = rig, table, model, data
        self._true_qpos, self._errors = data.qpos, errors
        self._known = {arm.name: arm for arm in rig.arms}
        self._centred = [a.name for a in rig.arms if "rcm" in a.arm.mechanism.frame_index]
        self.project = np.eye(model.nq)
        self._jacobian = np.zeros((6, model.nv))
        self._linear, self._angular = self._jacobian[:3], self._jacobian[3:]
        self._linkages: dict[str, Linkage] = {}
        for arm in rig.arms:
            index = table.arms[arm.name]
            loops = None if index.parallel else folding_table(arm.arm.mechanism)
            if len(index.hinges) and (index.parallel or loops):
                linkage = self._linkages[arm.name] = Linkage(arm, table, loops)
                self.project[index.qpos] = linkage.couple @ table.drive[index.rows]
        self._skew = [linkage for linkage in self._linkages.values() if linkage.skew]
        #: Arms whose loops several joints fold: no table gives their hinges.
        self._folded = [
            (arm.arm.mechanism, table.arms[arm.name])
            for arm in rig.arms
            if len(table.arms[arm.name].hinges) and arm.name not in self._linkages
        ]
        #: Reference frames of public poses, by arm and reference arm: a site, a pose that is
        #: multiplied from the left (or None), and the frame's name.
        self._views: dict[tuple[str, str], tuple[Site, Array | None, str]] = {}
        self._registration: Mapping[str, Array] = {}

    @property
    def _qpos(self) -> Array:
        return self._true_qpos if self._errors is None else self._errors.qpos()

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the rig's arms."""
        return tuple(self._known)

    def register(self, registration: Mapping[str, Array] | None) -> None:
        """Set where cameras' frames are reported, {arm: in the true frame of its poses (4, 4)}."""
        self._registration = registration or {}
        self._views.clear()

    @property
    def scratches(self) -> tuple[mujoco.MjData, mujoco.MjData]:
        """The two MjData that `bodies` and `tips` fill; others only prepare them."""
        return self._bodies, self._posed

    @cached_property
    def _bodies(self) -> mujoco.MjData:
        """Bodies where the physics has them, as of the last call of `bodies`."""
        return mujoco.MjData(self._model)

    @cached_property
    def _posed(self) -> mujoco.MjData:
        """Frames where joint positions have them, as of the last read-out of a pose."""
        return mujoco.MjData(self._model)

    @cached_property
    def _shown(self) -> Array:
        return self._posed.qpos

    @cached_property
    def _tip(self) -> dict[str, Site]:
        return self._sites("tip")

    @cached_property
    def _reference(self) -> dict[str, Site]:
        return self._sites("reference")

    def _sites(self, frame: str) -> dict[str, Site]:
        """Return one site of every arm, by the arm's name."""
        found: dict[str, Site] = {}
        for arm in self._known:
            site = self._model.site(naming.frame_site(arm, frame))
            at, turn = self._posed.site_xpos[site.id], self._posed.site_xmat[site.id]
            found[arm] = Site(site.id, int(site.bodyid[0]), at, turn.reshape(3, 3))
        return found

    # ------------------------------------------------------------------ the scratch data

    def bodies(self) -> mujoco.MjData:
        """Compute bodies where the physics has them now; valid until the next call of this."""
        bodies = self._bodies
        bodies.qpos[:] = self._true_qpos if self._errors is None else self._errors.qpos()
        mujoco.mj_kinematics(self._model, bodies)
        return bodies

    def tips(self) -> mujoco.MjData:
        """Compute frames where the measured joints have them; valid until the next pose."""
        return self._pose()

    def _pose(self, name: str = "", q: Array | None = None) -> mujoco.MjData:
        """Put frames where the measured joints have them, one arm at other joints (n,) if given."""
        qpos = self._true_qpos if self._errors is None else self._errors.qpos()
        np.dot(self.project, qpos, out=self._shown)
        for linkage in self._skew:
            linkage.close(qpos, self._shown)
        if q is not None:
            self._shown[self._table.arms[name].qpos] = self._linkages[name].at(q)[0]
        mujoco.mj_kinematics(self._model, self._posed)
        return self._posed

    def posed(self, q: Mapping[str, Array], out: mujoco.MjData) -> mujoco.MjData:
        """Put another MjData's frames where `tips` has them, with arms at joint positions.

        Args:
            q: {arm: joint positions (n,)}, of all arms; those that do not follow theirs
                (`follows`) stay where they are
            out: of the same model
        """
        np.dot(self.project, self._qpos, out=out.qpos)
        for name, linkage in self._linkages.items():
            out.qpos[linkage.qpos] = linkage.at(q[name])[0]
        mujoco.mj_kinematics(self._model, out)
        return out

    # ------------------------------------------------------------------ arms

    def measured(self, name: str) -> Array:
        """Return an arm's tip in its own reference frame, (4, 4)."""
        self._pose()
        return self._tip[name].seen_from(self._reference[name])

    def local_at(self, name: str, q: Array) -> Array:
        """Return the tip at joint positions (n,) as `measured` does, of an arm that `follows`."""
        self._pose(name, q)
        return self._tip[name].seen_from(self._reference[name])

    def public(self, name: str, reference_arm: str) -> tuple[Array, str]:
        """Return the measured tip in the frame of the arm's public poses, and that one's name."""
        return self._seen(self._tip[name], name, reference_arm)

    def public_at(self, name: str, q: Array, reference_arm: str) -> tuple[Array, str]:
        """Return the tip at joint positions as `public` does, of an arm that `follows`."""
        origin, before, frame = self._origin(name, reference_arm)
        self._pose(name, q)
        T = self._tip[name].seen_from(origin)
        return (T if before is None else before @ T), frame

    def depth(self, name: str) -> float:
        """Return the distance of an instrument's wrist past the remote centre [m]."""
        posed, bodies = self._pose(), self._table.arms[name].bodies
        shaft = posed.xmat[bodies["roll"]][2::3]
        return float(shaft @ (posed.xpos[bodies["wrist_pitch"]] - self._reference[name].at))

    def base_pose(self, name: str, reference_arm: str) -> tuple[Array, str]:
        """Return an arm's reference frame in the frame of its public poses, and that one's name.

        Args:
            name: of the arm
            reference_arm: as for `RigDescription.pose_frame`, which determines the frame
        """
        return self._seen(self._reference[name], name, reference_arm)

    def own(self, name: str, T: Array, reference_arm: str) -> Array:
        """Return a pose in the frame of an arm's public poses in the arm's reference frame."""
        origin, before, _ = self._origin(name, reference_arm)
        reference = self._reference[name]
        if origin is reference:
            return T if before is None else inverse(before).dot(T)
        self._pose()
        seen = T if before is None else inverse(before).dot(T)
        return origin.seen_from(reference).dot(seen)

    def reference_pose(self, name: str) -> Array:
        """Return the pose of an arm's reference frame in the world, (4, 4)."""
        self._pose()
        return self._reference[name].pose()

    def tip_pose(self, name: str) -> Array:
        """Return an arm's tip in the world, (4, 4)."""
        self._pose()
        return self._tip[name].pose()

    def tip_poses(self, names: Iterable[str]) -> dict[str, Array] | None:
        """Return tips of arms in the world, {arm: (4, 4)}, in one go; None unless all `follows`."""
        self._pose()
        found: dict[str, Array] = {}
        for name in names:
            if name not in self._linkages:
                return None
            T = found[name] = IDENTITY.copy()
            site = self._tip[name]
            T[:3, :3], T[:3, 3] = site.turn, site.at
        return found

    def remote_centres(self, bodies: mujoco.MjData | None = None) -> dict[str, Array]:
        """Return the remote centre of every arm that has one, in the world, (3,) [m].

        Setup joints alone move it, and they have no loops.

        Args:
            bodies: what `bodies` returned for the present state; computed when omitted
        """
        at = (self.bodies() if bodies is None else bodies).site_xpos
        return {name: at[self._reference[name].id].copy() for name in self._centred}

    def follows(self, name: str) -> bool:
        """Return whether hinges of an arm follow its joints in closed form, loops included.

        They do not where the arm is welded into the model or several joints fold its loops.
        """
        return name in self._linkages

    def jacobian(self, name: str, frame: WrenchFrame) -> Array:
        """Return J with (linear; angular) = J @ qd of an arm that `follows`, (6, n).

        Args:
            name: of the arm
            frame: "body": of the tip in its axes; "spatial": of the point at the reference frame's
                origin in that frame's axes
        """
        self._pose()
        linkage = self._linkages[name]
        seen = self._tip[name] if frame == "body" else self._reference[name]
        rates = linkage.at(linkage.drive.dot(self._qpos))[1]
        J = self._slope(self._tip[name].body, seen.at, rates)
        return np.matmul(seen.turn.T, J.reshape(2, 3, -1)).reshape(6, -1)

    def reach(self, name: str, T: Array, q: Array, tolerance: float = REACHED) -> Array | None:
        """Find joint positions that bring the tip of an arm that `follows` to a pose, (n,).

        By Newton's method with the loops closed; a jaw is at 0. Fewer than six joints bring it as
        near as they can, by least squares.

        Args:
            name: of the arm
            T: pose in the arm's reference frame, which no joint of it moves, (4, 4)
            q: where to start, (n,), n <= 6 [rad or m]
            tolerance: how near is near enough [m or rad]

        Returns:
            (n,), whatever the limits; None where it does not get there
        """
        linkage, tip, shown = self._linkages[name], self._tip[name], self._shown
        shown[:] = self._qpos
        mujoco.mj_kinematics(self._model, self._posed)
        goal = self._reference[name].pose().dot(T)
        at, axes = goal[:3, 3], goal[:3, :3]
        every, miss = np.zeros(linkage.drive.shape[0]), np.empty(6)
        found, far, near = every[: len(q)], miss[:3], False
        found[:] = q

        def step(longest: float) -> Array | None:
            nonlocal near
            try:
                shown[linkage.qpos], rates = linkage.at(every)
            except LoopError:
                return None
            mujoco.mj_kinematics(self._model, self._posed)
            np.subtract(at, tip.at, out=far)
            (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = axes.dot(tip.turn.T).tolist()
            miss[3:] = 0.5 * (r21 - r12), 0.5 * (r02 - r20), 0.5 * (r10 - r01)
            missed = max(map(abs, miss.tolist()))
            if missed < REACHED or longest < REACHED:
                near = missed <= tolerance and r00 + r11 + r22 > 1.0
                return None
            J = self._slope(tip.body, tip.at, rates)[:, : len(q)]
            try:
                square = J if len(q) == 6 else J.T.dot(J)
                change = np.linalg.solve(square, miss if len(q) == 6 else miss.dot(J))
                return np.asarray(change, dtype=np.float64)
            except np.linalg.LinAlgError:
                return None

        newton(found, step, NEWTON_STEPS)
        return found if near else None

    def _slope(self, body: int, point: Array, rates: Array) -> Array:
        """Return the Jacobian of a point of a body in the joints that hinges follow, (6, n)."""
        mujoco.mj_comPos(self._model, self._posed)
        mujoco.mj_jac(self._model, self._posed, self._linear, self._angular, point, body)
        return self._jacobian.dot(rates)

    # ------------------------------------------------------------------ weight

    @property
    def linear(self) -> bool:
        """Whether `joint_efforts` is `share @ forces`, wherever the arms are."""
        return not self._skew and not self._folded

    def joint_efforts(self, forces: Array, out: Array) -> Array:
        """Return the joint efforts that do the work of forces on all hinges, (J,) [N m or N].

        By virtual work along the closed loops where they are now: tau = (d hinges / d q)^T f.

        Args:
            forces: on MuJoCo's degrees of freedom, (nv,)
            out: written and returned, (J,)
        """
        np.dot(self._table.share, forces, out=out)
        for linkage in self._skew:
            q = linkage.drive.dot(self._qpos)
            np.dot(forces, linkage.at(q)[1], out=out[linkage.rows])
        for mechanism, index in self._folded:
            where = np.zeros(len(mechanism.frames))
            where[index.hinges] = self._qpos[index.qpos]
            rates = coordinate_rates(mechanism, where)[index.hinges]
            np.dot(forces[index.dof], rates, out=out[index.rows])
        return out

    # ------------------------------------------------------------------ inside

    def _seen(self, site: Site, name: str, reference_arm: str) -> tuple[Array, str]:
        """Return the pose of a site in the frame of an arm's public poses, and that one's name."""
        origin, before, frame = self._origin(name, reference_arm)
        self._pose()
        T = site.seen_from(origin)
        return (T if before is None else before @ T), frame

    def view(self, name: str, reference_arm: str) -> tuple[int, Array, str]:
        """Return the origin of an arm's public poses: a site, its pose, the frame.

        Returns:
            id of the site, its pose in the frame (4, 4), name of the frame
        """
        origin, before, frame = self._origin(name, reference_arm)
        return origin.id, IDENTITY if before is None else before, frame

    def tip_view(self, name: str) -> int:
        """Return the id of the site at an arm's tip."""
        return self._tip[name].id

    def own_view(self, name: str) -> int:
        """Return the id of the site at an arm's own reference frame."""
        return self._reference[name].id

    def _origin(self, name: str, reference_arm: str) -> tuple[Site, Array | None, str]:
        key = name, reference_arm
        view = self._views.get(key)
        if view is None:
            view = self._views[key] = self._view(name, reference_arm)
        return view

    def _view(self, name: str, reference_arm: str) -> tuple[Site, Array | None, str]:
        origin = pose_origin(self._rig, name, reference_arm)
        if (
            not origin.arm
        ):  # the reference frame of an arm that a display stands beside stands still
            self._pose()
            own = self._reference[name]
            return own, origin.placed(own.pose()), origin.frame
        if origin.tip:
            return self._tip[origin.arm], self._registration.get(name), origin.frame
        return self._reference[origin.arm], origin.before, origin.frame


class Linkage:
    """Hinges of one arm as functions of its joints, where at most one joint folds its loops.

    Args:
        arm: the arm
        table: joints of the model
        loops: what the couplings leave out, None where loops are parallelograms

    Attributes:
        couple: hinges by the couplings alone = couple @ q, (h, n)
        rows: the arm's joints in the table
        drive: q = drive @ qpos, (n, nq)
        qpos: addresses of the hinges, (h,)
        skew: whether the couplings leave something out
    """

    def __init__(self, arm: RigArm, table: JointTable, loops: LoopTable | None) -> None:
        index, self._mechanism = table.arms[arm.name], arm.arm.mechanism
        self.rows = index.rows
        self.couple, self.drive = table.couple[index.qpos][:, index.rows], table.drive[index.rows]
        self.qpos, self._dof, self._hinges = index.qpos, index.dof, index.hinges
        self._rates = table.share[index.rows].T.copy()
        self._rates.setflags(write=False)
        self.skew = loops is not None
        if loops is not None:
            hinge = {frame: k for k, frame in enumerate(index.hinges.tolist())}
            series = np.zeros((len(loops.series), len(hinge)))
            series[:, [hinge[k] for k in passive_frames(self._mechanism)]] = loops.series
            self._loops, self._fold = replace(loops, series=series), self.drive[loops.column]
            self._coupled = self.couple[:, loops.column]

    def close(self, qpos: Array, shown: Array) -> None:
        """Close skew loops in `shown`, where the couplings have put the hinges for `qpos`.

        Outside the table's range the hinges are where they are in `qpos`.
        """
        found = self._loops.at(float(self._fold.dot(qpos)))
        if found is None:
            shown[self.qpos] = qpos[self.qpos]
        else:
            shown[self.qpos] += found[0]

    def at(self, q: Array) -> tuple[Array, Array]:
        """Return the hinges at joint positions (n,), and d (every hinge) / d q.

        Returns:
            (h,) [rad or m], (nv, n)

        Raises:
            LoopError: the loops cannot be closed there
        """
        if not self.skew:
            return self.couple.dot(q), self._rates
        column = self._loops.column
        found = self._loops.at(float(q[column]))
        if found is None:
            every, rates = coordinates(self._mechanism, q), np.zeros_like(self._rates)
            rates[self._dof] = coordinate_rates(self._mechanism, every)[self._hinges]
            return every[self._hinges], rates
        beyond, slope = found
        rates = self._rates.copy()
        rates[self._dof, column] = self._coupled + slope
        return self.couple.dot(q) + beyond, rates


class Site:
    """A frame on a body of the shadow; its arrays change with every kinematics.

    Attributes:
        id, body: ids of the site and of its body
        at, turn: position (3,) and axes (3, 3) in the world, views
    """

    def __init__(self, number: int, body: int, at: Array, turn: Array) -> None:
        self.id, self.body, self.at, self.turn = number, body, at, turn
        self._back = turn.T
        self._moved = np.zeros((3, 4))
        self._axes, self._apart = self._moved[:, :3], self._moved[:, 3]

    def pose(self) -> Array:
        """Return the pose in the world, (4, 4)."""
        T = IDENTITY.copy()
        T[:3, :3], T[:3, 3] = self.turn, self.at
        return T

    def seen_from(self, origin: Site) -> Array:
        """Return the pose in another site, (4, 4)."""
        self._axes[:] = self.turn
        np.subtract(self.at, origin.at, out=self._apart)
        T = IDENTITY.copy()
        np.dot(origin._back, self._moved, out=T[:3])
        return T
