"""Soft tissue in time: the condensed mesh's forces, punctures, channels, thread and tearing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, cast

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import Prop
from trocar.descriptions.tissues import Tissue
from trocar.errors import DivergedError, InputError
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.modeling import naming
from trocar.modeling.tissues import (
    BRANCH_M,
    BUNCHED,
    CHANNEL,
    EYE_ARMATURE,
    EYE_KG,
    PLACES,
    PLATE_M,
    PLATES,
    SLACK_M,
    tissue_bit,
)
from trocar.simulation.journal import Journal, command
from trocar.simulation.parts import Attached, Part, steps_in
from trocar.simulation.records import FARTHEST_M, checked_pose
from trocar.simulation.tissue.contact import (
    CLOSED_M,
    OPENED_M,
    Held,
    JawFingers,
    TissueSurface,
    Tools,
    compliance_of,
    jaws_of,
)
from trocar.simulation.tissue.elastic import Condensed, ElasticPad, pad_of

Array = NDArray[np.float64]

#: Punctures and channels are looked at this often, counted from a reset. Source: our own choice; a
#: tip at 20 mm/s moves by 0.1 mm in it. [s]
PERIOD_S = 0.005
#: Damping of the mesh by its stiffness. Source: our own choice; with it a place of 2 g and 1 N/mm
#: comes to rest after one swing. [s]
DAMPING_S = 4.5e-4
#: A place is made so heavy that a step's explicit force moves it by this share of its displacement
#: at most. Source: symplectic Euler is stable below 4; our own choice.
STEADY = 1.2
#: Channel points inside the wound lie this far from its walls. Source: measured: nearer ones come
#: so close that the thread's length chatters under 5 N. [m]
INSET_M = 2e-3
#: Height of a stitch's circle above the surface by its radius, where none is planned. Source: our
#: own choice; bites are then 0.8 radii wide on each side and 0.4 deep.
RISE = 0.604
#: A channel point is left where the needle's end is this near. Source: our own choice. [rad]
END_RAD = 0.03
#: Channels lie at least so far inside the tissue. Source: our own choice, half a patch. [m]
MARGIN_M = 7e-4

#: A tip that is so deep in tissue without a puncture is beside the plan. Source: our own choice.
#: [m]
ASTRAY_M = 1e-3
#: Fingers this near to the highest place of the surface are looked at. Source: our own choice, two
#: looks at 500 mm/s. [m]
CLOSE_M = 5e-3
#: Pads whose ends are so deep below the surface at rest hold a patch that is so deep in tissue.
#: Source: our own choice. [m]
PINCH_M = 5e-4
#: The mesh is looked at so often, and only where a place has moved so far; so many of its cells may
#: be inside out, as some at a tight thread are. Source: measured: 2 of 5040 at 2 N. [s, m]
VOLUMES_S, FAR_M, INVERTED = 0.25, 2e-3, 0.02

LIMIT = int(mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON)


class TissueReading(NamedTuple):
    """The stitches of a tissue at a time [s]; n rows in the order of the plan.

    Attributes:
        points: channel points now, where needle and thread pass, in the world (n, 4, 3) [m]
        offsets: from the planned channel points to the material points that the needle passed,
            in the tissue's frame, NaN before (n, 4, 3) [m]
        passed, left: whether the tip, and the needle's end, passed each channel point (n, 4)
        gaps: between the walls, at the surface and at the depth of the stitch (n, 2) [m]
        forces: of the tissue on its places, in its frame (n, 8, 3) [N]
        displacements: of its places, in its frame (n, 8, 3) [m]
        torn: places that tore out (n, 8)
        tension: of the thread [N]
        excess: by which the thread is longer than it may be: a measure of numerical health [m]
        fed: thread that has passed the last channel point from the knot on [m]
        pressed: force with which fingers press its surface [N]
        gripped: force of the tissue on each jaw that grips it, in its frame, {arm: (3,)} [N]
    """

    points: Array
    offsets: Array
    passed: NDArray[np.bool_]
    left: NDArray[np.bool_]
    gaps: Array
    forces: Array
    displacements: Array
    torn: NDArray[np.bool_]
    tension: float
    excess: float
    fed: float
    pressed: float
    gripped: dict[str, Array]
    time: float


@dataclass(frozen=True, eq=False)
class TissueState:
    """Saved state of a tissue beside the physics."""

    pose: Array
    stiffness: float
    plan: Array
    offsets: Array
    passed: NDArray[np.bool_]
    left: NDArray[np.bool_]
    torn: NDArray[np.bool_]
    grips: tuple[Held, ...]
    near: tuple[int, ...]
    opened: tuple[bool, ...]
    astray: bool
    fields: tuple[Array, ...]


def default_plan(tissue: Tissue) -> Array:
    """Return evenly spaced stitches straight across the wound, (n, 4, 3) [m]."""
    radius, height = tissue.wire.radius, RISE * tissue.wire.radius
    pitch = tissue.length / (tissue.stitches + 1)
    xs = (np.arange(tissue.stitches) - 0.5 * (tissue.stitches - 1)) * min(pitch, 5e-3)
    return np.array([stitch_points(tissue, x, radius, height) for x in xs])


def stitch_points(
    tissue: Tissue, x: float, radius: float, height: float, side: float = 1.0
) -> Array:
    """Return the channel points of a circle across the wound, (4, 3) [m].

    Args:
        tissue: that it passes
        x: where along the wound [m]
        radius, height: of the circle, and of its centre above the surface [m]
        side: 1: in on the side of +y; -1: of -y
    """
    inner = 0.5 * tissue.gap + INSET_M
    wide = float(np.sqrt(max(radius**2 - height**2, 0.0)))
    deep = height - float(np.sqrt(max(radius**2 - inner**2, 0.0)))
    across = side * np.array([wide, inner, -inner, -wide])
    return np.column_stack([np.full(4, x), across, [0.0, deep, deep, 0.0]])


class SoftTissue(Part):
    """A prop that is tissue.

    Args:
        prop: its description
        arms: how many there are in the rig
        timestep: of the physics [s]
        journal: receives commands, and the events "puncture", "channel", "swage", "tear", "astray"
            (a tip entered beside the plan, where tissue does not hold it), "grip" and "slip"

    Attributes:
        name, tissue: as described
        pose: of its frame in the world, (4, 4)
        plan: channel points of each stitch at rest, in its frame, (n, 4, 3) [m]
        stitch: the stitch under way, n after the last one
    """

    def __init__(self, prop: Prop, arms: int, timestep: float, journal: Journal) -> None:
        if prop.tissue is None:
            raise InputError(f"{prop.name}: is no tissue")
        self.name, self.tissue, self._start = prop.name, prop.tissue, prop.pose
        self._journal, self._source, self._prefix = journal, prop.name, ""
        self._timestep = timestep
        self._bit = tissue_bit(arms)
        self.every, self.before_every = steps_in(PERIOD_S, timestep), 1

    @cached_property
    def pad(self) -> ElasticPad:
        """Its mesh."""
        return pad_of(self.tissue)

    def attach(self, physics: Attached) -> None:
        """Take the physics that it is in, what shows the same bodies, and what touches it."""
        model, data = physics.model, physics.data
        self._model, self._data = model, data
        self._shadows = *physics.frames.scratches, *physics.true_frames.scratches
        jaws = jaws_of(physics.rig, model)
        self._tools = Tools(model, data, jaws)
        if jaws:
            compliance_of(self.tissue)  # once, rather than when a jaw comes near
        tissue, name, count = self.tissue, self.name, self.tissue.stitches
        stitches = [f"{name}/{k}" for k in range(count)]

        def ids(kind: Any, parts: Sequence[str]) -> NDArray[np.intp]:
            found = [[kind(naming.scoped(s, part)).id for part in parts] for s in stitches]
            return np.array(found, dtype=np.intp)

        self._body, self._needle = model.body(name).id, model.body(self.tissue.needle).id
        self._eyes, self._sites = ids(model.body, PLACES), ids(model.site, CHANNEL)
        self._welds, self._plates = ids(model.equality, CHANNEL), ids(model.geom, PLATES)
        self._strings = ids(model.tendon, [f"thread_{place}" for place in CHANNEL])
        self._struts = ids(model.tendon, [f"strut_{place}" for place in CHANNEL[:-1]])
        self._walls = ids(model.tendon, ["wall", "edge"])
        #: Of each tendon whether it is a length of the thread.
        self._threads = np.isin(np.arange(int(model.ntendon)), self._strings)
        self._locks = ids(model.tendon, ["lock"])[:, 0]
        beads = [model.joint(naming.scoped(name, f"bead{k}")) for k in range(len(CHANNEL))]
        self._beads = np.array([(int(b.qposadr[0]), int(b.dofadr[0])) for b in beads])
        feed = model.joint(naming.scoped(name, "feed"))
        self._feed, self._feed_dof = int(feed.qposadr[0]), int(feed.dofadr[0])
        first = model.joint(f"{stitches[0]}/{PLACES[0]}/x")
        size = 3 * len(PLACES) * count
        self._rows = rows = slice(k := int(first.dofadr[0]), k + size)
        self._q = data.qpos[(k := int(first.qposadr[0])) : k + size]
        self._v, self._applied = data.qvel[rows], data.qfrc_applied[rows]
        self._tip = self.tissue.wire.tip[:3, 3]
        #: Fields of the model that stitches change.
        paths = np.append(self._strings.ravel(), self._locks)
        tendons = np.concatenate([paths, self._struts.ravel(), self._walls.ravel()])
        #: Of how many parts a tendon has been compiled.
        self._parts = np.diff(model.tendon_adr, append=model.nwrap)
        self._fields: tuple[tuple[Array, Any], ...] = (
            (model.eq_data, self._welds.ravel()),
            (model.site_pos, self._sites.ravel()),
            (model.tendon_range, tendons),
            (model.tendon_num, paths),
            (model.geom_contype, self._plates.ravel()),
            (model.dof_frictionloss, [self._feed_dof]),
            (model.dof_M0, rows),
            (model.body_pos, self._body),
            (model.body_quat, self._body),
        )
        self._fresh = tuple(field[row].copy() for field, row in self._fields)
        self._moved = np.zeros(size)
        #: The square of how far a needle may be that touches it [m^2].
        sizes = [0.5 * tissue.length, 0.5 * tissue.gap + tissue.width, tissue.depth]
        self._far = (float(np.linalg.norm(sizes)) + tissue.wire.radius + CLOSE_M) ** 2
        self.begin()

    def begin(self) -> None:
        """Begin anew: intact, where the description has it, with stitches evenly spaced."""
        self._begin(self._start, 1.0, default_plan(self.tissue))

    @command
    def set_cp(self, T: ArrayLike, stiffness: float = 1.0) -> None:
        """Put it somewhere, intact again and with the stitches that were planned.

        Args:
            T: pose of its frame in the world, (4, 4)
            stiffness: factor on all its moduli

        Raises:
            InputError: no pose, or a factor that is not in 0.01 to 100; nothing changes
        """
        at = checked_pose(self.name, T)
        if not 0.01 <= stiffness <= 100.0:
            raise InputError(f"{self.name}: got stiffness {stiffness!r}; allowed: 0.01 to 100")
        self._begin(at, float(stiffness), self.plan)

    @command
    def set_plan(self, points: ArrayLike) -> None:
        """Plan where stitches shall pass; it is intact again.

        Args:
            points: channel points in its frame at rest: in, both sides of the wound, out, for one
                to all of its stitches, (n, 4, 3) [m]

        Raises:
            InputError: another shape, more stitches than the tissue has, points outside of it, in
                another order, or thread that is too short; nothing changes
        """
        plan = _checked_plan(self.name, self.tissue, points)
        spare = default_plan(self.tissue)[len(plan) :]
        self._begin(self.pose, self.stiffness, np.concatenate([plan, spare]))

    @command
    def lock(self, stitch: int) -> None:
        """Let the thread no longer slip back through the stitches up to this one, as by a knot.

        Args:
            stitch: its number, from 0

        Raises:
            InputError: no stitch, or one that the needle has not left; nothing changes
        """
        known = isinstance(stitch, int | np.integer) and 0 <= stitch < len(self.plan)  # pyright: ignore[reportUnnecessaryIsInstance]  public input
        if not known or not self.left[stitch].all():
            raise InputError(
                f"{self.name}: lock: got stitch {stitch!r}; allowed: one that the needle has left"
            )
        self._loosen(self._locks)
        self._model.tendon_range[self._locks[stitch], 1] = self._measure(self._locks[stitch])

    def locked(self, stitch: int) -> bool:
        """Return whether the thread of a stitch, or of a later one, is locked."""
        limits = self._model.tendon_range[self._locks[stitch:], 1]
        return bool((limits < SLACK_M).any())

    def before_step(self) -> None:
        """Apply the mesh's forces where its places are now."""
        moved, applied = self._moved, self._applied
        np.multiply(self._v, DAMPING_S, moved)
        np.add(moved, self._q, moved)
        np.dot(self._pull, moved, applied)
        np.add(applied, self._still, applied)
        if self._tools.near or self._grips:
            self._touch()

    def _touch(self) -> None:
        """Apply the forces between tissue and jaws."""
        mujoco.mj_kinematics(self._model, self._data)
        tools, count = self._tools, len(self._held)
        tools.release()
        displaced = self._displaced()
        if self._grips:
            forces = -self.stiffness * self._condensed().stiffness @ displaced
            self._applied[self._held] = forces[:count] - DAMPING_S * (
                self.stiffness * self._condensed().stiffness[:count, :count] @ self._v[self._held]
            )
            turn = self.pose[:3, :3]
            self._pulls = forces[count:].reshape(-1, 3)
            for grip, force in zip(self._grips, self._pulls, strict=True):
                body = tools.jaws[grip.jaw].bodies[0]
                tools.push(body, self._anchor(grip), turn @ force)
        if tools.near:
            pressed = tools.apply(self.pose, self._surface(), displaced, self.stiffness)
            self._applied[self._held] += pressed[:count]

    def _displaced(self) -> Array:
        """Return the displacements of all places that are held, then of patches in jaws, (k,)."""
        own = (self._q - self._rest)[self._held]
        if not self._grips:
            return own
        pose = self.pose
        moved = [
            (self._anchor(grip) - pose[:3, 3]) @ pose[:3, :3] - grip.point for grip in self._grips
        ]
        return np.concatenate([own, *moved])

    def _anchor(self, grip: Held) -> Array:
        """Return the position of a patch between pads in the world, (3,) [m]."""
        finger = self._tools.jaws[grip.jaw].bodies[0]
        turn = self._data.xmat[finger].reshape(3, 3)
        return self._data.xpos[finger] + turn @ grip.anchor

    def look(self) -> None:
        """Let the needle puncture and pass, jaws grip, and tissue tear, as the last step tells."""
        data, stitch = self._data, self.stitch
        self._tear()
        self._pinch()
        if self._journal.period % round(VOLUMES_S / self._timestep) == 0:
            self._check_volumes()
        if stitch == len(self.plan):
            return
        passed, side = self.passed[stitch], self._sides[stitch]
        x, y, z = (data.xpos[self._needle] - self.pose[:3, 3]).tolist()
        if not passed[0] and x * x + y * y + z * z > self._far:
            return  # the needle is nowhere near
        now = self._q.reshape(len(self.plan), -1, 3)[stitch]
        done = passed.tolist()
        tip = np.zeros(3) if done[3] else self._local(self._needle, self._tip)
        if not done[0]:
            if self._pressed(self._plates[stitch, 0]) > self.tissue.puncture:
                self._puncture(0)
                self._pass(0)
            beside = np.abs(tip - now[0])[:2].max() > PLATE_M[0]  # it presses on no plate
            if beside and tip[2] < -ASTRAY_M and not self._astray and self._inside(tip):
                self._astray = True
                self._event("astray", offset=tip - now[0])
        elif not done[1]:
            if side * (tip[1] - now[1, 1]) < 0.0:
                self._pass(1)
        elif not done[2]:
            wall = self._plates[stitch, 2 if side > 0.0 else 1]
            if self._pressed(wall) > self.tissue.puncture:
                self._puncture(2 if side > 0.0 else 1)
            if side * (tip[1] - now[2, 1]) < 0.0:
                self._pass(2)
        elif not done[3] and tip[2] > now[3, 2]:
            self._pass(3)
        if not done[0]:
            return
        ends = data.qpos[self._beads[:, 0]] <= END_RAD - self.tissue.wire.arc
        for point in np.flatnonzero(passed & ~self.left[stitch] & ends):
            self._leave(int(point))

    def read(self) -> TissueReading:
        """Return the stitches now."""
        count, model, data = len(self.plan), self._model, self._data
        self._kinematics()
        now = self._q.reshape(count, -1, 3)
        at = data.xpos[self._body], data.xmat[self._body].reshape(3, 3)
        points = (now[:, :4] + model.site_pos[self._sites]) @ at[1].T + at[0]
        walls = now[:, 4:, 1]
        gaps = self._sides[:, None] * np.stack(
            [walls[:, 1] - walls[:, 3], walls[:, 0] - walls[:, 2]], axis=1
        )
        moved = (self._q - self._rest).reshape(now.shape)
        forces = (self._pull @ (self._q - self._rest)).reshape(now.shape)
        limits = model.tendon_range[:, 1]
        threads = np.append(self._strings.ravel(), self._locks)
        tight = threads[limits[threads] < 0.5 * SLACK_M]
        over = data.ten_length[tight] - limits[tight]
        return TissueReading(
            points,
            self.offsets.copy(),
            self.passed.copy(),
            self.left.copy(),
            gaps,
            forces,
            moved,
            self.torn.copy(),
            self.tension(),
            float(max(over.max(initial=0.0), 0.0)),
            float(data.qpos[self._feed]),
            self._tools.force,
            {
                self._tools.jaws[grip.jaw].arm: force.copy()
                for grip, force in zip(self._grips, self._pulls, strict=True)
            },
            float(data.time),
        )

    def forces_on_jaws(self) -> dict[str, Array]:
        """Return the force of its surface and of what they grip on each jaw, {arm: (3,)} [N]."""
        return self._tools.forces() if self._tools.near or self._grips else {}

    def tension(self) -> float:
        """Return the tension of the thread, as of the last step [N]."""
        data = self._data
        rows = np.arange(int(data.ne + data.nf), int(data.nefc))
        rows = rows[data.efc_type[rows] == LIMIT]
        return float(data.efc_force[rows[self._threads[data.efc_id[rows]]]].sum())

    def displacements(self) -> Array:
        """Return the displacement of every node of its mesh, in its frame, (n, 3) [m]."""
        if self._grips:
            mujoco.mj_kinematics(self._model, self._data)
        condensed = self._condensed()
        moved: Array = condensed.response @ self._displaced()
        if self._tools.nodes:
            surface = self._surface()
            forces, places = np.zeros((len(moved), 3)), np.zeros(condensed.response.shape[-1])
            for (half, node), force in self._tools.nodes.items():
                forces[surface.nodes[half, node], 2] = -force
                places -= force * surface.rise[half][node]
            own = self.pad.solve(forces.ravel()).reshape(-1, 3)
            back = condensed.response @ np.linalg.solve(condensed.stiffness, places)
            moved += (own - back) / self.stiffness
        return moved

    @property
    def astray(self) -> bool:
        """Whether a tip has entered the tissue beside the stitch that is planned next."""
        return self._astray

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return float(self._data.time)

    def threaded(self) -> tuple[Array, Array, Array, float]:
        """Return the path of the thread now, from the needle on, in the world.

        Returns:
            the needle's end (3,); direction in which thread leaves it (3,); points of tissue that
            it passes (n, 3); length from the needle to the last of these, where the knot stops [m]
        """
        data, count = self._data, len(self.plan)
        turn = data.xmat[self._needle].reshape(3, 3)
        swage = data.xpos[self._needle] + turn @ self.tissue.wire.swage[:3, 3]
        local = self._q.reshape(count, -1, 3)[:, :4] + self._model.site_pos[self._sites]
        passed = local[self.left][::-1]
        points = passed @ self.pose[:3, :3].T + self.pose[:3, 3]
        back = -turn @ self.tissue.wire.swage[:3, 1]
        return swage, back, points, float(data.qpos[self._feed])

    def save(self) -> TissueState:
        """Return copies of all that motion depends on beside the physics."""
        return TissueState(
            self.pose.copy(),
            self.stiffness,
            self.plan.copy(),
            self.offsets.copy(),
            self.passed.copy(),
            self.left.copy(),
            self.torn.copy(),
            self._grips,
            tuple(self._tools.near),
            self._opened,
            self._astray,
            tuple(field[row].copy() for field, row in self._fields),
        )

    def load(self, state: TissueState) -> None:
        """Go on from a saved state; the physics is loaded already."""
        self.pose, self.stiffness, self.plan = state.pose.copy(), state.stiffness, state.plan.copy()
        self.offsets, self.torn = state.offsets.copy(), state.torn.copy()
        self.passed, self.left = state.passed.copy(), state.left.copy()
        self._grips, self._opened, self._astray = state.grips, state.opened, state.astray
        self._pulls = np.zeros((len(state.grips), 3))
        self._tools.near, self._tools.force, self._tools.nodes = list(state.near), 0.0, {}
        self._count()
        self._condense()
        for (field, row), value in zip(self._fields, state.fields, strict=True):
            field[row] = value
        self._refresh()

    # ------------------------------------------------------------------ inside

    def _begin(self, pose: Array, stiffness: float, plan: Array) -> None:
        model, data, shape = self._model, self._data, plan.shape[:2]
        for (field, row), value in zip(self._fields, self._fresh, strict=True):
            field[row] = value
        self.pose, self.stiffness, self.plan = pose.copy(), stiffness, plan
        model.body_pos[self._body] = pose[:3, 3]
        model.body_quat[self._body] = quaternion_from_matrix(pose[:3, :3])
        self.offsets = np.full(plan.shape, np.nan)
        self.passed, self.left = np.zeros(shape, bool), np.zeros(shape, bool)
        self.torn = np.zeros((len(plan), len(PLACES)), bool)
        self._grips: tuple[Held, ...] = ()
        self._pulls = np.zeros((0, 3))
        self._opened = (False,) * len(self._tools.jaws)
        self._astray = False
        self._tools.near = []
        self._tools.release()
        self._count()
        data.eq_active[self._welds] = 0
        self._condense()
        most = float(np.linalg.eigvalsh(-self._pull)[-1])
        heavy = most * self._timestep**2 / STEADY
        model.dof_M0[self._rows] = max(EYE_ARMATURE + EYE_KG, heavy)  # of bodies on slides
        self._q[:], self._v[:], self._applied[:] = self._rest, 0.0, 0.0
        data.qpos[self._feed] = data.qvel[self._feed_dof] = 0.0
        long = np.linalg.norm(np.diff(plan, axis=1), axis=2)
        long[:, 1] -= self.tissue.gap
        model.tendon_range[self._struts, 0] = BUNCHED * np.maximum(long, 0.0)
        model.tendon_range[self._walls] = np.where(
            self._sides[:, None, None] > 0.0, [0.0, SLACK_M], [-SLACK_M, 0.0]
        )
        self._loosen(np.append(self._strings.ravel(), self._locks))
        self._arm_plates()
        self._refresh()

    def _refresh(self) -> None:
        """Bring the tissue's body, which stands still, to where it was put.

        MuJoCo works out poses of bodies that stand still only once while bodies may sleep.
        """
        option, sleep = self._model.opt, int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        flags = option.enableflags
        option.enableflags &= ~sleep
        for data in (self._data, *self._shadows):
            mujoco.mj_kinematics(self._model, data)
        option.enableflags = flags

    def _count(self) -> None:
        """Set what follows from the plan and from what passed."""
        self._sides = np.sign(self.plan[:, 0, 1])
        whole = [bool(row.all()) for row in self.left]
        self.stitch = whole.index(False) if False in whole else len(whole)

    def _arm_plates(self) -> None:
        """Let only the plates of the stitch under way be touched, until they are punctured."""
        contype = self._model.geom_contype
        contype[self._plates] = 0
        if self.stitch < len(self.plan):
            wall = 2 if self._sides[self.stitch] > 0.0 else 1
            contype[self._plates[self.stitch, [0, wall]]] = self._bit

    def _condensed(self) -> Condensed:
        return _condensed(self.tissue, self._points)

    def _surface(self) -> TissueSurface:
        return _surface(self.tissue, self._points)

    def _places(self) -> Array:
        """Return its places at rest, in its frame, (8n, 3) [m]."""
        found: list[Array] = []
        half = 0.5 * self.tissue.gap
        for points, side in zip(self.plan, self._sides, strict=True):
            across = points[:, 1]
            curve = np.polynomial.Polynomial.fit(across, points[:, 2], 2)
            sideways, lengthways = np.sort(points[:, :2], axis=0).T[::-1]
            along = cast(Array, np.interp([-half, half], sideways, lengthways))
            near, far = (along[1], along[0]) if side > 0.0 else (along[0], along[1])
            deep = [float(curve(side * half)), float(curve(-side * half))]
            walls: list[list[float]] = [[near, side * half, deep[0]], [near, side * half, 0.0]]
            walls += [[far, -side * half, deep[1]], [far, -side * half, 0.0]]
            found.append(np.concatenate([points, walls]))
        return np.concatenate(found)

    def _condense(self) -> None:
        places = self._places()
        self._rest, held = places.ravel(), ~self.torn.ravel()
        self._held = np.flatnonzero(np.repeat(held, 3))
        #: The patches that are held: places, and what is between pads.
        self._points = np.array([*places[held], *(g.point for g in self._grips)]).tobytes()
        self._pull, count = np.zeros((len(self._rest),) * 2), len(self._held)
        stiff = self._condensed().stiffness[:count, :count]
        self._pull[np.ix_(self._held, self._held)] = -self.stiffness * stiff
        #: Forces without displacement less those of places at 0; they hold the bodies' weight.
        up = -EYE_KG * self._model.opt.gravity @ self.pose[:3, :3]
        self._still = np.tile(up, len(places)) - self._pull @ self._rest

    def _kinematics(self) -> None:
        """Bring bodies and tendons to where the last step ended: MuJoCo has where it began."""
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_tendon(self._model, self._data)

    def _loosen(self, paths: NDArray[np.intp]) -> None:
        """Let paths of the thread hold nothing; of one part, they take no time to compute."""
        self._model.tendon_range[paths, 1], self._model.tendon_num[paths] = SLACK_M, 1

    def _measure(self, path: int) -> float:
        """Return the length of a path of the thread now, all of its parts from here on [m]."""
        self._model.tendon_num[path] = self._parts[path]
        self._kinematics()
        return float(self._data.ten_length[path])

    def _local(self, body: int, point: Array) -> Array:
        """Return a point of a body in the tissue's frame, (3,)."""
        data = self._data
        at = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
        return (at - self.pose[:3, 3]) @ self.pose[:3, :3]

    def _inside(self, point: Array) -> bool:
        """Return whether a point in its frame is inside one of its halves at rest."""
        size, across = self.tissue, abs(point[1]) - 0.5 * self.tissue.gap
        along = abs(point[0]) < 0.5 * size.length
        return bool(along and 0.0 < across < size.width and -size.depth < point[2] < 0.0)

    def _pinch(self) -> None:
        """Let jaws near the surface grip, and let go of, what is between their pads."""
        tools, tissue = self._tools, self.tissue
        if not tools.jaws:
            return
        risen = float((self._q[2::3] - self._rest[2::3]).max())
        over = tools.over(self.pose, tissue, CLOSE_M + max(0.0, risen))
        if not (over or tools.near or self._grips):
            return
        tools.look(self.pose, self._surface(), self._displaced(), over, 2.0 * PERIOD_S)
        if not tools.near:
            tools.release()
        opened = list(self._opened)
        grips = list(self._grips)
        for row, jaw in enumerate(tools.jaws):
            mine = next((grip for grip in grips if grip.jaw == row), None)
            if mine is None and not {2 * row, 2 * row + 1} & {*tools.near}:
                continue
            middle, apart = tools.between(row)
            pull = 0.0
            if mine is not None:
                pull = float(np.linalg.norm(self._pulls[self._grips.index(mine)]))
            if mine is not None and (apart > OPENED_M or pull > tissue.tear):
                grips.remove(mine)
                slipped = apart <= OPENED_M
                self._event("slip" if slipped else "grip", arm=jaw.arm, held=False, force=pull)
            elif mine is None and opened[row] and apart < CLOSED_M:
                point = (middle - self.pose[:3, 3]) @ self.pose[:3, :3]
                if point[2] < -PINCH_M and self._inside(point) and not self._grasps(jaw):
                    point[2] = -PINCH_M
                    grips.append(Held(row, point, self._in_finger(jaw.bodies[0], point)))
                    self._event("grip", arm=jaw.arm, held=True, at=point)
            if not CLOSED_M <= apart <= OPENED_M:
                opened[row] = apart > OPENED_M
        self._opened = tuple(opened)
        if tuple(grips) != self._grips:
            kept = {id(g): self._pulls[k] for k, g in enumerate(self._grips)}
            self._grips = tuple(grips)
            self._pulls = np.array([kept.get(id(g), np.zeros(3)) for g in grips]).reshape(-1, 3)
            self._tools.release()
            self._condense()

    def _in_finger(self, finger: int, point: Array) -> Array:
        """Return the patch about a point at rest as it is now, in a finger's frame."""
        moved = self.pad.weights(point) @ self.displacements()
        at = self.pose[:3, :3] @ (point + moved) + self.pose[:3, 3]
        return (at - self._data.xpos[finger]) @ self._data.xmat[finger].reshape(3, 3)

    def _grasps(self, jaw: JawFingers) -> bool:
        """Return whether fingers touch the needle."""
        met = self._data.contact.geom[(np.isin(self._data.contact.geom, jaw.geoms)).any(axis=1)]
        return bool((self._model.geom_bodyid[met] == self._needle).any())

    def _check_volumes(self) -> None:
        """Reject tissue of which much is turned inside out: the linear mesh means nothing then.

        Raises:
            DivergedError: where and when
        """
        if float(np.abs(self._q - self._rest).max()) < FAR_M and not self._tools.nodes:
            return
        volumes = self.pad.volumes(self.displacements())
        bad = int((volumes <= 0.0).sum())
        if bad > INVERTED * len(volumes):
            worst = int(np.argmin(volumes))
            at = 1e3 * self.pad.nodes[self.pad.cells[worst]].mean(axis=0)
            raise DivergedError(
                float(self._data.time),
                self.name,
                None,
                f"{bad} of {len(volumes)} elements are turned inside out, most of all element"
                f" {worst} at {at.round(1).tolist()} mm; allowed: {100 * INVERTED:g} %",
            )

    def _pressed(self, plate: int) -> float:
        """Return the force with which tips press on a plate [N]."""
        touching = self._data.contact
        hit = touching.geom == plate
        if not hit.any():
            return 0.0
        met = np.flatnonzero(hit.any(axis=1) & (touching.efc_address >= 0))
        rows = [slice(k := touching.efc_address[c], k + touching.dim[c]) for c in met]
        return sum(float(np.linalg.norm(self._data.efc_force[row])) for row in rows)

    def _puncture(self, plate: int) -> None:
        geom = self._plates[self.stitch, plate]
        if self._model.geom_contype[geom]:
            self._model.geom_contype[geom] = 0
            self._event("puncture", place=PLATES[plate], force=self._pressed(geom))

    def _pass(self, point: int) -> None:
        """Let a bead take hold of a channel point where the tip is now."""
        model, data, stitch = self._model, self._data, self.stitch
        self._kinematics()
        offset = (
            self._local(self._needle, self._tip)
            - self._q.reshape(-1, len(PLACES), 3)[stitch, point]
        )
        weld, (angle, rate) = self._welds[stitch, point], self._beads[point]
        model.eq_data[weld, 3:6] = offset
        model.site_pos[self._sites[stitch, point]] = offset
        data.qpos[angle], data.qvel[rate], data.eq_active[weld] = 0.0, 0.0, 1
        self.offsets[stitch, point], self.passed[stitch, point] = offset, True
        if point >= 2:  # whatever the tip did not press on is behind it
            model.geom_contype[self._plates[stitch]] = 0
        self._event("channel", place=CHANNEL[point], offset=offset)

    def _leave(self, point: int) -> None:
        """Hand a channel point over from the needle's end to the thread."""
        model, data, stitch = self._model, self._data, self.stitch
        data.eq_active[self._welds[stitch, point]] = 0
        self._loosen(self._strings.ravel())
        string = self._strings[stitch, point]
        fed = float(data.qpos[self._feed])
        length = self._measure(string) - (BRANCH_M - fed)
        data.qpos[self._feed] = max(fed, length)
        model.tendon_range[string, 1] = BRANCH_M
        self.left[stitch, point] = True
        through = int(self.left.sum())
        model.dof_frictionloss[self._feed_dof] = through * self.tissue.thread.friction
        self._event("swage", place=CHANNEL[point], fed=float(data.qpos[self._feed]))
        self._count()
        if self.stitch != stitch:
            self._arm_plates()

    def _tear(self) -> None:
        """Let places tear out whose force is above the limit; the mesh no longer holds them."""
        forces = self._applied  # of the last step
        if forces.dot(forces) < self.tissue.tear**2:
            return
        strong = np.linalg.norm(forces.reshape(-1, 3), axis=1).reshape(self.torn.shape)
        found = strong > self.tissue.tear
        found[:, len(CHANNEL) :] = False
        if not found.any():
            return
        self.torn |= found
        self._condense()
        for stitch, place in np.argwhere(found).tolist():
            self._event("tear", of=stitch, place=PLACES[place], force=float(strong[stitch, place]))

    def _event(self, name: str, **values: object) -> None:
        self._journal.event(self.name, name, **{"stitch": self.stitch, **values})


