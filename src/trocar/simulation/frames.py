"""Where frames, tips and centres of gravity are, from the state as it is: never from leftovers.

MuJoCo leaves poses where the last step began. Everything that is read is computed anew on a shadow
MjData, which is never stepped.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import CART, DISPLAY, RigDescription
from trocar.geometry.se3 import inverse
from trocar.modeling import naming
from trocar.modeling.joints import JointTable
from trocar.simulation.controllers import WrenchFrame

Array = NDArray[np.float64]

IDENTITY = np.eye(4)


class Frames:
    """Poses of one rig's frames in the world and in each other.

    Tips are where the measured joints have them (forward kinematics, loops as drawn), so that they
    agree with `trocar fk`; bodies are where the physics has them, which is off by the loops'
    compliance (0.3 to 0.6 um in motion, measured).

    Args:
        rig: its description
        table: its joints
        model, data: the physics

    Attributes:
        shadow: an MjData of the same model; `bodies` and `tips` say what it holds
    """

    def __init__(
        self,
        rig: RigDescription,
        table: JointTable,
        model: mujoco.MjModel,
        data: mujoco.MjData,
    ) -> None:
        self._rig, self._table, self._model, self._data = rig, table, model, data
        self.shadow = shadow = mujoco.MjData(model)
        self._qpos, self._shown = data.qpos, shadow.qpos
        self._known = {arm.name: arm for arm in rig.arms}
        self._project = np.eye(model.nq)
        self._jacobian = np.zeros((6, model.nv))
        self._linear, self._angular = self._jacobian[:3], self._jacobian[3:]
        self._tip, self._reference = (
            {arm.name: self._site(naming.frame_site(arm.name, frame)) for arm in rig.arms}
            for frame in ("tip", "reference")
        )
        self._couple: dict[str, Array] = {}
        for arm in rig.arms:
            index = table.arms[arm.name]
            if index.parallel:
                rows = index.rows
                couple = self._couple[arm.name] = table.couple[index.qpos][:, rows]
                self._project[index.qpos] = couple @ table.drive[rows]
        #: Where public poses are seen from, by arm and reference arm: a site, what stands before
        #: it, and the frame's name.
        self._views: dict[tuple[str, str], tuple[Site, Array | None, str]] = {}

    def _site(self, name: str) -> Site:
        site = self._model.site(name)
        at, turn = self.shadow.site_xpos[site.id], self.shadow.site_xmat[site.id]
        return Site(site.id, int(site.bodyid[0]), at, turn.reshape(3, 3))

    # ------------------------------------------------------------------ what the shadow holds

    def bodies(self) -> mujoco.MjData:
        """Return the shadow with bodies where the physics has them now."""
        self._shown[:] = self._qpos
        mujoco.mj_kinematics(self._model, self.shadow)
        return self.shadow

    def tips(self) -> mujoco.MjData:
        """Return the shadow with frames where the measured joints have them."""
        np.dot(self._project, self._qpos, out=self._shown)
        mujoco.mj_kinematics(self._model, self.shadow)
        return self.shadow

    def told(self, name: str, q: Array) -> mujoco.MjData:
        """Return the shadow as `tips` does, with one arm at joint positions, (n,)."""
        np.dot(self._project, self._qpos, out=self._shown)
        index = self._table.arms[name]
        self._shown[index.qpos] = self._couple[name].dot(q)
        mujoco.mj_kinematics(self._model, self.shadow)
        return self.shadow

    # ------------------------------------------------------------------ arms

    def measured(self, name: str) -> Array:
        """Return an arm's tip in its own reference frame, (4, 4)."""
        self.tips()
        return self._tip[name].seen_from(self._reference[name])

    def public(self, name: str, reference_arm: str) -> tuple[Array, str]:
        """Return the measured tip in the frame of the arm's public poses, and that one's name."""
        return self._seen(self._tip[name], name, reference_arm)

    def public_at(self, name: str, q: Array, reference_arm: str) -> tuple[Array, str]:
        """Return the tip at joint positions as `public` does, of an arm with parallelograms."""
        origin, before, frame = self._origin(name, reference_arm)
        self.told(name, q)
        T = self._tip[name].seen_from(origin)
        return (T if before is None else before @ T), frame

    def depth(self, name: str) -> float:
        """Return how far past the remote centre an instrument's first wrist joint is [m]."""
        shadow, bodies = self.tips(), self._table.arms[name].bodies
        shaft = shadow.xmat[bodies["roll"]][2::3]
        return float(shaft @ (shadow.xpos[bodies["wrist_pitch"]] - self._reference[name].at))

    def base_pose(self, name: str, reference_arm: str) -> tuple[Array, str]:
        """Return an arm's reference frame in the frame of its public poses, and that one's name.

        Args:
            name: of the arm
            reference_arm: as for `RigDescription.pose_frame`, which says which frame it is
        """
        return self._seen(self._reference[name], name, reference_arm)

    def reference_pose(self, name: str) -> Array:
        """Return the pose of an arm's reference frame in the world, (4, 4)."""
        self.tips()
        return self._reference[name].pose()

    def remote_centres(self) -> dict[str, Array]:
        """Return the remote centre of every arm that has one, in the world, (3,) [m]."""
        self.tips()
        return {
            a.name: self._reference[a.name].at.copy()
            for a in self._rig.arms
            if "rcm" in a.arm.mechanism.frame_index
        }

    def jacobian(self, name: str, frame: WrenchFrame) -> Array:
        """Return J with (linear; angular) = J @ qd of an arm with parallelograms, (6, n).

        Args:
            name: of the arm
            frame: "body": of the tip in its axes; "spatial": of the point at the reference frame's
                origin in that frame's axes
        """
        shadow, tip = self.tips(), self._tip[name]
        mujoco.mj_comPos(self._model, shadow)
        seen = tip if frame == "body" else self._reference[name]
        mujoco.mj_jac(self._model, shadow, self._linear, self._angular, seen.at, tip.body)
        index = self._table.arms[name]
        J = self._jacobian[:, index.dof] @ self._table.share[index.rows][:, index.dof].T
        return np.matmul(seen.turn.T, J.reshape(2, 3, -1)).reshape(6, -1)

    # ------------------------------------------------------------------ weight

    def holding_efforts(self, out: Array) -> Array:
        """Return the efforts that hold every motor's load still now, (J,) [N m or N].

        By virtual work, with the hinges inside loops in the fixed ratios of parallelograms.
        """
        shadow = self.bodies()
        mujoco.mj_comPos(self._model, shadow)
        mujoco.mj_rne(self._model, shadow, 0, shadow.qfrc_inverse)
        return np.dot(self._table.share, shadow.qfrc_inverse, out=out)

    # ------------------------------------------------------------------ inside

    def _seen(self, site: Site, name: str, reference_arm: str) -> tuple[Array, str]:
        """Return the pose of a site in the frame of an arm's public poses, and that one's name."""
        origin, before, frame = self._origin(name, reference_arm)
        self.tips()
        T = site.seen_from(origin)
        return (T if before is None else before @ T), frame

    def view(self, name: str, reference_arm: str) -> tuple[int, Array, str]:
        """Return where the public poses of an arm are seen from: a site, its pose, the frame.

        Returns:
            id of the site, its pose in the frame (4, 4), name of the frame
        """
        origin, before, frame = self._origin(name, reference_arm)
        return origin.id, IDENTITY if before is None else before, frame

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
        arm, own = self._known[name], self._reference[name]
        if arm.base_frame is not None:
            return own, arm.base_frame.pose, arm.base_frame.name
        frame = self._rig.pose_frame(name, reference_arm)
        if frame == DISPLAY and self._rig.display is not None:
            self.tips()  # a master's reference frame stands still
            return own, inverse(self._rig.display) @ own.pose(), frame
        if frame == arm.own_frame:
            return own, None, frame
        return (self._reference[arm.on] if frame == CART else self._tip[frame]), None, frame


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
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.turn, self.at
        return T

    def seen_from(self, origin: Site) -> Array:
        """Return the pose in another site, (4, 4)."""
        self._axes[:] = self.turn
        np.subtract(self.at, origin.at, out=self._apart)
        T = IDENTITY.copy()
        np.dot(origin._back, self._moved, out=T[:3])
        return T
