"""What can be felt in a simulation: forces of contacts, accelerations, what a ray meets.

Forces and accelerations are those of the last physics period: the integrator solves for the mean
over a period, so they balance to the last digit and need no step of their own. After an arm was put
somewhere there is no such period, and they are computed for the state as it stands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.simulation.sensor_readings import Contact, ContactTable
from trocar.simulation.tip_load import TipLoad

Array = NDArray[np.float64]
Bodies = NDArray[np.bool_]

#: Everything that a period depends on.
WHOLE_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
#: A ray begins so far behind its pad, so that it meets what is pressed into the pad by the depth
#: of a contact. Source: our own choice; fingers are 1.7 mm thick. [m]
BEHIND_PAD_M = 1e-3
#: A ray goes on so far behind a surface of its own arm. Source: our own choice. [m]
BEHIND_SURFACE_M = 1e-9


@dataclass(frozen=True, eq=False)
class Site:
    """A place on a body: T_body_site (4, 4)."""

    body: int
    pose: Array

    def pose_in(self, data: mujoco.MjData) -> Array:
        """Return T_world_site (4, 4)."""
        at = np.eye(4)
        at[:3, :3] = data.xmat[self.body].reshape(3, 3)
        at[:3, 3] = data.xpos[self.body]
        return at @ self.pose


class Probes:
    """Looks at the physics through a copy of its state, and changes nothing.

    Args:
        model, data: the physics
        load: the forces at the tips
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, load: TipLoad) -> None:
        self._model, self._data = model, data
        self._load = load
        self._names = tuple(model.body(k).name for k in range(model.nbody))

    def beyond(self, body: int) -> Bodies:
        """Return which bodies hang on a body, itself included, (n_bodies,)."""
        found = np.zeros(self._model.nbody, dtype=np.bool_)
        found[body] = True
        for index in range(body + 1, self._model.nbody):
            found[index] = found[self._model.body_parentid[index]]
        return found

    def contacts(self, mine: Bodies) -> tuple[Contact, ...]:
        """Return where some bodies touch others or each other."""
        return tuple(contact for contact, _, _ in self._touching(self._touched(mine), mine))

    def contact_table(self) -> ContactTable:
        """Return where any two bodies touch, as `contacts` of all bodies does, at once."""
        data = self._touched(np.ones(self._model.nbody, dtype=np.bool_))
        here = np.flatnonzero(data.contact.efc_address >= 0)
        found = data.contact
        axes = found.frame[here].reshape(-1, 3, 3)  # rows; the normal leads from the first shape
        # An elliptic cone's forces are along the axes: of the normal, and of two tangents where
        # there is friction, as all shapes have it.
        rows = found.efc_address[here][:, None] + np.arange(3)
        felt = data.efc_force[rows]  # what the first shape does to the second
        return ContactTable(
            float(self._data.time),
            self._names,
            self._model.geom_bodyid[found.geom[here]].astype(np.intp),
            found.pos[here].copy(),
            -axes[:, 0],
            -(felt[:, None] @ axes)[:, 0],
            -found.dist[here],
        )

    def wrench(self, mine: Bodies, site: Site) -> tuple[Array, Array]:
        """Return force and torque that act on some bodies from outside, at a site in its axes."""
        data = self._acted()
        at = site.pose_in(data)
        origin = at[:3, 3]
        force, torque = np.zeros(3), np.zeros(3)
        for point, push, turn in self._pushes(data, mine):
            force += push
            torque += np.cross(point - origin, push) + turn
        return at[:3, :3].T @ force, at[:3, :3].T @ torque

    def inertial(self, site: Site) -> tuple[Array, Array]:
        """Return angular velocity and proper acceleration of a site, in its axes.

        a = J dv/dt + dJ/dt v - g, with the last period's dv/dt.
        """
        model, now = self._model, self._now()
        acceleration = self._acted().qacc.copy()
        at = site.pose_in(now)
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        changing = np.zeros((3, model.nv))
        mujoco.mj_jac(model, now, linear, angular, at[:3, 3], site.body)
        mujoco.mj_jacDot(model, now, changing, None, at[:3, 3], site.body)
        proper = linear @ acceleration + changing @ now.qvel - model.opt.gravity
        return at[:3, :3].T @ (angular @ now.qvel), at[:3, :3].T @ proper

    def ray(self, start: Site, end: Site, arm: Bodies) -> tuple[float, float]:
        """Return how far it is from one site towards another to what is no part of an arm.

        Returns:
            distance, below 0 where it reaches behind the first site, inf when nothing lies between
            the sites; from site to site [m]
        """
        now = self._now()
        first, last = start.pose_in(now)[:3, 3], end.pose_in(now)[:3, 3]
        gap = float(np.linalg.norm(last - first))
        if gap < BEHIND_SURFACE_M:
            return np.inf, gap
        along = (last - first) / gap
        passed, hit = -BEHIND_PAD_M, np.zeros(1, dtype=np.int32)
        while passed < gap:
            origin = first + passed * along
            free = mujoco.mj_ray(self._model, now, origin, along, None, True, -1, hit)
            passed += free
            if free < 0.0 or passed >= gap:
                break
            if not arm[self._model.geom_bodyid[hit[0]]]:
                return passed, gap
            passed += BEHIND_SURFACE_M
        return np.inf, gap

    def _now(self) -> mujoco.MjData:
        """Return the state as it stands, with its positions and velocities worked out."""
        scratch = self._copied()
        mujoco.mj_kinematics(self._model, scratch)
        mujoco.mj_comPos(self._model, scratch)
        mujoco.mj_comVel(self._model, scratch)
        return scratch

    def _acted(self) -> mujoco.MjData:
        """Return where the forces and accelerations of the last period stand."""
        if np.isfinite(self._data.qacc).all():
            return self._data
        scratch = self._copied()
        mujoco.mj_forward(self._model, scratch)
        return scratch

    def _touched(self, mine: Bodies) -> mujoco.MjData:
        """Return where the contacts of some bodies stand; those of what sleeps are worked out."""
        trees = self._model.body_treeid[mine]
        if not (self._data.tree_asleep[trees[trees >= 0]] >= 0).any():
            return self._acted()
        scratch = self._copied()  # is never stepped, so nothing in it falls asleep
        mujoco.mj_forward(self._model, scratch)
        return scratch

    @cached_property
    def _scratch(self) -> mujoco.MjData:
        """What is computed for a reading is computed here; most worlds never need it."""
        return mujoco.MjData(self._model)

    def _copied(self) -> mujoco.MjData:
        state = np.zeros(mujoco.mj_stateSize(self._model, WHOLE_STATE))
        mujoco.mj_getState(self._model, self._data, state, WHOLE_STATE)
        mujoco.mj_setState(self._model, self._scratch, state, WHOLE_STATE)
        return self._scratch

    def _pushes(self, data: mujoco.MjData, mine: Bodies) -> Iterator[tuple[Array, Array, Array]]:
        """Yield (point, force, torque) in the world of all that acts on bodies from outside."""
        for contact, body, other in self._touching(data, mine):
            if mine[body] != mine[other]:
                yield contact.point, contact.force, contact.torque
        for body in np.flatnonzero(mine & data.xfrc_applied.any(axis=1)):
            applied = data.xfrc_applied[body]
            yield data.xipos[body], applied[:3], applied[3:]
        for body, point, force in self._load.acting():
            if mine[body]:
                yield data.xpos[body] + data.xmat[body].reshape(3, 3) @ point, force, np.zeros(3)

    def _touching(self, data: mujoco.MjData, mine: Bodies) -> Iterator[tuple[Contact, int, int]]:
        """Yield each contact of some bodies with the ids of the two bodies, one of `mine` first."""
        model, felt = self._model, np.zeros(6)
        for index in range(data.ncon):
            contact = data.contact[index]
            shapes = [int(shape) for shape in contact.geom]
            bodies = [int(model.geom_bodyid[shape]) for shape in shapes]
            if contact.efc_address < 0 or not mine[bodies].any():
                continue
            mujoco.mj_contactForce(model, data, index, felt)
            axes = contact.frame.reshape(3, 3)  # rows; the normal leads from the first shape
            sign = 1.0  # MuJoCo tells what the first does to the second
            if mine[bodies[0]]:
                shapes, bodies, sign = shapes[::-1], bodies[::-1], -1.0
            other, body = bodies
            yield (
                Contact(
                    body=model.body(body).name,
                    other=model.body(other).name,
                    shape=model.geom(shapes[1]).name,
                    other_shape=model.geom(shapes[0]).name,
                    point=contact.pos.copy(),
                    normal=sign * axes[0],
                    force=sign * (felt[:3] @ axes),
                    torque=sign * (felt[3:] @ axes),
                    depth=-float(contact.dist),
                ),
                body,
                other,
            )
