"""Grasps of free objects between the pads of jaws: hold, load, slip and release."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import acos, hypot, inf, sqrt
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.kinematics.forward import pose
from trocar.modeling import naming
from trocar.modeling.threads import bodies_of
from trocar.simulation.journal import Journal
from trocar.simulation.parts import Attached, Part

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Grips are looked at this often, counted from a reset. Source: our own choice, as often as a
#: controller at 100 Hz commands. [s]
PERIOD_S = 0.01
#: A jaw holds what both pads press harder than this for so long, and no longer holds what a pad
#: presses less than the other. Source: measured on needles and rings, of which 18.7 N is the most
#: that the jaw of a large needle driver exerts. [N, s, N]
PRESS_N, PRESSED_S, LOOSE_N = 3.0, 0.05, 1.0
#: A finger that presses with less of its forces along one normal than this is dug in by an edge,
#: and holds by friction alone: a weld would keep it there. Source: measured on a needle that lies
#: across an edge: 0.7, with 140 N at the finger's side; 1.0 of needles between pads.
PARALLEL = 0.9
#: Shares of the friction ellipsoid: beyond the first, friction alone holds an object; below the
#: second of the first, it is stuck again. Source: measured in twenty directions of forces and
#: torques, in which a needle slips at 0.85 of the ellipsoid or later.
LOADED, RESTUCK = 0.6, 0.8
#: A thread that is pulled by so many times the tension that it bears steadily slips out, whatever
#: friction carries. Source: our own choice, below the 2.5 times at which waves on it begin to grow
#: (`modeling.threads`).
TORN = 2.0
#: It slipped where it moved so far between the pads since. Source: our own choice, half a needle's
#: wire. [m, rad]
SLIPPED_M, SLIPPED_RAD = 2e-4, 0.04
#: Height of a fall after a release that counts as dropped. Source: our own choice, two
#: thirds of the height of a peg. [m]
DROPPED_M = 0.008
#: Rows of constraints of a weld.
WELD_ROWS = 6
#: Time before an object that slipped is held again. Source: our own choice. [s]
SLIPPED_S = 0.2


class Grasp(NamedTuple):
    """The object between the pads of a jaw.

    Attributes:
        object: name of what it holds, "" for nothing
        force: with which the pads press it, the lesser of both [N]
        load: share of what friction carries that is in use: it slips at 1; NaN where friction alone
            holds it, and 0 of nothing
        time: [s]
    """

    object: str
    force: float
    load: float
    time: float


@dataclass(frozen=True, eq=False)
class Hold:
    """The grip of a jaw on an object, as it was when it began.

    Attributes:
        object: its index
        body: of the object, which the jaw holds: a link of a thread
        anchor: centre of the grip in the object (3,) [m]
        turned: rotation of the object in the left finger, quaternion wxyz (4,)
        centre: of the grip, in the left finger (3,) [m]
        axes: in the left finger, columns: along the pads' line of contact, across, normal (3, 3)
        levers: of friction about these axes: most torque per newton of both pads' force (3,) [m]
        friction: coefficient of the pads on the object
        stuck: whether the weld holds it; else friction of the pads does
    """

    object: int
    body: int
    anchor: Array
    turned: Array
    centre: Array
    axes: Array
    levers: Array
    friction: float
    stuck: bool = True


@dataclass(frozen=True, eq=False)
class GraspState:
    """Saved state of a jaw: its hold, and the looks at which each object was pressed."""

    hold: Hold | None
    looks: NDArray[np.int64]
    read: Grasp


class Jaws(NamedTuple):
    """The fingers of one arm: bodies, and the equalities by which they hold each object."""

    arm: str
    bodies: tuple[int, int]
    welds: list[int]


class Grasps(Part):
    """The objects that the jaws of a rig hold.

    A free body between two jaws creeps in any time-stepping of Coulomb friction: the arm turns on
    arcs, the body moves along tangents. So what both pads press for 50 ms is held by a weld to the
    left finger, with frictionless pads: no creep. Where the load comes near the ellipsoid of what
    friction of the pads' forces carries, friction itself takes over, until the load is less or the
    object slips: so it is let go exactly where friction lets go.

    Args:
        rig: its description
        timestep: of the physics [s]
        journal: receives "grasp/object" with the force, "grasp/slipped" and "grasp/dropped"

    Attributes:
        objects: names of what can be held
        arms: names of those that have jaws
        latest: the grasp of each of them, as of the last look
    """

    def __init__(self, rig: RigDescription, timestep: float, journal: Journal) -> None:
        self._kind, self._journal = rig.grasp, journal
        self._jaws: list[Jaws] = []
        self.objects = graspable(rig)
        self._props = tuple(p for p in rig.objects if p.name in self.objects)
        #: The pull at which each object slips out of a jaw; inf of all but threads [N].
        self._strength = [TORN * p.thread.tension if p.thread else inf for p in self._props]
        self._period = max(1, round(PERIOD_S / timestep))
        self._enough = max(1, round(PRESSED_S / (timestep * self._period)))
        self._again = -round(SLIPPED_S / (timestep * self._period))

    def attach(self, physics: Attached) -> None:
        """Take the physics that the jaws are in; an arm whose tool was exchanged holds nothing."""
        kept: dict[str, GraspState] | None = None
        if physics.exchanged:
            self.let_go(arm=physics.exchanged)
            kept = self.save()
        self._find_jaws(physics.rig, physics.model, physics.data)
        self.every = self._period if self._jaws else 0
        if kept is not None:
            self.load(kept)

    def _find_jaws(self, rig: RigDescription, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Take the physics that the jaws are in, with nothing held."""
        self._model, self._data = model, data
        self._axes, self._origins = data.xmat.reshape(-1, 3, 3), data.xpos
        self._jaws, self._faces = find_jaws(rig, model, self.objects)
        self.arms = tuple(jaws.arm for jaws in self._jaws)
        bodies = [model.body(name).id for name in self.objects]
        self._bodies = np.array(bodies, dtype=np.intp)
        #: Root of the tree of each: itself, or the body that a thread is tied to. All forces on a
        #: tree are those on the six degrees of freedom of its root.
        self._roots: list[int] = model.body_rootid[self._bodies].tolist()
        self._dofs = [slice(k := int(model.body_dofadr[root]), k + 6) for root in self._roots]
        finger, held = np.full(model.nbody, -1), np.full(model.nbody, -1)
        for row, jaws in enumerate(self._jaws):
            finger[list(jaws.bodies)] = 2 * row, 2 * row + 1
        for row, prop in enumerate(self._props):
            held[[model.body(name).id for name in bodies_of(prop)]] = row
        #: Of each geom: its finger, 2 * jaws + side, and its object; -1 of others.
        self._finger, self._held = finger[model.geom_bodyid], held[model.geom_bodyid]
        #: The same as lists, with -1 in the end for flexes, whose contacts have the geom -1.
        self._finger_of, self._held_of = [*self._finger.tolist(), -1], [*self._held.tolist(), -1]
        self._condim, self._pair_dim = model.geom_condim.copy(), model.pair_dim.copy()
        ends = np.stack([model.pair_geom1, model.pair_geom2], axis=-1).reshape(-1, 2)
        self._pairs = self._finger[ends].max(axis=1), self._held[ends].max(axis=1)
        self._forget()

    @property
    def idle(self) -> bool:
        """Whether no jaw held or pressed anything at the last look."""
        return not self._pressing and not any(self._holds)

    def read(self) -> dict[str, Grasp]:
        """Return the grasp of each jaw as of the last look, {arm: grasp}."""
        return dict(zip(self.arms, self.latest, strict=True))

    def begin(self) -> None:
        """Begin anew, with nothing held."""
        self._forget()
        self._slicken()

    def save(self) -> dict[str, GraspState]:
        """Return the state of each jaw, {arm: state}."""
        rows = zip(self._jaws, self._holds, self._looks, self.latest, strict=True)
        return {jaws.arm: GraspState(hold, looks.copy(), r) for jaws, hold, looks, r in rows}

    def load(self, state: Mapping[str, GraspState]) -> None:
        """Hold what was held when `save` returned the state; other jaws hold nothing."""
        self._forget()
        for row, jaws in enumerate(self._jaws):
            if jaws.arm in state:
                kept = state[jaws.arm]
                self._looks[row], self.latest[row] = kept.looks, kept.read
                self._set(row, kept.hold)
        self._pressing = bool(self._looks.any())
        self._slicken()

    def placed(self, arm: str) -> None:
        """Let go of what an arm held that was put elsewhere."""
        if arm:
            self.let_go(arm=arm)

    def let_go(self, *, arm: str = "", prop: str = "") -> None:
        """Let go of what an arm holds, or of an object: it was put elsewhere."""
        for row, hold in enumerate(self._holds):
            if hold is not None and (
                self._jaws[row].arm == arm or self.objects[hold.object] == prop
            ):
                self._release(row)

    def look(self) -> None:
        """Take hold and let go, as contacts of the last step tell; to be called after it."""
        data = self._data
        if self._loose:
            self._watch_falls()
        if not data.ncon and not self._pressing and not any(self._holds):
            return
        contacts: dict[tuple[int, int], list[int]] = {}  # (jaws, object): contacts
        force: dict[tuple[int, int], float] = {}  # (finger, object): across its face [N]
        fingers, objects = self._finger_of, self._held_of
        geoms: list[tuple[int, int]] = data.contact.geom.tolist() if data.ncon else []
        pads: list[tuple[int, int, int]] = []  # contacts of fingers with objects; they are few
        for k, (one, two) in enumerate(geoms):
            finger = fingers[one] if fingers[one] >= 0 else fingers[two]
            held = objects[one] if objects[one] >= 0 else objects[two]
            if finger >= 0 and held >= 0:
                pads.append((k, finger, held))
        if pads:
            touching = data.contact
            firsts: list[int] = touching.efc_address.tolist()
            pushes, normals = data.efc_force, touching.frame[:, :3]
            across: dict[int, Array] = {}  # normals of fingers' faces in the world
            for k, finger, held in pads:
                if (first := firsts[k]) < 0:
                    continue
                contacts.setdefault((finger // 2, held), []).append(k)
                if finger not in across:
                    body, face = self._faces[finger]  # its edges do not press
                    across[finger] = self._axes[body].dot(face)
                squeeze = float(pushes[first] * normals[k].dot(across[finger]))
                force[finger, held] = force.get((finger, held), 0.0) + abs(squeeze)
        for row in range(len(self._jaws)):
            if (hold := self._holds[row]) is None:
                self._watch(row, contacts, force)
            else:
                pressed = force.get((2 * row + 1, hold.object), 0.0)
                self._guard(row, hold, contacts.get((row, hold.object), []), pressed)
        self._pressing = np.count_nonzero(self._looks) > 0  # any() takes 1 us

    def _guard(self, row: int, hold: Hold, contacts: list[int], pressed: float) -> None:
        """Let go of what slips or is no longer pressed; leave what is loaded to friction."""
        load, pull = self._load(row, hold, contacts, pressed)
        self.latest[row] = self._grasp(hold.object, pressed, load)
        self._most[row] = max(self._most[row], pressed)
        if hold.stuck and pressed < LOOSE_N:
            self._release(row)
        elif pull > self._strength[hold.object]:
            self._slip(row, hold, load)
            self._looks[row, hold.object] = 2 * self._again
            self._slicken()
        elif self._kind != "friction+stick":
            return
        elif hold.stuck and load > LOADED:
            self._set(row, replace(hold, stuck=False))
            self._slicken()
        elif not hold.stuck:
            anchor, turned = self._placed(row, hold.body, hold.centre)
            far = float(np.linalg.norm(anchor - hold.anchor))
            same = min(1.0, abs(float(turned @ hold.turned)))
            if pressed < LOOSE_N or far > SLIPPED_M or 2.0 * acos(same) > SLIPPED_RAD:
                self._slip(row, hold, load)
            elif load < LOADED * RESTUCK:
                self._set(row, replace(hold, anchor=anchor, turned=turned, stuck=True))
                self._slicken()

    def _watch(
        self,
        row: int,
        contacts: Mapping[tuple[int, int], list[int]],
        force: Mapping[tuple[int, int], float],
    ) -> None:
        """Take hold of what both pads have pressed for long enough."""
        looks, most, least = self._looks[row], -1, 0.0
        pressed = [held for jaws, held in contacts if jaws == row]
        if not pressed and not self._pressing:
            self.latest[row] = self._grasp(None, 0.0)
            return
        counts = np.where(looks < 0, looks + 1, 0)
        for held in sorted(pressed):
            weaker = min(force.get((2 * row + side, held), 0.0) for side in (0, 1))
            if weaker > PRESS_N or looks[held] < 0:
                counts[held] = looks[held] + 1
            if weaker > least:
                most, least = held, weaker
        looks[:] = counts
        if (looks == self._again).any():  # friction is back
            self._slicken()
        presses = least > PRESS_N
        self.latest[row] = self._grasp(most if presses else None, least)
        if presses and looks[most] >= self._enough:
            self._take(row, most, np.array(contacts[row, most]), least)

    # ------------------------------------------------------------------ inside

    def _forget(self) -> None:
        count = len(self._jaws)
        self._holds: list[Hold | None] = [None] * count
        self._looks = np.zeros((count, len(self.objects)), dtype=np.int64)
        self._pressing = False  # whether any of these is not 0
        #: The largest force of each hold so far; what was let go: jaw, body, from where [m].
        self._most = [0.0] * count
        self._loose: dict[int, tuple[int, int, float]] = {}
        self.latest = [Grasp("", 0.0, 0.0, 0.0)] * count

    def _take(self, row: int, found: int, contacts: Index, force: float) -> None:
        """Take hold of an object where it is now, unless a finger is dug into it."""
        data, finger = self._data, self._jaws[row].bodies[0]
        touching = data.contact
        meets = self._finger[touching.geom[contacts]]
        sides = meets.max(axis=1) % 2
        # a normal points from the first geom to the second; pushes of both sides from left to right
        signs = np.where(meets[:, 0] >= 0, 1.0, -1.0) * np.where(sides, -1.0, 1.0)
        turn, origin = data.xmat[finger].reshape(3, 3), data.xpos[finger]
        forces = data.efc_force[touching.efc_address[contacts]]
        pushes = (touching.frame[contacts][:, :3] * signs[:, None]) @ turn
        for side in (0, 1):
            own = sides == side
            if np.linalg.norm(forces[own] @ pushes[own]) < PARALLEL * forces[own].sum():
                return
        at = (touching.pos[contacts] - origin) @ turn
        grip = _grip(at, forces, sides, pushes, touching.friction[contacts])
        of = touching.geom[contacts, np.where(meets[:, 0] >= 0, 1, 0)]
        pressed = np.bincount(self._model.geom_bodyid[of], forces)
        body = int(pressed.argmax())
        anchor, turned = self._placed(row, body, grip[0])
        self._set(row, Hold(found, body, anchor, turned, *grip))
        self._slicken()
        self._looks[row] = 0
        self.latest[row] = self._grasp(found, force)
        self._most[row] = force
        self._loose.pop(found, None)
        name = self.objects[found]
        self._journal.event(self._jaws[row].arm, "grasp/object", object=name, force=force)

    def _placed(self, row: int, body: int, centre: Array) -> tuple[Array, Array]:
        """Return a grip's centre in a body, and the body's quaternion in the finger."""
        data, finger = self._data, self._jaws[row].bodies[0]
        mujoco.mj_kinematics(self._model, data)  # bodies were where the last step began
        there, about = data.xmat[body].reshape(3, 3), data.xmat[finger].reshape(3, 3)
        anchor = (data.xpos[finger] + about @ centre - data.xpos[body]) @ there
        back, turned = np.empty(4), np.empty(4)
        mujoco.mju_negQuat(back, data.xquat[finger])
        mujoco.mju_mulQuat(turned, back, data.xquat[body])
        return anchor, turned

    def _release(self, row: int) -> None:
        if (hold := self._holds[row]) is not None:
            height = float(self._data.xpos[hold.body, 2])
            self._loose[hold.object] = row, hold.body, height
        self._set(row, None)
        self._slicken()
        self._looks[row] = 0
        self.latest[row] = self._grasp(None, 0.0)
        self._journal.event(self._jaws[row].arm, "grasp/object", object="", force=self._most[row])

    def _slip(self, row: int, hold: Hold, load: float) -> None:
        """Let go of an object that slipped out of the pads, and report it."""
        self._release(row)
        self._looks[row, hold.object] = self._again
        arm, name = self._jaws[row].arm, self.objects[hold.object]
        self._journal.event(arm, "grasp/slipped", object=name, load=load)

    def _watch_falls(self) -> None:
        """Report what fell since a jaw let go of it."""
        holding = {hold.object for hold in self._holds if hold is not None}
        for found, (row, body, height) in list(self._loose.items()):
            fallen = height - float(self._data.xpos[body, 2])
            if found in holding or fallen > DROPPED_M:
                del self._loose[found]
            if found not in holding and fallen > DROPPED_M:
                arm, name = self._jaws[row].arm, self.objects[found]
                self._journal.event(arm, "grasp/dropped", object=name, height=fallen)

    def _set(self, row: int, hold: Hold | None) -> None:
        """Hold an object where it is in the left finger, or nothing."""
        self._holds[row], welds = hold, self._jaws[row].welds
        self._data.eq_active[welds] = 0
        if hold is not None and hold.stuck and self._kind != "friction":
            weld = welds[hold.object]
            self._model.eq_obj2id[weld] = hold.body
            self._model.eq_data[weld, :10] = *hold.anchor, *hold.centre, *hold.turned
            self._data.eq_active[weld] = 1

    def _slicken(self) -> None:
        """Take the friction from pads on objects that a weld holds, as it would fight the weld.

        Pads also have no friction on a thread that slipped at `TORN` times its tension, until the
        jaw may hold it again.
        """
        model = self._model
        model.geom_condim[:], model.pair_dim[:] = self._condim, self._pair_dim
        if self._kind == "friction":
            return
        slick = [(row, h.object) for row, h in enumerate(self._holds) if h is not None and h.stuck]
        for row, found in (*slick, *np.argwhere(self._looks < self._again).tolist()):
            mine, its = self._finger // 2 == row, self._held == found
            # where its own friction prevails there are pairs: it keeps it towards all else
            model.geom_condim[mine | (its & (model.geom_priority == 0))] = 1
            model.pair_dim[(self._pairs[0] // 2 == row) & (self._pairs[1] == found)] = 1

    def _load(self, row: int, hold: Hold, contacts: list[int], right: float) -> tuple[float, float]:
        """Return the share of what friction carries that the grip's load takes, and its force."""
        if self._kind == "friction":
            return float("nan"), 0.0
        data, finger = self._data, self._jaws[row].bodies[0]
        found, body = data.contact, self._roots[hold.object]
        firsts, sizes = found.efc_address.tolist(), found.dim.tolist()
        rows: list[int] = []
        for c in contacts:
            rows += range(firsts[c], firsts[c] + sizes[c])
        if data.eq_active[weld := self._jaws[row].welds[hold.object]]:
            first = bisect_left(data.efc_id[: data.ne].tolist(), weld)  # equalities first, in order
            rows += range(first, first + WELD_ROWS)
        chosen = np.array(rows, np.intp)
        jacobian = data.efc_J.reshape(-1, self._model.nv).take(chosen, axis=0)
        push = data.efc_force.take(chosen).dot(jacobian[:, self._dofs[hold.object]])
        facing, origins = self._axes[finger], self._origins
        turn = facing.dot(hold.axes)
        x, y, z = (origins[finger] + facing.dot(hold.centre) - origins[body]).tolist()
        fx, fy, fz = push[:3].tolist()
        tx, ty, tz = self._axes[body].dot(push[3:]).tolist()
        about = np.array([tx - (y * fz - z * fy), ty - (z * fx - x * fz), tz - (x * fy - y * fx)])
        force, torque = push[:3].dot(turn).tolist(), about.dot(turn).tolist()
        both = max(right + max(right + force[2], 0.0), 1e-9)
        sliding = (force[0] ** 2 + force[1] ** 2) / hold.friction**2
        a, b, c = hold.levers.tolist()
        turning = (torque[0] / a) ** 2 + (torque[1] / b) ** 2 + (torque[2] / c) ** 2
        return sqrt(sliding + turning) / both, hypot(fx, fy, fz)

    def _grasp(self, found: int | None, force: float, load: float = 0.0) -> Grasp:
        name = "" if found is None else self.objects[found]
        return Grasp(name, force, load, float(self._data.time))


def graspable(rig: RigDescription) -> tuple[str, ...]:
    """Return the names of the objects that jaws can hold: free ones and threads."""
    return tuple(prop.name for prop in rig.objects if prop.thread or prop.joint is None)


def find_jaws(
    rig: RigDescription, model: mujoco.MjModel, objects: Sequence[str]
) -> tuple[list[Jaws], list[tuple[int, Array]]]:
    """Find the jaws of a rig that can hold objects.

    Returns:
        the jaws; and of each of their fingers its body and the normal of its face in it, either
        way, (3,)
    """
    found: list[Jaws] = []
    faces: list[tuple[int, Array]] = []
    for arm in rig.arms if objects else ():
        welds = [_equality(model, naming.grasp(arm.name, name)) for name in objects]
        if -1 not in welds:
            sides = [model.body(naming.scoped(arm.name, f)).id for f in arm.arm.fingers]
            found.append(Jaws(arm.name, (sides[0], sides[1]), welds))
            mechanism, shut = arm.arm.mechanism, np.zeros(len(arm.arm.joints))
            for body, finger in zip(sides, arm.arm.fingers, strict=True):
                normal = pose(mechanism, shut, finger, mechanism.tip)[1, :3]  # as in `Pads`
                faces.append((body, normal))
    return found, faces


def _grip(
    at: Array, force: Array, sides: Index, pushes: Array, friction: Array
) -> tuple[Array, Array, Array, float]:
    """Return centre, axes and levers of a grip and its friction, as `Hold` has them.

    Two rigid pads carry torque about the normal by friction at the points where they touch; about
    an axis along them by friction on both sides of the object and by pressing at their ends.

    Args:
        at: where the pads touch, (n, 3) [m]
        force: with which, (n,) [N]
        sides: 0 of the left finger, 1 of the right, (n,)
        pushes: normals from left to right, (n, 3)
        friction: MuJoCo's five coefficients, (n, 5)
    """
    weight = force / force.sum()
    normal = weight @ pushes
    normal /= np.linalg.norm(normal)
    middles = [np.average(at[sides == k], axis=0, weights=force[sides == k]) for k in (0, 1)]
    thick = abs(float((middles[1] - middles[0]) @ normal))
    apart = at - np.where(sides[:, None] == 0, middles[0], middles[1])
    apart -= np.outer(apart @ normal, normal)
    _, _, basis = np.linalg.svd(np.vstack([apart, 1e-12 * (np.eye(3) - np.outer(normal, normal))]))
    axes = np.column_stack([basis[0], np.cross(normal, basis[0]), normal])
    reach = np.mean([np.abs(apart[sides == k] @ axes).max(axis=0) for k in (0, 1)], axis=0)
    slide = float(weight @ friction[:, 0])
    turning = weight @ np.hypot(friction[:, 0] * np.linalg.norm(apart, axis=1), friction[:, 2])
    pressing = slide * thick / 2
    levers = np.array([pressing + reach[1], pressing + reach[0], turning])
    return (middles[0] + middles[1]) / 2, axes, levers, slide


def _equality(model: mujoco.MjModel, name: str) -> int:
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_EQUALITY, name)
