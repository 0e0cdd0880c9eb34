"""Contact forces, accelerations, rays and band tensions of a state, for sensors.

Forces and accelerations are those of the last physics step: the integrator solves for the mean
over a step, so they balance to the last digit and need no computation of their own. After an arm
was put somewhere there is no such step, and they are computed for the state as it stands.

MuJoCo keys a contact by two geoms, or by a flex where a geom is -1. Here both sides of a contact
are *carriers*: bodies by their ids, then flexes, flex k being carrier `nbody + k`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.descriptions.sensor_records import Bodies, Contact, Place, PlaceMotion, SensorReading
from trocar.errors import UnknownNameError
from trocar.modeling import naming
from trocar.modeling.joints import JointTable
from trocar.simulation.arm import Arm
from trocar.simulation.parts import Attached, Part
from trocar.simulation.tip_load import TipLoad

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Everything that a step depends on.
WHOLE_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
#: A ray begins so far behind its pad, so that it meets what is pressed into the pad by the depth
#: of a contact. Source: our own choice; fingers are 1.7 mm thick. [m]
BEHIND_PAD_M = 1e-3
#: A ray goes on so far behind a surface of its own arm. Source: our own choice. [m]
BEHIND_SURFACE_M = 1e-9


@dataclass(frozen=True, eq=False)
class ContactTable:
    """Every place where two bodies touch, a row each; vectors in the world.

    Attributes:
        time: [s]
        names: of all bodies, then of all flexes
        bodies: which two touch, `body` and `other` as in `Contact`, indices of `names`, (n, 2)
        points: (n, 3) [m]
        normals: from `other` into `body`, (n, 3)
        forces: what `other` does to `body`, (n, 3) [N]
        depths: how far the shapes overlap, (n,) [m]
    """

    time: float
    names: tuple[str, ...]
    bodies: Index
    points: Array
    normals: Array
    forces: Array
    depths: Array


@dataclass(frozen=True, eq=False)
class ProbeSite:
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
        rig: its description
        table: where its arms are in the model
        model, data: the physics
        arms: by name
        load: the forces at the tips
    """

    def __init__(
        self,
        rig: RigDescription,
        table: JointTable,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        arms: Mapping[str, Arm],
        load: TipLoad,
    ) -> None:
        self._rig, self._table, self._arms, self._load = rig, table, arms, load
        self._model, self._data = model, data

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return carrier_names(self._model)

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return float(self._data.time)

    def effort(self, arm: str, joint: str) -> float:
        """Return the effort of a motor on its joint [N m or N]."""
        index = self._arms[arm].description.mechanism.joint_index[joint]
        return float(self._arms[arm].joints.readings()[2][index])

    def bodies(self, arm: str = "", frame: str = "") -> Bodies:
        """Return the bodies on a frame and beyond it, all of an arm, a prop's, or everything."""
        if not arm and not frame:
            return np.ones(len(self._names), dtype=np.bool_)
        found = np.zeros(len(self._names), dtype=np.bool_)
        if not arm:
            found[self._model.body(frame).id] = True
            return found
        if not frame:
            found[list(self._table.arms[arm].bodies.values())] = True
            return found
        first, _ = self._table.arms[arm].carrier(self._rig.arm(arm), frame)
        found[first] = True
        for index in range(first + 1, self._model.nbody):
            found[index] = found[self._model.body_parentid[index]]
        return found

    def contacts(self, mine: Bodies) -> tuple[Contact, ...]:
        """Return the contacts of some bodies with others or each other."""
        return tuple(contact for contact, _, _ in self._touching(self._touched(mine), mine))

    def contact_table(self) -> ContactTable:
        """Return all contacts as arrays, as `contacts` of all bodies does."""
        data = self._touched(self.bodies())
        here = np.flatnonzero(data.contact.efc_address >= 0)
        found = data.contact
        return ContactTable(
            float(self._data.time),
            self._names,
            carriers(self._model, found.geom[here], found.flex[here]),
            found.pos[here].copy(),
            -found.frame[here, :3],  # the normal leads from the first shape
            -self._contact_forces(data, here),
            -found.dist[here],
        )

    def contact_forces(self) -> dict[str, Array]:
        """Return the net force of contacts and of held objects on each arm, {arm: (3,)} [N]."""
        return {name: np.array(force) for name, force in self.net_forces().items()}

    def net_forces(self) -> dict[str, list[float]]:
        """Return `contact_forces` in plain numbers, {arm: three} [N]."""
        data, on = self._acted(), self._arm_of_geom
        total = [[0.0, 0.0, 0.0] for _ in self._arms]
        equalities: list[int] = data.efc_id[: data.ne].tolist()
        if not self._welds.keys().isdisjoint(equalities):  # of the last step, whatever is active
            for weld, (finger, _) in self._welds.items():
                if weld in equalities:
                    first = equalities.index(weld)
                    on_arm = total[int(self._arm_of_body[finger])]
                    for i, f in enumerate(data.efc_force[first : first + 3].tolist()):
                        on_arm[i] += f
        mine: list[tuple[int, int, int]] = []  # contacts with the arms on both sides; they are few
        if data.ncon:
            geoms: list[tuple[int, int]] = data.contact.geom.tolist()
            for k, (a, b) in enumerate(geoms):
                if on[a] >= 0 or on[b] >= 0:
                    mine.append((k, on[a], on[b]))
        if mine:
            found = data.contact
            pushes: list[float] = data.efc_force.tolist()
            firsts: list[int] = found.efc_address.tolist()
            dims: list[int] = found.dim.tolist()
            frames: list[list[float]] = found.frame.tolist()
            for k, one, other in mine:
                if (first := firsts[k]) < 0:
                    continue
                nx, ny, nz, sx, sy, sz, tx, ty, tz = frames[k]
                push = pushes[first]
                x, y, z = push * nx, push * ny, push * nz
                if dims[k] > 1:  # one where a weld holds it, and pads only press
                    s, t = pushes[first + 1 : first + 3]
                    x, y, z = x + s * sx + t * tx, y + s * sy + t * ty, z + s * sz + t * tz
                if one >= 0:
                    a, b, c = total[one]
                    total[one] = [a - x, b - y, c - z]
                if other >= 0:
                    a, b, c = total[other]
                    total[other] = [a + x, b + y, c + z]
        return dict(zip(self._arms, total, strict=True))

    @cached_property
    def _arm_of_body(self) -> Index:
        """The arm that each body is of, -1 for none."""
        found = np.full(self._model.nbody, -1)
        for k, name in enumerate(self._arms):
            found[list(self._table.arms[name].bodies.values())] = k
        return found

    @cached_property
    def _arm_of_geom(self) -> list[int]:
        """The arm that each geom is on, -1 for none and, in the end, for flexes."""
        return [*self._arm_of_body[self._model.geom_bodyid].tolist(), -1]

    def _contact_forces(self, data: mujoco.MjData, here: Index) -> Array:
        """Return forces of the first shapes of contacts on the second in the world, (n, 3) [N].

        An elliptic cone's forces are along the axes: of the normal, and of two tangents where there
        is friction, as all shapes have it but pads whose object a weld holds.
        """
        found = data.contact
        rows, felt = found.efc_address[here], np.zeros((len(here), 3))
        felt[:, 0] = data.efc_force[rows]
        rubs = found.dim[here] > 1
        felt[rubs, 1:] = data.efc_force[rows[rubs][:, None] + np.arange(1, 3)]
        return (felt[:, None] @ found.frame[here].reshape(-1, 3, 3))[:, 0]

    def wrench(self, mine: Bodies, at: Place) -> tuple[Array, Array]:
        """Return force and torque that act on some bodies from outside, at a place in its axes."""
        data = self._acted()
        seen = self._site(at).pose_in(data)
        origin = seen[:3, 3]
        force, torque = np.zeros(3), np.zeros(3)
        for point, pressed, turn in self._external_forces(data, mine):
            force += pressed
            torque += np.cross(point - origin, pressed) + turn
        return seen[:3, :3].T @ force, seen[:3, :3].T @ torque

    def motion(self, at: Place) -> PlaceMotion:
        """Return velocity and acceleration of a place.

        a = J dv/dt + dJ/dt v - g, with the last step's dv/dt.
        """
        model, now, site = self._model, self._now(), self._site(at)
        acceleration = self._acted().qacc.copy()
        seen = site.pose_in(now)
        back, origin = seen[:3, :3].T, seen[:3, 3]
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        changing = np.zeros((3, model.nv))
        mujoco.mj_jac(model, now, linear, angular, origin, site.body)
        mujoco.mj_jacDot(model, now, changing, None, origin, site.body)
        proper = linear @ acceleration + changing @ now.qvel - model.opt.gravity
        return PlaceMotion(back @ (linear @ now.qvel), back @ (angular @ now.qvel), back @ proper)

    def ray(self, start: Place, end: Place, through: Bodies) -> tuple[float, float, str]:
        """Return the distance from a place towards another to a body, and that of the places.

        Args:
            start, end: of the ray
            through: bodies that the ray passes through

        Returns:
            distance, below 0 where it reaches behind the start, inf when nothing lies between the
            places; from place to place [m]; name of the body, "" for nothing
        """
        now = self._now()
        first = self._site(start).pose_in(now)[:3, 3]
        last = self._site(end).pose_in(now)[:3, 3]
        gap = float(np.linalg.norm(last - first))
        if gap < BEHIND_SURFACE_M:
            return np.inf, gap, ""
        along = (last - first) / gap
        passed, hit = -BEHIND_PAD_M, np.zeros(1, dtype=np.int32)
        while passed < gap:
            origin = first + passed * along
            free = mujoco.mj_ray(self._model, now, origin, along, None, True, -1, hit)
            passed += free
            if free < 0.0 or passed >= gap:
                break
            body = self._model.geom_bodyid[hit[0]]
            if not through[body]:
                return passed, gap, self._names[int(body)]
            passed += BEHIND_SURFACE_M
        return np.inf, gap, ""

    def band(self, name: str) -> tuple[float, float]:
        """Return the length of an elastic band and its tension [m, N]."""
        model, now = self._model, self._now()
        mujoco.mj_tendon(model, now)
        index = model.tendon(naming.band(name)).id
        length, rate = float(now.ten_length[index]), 0.0
        if model.tendon_damping[index]:
            mujoco.mj_fwdVelocity(model, now)
            rate = float(now.ten_velocity[index])
        described = next(band for band in self._rig.bands if band.name == name)
        stretch = max(0.0, length - described.rest_length)
        return length, described.stiffness * stretch + described.damping * rate

    def _site(self, place: Place) -> ProbeSite:
        if not place.arm:
            return ProbeSite(self._model.body(place.frame).id, place.pose)
        body, at = self._table.arms[place.arm].carrier(self._rig.arm(place.arm), place.frame)
        return ProbeSite(body, at @ place.pose)

    def _now(self) -> mujoco.MjData:
        """Return the state as it stands, with its positions and velocities worked out."""
        scratch = self._copied()
        mujoco.mj_kinematics(self._model, scratch)
        mujoco.mj_comPos(self._model, scratch)
        mujoco.mj_comVel(self._model, scratch)
        return scratch

    def _acted(self) -> mujoco.MjData:
        """Return the data that holds forces and accelerations of the last step."""
        qacc = self._data.qacc
        if math.isfinite(qacc.dot(qacc)):  # all are, in a quarter of the time
            return self._data
        scratch = self._copied()
        mujoco.mj_forward(self._model, scratch)
        return scratch

    def _touched(self, mine: Bodies) -> mujoco.MjData:
        """Return the data that holds contacts of some bodies; those of sleepers are computed."""
        trees: NDArray[np.int32] = self._model.body_treeid[mine[: self._model.nbody]]
        if (trees < 0).all():  # what stands still: everything that sleeps may lie on it
            trees = np.arange(self._model.ntree, dtype=np.int32)
        if not (self._data.tree_asleep[trees[trees >= 0]] >= 0).any():
            return self._acted()
        scratch = self._copied()  # is never stepped, so nothing in it falls asleep
        mujoco.mj_forward(self._model, scratch)
        return scratch

    @cached_property
    def _scratch(self) -> mujoco.MjData:
        """Scratch data of readings; most worlds never need it."""
        return mujoco.MjData(self._model)

    def _copied(self) -> mujoco.MjData:
        state = np.zeros(mujoco.mj_stateSize(self._model, WHOLE_STATE))
        mujoco.mj_getState(self._model, self._data, state, WHOLE_STATE)
        mujoco.mj_setState(self._model, self._scratch, state, WHOLE_STATE)
        return self._scratch

    def _external_forces(
        self, data: mujoco.MjData, mine: Bodies
    ) -> Iterator[tuple[Array, Array, Array]]:
        """Yield (point, force, torque) in the world of all that acts on bodies from outside."""
        for contact, body, other in self._touching(data, mine):
            if mine[body] != mine[other]:
                yield contact.point, contact.force, contact.torque
        for weld, pair in self._welds.items():
            if data.eq_active[weld] and mine[pair[0]] != mine[pair[1]]:
                force, torque = self._held(data, weld, pair[1])
                sign = 1.0 if mine[pair[1]] else -1.0
                yield data.xpos[pair[1]], sign * force, sign * torque
        for body in np.flatnonzero(mine[: len(data.xfrc_applied)] & data.xfrc_applied.any(axis=1)):
            applied = data.xfrc_applied[body]
            yield data.xipos[body], applied[:3], applied[3:]
        for body, point, force in self._load.acting():
            if mine[body]:
                yield data.xpos[body] + data.xmat[body].reshape(3, 3) @ point, force, np.zeros(3)

    @cached_property
    def _welds(self) -> dict[int, tuple[int, int]]:
        """The equalities by which jaws may hold objects, with finger and object."""
        model = self._model
        return {
            k: (int(model.eq_obj1id[k]), int(model.eq_obj2id[k]))
            for k in range(model.neq)
            if model.eq_type[k] == mujoco.mjtEq.mjEQ_WELD and not model.eq_active0[k]
        }

    def _held(self, data: mujoco.MjData, weld: int, body: int) -> tuple[Array, Array]:
        """Return force and torque about its origin that a weld exerts on a free body, in the world.

        While it is active, pads only press: this is what friction would carry.
        """
        rows = (data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY) & (data.efc_id == weld)
        first = int(self._model.body_dofadr[body])
        jacobian = data.efc_J.reshape(-1, self._model.nv)[rows, first : first + 6]
        push = jacobian.T @ data.efc_force[rows]
        return push[:3], data.xmat[body].reshape(3, 3) @ push[3:]

    def _touching(self, data: mujoco.MjData, mine: Bodies) -> Iterator[tuple[Contact, int, int]]:
        """Yield each contact of some carriers with both carriers, one of `mine` first."""
        model, felt = self._model, np.zeros(6)
        pairs = carriers(model, data.contact.geom, data.contact.flex).tolist()
        for index, (first, second) in enumerate(pairs):
            contact = data.contact[index]
            if contact.efc_address < 0 or not (mine[first] or mine[second]):
                continue
            mujoco.mj_contactForce(model, data, index, felt)
            axes = contact.frame.reshape(3, 3)  # rows; the normal leads from the first shape
            shapes: list[str] = [
                model.geom(geom).name if geom >= 0 else self._names[carrier]
                for geom, carrier in zip(contact.geom, (first, second), strict=True)
            ]
            body, other, sign = second, first, 1.0  # MuJoCo gives the force of the first on it
            if mine[first]:
                body, other, shapes, sign = first, second, shapes[::-1], -1.0
            yield (
                Contact(
                    body=self._names[int(body)],
                    other=self._names[int(other)],
                    shape=shapes[1],
                    other_shape=shapes[0],
                    point=contact.pos.copy(),
                    normal=sign * axes[0],
                    force=sign * (felt[:3] @ axes),
                    torque=sign * (felt[3:] @ axes),
                    depth=-float(contact.dist),
                ),
                body,
                other,
            )


