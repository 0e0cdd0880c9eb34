"""Joints, tips and objects of a world at one moment, read in one go."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.simulation.objects import Objects, ObjectStates
from trocar.simulation.world import World

Array = NDArray[np.float64]


class RigReadings:
    """Readings of some arms and all objects of a world, computed once for all their users.

    All are as the robots report them. What they need of the model is looked up once; `Motors` and
    `Frames` read worlds with errors, and rigs with arms that are welded in or whose loops are no
    parallelograms.

    Args:
        world: to read
        arms: names of those that are read

    Attributes:
        objects: states of all objects
        joints: measured positions, {arm: (n,)} [rad or m]
        tips: measured poses in the world, {arm: (4, 4)}; valid once `read` or `renew` was called
    """

    objects: ObjectStates
    joints: dict[str, Array]
    tips: dict[str, Array]

    def __init__(self, world: World, arms: Sequence[str]) -> None:
        self._world, self._arms = world, {name: world.arms[name] for name in arms}
        self._journal, self._at = world.journal, (-1, -1)
        self._look_up()

    def renew(self) -> None:
        """Read again if anything moved since the last reading; set-points move nothing."""
        journal = self._journal
        if self._at != (journal.period, journal.revision - journal.streamed):
            self.read()

    def read(self) -> None:
        """Read everything; arrays of earlier readings stay as they are."""
        world, journal = self._world, self._journal
        if self._model is not world.model:
            self._look_up()
        self._at = journal.period, journal.revision - journal.streamed
        data, qpos = self._data, self._qpos
        if self._free:
            at, v = qpos.take(self._places), self._qvel.take(self._rates)
            moving = at[:, :3], at[:, 3:], v[:, :3], v[:, 3:]
            self.objects = ObjectStates(self._names, data.time, *moving, self._no_joints)
        else:
            self.objects = self._objects.states()
        joints: dict[str, Array] = {}
        tips: dict[str, Array] = {}
        self.joints, self.tips = joints, tips
        if not self._plain:
            tips |= world.frames.tip_poses(self._arms) or {}
            for name, arm in self._arms.items():
                joints[name] = arm.runtime.motors.positions()
                if name not in tips:
                    tips[name] = arm.measured_cp("world").matrix
            return
        np.dot(self._project, qpos, out=self._shown)
        mujoco.mj_kinematics(self._compiled, self._posed)
        for name, drive, position, turn in self._rows:
            joints[name] = drive.dot(qpos)
            T = tips[name] = np.zeros((4, 4))
            T[:3, :3], T[:3, 3], T[3, 3] = turn, position, 1.0

    def touching(self) -> bool:
        """Return whether contacts, grasps or tissue may exert a force on these arms.

        After something was put elsewhere, too: contacts are then not known before the next step.
        """
        data, qacc = self._data, self._data.qacc
        if self._world.tissues or not isfinite(qacc.dot(qacc)):
            return True
        if self._welds and not self._welds.isdisjoint(data.efc_id[: data.ne].tolist()):
            return True
        if not data.ncon:
            return False
        on_arm = self._on_arm
        for one, other in data.contact.geom.tolist():  # noqa: SIM110  a generator is one more call
            if on_arm[one] or on_arm[other]:
                return True
        return False

    def _look_up(self) -> None:
        """Take views and rows of the compiled model."""
        world = self._world
        self._model, compiled, data = world.model, world.mj_model, world.mj_data
        self._compiled, self._data, self._qpos, self._qvel = compiled, data, data.qpos, data.qvel
        self._objects = world.part(Objects)
        kinematics = self._objects.kinematics
        names = self._names = kinematics.names
        self._free = bool(names) and all(one.kind == "free" for one in kinematics.joints)
        if self._free:
            self._places, self._rates = kinematics.free_rows(names)
            self._no_joints = kinematics.coordinates(self._qpos, self._qvel)
        on_arm = np.zeros(compiled.nbody, np.bool_)
        for name in self._arms:
            on_arm[list(world.joints.arms[name].bodies.values())] = True
        #: Whether each geom is on one of the arms; flexes, which have the geom -1, are not.
        self._on_arm: list[bool] = [*on_arm[compiled.geom_bodyid].tolist(), False]
        weld = mujoco.mjtEq.mjEQ_WELD
        #: The equalities by which jaws hold objects, when they do.
        self._welds = {
            k
            for k in range(compiled.neq)
            if compiled.eq_type[k] == weld and not compiled.eq_active0[k]
        }
        frames, welded = world.frames, (one.runtime.motors.welded for one in self._arms.values())
        self._plain = world.errors is None and frames.linear and not any(welded)
        if self._plain:
            self._posed, self._project = frames.tips(), frames.project
            self._shown = self._posed.qpos
            sites = [frames.tip_view(name) for name in self._arms]
            self._rows = [
                (
                    name,
                    world.joints.drive[world.joints.arms[name].rows],
                    self._posed.site_xpos[site],
                    self._posed.site_xmat[site].reshape(3, 3),
                )
                for name, site in zip(self._arms, sites, strict=True)
            ]
