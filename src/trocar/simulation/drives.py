"""The elastic part of identified drivetrains: pre-sliding friction, springs, cables, biases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.polynomial import Polynomial, chebyshev
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.modeling import naming
from trocar.modeling.drives import arm_drives
from trocar.modeling.joints import JointTable
from trocar.simulation.parts import Attached, Part

Array = NDArray[np.float64]

#: Springs are renewed this often. Source: our own choice; a PSM at 0.5 rad/s travels by the limit
#: of its first stop elements in this time, and twice as often costs 10 % of its speed. [s]
PERIOD_S = 0.01
#: A spring's stiffness where nothing yields [N m/rad or N/m]. Source: our own choice; a constant
#: force is then a spring that begins far away, and changes by 1e-12 N m in a radian.
LEAST = 1e-12


class SpringFields(NamedTuple):
    """Views of the fields of one world's model that springs are written into."""

    jnt_stiffness: Array
    qpos_spring: Array
    tendon_stiffness: Array
    tendon_lengthspring: Array


#: Their names.
SPRING_FIELDS = SpringFields._fields


@dataclass
class Springs:
    """The springs of one world's model, and the stop elements that they stand for.

    Attributes:
        fields: of the model
        anchor: coordinates at which the elements are unloaded, (S,)
        slips: which slipped forwards, then which backwards, when the springs were written; None
            where they were not
    """

    fields: SpringFields
    anchor: Array
    slips: bytes | None = None