def carrier_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of all bodies, then of all flexes; "body 3" for one without a name."""
    flex = mujoco.mjtObj.mjOBJ_FLEX
    bodies = (model.body(k).name or f"body {k}" for k in range(model.nbody))
    flexes = (mujoco.mj_id2name(model, flex, k) or f"flex {k}" for k in range(model.nflex))
    return (*bodies, *flexes)


def moved_carrier(model: mujoco.MjModel, body: int) -> int:
    """Return the flex whose vertices or nodes a body is one of; else the body itself."""
    for k in range(model.nflex):
        first, count = model.flex_vertadr[k], model.flex_vertnum[k]
        node, nodes = model.flex_nodeadr[k], model.flex_nodenum[k]
        if (
            body in model.flex_vertbodyid[first : first + count]
            or body in model.flex_nodebodyid[node : node + nodes]
        ):
            return model.nbody + k
    return body


def carriers(model: mujoco.MjModel, geoms: NDArray[np.int32], flexes: NDArray[np.int32]) -> Index:
    """Return the carriers of a contact's sides.

    Args:
        model: the model
        geoms: as MuJoCo has them, -1 where a flex touches, (..., 2)
        flexes: likewise, -1 where a geom touches, (..., 2)

    Returns:
        (..., 2)
    """
    found = cast(Any, np.where(geoms >= 0, model.geom_bodyid[geoms], model.nbody + flexes))
    return found.astype(np.intp)


#: A sample is due when its time comes to within this share of its period: rounding of the time.
DUE = 1e-6


@dataclass(frozen=True, eq=False)
class _Held:
    """The last sample of a sensor with a rate: its number, and the generator of its noise."""

    number: int
    rng: np.random.Generator
    reading: SensorReading


class Sensors(Part):
    """Reads the sensors of one rig.

    Args:
        load: the forces at the tips

    Attributes:
        probes: looks at the physics that the sensors sample
    """

    def __init__(self, load: TipLoad) -> None:
        self._load = load
        self._held: dict[str, _Held] = {}

    def attach(self, physics: Attached) -> None:
        """Take the physics; sensors of an arm whose tool was exchanged are sampled anew."""
        self._rig, self._rng = physics.rig, physics.rng
        self.probes = Probes(
            physics.rig, physics.joints, physics.model, physics.data, physics.arms, self._load
        )
        self._known = {sensor.name: sensor for sensor in physics.rig.sensors}
        if physics.exchanged:
            self._held = {
                name: held
                for name, held in self._held.items()
                if self._known[name].arm != physics.exchanged
            }

    def save(self) -> dict[str, tuple[int, SensorReading]]:
        """Return the last samples of sensors with a rate."""
        return {name: (held.number, held.reading) for name, held in self._held.items()}

    def load(self, state: Mapping[str, tuple[int, SensorReading]]) -> None:
        """Take the samples that `save` returned."""
        rng = self._rng()
        self._held = {
            name: _Held(number, rng, reading) for name, (number, reading) in state.items()
        }

    def read(self, name: str) -> SensorReading:
        """Return a new sample of a sensor, or its last one while its rate allows no new one.

        Noise is drawn from the world's generator; another one than before begins anew.

        Args:
            name: of the sensor

        Raises:
            UnknownNameError: no such sensor; the known ones are listed
        """
        sensor = self._known.get(name)
        if sensor is None:
            raise UnknownNameError("sensor", name, self._known, f"rig {self._rig.name}")
        rng = self._rng()
        if not sensor.rate:
            return sensor.sample(self.probes, rng)
        number = math.floor(self.probes.time * sensor.rate + DUE)
        held = self._held.get(name)
        if held is None or held.number != number or held.rng is not rng:
            held = self._held[name] = _Held(number, rng, sensor.sample(self.probes, rng))
        return held.reading
