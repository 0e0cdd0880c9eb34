"""What jaws hold: free objects that both pads press, and when they let go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.modeling import naming
from trocar.simulation.journal import Journal

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Grips are looked at this often, counted from a reset. Source: our own choice, as often as a
#: controller at 200 Hz commands. [s]
PERIOD_S = 0.005
#: A jaw holds what both pads press harder than this for so long, and no longer holds what a pad
#: presses less than the other. Source: measured on needles and rings, of which 18.7 N is the most
#: that the jaw of a large needle driver exerts. [N, s, N]
PRESS_N, PRESSED_S, LOOSE_N = 3.0, 0.05, 1.0
#: What slipped is held again no sooner. Source: our own choice. [s]
SLIPPED_S = 0.2


class Grasp(NamedTuple):
    """What a jaw has between its pads.

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
    """How an object is held, as it was when the jaw took hold of it.

    Attributes:
        object: its index
        anchor: centre of the grip in the object (3,) [m]
        turned: rotation of the object in the left finger, quaternion wxyz (4,)
        centre: of the grip, in the left finger (3,) [m]
        axes: in the left finger, columns: along the pads' line of contact, across, normal (3, 3)
        levers: of friction about these axes: most torque per newton of both pads' force (3,) [m]
        friction: coefficient of the pads on the object
    """

    object: int
    anchor: Array
    turned: Array
    centre: Array
    axes: Array
    levers: Array
    friction: float


@dataclass(frozen=True, eq=False)
class GraspState:
    """What of a jaw's grip a saved world keeps: its hold, and how long it presses what."""

    hold: Hold | None
    looks: NDArray[np.int64]
    read: Grasp


class Jaws(NamedTuple):
    """The fingers of one arm: bodies, and the equalities by which they hold each object."""

    arm: str
    bodies: tuple[int, int]
    welds: Index