class Drives:
    """Springs of all drives of a rig. Drive d has the coordinate x, its drivetrains c = scale x.

    Stop elements deflect by z <- clip(z + dc, -limit, limit), and the force against c is

        F(c) = sum k z + offset + stiffness c + a sin c + b cos c + cable(c)

    as `trocar predict` has it. Between two renewals it is a spring of the hinge or tendon, with the
    force F and the slope F' of the moment, which the integrator takes implicitly; elements that
    slip do not add to F'.

    Args:
        rig: arms with their overlays
        table: their joints
        model: compiled
        friction: as of `ModelOptions`

    Attributes:
        every: physics steps between two renewals
        coordinates: x = coordinates @ qpos, (D, nq)
    """

    def __init__(
        self, rig: RigDescription, table: JointTable, model: mujoco.MjModel, friction: str
    ) -> None:
        found = [
            (place.name, drive)
            for place in rig.arms
            if len(table.arms[place.name].hinges)
            for drive in arm_drives(place.arm, friction)
        ]
        found.sort(key=lambda one: len(one[1].hinges) > 1)  # hinges ahead of tendons
        self._names = [naming.scoped(arm, drive.name) for arm, drive in found]
        self.every = max(1, round(PERIOD_S / float(model.opt.timestep)))
        alone = [n for n, (_, d) in zip(self._names, found, strict=True) if len(d.hinges) == 1]
        self._hinges = np.array([model.joint(name).id for name in alone], np.intp)
        self._places = model.jnt_qposadr[self._hinges].astype(np.intp)
        tendons = [model.tendon(name).id for name in self._names[len(alone) :]]
        self._tendons = np.array(tendons, np.intp)
        first = tendons[0] if tendons else 0
        straight = tendons == list(range(first, first + len(tendons)))
        self._adjacent = slice(first, first + len(tendons)) if straight else self._tendons
        rows = np.zeros((len(found), model.nq))
        for d, (arm, drive) in enumerate(found):
            for frame, weight in drive.hinges.items():
                rows[d, model.joint(naming.scoped(arm, frame)).qposadr[0]] = weight
        self.coordinates, self._along = rows, rows @ table.couple
        trains = [(d, s, train) for d, (_, one) in enumerate(found) for s, train in one.trains]
        stops = [
            (d, scale, k, limit)
            for d, scale, train in trains
            for k, limit in zip(train.terms.get("stops", ()), train.stop_limits, strict=True)
        ]
        self._owner = np.array([d for d, *_ in stops], np.intp)
        self._limit = np.array([limit for *_, limit in stops])
        self._opposite, self._stops = -self._limit, np.array([k for _, _, k, _ in stops])
        self._waves = [
            (d, scale, *train.terms["harmonic"])
            for d, scale, train in trains
            if "harmonic" in train.terms
        ]
        self._cables = [
            (d, scale, train.cable_range, *_polynomials(train.terms["cable"]))
            for d, scale, train in trains
            if "cable" in train.terms
        ]
        self._curved = bool(self._waves or self._cables)
        # One product for all: where elements and drives are; slopes and forces by what yields.
        most, count = len(stops), len(found)
        scales = np.array([scale for _, scale, *_ in stops])
        self._where = np.concatenate([scales[:, None] * rows[self._owner], rows])
        offset, stiffness = np.zeros(count), np.zeros(count)
        for d, scale, train in trains:
            offset[d] += scale * train.one("offset")
            stiffness[d] += scale**2 * train.one("stiffness")
        slopes, forces = np.zeros((2, count, 3 * most + count + 1))
        for i, (d, scale, k, _) in enumerate(stops):
            slopes[d, most + i], forces[d, i] = scale**2 * k, scale * k
        slopes[:, -1], forces[:, -1] = stiffness + LEAST, offset
        forces[:, 3 * most : -1] = np.diag(stiffness)
        self._gain = np.concatenate([slopes, forces])
        self._constant, self._elastic = offset @ self._along, (self._along.T * stiffness) @ rows
        # What `renew` computes with, and views of its parts: each call of numpy costs 1 us.
        self._by, self._found = np.ones(3 * most + count + 1), np.zeros(2 * count)
        self._z, self._sticks = self._by[:most], self._by[most : 2 * most]
        self._slips = np.zeros((2, most), np.bool_)
        self._ahead, self._behind = self._slips
        self._none = self._slips.tobytes()
        self._at = self._by[2 * most : -1]
        self._elements, self._x, self._moved = self._at[:most], self._at[most:], np.zeros(most)
        self._slope, self._force = self._found[:count], self._found[count:]
        alone = len(self._hinges)
        self._of_hinges = self._slope[:alone], self._force[:alone]
        self._of_tendons = self._slope[alone:], self._force[alone:, None]

    @property
    def elements(self) -> int:
        """Number of stop elements."""
        return len(self._owner)

    def begin(self, qpos: Array, springs: Springs, arm: str = "") -> None:
        """Unload the stop elements of an arm, of all without a name, where the joints are."""
        which = np.array([arm in ("", naming.owner(name)) for name in self._names], np.bool_)
        at, of_arm = self._where.dot(qpos)[: len(self._owner)], which[self._owner]
        springs.anchor[of_arm], springs.slips = at[of_arm], None
        self.renew(qpos, springs)

    def renew(self, qpos: Array, springs: Springs) -> None:
        """Move the stop elements along to where the joints are, and renew the springs there.

        Args:
            qpos: coordinates of the model, (nq,)
            springs: of the world, overwritten
        """
        anchor, z, moved = springs.anchor, self._z, self._moved
        self._where.dot(qpos, out=self._at)
        np.subtract(self._elements, anchor, out=moved)
        np.greater(moved, self._limit, out=self._ahead)
        np.less(moved, self._opposite, out=self._behind)
        slips = self._slips.tobytes()
        same = slips == springs.slips and not self._curved
        if same and slips == self._none:
            return  # all yield as springs do
        np.minimum(moved, self._limit, out=z)
        np.maximum(z, self._opposite, out=z)
        np.subtract(self._elements, z, out=anchor)
        if same:
            return  # what slips goes on with the same force
        springs.slips, slope, force = slips, self._slope, self._force
        np.equal(moved, z, out=self._sticks)
        self._gain.dot(self._by, out=self._found)
        if self._curved:
            self._add_curves(self._x, slope, force)
            np.maximum(slope, LEAST, out=slope)
        np.divide(force, slope, out=force)
        np.subtract(self._x, force, out=force)
        self._write(springs.fields)

    def save(self, springs: Springs) -> tuple[Array, Array, bytes | None]:
        """Return anchors, springs as `read` returns them, and which elements slipped."""
        return springs.anchor.copy(), self.read(springs.fields), springs.slips

    def load(self, springs: Springs, saved: tuple[Array, Array, bytes | None]) -> None:
        """Restore what `save` returned."""
        springs.anchor[:], found, springs.slips = saved
        self.write(springs.fields, found)

    def read(self, fields: SpringFields) -> Array:
        """Return stiffness and rest position of every drive's spring in a model, (2, D)."""
        tendons = self._tendons
        stiffness = fields.jnt_stiffness[self._hinges], fields.tendon_stiffness[tendons]
        rest = fields.qpos_spring[self._places], fields.tendon_lengthspring[tendons, 0]
        return np.stack([np.concatenate(stiffness), np.concatenate(rest)])

    def write(self, fields: SpringFields, springs: Array) -> None:
        """Write springs, (2, D) as `read` returns them, into a model."""
        self._slope[:], self._force[:] = springs
        self._write(fields)

    def _write(self, fields: SpringFields) -> None:
        fields.jnt_stiffness[self._hinges] = self._of_hinges[0]
        fields.qpos_spring[self._places] = self._of_hinges[1]
        if len(self._tendons):
            tendons = self._adjacent
            fields.tendon_stiffness[tendons] = self._of_tendons[0]
            fields.tendon_lengthspring[tendons] = self._of_tendons[1]

    def holding(self, qpos: Array) -> Array:
        """Return the efforts that hold what is no friction: springs, cables and biases, (J,)."""
        held = self._elastic.dot(qpos)
        held += self._constant
        if self._curved:
            force = np.zeros(len(self._along))
            self._add_curves(self.coordinates.dot(qpos), force.copy(), force)
            held += force.dot(self._along)
        return held

    def stored(self, qpos: Array, anchor: Array) -> float:
        """Return the energy that stop elements with anchors, (S,), store [J]."""
        z = self._where[: len(anchor)] @ qpos - anchor
        return float(0.5 * self._stops @ np.clip(z, self._opposite, self._limit) ** 2)

    def carried_over(self, old: Drives, anchor: Array) -> Array:
        """Return anchors from those of another model, by the drives' names, (S,)."""
        found = np.zeros(len(self._owner))
        for d, name in enumerate(self._names):
            if name in old._names:
                own, others = self._owner == d, old._owner == old._names.index(name)
                if np.array_equal(self._limit[own], old._limit[others]):
                    found[own] = anchor[others]
        return found

    def _add_curves(self, x: Array, slope: Array, force: Array) -> None:
        """Add harmonic springs and cables to slopes and forces, (D,) each."""
        for d, scale, a, b in self._waves:
            angle = scale * float(x[d])
            sine, cosine = sin(angle), cos(angle)
            force[d] += scale * (a * sine + b * cosine)
            slope[d] += scale**2 * (a * cosine - b * sine)
        for d, scale, (lower, upper), terms, steep in self._cables:
            u = 2.0 * (scale * float(x[d]) - lower) / (upper - lower) - 1.0
            force[d] += scale * _horner(terms, min(max(u, -1.0), 1.0))
            if -1.0 < u < 1.0:
                slope[d] += scale**2 * 2.0 / (upper - lower) * _horner(steep, u)