@lru_cache(maxsize=16)
def _condensed(tissue: Tissue, points: bytes) -> Condensed:
    """Return a tissue condensed to patches about points."""
    return pad_of(tissue).condense(np.frombuffer(points).reshape(-1, 3))


@lru_cache(maxsize=16)
def _surface(tissue: Tissue, points: bytes) -> TissueSurface:
    """Return the surface of a tissue that is condensed to patches about points."""
    condensed = _condensed(tissue, points)
    return TissueSurface(tissue, pad_of(tissue), condensed.response, condensed.stiffness)


def _checked_plan(name: str, tissue: Tissue, points: ArrayLike) -> Array:
    try:
        plan: Array = np.asarray(points, dtype=np.float64).copy()
    except (TypeError, ValueError, OverflowError):
        plan = np.zeros(0)
    if plan.ndim != 3 or plan.shape[1:] != (4, 3) or not 1 <= len(plan) <= tissue.stitches:
        raise InputError(
            f"{name}: got a plan of shape {plan.shape}; allowed: (n, 4, 3) with n = 1 to"
            f" {tissue.stitches}"
        )
    if not (np.abs(plan) <= FARTHEST_M).all():  # NaN is not either
        raise InputError(f"{name}: got {points!r}; allowed: points up to {FARTHEST_M:g} m away")
    edge = 0.5 * tissue.gap
    most = np.array([0.5 * tissue.length, edge + tissue.width, np.inf]) - MARGIN_M
    for number, row in enumerate(plan):
        side = np.sign(row[0, 1]) * row[:, 1]
        inside = (np.abs(row) <= most).all() and (row[:, 2] >= MARGIN_M - tissue.depth).all()
        if not inside:
            raise InputError(
                f"{name}: stitch {number} leaves the tissue: got {(1e3 * row).round(2).tolist()}"
                f" mm; allowed: within {(1e3 * most[:2]).round(2).tolist()} mm along and across,"
                f" down to {1e3 * (tissue.depth - MARGIN_M):g} mm"
            )
        if not (side[0] > side[1] > edge and -edge > side[2] > side[3]):
            raise InputError(
                f"{name}: stitch {number} got {(1e3 * side).round(2).tolist()} mm across; allowed:"
                " from one side of the wound to the other in order, the inner points beyond its"
                " walls"
            )
    path = float(np.linalg.norm(np.diff(plan.reshape(-1, 3), axis=0), axis=1).sum())
    if path > tissue.thread.free:
        raise InputError(
            f"{name}: got {1e3 * tissue.thread.free:.1f} mm of thread before its knot; needed:"
            f" {1e3 * path:.1f} mm for the path of {len(plan)} stitches"
        )
    return plan