class Grasps:
    """What the jaws of a rig hold.

    A free body between two jaws creeps in any time-stepping of Coulomb friction: the arm turns on
    arcs, the body moves along tangents. So what both pads press for 50 ms is held by a weld to the
    left finger, with frictionless pads: no creep. The weld goes once its load leaves the ellipsoid
    of what friction of the pads' forces carries, or once a pad no longer presses.

    Args:
        rig: its description
        timestep: of the physics [s]
        journal: receives "grasp/object" and "grasp/slipped" of arms

    Attributes:
        every: physics steps between two looks
    """

    def __init__(self, rig: RigDescription, timestep: float, journal: Journal) -> None:
        self._kind, self._journal = rig.grasp, journal
        self.objects = tuple(prop.name for prop in rig.objects if prop.joint is None)
        self.every = max(1, round(PERIOD_S / timestep))
        self._enough = max(1, round(PRESSED_S / (timestep * self.every)))
        self._again = -round(SLIPPED_S / (timestep * self.every))

    def attach(self, rig: RigDescription, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Take the physics that the jaws are in, with nothing held."""
        self._model, self._data = model, data
        self._jaws: list[Jaws] = []
        for arm in rig.arms if self.objects else ():
            welds = [_equality(model, naming.grasp(arm.name, name)) for name in self.objects]
            if -1 not in welds:
                sides = [model.body(naming.scoped(arm.name, f)).id for f in arm.arm.fingers]
                self._jaws.append(Jaws(arm.name, (sides[0], sides[1]), np.array(welds)))
        bodies = [model.body(name).id for name in self.objects]
        self._bodies = np.array(bodies, dtype=np.intp)
        self._dofs = [slice(k := int(model.body_dofadr[body]), k + 6) for body in bodies]
        finger, held = np.full(model.nbody, -1), np.full(model.nbody, -1)
        for row, jaws in enumerate(self._jaws):
            finger[list(jaws.bodies)] = 2 * row, 2 * row + 1
        held[self._bodies] = np.arange(len(bodies))
        #: Of each geom: its finger, 2 * jaws + side, and its object; -1 of others.
        self._finger, self._held = finger[model.geom_bodyid], held[model.geom_bodyid]
        self._condim, self._pair_dim = model.geom_condim.copy(), model.pair_dim.copy()
        ends = np.stack([model.pair_geom1, model.pair_geom2], axis=-1).reshape(-1, 2)
        self._pairs = self._finger[ends].max(axis=1), self._held[ends].max(axis=1)
        self._forget()

    def __bool__(self) -> bool:
        """Return whether any jaw of the rig may hold anything."""
        return bool(self._jaws)

    def read(self) -> dict[str, Grasp]:
        """Return what each jaw has between its pads, as of the last look, {arm: grasp}."""
        return {jaws.arm: read for jaws, read in zip(self._jaws, self._read, strict=True)}

    def begin(self) -> None:
        """Begin anew, with nothing held."""
        self._forget()
        self._slicken()

    def save(self) -> dict[str, GraspState]:
        """Return what each jaw holds, {arm: state}."""
        rows = zip(self._jaws, self._holds, self._looks, self._read, strict=True)
        return {jaws.arm: GraspState(hold, looks.copy(), r) for jaws, hold, looks, r in rows}

    def load(self, states: Mapping[str, GraspState]) -> None:
        """Hold what was held when `save` returned the states; other jaws hold nothing."""
        self._forget()
        for row, jaws in enumerate(self._jaws):
            if jaws.arm in states:
                state = states[jaws.arm]
                self._looks[row], self._read[row] = state.looks, state.read
                self._set(row, state.hold)
        self._slicken()

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
        if not data.ncon and not self._looks.any() and not any(self._holds):
            return
        touching = data.contact
        finger = self._finger[touching.geom]
        held, first = self._held[touching.geom], touching.efc_address
        met = (finger.max(axis=1) >= 0) & (held.max(axis=1) >= 0) & (first >= 0)
        rows = np.flatnonzero(met)
        finger, held = finger[rows].max(axis=1), held[rows].max(axis=1)
        normal = data.efc_force[first[rows]]
        force = np.zeros((2 * len(self._jaws), len(self.objects)))
        np.add.at(force, (finger, held), normal)
        for row, jaws in enumerate(self._jaws):
            left, right = force[2 * row], force[2 * row + 1]
            hold, mine = self._holds[row], finger // 2 == row
            if hold is not None:
                pressed = float(right[hold.object])
                load = self._load(row, hold, rows[mine & (held == hold.object)], pressed)
                self._read[row] = self._grasp(hold.object, pressed, load)
                if pressed < LOOSE_N:
                    self._release(row)
                elif load > 1.0 and self._kind == "friction+stick":
                    self._release(row)
                    self._looks[row, hold.object] = self._again
                    name = self.objects[hold.object]
                    self._journal.event(jaws.arm, "grasp/slipped", object=name, load=load)
                continue
            least, looks = np.minimum(left, right), self._looks[row]
            looks[:] = np.where((least > PRESS_N) | (looks < 0), looks + 1, 0)
            most = int(least.argmax())
            self._read[row] = self._grasp(most if looks[most] > 0 else None, float(least[most]))
            if looks[most] >= self._enough:
                self._take(row, most, rows[mine & (held == most)], float(least[most]))

    # ------------------------------------------------------------------ inside

    def _forget(self) -> None:
        count = len(self._jaws)
        self._holds: list[Hold | None] = [None] * count
        self._looks = np.zeros((count, len(self.objects)), dtype=np.int64)
        self._read = [Grasp("", 0.0, 0.0, 0.0)] * count

    def _take(self, row: int, found: int, contacts: Index, force: float) -> None:
        """Take hold of an object where it is now."""
        model, data, body = self._model, self._data, self._bodies[found]
        finger, touching = self._jaws[row].bodies[0], data.contact
        meets = self._finger[touching.geom[contacts]]
        sides = meets.max(axis=1) % 2
        # a normal points from the first geom to the second; pushes of both sides from left to right
        signs = np.where(meets[:, 0] >= 0, 1.0, -1.0) * np.where(sides, -1.0, 1.0)
        turn, origin = data.xmat[finger].reshape(3, 3), data.xpos[finger]
        grip = _grip(
            (touching.pos[contacts] - origin) @ turn,
            data.efc_force[touching.efc_address[contacts]],
            sides,
            (touching.frame[contacts][:, :3] * signs[:, None]) @ turn,
            touching.friction[contacts],
        )
        mujoco.mj_kinematics(model, data)  # bodies were where the last step began
        there, about = data.xmat[body].reshape(3, 3), data.xmat[finger].reshape(3, 3)
        anchor = (data.xpos[finger] + about @ grip[0] - data.xpos[body]) @ there
        back, turned = np.empty(4), np.empty(4)
        mujoco.mju_negQuat(back, data.xquat[finger])
        mujoco.mju_mulQuat(turned, back, data.xquat[body])
        self._set(row, Hold(found, anchor, turned, *grip))
        self._slicken()
        self._read[row] = self._grasp(found, force)
        self._journal.event(self._jaws[row].arm, "grasp/object", object=self.objects[found])

    def _release(self, row: int) -> None:
        self._set(row, None)
        self._slicken()
        self._looks[row] = 0
        self._read[row] = self._grasp(None, 0.0)
        self._journal.event(self._jaws[row].arm, "grasp/object", object="")

    def _set(self, row: int, hold: Hold | None) -> None:
        """Hold an object where it is in the left finger, or nothing."""
        self._holds[row], welds = hold, self._jaws[row].welds
        self._data.eq_active[welds] = 0
        if hold is not None and self._kind != "friction":
            weld = welds[hold.object]
            self._model.eq_data[weld, :10] = *hold.anchor, *hold.centre, *hold.turned
            self._data.eq_active[weld] = 1

    def _slicken(self) -> None:
        """Let pads only press what a weld holds: rows of friction would fight it."""
        model = self._model
        model.geom_condim[:], model.pair_dim[:] = self._condim, self._pair_dim
        if self._kind == "friction":
            return
        for row, hold in enumerate(self._holds):
            if hold is None:
                continue
            mine, its = self._finger // 2 == row, self._held == hold.object
            # where its own friction prevails there are pairs: it keeps it towards all else
            model.geom_condim[mine | (its & (model.geom_priority == 0))] = 1
            model.pair_dim[(self._pairs[0] // 2 == row) & (self._pairs[1] == hold.object)] = 1

    def _load(self, row: int, hold: Hold, contacts: Index, right: float) -> float:
        """Return the share of what friction carries that the grip's load takes."""
        if self._kind == "friction":
            return float("nan")
        data, finger = self._data, self._jaws[row].bodies[0]
        is_weld = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        is_weld &= data.efc_id == self._jaws[row].welds[hold.object]
        rows = [*data.contact.efc_address[contacts], *np.flatnonzero(is_weld)]
        jacobian = data.efc_J.reshape(-1, self._model.nv)[rows, self._dofs[hold.object]]
        push = jacobian.T @ data.efc_force[rows]
        body = self._bodies[hold.object]
        turn = data.xmat[finger].reshape(3, 3) @ hold.axes
        arm = data.xpos[finger] + data.xmat[finger].reshape(3, 3) @ hold.centre - data.xpos[body]
        torque = data.xmat[body].reshape(3, 3) @ push[3:] - np.cross(arm, push[:3])
        force, torque = turn.T @ push[:3], turn.T @ torque
        both = max(right + max(right + force[2], 0.0), 1e-9)
        sliding = np.hypot(force[0], force[1]) / (hold.friction * both)
        turning = torque / (hold.levers * both)
        return float(np.sqrt(sliding**2 + turning @ turning))

    def _grasp(self, found: int | None, force: float, load: float = 0.0) -> Grasp:
        name = "" if found is None else self.objects[found]
        return Grasp(name, force, load, float(self._data.time))


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
