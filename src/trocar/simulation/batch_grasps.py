"""Grasps in the worlds of a batch, read by contact sensors, since a batch lists no contacts."""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import cast

import mujoco
import numpy as np
from mujoco.batch import Batch as Rows  # pyright: ignore[reportMissingTypeStubs]  it has none
from numpy.typing import NDArray

from trocar.modeling.build import RigModel
from trocar.simulation.grasps import (
    LOOSE_N,
    PARALLEL,
    PERIOD_S,
    PRESS_N,
    PRESSED_S,
    Grasps,
    find_jaws,
    graspable,
)
from trocar.simulation.journal import Journal
from trocar.simulation.parts import Attached

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.intp]

#: Contacts of a finger with an object that a sensor reads, those with the largest forces. Source:
#: our own choice; with it, grasps of whole scripted episodes are those of `Task`.
CONTACTS = 8
#: Readings of each contact: force in the contact's axes, normal first, and the normal in the world.
DATA = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE) | 1 << int(
    mujoco.mjtConDataField.mjCONDATA_NORMAL
)
WIDTH = 6
#: Keeps the contacts with the largest forces.
MOST_FORCE = 2
#: Held by nothing.
NOTHING = -1


def sensed_model(model: RigModel, compiled: mujoco.MjModel) -> mujoco.MjModel:
    """Return a model with contact sensors between all fingers and free objects.

    Nothing else differs, and sensors do not change motion.

    Args:
        model: of the rig
        compiled: of a world of it, whose gains, brakes and limits are kept
    """
    spec, objects = model.spec.copy(), graspable(model.rig)
    jaws, _ = find_jaws(model.rig, compiled, objects)
    for one in jaws:
        for finger in one.bodies:
            for name in objects:
                spec.add_sensor(
                    name=f"{compiled.body(finger).name}/{name}",
                    type=mujoco.mjtSensor.mjSENS_CONTACT,
                    objtype=mujoco.mjtObj.mjOBJ_BODY,
                    objname=compiled.body(finger).name,
                    reftype=mujoco.mjtObj.mjOBJ_BODY,
                    refname=name,
                    intprm=[DATA, MOST_FORCE, CONTACTS],
                )
    made = spec.compile()
    for owner, kept in ((made, compiled), (made.opt, compiled.opt)):
        for field in dir(kept):
            if not isinstance(getattr(owner, field), np.ndarray):
                continue
            values, own = (cast(Array, getattr(one, field)) for one in (kept, owner))
            if own.flags.writeable and own.shape == values.shape:
                own[...] = values
    made.opt.disableactuator = compiled.opt.disableactuator
    return made


#: Fields of MjModel that grasps write.
WRITTEN = ("eq_data", "eq_obj2id", "geom_condim", "pair_dim")


class BatchGrasps:
    """The objects that jaws hold in n worlds, as `Grasps` finds them, by friction alone.

    Args:
        model: of the rig
        rows: the worlds, of a model from `sensed_model`

    Attributes:
        arms: those with jaws
        objects: those that jaws can hold
        every: physics steps between looks
        held: row of `objects` that each jaw holds or both its pads press, or `NOTHING`, (n, A)
    """

    def __init__(self, model: RigModel, rows: Rows) -> None:
        compiled: mujoco.MjModel = rows.model
        self.objects = graspable(model.rig)
        jaws, faces = find_jaws(model.rig, compiled, self.objects)
        self.arms = tuple(one.arm for one in jaws)
        timestep, count = float(compiled.opt.timestep), len(self.objects)
        self.every = max(1, round(PERIOD_S / timestep))
        self._enough = max(1, round(PRESSED_S / (timestep * self.every)))
        shape: tuple[int, ...] = rows.nsim, len(jaws), 2, count, CONTACTS, WIDTH
        used = int(np.prod(shape[1:]))
        first = int(compiled.nsensordata) - used  # added last
        self._sensed: Array = rows.bind("sensordata")[:, first:]
        self._shape = shape[1:]
        fingers = [body for body, _ in faces]
        self._turns: Array = rows.bind("xmat").reshape(rows.nsim, -1, 3, 3)
        self._fingers = np.array(fingers, np.intp).reshape(-1, 2)
        self._faces = np.array([face for _, face in faces]).reshape(-1, 2, 3)
        self.held = np.full(shape[:2], NOTHING)
        self._holds = self.held.copy()
        self._looks = np.zeros((*shape[:2], count), np.intp)

    def forget(self, worlds: Index) -> None:
        """Begin anew in some worlds, with nothing held."""
        self.held[worlds] = self._holds[worlds] = NOTHING
        self._looks[worlds] = 0

    def look(self, worlds: Index) -> None:
        """Take hold and let go in some worlds, as contacts of the last step tell."""
        sensed = self._sensed[worlds]
        if not sensed.any() and not (self._looks.any() or (self._holds >= 0).any()):
            self.held[worlds] = NOTHING
            return
        of = sensed.reshape(len(sensed), *self._shape)
        force, normal = of[..., 0], of[..., 3:]  # (n, A, 2, O, C), and (3,) more
        faces = np.einsum("nasij,asj->nasi", self._turns[worlds][:, self._fingers], self._faces)
        pushes = np.abs(force * np.einsum("nasock,nask->nasoc", normal, faces)).sum(axis=-1)
        weaker = pushes.min(axis=2)
        each = np.arange(len(sensed))[:, None], np.arange(len(self.arms))
        holds, looks = self._holds[worlds], self._looks[worlds]
        free = holds < 0
        looks = np.where((weaker > PRESS_N) & free[..., None], looks + 1, 0)
        most = weaker.argmax(axis=-1)
        presses = free & (weaker[(*each, most)] > PRESS_N)
        takes = presses & (looks[(*each, most)] >= self._enough)
        if takes.any():
            along = np.linalg.norm((force[..., None] * normal).sum(axis=-2), axis=-1)
            flat = (along >= PARALLEL * force.sum(axis=-1)).all(axis=2)  # no edge is dug in
            takes &= flat[(*each, most)]
        loose = ~free & (pushes[:, :, 1][(*each, np.maximum(holds, 0))] < LOOSE_N)
        holds = np.where(takes, most, np.where(loose, NOTHING, holds))
        looks[takes] = 0
        self._holds[worlds], self._looks[worlds] = holds, looks
        self.held[worlds] = np.where(presses, most, holds)