def _polynomials(terms: Sequence[float]) -> tuple[list[float], list[float]]:
    """Return powers, highest first, of Chebyshev terms from the first on, and of their slope."""
    powers = Polynomial(chebyshev.cheb2poly([0.0, *terms]))
    return powers.coef[::-1].tolist(), powers.deriv().coef[::-1].tolist()


def _horner(powers: Sequence[float], u: float) -> float:
    total = 0.0
    for coefficient in powers:
        total = total * u + coefficient
    return total


def spring_fields(model: mujoco.MjModel) -> SpringFields:
    """Return views of the fields of a model that springs are written into."""
    return SpringFields(*(getattr(model, name) for name in SPRING_FIELDS))


def drives_of(
    rig: RigDescription, table: JointTable, model: mujoco.MjModel, friction: str
) -> Drives | None:
    """Return the drives of a rig, None where no arm has identified dynamics."""
    if not any(arm_drives(place.arm, friction) for place in rig.arms):
        return None
    return Drives(rig, table, model, friction)


class Drivetrains(Part):
    """The identified drivetrains of a world.

    Args:
        friction: as of `ModelOptions`

    Attributes:
        drives: of the rig as it is compiled, None where no arm has identified dynamics
        springs: what they write into the world's model
    """

    def __init__(self, friction: str) -> None:
        self._friction = friction
        self.drives: Drives | None = None

    def attach(self, physics: Attached) -> None:
        """Take the physics; stop elements of drives that are still there stay loaded."""
        before = self.drives
        anchor = None if before is None else self.springs.anchor
        self._data = physics.data
        self.drives = drives_of(physics.rig, physics.joints, physics.model, self._friction)
        drives = self.drives
        if drives is None:
            return
        self.every = drives.every
        kept = np.zeros(drives.elements)
        if before is not None and anchor is not None:
            kept = drives.carried_over(before, anchor)
        self.springs = Springs(spring_fields(physics.model), kept)

    def placed(self, arm: str) -> None:
        """Unload the stop elements of an arm where it is."""
        if self.drives is not None:
            self.drives.begin(self._data.qpos, self.springs, arm)

    def look(self) -> None:
        """Renew the springs."""
        if self.drives is not None:
            self.drives.renew(self._data.qpos, self.springs)

    def save(self) -> tuple[Array, Array, bytes | None] | None:
        """Return anchors, springs and which elements slipped, None without drives."""
        return None if self.drives is None else self.drives.save(self.springs)

    def load(self, state: tuple[Array, Array, bytes | None]) -> None:
        """Restore what `save` returned."""
        if self.drives is not None:
            self.drives.load(self.springs, state)