class WeldedGrasps:
    """The objects that jaws hold in n worlds by the welds of `Grasps`, of which each world has one.

    A look at a world in which nothing is touched or held costs nothing.

    Args:
        model: of the rig
        rows: the worlds, of a model from `sensed_model`

    Attributes:
        arms, objects, every, held: as of `BatchGrasps`
    """

    def __init__(self, model: RigModel, rows: Rows) -> None:
        self._rows = rows
        self._model: mujoco.MjModel = copy.copy(rows.model)
        self._data = mujoco.MjData(self._model)
        self.objects = graspable(model.rig)
        jaws, _ = find_jaws(model.rig, self._model, self.objects)
        self.arms = tuple(one.arm for one in jaws)
        timestep = float(self._model.opt.timestep)
        physics = cast(
            Attached,
            SimpleNamespace(rig=model.rig, model=self._model, data=self._data, exchanged=""),
        )
        self._each = [Grasps(model.rig, timestep, Journal()) for _ in range(rows.nsim)]
        for grasps in self._each:
            grasps.attach(physics)
        self.every = self._each[0].every
        names = [name for name in WRITTEN if getattr(self._model, name).size]
        #: Fields that grasps write: in the model, in that of each world, and as they began.
        self._fields = [
            (own := getattr(self._model, name), rows.expand(name), own.copy()) for name in names
        ]
        self._active: Array = rows.bind("eq_active")
        used = 2 * len(jaws) * len(self.objects) * CONTACTS * WIDTH
        self._sensed: Array = rows.bind("sensordata")[:, int(self._model.nsensordata) - used :]
        self.held = np.full((rows.nsim, len(jaws)), NOTHING)
        #: Worlds in which a jaw held or pressed something at the last look.
        self._busy = np.zeros(rows.nsim, np.bool_)

    def forget(self, worlds: Index) -> None:
        """Begin anew in some worlds, with nothing held."""
        self.held[worlds], self._busy[worlds] = NOTHING, False
        numbers: list[int] = worlds.tolist()
        for world in numbers:
            self._each[world].begin()
        for _, rows, first in self._fields:
            rows[worlds] = first

    def look(self, worlds: Index) -> None:
        """Take hold and let go in some worlds, as contacts of the last step tell."""
        touched: Bools = np.logical_or.reduce(self._sensed[worlds] != 0.0, axis=1)
        numbers: list[int] = worlds[touched | self._busy[worlds]].tolist()
        for world in numbers:
            grasps = self._each[world]
            self._rows.get_data(world, self._data)
            for own, rows, _ in self._fields:
                own[...] = rows[world]
            grasps.look()
            for own, rows, _ in self._fields:
                rows[world] = own
            self._active[world] = self._data.eq_active
            for column, one in enumerate(grasps.read().values()):
                self.held[world, column] = self.objects.index(one.object) if one.object else NOTHING
            self._busy[world] = not grasps.idle
