"""Plans of stitches: the way of needle and thread through a wound, and the grips of both arms.

A stitch is a circle in a plane across the wound: the needle turns about its centre, which lies
above the surface. One arm drives it in from one side until its tip has come out on the other; the
other arm takes it there and turns it out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.cameras import StereoCalibration
from trocar.cameras.lens import project
from trocar.descriptions.needles import Needle
from trocar.descriptions.table import parse_table, toml_text
from trocar.descriptions.tissues import Tissue
from trocar.errors import InputError, SingularError, UnreachableError
from trocar.geometry.se3 import inverse, transform, transform_points
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.inverse import inverse_kinematics, nearest_solution
from trocar.outputs import whole_file, write_text
from trocar.plotting.drawing import PALETTE, new_figure, png
from trocar.simulation import World
from trocar.simulation.tissue.tissues import RISE, stitch_points
from trocar.tasks.suturing.pull import PULLS, REACH_M, UP, Pull, clear_ways, pulls

Array = NDArray[np.float64]

#: Angles of the driving arm's grip from the swage, and of the other's from the tip. Source:
#: measured: a jaw nearer to the point does not hold it well. [rad]
HOLD_SWAGE, HOLD_TIP = np.radians([18.0, 16.0])
#: Angle of the tip before the surface at which driving begins, and of the needle's end beyond it at
#: which the needle has left. Source: our own choice. [rad]
BEFORE, BEYOND = np.radians([25.0, 9.0])
#: Height of the wire above the surface in a jaw, at least, as one arm takes the needle from the
#: other. Source: measured on a 26 mm half circle: jaws then stay clear of the tissue. [m]
JAW_M = 2.5e-3
#: Width of a bite by that of a half of the tissue, at most. Source: measured: wider ones pull at
#: the clamped face, and 2 N do not close a stiff wound; 5.8 mm in a half of 15 mm do.
WIDEST = 0.36
#: Least width of a bite beyond a half of the gap. Source: our own choice: the channel
#: points beside the wound lie 2 mm inside its walls. [m]
LEAST_BITE_M = 2.5e-3
#: Steps in which reach is checked. Source: measured: steps of 12 deg miss solutions. [rad]
STEP = np.radians(4.0)
#: Height above a needle from which it is picked. Source: our own choice. [m]
ABOVE_M = 0.02
#: Least room of a joint to a limit within reach. Source: our own choice. [rad]
LEAST = np.radians(2.0)
#: Least distance between the axes of two shafts. Source: radii of 4.2 mm of instruments and 5 mm of
#: the endoscope, and some room. [m]
APART_M = 0.0105
#: Distance from an instrument's tip back to the end of its shaft. Source: length of the wrist
#: of a large needle driver in the dVRK's tables, 9.1 mm. [m]
WRIST_M = 0.0091
#: Points of a shaft that are checked. Source: our own choice, one each 4 mm.
ALONG = 40
#: Largest height of a circle's centre by its radius. Source: our own choice: flatter bites lie
#: within a patch's radius of the surface.
MOST_RISE = 0.92
#: Room of all joints at which no better plan is sought. Source: our own choice. [rad]
ENOUGH = np.radians(8.0)


@dataclass(frozen=True)
class Grip:
    """A jaw's grip on a needle.

    Attributes:
        angle: on the needle, from its swage [rad]
        along: 1: the jaw points along the needle's z axis; -1: against it
        across: 1: the fingers close outwards from the circle's centre; -1: inwards
    """

    angle: float
    along: int
    across: int

    def pose(self, needle: Needle) -> Array:
        """Return the pose of the arm's tip in the needle's frame, (4, 4)."""
        on_wire = needle.pose(self.angle)
        z, y = self.along * on_wire[:3, 2], self.across * on_wire[:3, 0]
        return transform(np.column_stack([np.cross(y, z), y, z]), on_wire[:3, 3] - REACH_M * z)


@dataclass(frozen=True, eq=False)
class Stitch:
    """One stitch.

    Attributes:
        wound: its frame in the world: origin in its middle on the surface, x along it, z up (4, 4)
        points: channel points in this frame: in, both sides of the wound, out (4, 3) [m]
        radius, height: of the circle, and of its centre above the surface [m]
        start, out, end: angles of the tip about the circle, from the side where it goes in: where
            driving begins, where the other arm takes the needle, where it has left [rad]
        side: 1: in on the side of the wound's +y; -1: of -y
        driver, taker: arms that drive the needle in, and out
        grips: of both
        margins: least distances of their joints from limits [rad]
        limited: which joints these are
    """

    wound: Array
    points: Array
    radius: float
    height: float
    start: float
    out: float
    end: float
    side: int
    driver: str
    taker: str
    grips: tuple[Grip, Grip]
    margins: tuple[float, float]
    limited: tuple[str, str]

    @property
    def surface(self) -> float:
        """Angle of the tip where it goes in [rad]."""
        return float(np.arcsin(self.height / self.radius))

    def needle_pose(self, needle: Needle, angle: float) -> Array:
        """Return the needle in the world with its tip at an angle of the circle, (4, 4) [rad]."""
        x = float(self.points[0, 0])
        return needle_on_circle(self.wound, x, self.height, self.side, angle - needle.arc)

    def pulls(
        self,
        taker: TipWorkspace,
        tissue: Tissue,
        start: Array,
        held: Array,
        directions: Sequence[tuple[float, float, float]] = PULLS,
    ) -> Iterator[Pull]:
        """Yield pulls of the thread after the stitch, the best first.

        Args:
            taker: workspace of the arm that pulls
            tissue: that is stitched
            start: pose of its tip in the world where it begins, (4, 4)
            held: the same in the needle's frame, (4, 4)
            directions: across the wound, up, and towards the arm's own side along it
        """
        x, y, _ = self.wound[:3, :3].T
        aside = x * np.sign(x @ (taker.port - self.wound[:3, 3]))
        axes, free = np.array([self.side * y, UP, aside]), tissue.thread.free
        ways = clear_ways(start[:3, 3], axes, free, scope_shafts(taker.world), directions)
        return pulls(start, held, tissue.wire, ways, free)

    def angle_of(self, needle: Needle, pose: Array) -> float:
        """Return the angle of the tip of a needle in the world, 0 to 2 pi [rad]."""
        local = self.wound[:3, :3].T @ pose[:3, 0]
        return float(np.arctan2(-local[2], self.side * local[1]) + needle.arc) % (2.0 * np.pi)


@dataclass(frozen=True, eq=False)
class Plan:
    """Stitches of a wound, in their order.

    Attributes:
        stitches: each
        needle: with which
    """

    stitches: tuple[Stitch, ...]
    needle: Needle

    def document(self) -> dict[str, object]:
        """Return the plan as plain values, for a file."""
        n = self.needle
        dimensions = {"radius_m": n.radius, "arc_rad": n.arc, "wire_m": n.wire, "taper_m": n.taper}
        rows: list[dict[str, object]] = []
        for one in self.stitches:
            rows.append(
                {
                    "wound": one.wound.tolist(),
                    "points_m": one.points.tolist(),
                    "radius_m": one.radius,
                    "height_m": one.height,
                    "angles_rad": [one.start, one.out, one.end],
                    "side": one.side,
                    "arms": [one.driver, one.taker],
                    "grips": [[g.angle, g.along, g.across] for g in one.grips],
                    "margins_rad": list(one.margins),
                    "limited": list(one.limited),
                }
            )
        return {"schema": 1, "needle": dimensions, "stitch": rows}

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Write it as TOML, or its picture into a file that ends in .png."""
        if path.suffix == ".png":
            with whole_file(path, overwrite) as built:
                built.write_bytes(self.picture())
        else:
            write_text(path, toml_text(self.document()), overwrite)

    def picture(self) -> bytes:
        """Return a drawing of it as PNG: from above, and each stitch across the wound.

        Raises:
            MissingExtraError: matplotlib is not installed
        """
        figure = new_figure(9.0, 4.4, "drawing a plan")
        above, across = figure.subplots(1, 2)
        angles = np.linspace(0.0, 2.0 * np.pi, 181)
        for number, one in enumerate(self.stitches):
            colour, points = PALETTE[number % len(PALETTE)], 1e3 * one.points
            radius, height = 1e3 * one.radius, 1e3 * one.height
            above.plot(points[[0, 3], 0], points[[0, 3], 1], "-o", color=colour, markevery=[0])
            words = (
                f"{number + 1}: {one.driver} drives ({np.degrees(one.margins[0]):.0f} deg to"
                f" {one.limited[0]}'s limit),\n{one.taker} takes"
                f" ({np.degrees(one.margins[1]):.0f} deg to {one.limited[1]}'s)"
            )
            across.plot(
                radius * np.cos(angles),
                height + radius * np.sin(angles),
                "--",
                color=colour,
                lw=0.8,
            )
            across.plot(points[:, 1], points[:, 2], "o", color=colour, label=words)
        above.axhline(0.0, color="0.6")
        across.axhline(0.0, color="0.6")
        above.set(title="from above (dot: in)", xlabel="along the wound [mm]")
        above.set(ylabel="across [mm]")
        across.set(title="across: needle's circle, channel points", xlabel="across [mm]")
        across.set(ylabel="above the surface [mm]")
        figure.legend(fontsize=7, loc="outside lower center")  # pyright: ignore[reportUnknownMemberType]
        for axes in (above, across):
            axes.set_aspect("equal", adjustable="datalim")
        return png(figure)


def load_plan(path: Path) -> Plan:
    """Read a plan.

    Raises:
        DescriptionError: file, key, what was got and what is allowed
    """
    table = parse_table(path.read_text(), str(path))
    row = table.table("needle")
    needle = Needle(*(row.number(k) for k in ("radius_m", "arc_rad", "wire_m", "taper_m")))
    stitches: list[Stitch] = []
    for one in table.tables("stitch"):
        grips = one.matrix("grips", 2, 3)
        margins, limited = one.numbers("margins_rad", 2), one.texts("limited")
        angles = one.numbers("angles_rad", 3).tolist()
        arms = one.texts("arms")
        stitches.append(
            Stitch(
                one.matrix("wound", 4, 4),
                one.matrix("points_m", 4, 3),
                one.number("radius_m"),
                one.number("height_m"),
                *(angles[0], angles[1], angles[2]),
                round(one.number("side")),
                *(arms[0], arms[1]),
                (_grip(grips[0]), _grip(grips[1])),
                (float(margins[0]), float(margins[1])),
                (limited[0], limited[1]),
            )
        )
    return Plan(tuple(stitches), needle)


def _grip(row: Array) -> Grip:
    return Grip(float(row[0]), round(float(row[1])), round(float(row[2])))


def needle_on_circle(wound: Array, x: float, height: float, side: int, swage: float) -> Array:
    """Return the pose of a needle on a stitch's circle, its swage at an angle of it, (4, 4).

    Args:
        wound: frame of the wound in the world, (4, 4)
        x: where along it [m]
        height: of the circle's centre above the surface [m]
        side: as of a stitch
        swage: angle of the needle's swage [rad]
    """
    c, s = np.cos(swage), np.sin(swage)
    turn = np.array([[0.0, 0.0, -side], [c * side, -s * side, 0.0], [-s, -c, 0.0]])
    return wound @ transform(turn, np.array([x, 0.0, height]))


def wound_frame(line: ArrayLike, up: ArrayLike = UP) -> tuple[Array, float]:
    """Return the frame of a wound that points along its middle were seen of, and its length.

    Args:
        line: points on the surface along the wound in the world, (n, 3) [m]
        up: direction out of the surface, (3,)

    Returns:
        T_world_wound (4, 4): origin in the middle, x along the wound towards +x of the world, z
        up; length [m]

    Raises:
        InputError: fewer than two points, or all in one place
    """
    points = np.asarray(line, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or not np.isfinite(points).all():
        raise InputError(f"wound: got points of shape {points.shape}; allowed: (n, 3), n from 2 on")
    middle, z = points.mean(axis=0), np.asarray(up, dtype=np.float64) / np.linalg.norm(up)
    flat = (points - middle) - np.outer((points - middle) @ z, z)
    x = np.linalg.svd(flat, full_matrices=False)[2][0]
    x = x if x[int(np.argmax(np.abs(x)))] > 0.0 else -x
    reach = flat @ x
    length = float(np.ptp(reach))
    if length < 1e-3:
        raise InputError(f"wound: got points within {1e3 * length:.2g} mm; allowed: 1 mm or more")
    origin = middle + 0.5 * (reach.max() + reach.min()) * x
    return transform(np.column_stack([x, np.cross(z, x), z]), origin), length


class TipWorkspace:
    """The workspace of an arm's tip.

    Args:
        world: with the arm where its base is
        arm: its name
    """

    def __init__(self, world: World, arm: str) -> None:
        self.world, self.arm = world, world.arms[arm]
        self._mechanism, self._structure = (
            self.arm.description.mechanism,
            self.arm.description.inverse_kinematics,
        )
        self._forward = world.reference_pose(arm)
        self._back = inverse(self._forward)
        count = self.arm.description.own_joints
        self._lower, self._upper = self.arm.joints.lower[:count], self.arm.joints.upper[:count]
        self.names = self.arm.joints.names[:count]
        #: Joints that turn: whose distances from limits are angles.
        self._turns = np.array([j.kind != "prismatic" for j in self.arm.description.joints[:count]])
        self.port = world.remote_centres()[arm]

    def pose(self, q: Array) -> Array:
        """Return the pose of the tip in the world at joint positions, (4, 4)."""
        return self._forward @ chain_pose(self._mechanism)(np.append(q, 0.0))

    def all(self, T: Array) -> Array:
        """Return every joint position with the tip at a pose in the world, (k, n); none: (0, n)."""
        try:
            return inverse_kinematics(self._mechanism, self._structure, self._back @ T)
        except (UnreachableError, SingularError):
            return np.zeros((0, len(self.names)))

    def near(self, T: Array, q: Array) -> Array | None:
        """Return joint positions nearest to q with the tip at a pose in the world; None: none."""
        try:
            return nearest_solution(self._mechanism, self._structure, self._back @ T, q)
        except (UnreachableError, SingularError):
            return None

    def room(self, T: Array) -> tuple[float, str]:
        """Return the most room of joints to limits with the tip at a pose, and the nearest joint.

        Returns:
            the least distance, below 0 beyond a limit, -inf where no turning joint is in the way
            [rad]; its joint
        """
        try:
            found = inverse_kinematics(self._mechanism, self._structure, self._back @ T)
        except SingularError:
            return -np.inf, ""
        except UnreachableError as problem:
            turning = [name for name, turns in zip(self.names, self._turns, strict=True) if turns]
            joints = {key: over for key, over in problem.excess.items() if key in turning}
            joint = max(joints, key=lambda key: joints[key], default="")
            return -joints.get(joint, np.inf), joint
        return max(self.margin(q) for q in found)

    def why_not(self, T: Array) -> str:
        """Return ": ", which joint a pose brings beyond its limit, and by how much; "" in reach."""
        try:
            inverse_kinematics(self._mechanism, self._structure, self._back @ T)
        except (UnreachableError, SingularError) as problem:
            return f": {problem}"
        return ""

    def margin(self, q: Array) -> tuple[float, str]:
        """Return the least distance of a turning joint from a limit, and which [rad]."""
        room = np.where(self._turns, np.minimum(q - self._lower, self._upper - q), np.inf)
        worst = int(np.argmin(room, axis=-1))
        return float(room[worst]), self.names[worst]

    def through(
        self, q: Array, poses: Sequence[Array], least: float = -np.inf
    ) -> tuple[float, str, Array]:
        """Return the way from joint positions through poses, without jumps.

        Args:
            q: joint positions
            poses: of the tip in the world, (4, 4) each
            least: margin at which it is given up

        Returns:
            least margin on it (-inf without a way), the joint that has it, the last joint positions
        """
        room, joint = self.margin(q)
        for T in poses:
            after = self.near(T, q)
            if after is None or (np.abs(after - q)[self._turns] > 8.0 * STEP).any():
                return -np.inf, "", q
            q = after
            room, joint = min((room, joint), self.margin(q))
            if room <= least:
                break
        return room, joint, q

    def count(self, q: Array, poses: Sequence[Array]) -> int:
        """Return the number of poses that the tip gets through from q on, without jumps."""
        for number, T in enumerate(poses):
            room, _, q = self.through(q, [T])
            if not np.isfinite(room):
                return number
        return len(poses)

    def along(self, poses: Sequence[Array]) -> tuple[float, str, Array] | None:
        """Return the way through poses that stays farthest from limits.

        Returns:
            least margin, its joint, joint positions at the first pose; None where there is no way
        """
        best: tuple[float, str, Array] | None = None
        for first in self.all(poses[0]):
            room, joint, _ = self.through(first, poses[1:], -np.inf if best is None else best[0])
            if np.isfinite(room) and (best is None or room > best[0]):
                best = room, joint, first
        return best


def make_plan(
    world: World, tissue: Tissue, wound: Array, places: Sequence[float], needle_pose: Array
) -> Plan:
    """Plan stitches across a wound: arms, sides and grips.

    Args:
        world: with the arms
        tissue: what is stitched, as far as it is known: its gap, depth and width, and the needle
        wound: its frame in the world, (4, 4)
        places: where along it, of each stitch [m]
        needle_pose: of the needle where it lies, in the world (4, 4): it is picked from above

    Raises:
        InputError: the needle does not fit jaws or tissue
        UnreachableError: no arm reaches it, shafts would meet, or an endoscope does not see it;
            says which joint is in the way and by how much
    """
    needle = tissue.wire
    scopes = scope_shafts(world)
    arms = [name for name, arm in world.arms.items() if arm.description.type == "PSM"]
    reaches = {name: TipWorkspace(world, name) for name in arms}
    found: list[Stitch] = []
    for place in places:
        before = found[-1] if found else None
        _check_view(world, _draft(tissue, (wound, place), 1, ("", "")))
        options = list(_options(reaches, tissue, (wound, place), needle_pose, before))
        if options:
            gaps = [clearance(one, needle, reaches, scopes) for one in options]
            options = [one for one, gap in zip(options, gaps, strict=True) if gap >= APART_M]
            if not options:
                raise UnreachableError(
                    f"stitch {len(found) + 1}: shafts come within {1e3 * max(gaps):.1f} mm of each"
                    f" other; allowed: {1e3 * APART_M:.1f} mm"
                )
        best = max(options, key=lambda one: min(one.margins), default=None)
        if best is None or min(best.margins) < LEAST:
            raise UnreachableError(_why_not(reaches, tissue, (wound, place), best))
        found.append(best)
    return Plan(tuple(found), needle)


def scope_shafts(world: World) -> list[tuple[Array, Array]]:
    """Return both ends of the shafts of endoscopes in the world, (3,) each [m]."""
    return [
        (arm.measured_cp("world").matrix[:3, 3], world.remote_centres()[name])
        for name, arm in world.arms.items()
        if arm.description.type == "ECM"
    ]


def circle_height(tissue: Tissue) -> float:
    """Return the height of a stitch's circle's centre above the surface [m].

    The lower, the deeper it bites; so high that the jaws of both arms stay clear of the surface
    while they hold the needle, and that bites are not too wide for the tissue.

    Raises:
        InputError: the needle does not fit jaws or tissue; says what is allowed
    """
    needle, room = tissue.wire, 0.5 * tissue.gap + tissue.width
    radius = needle.radius
    if needle.wire > 2e-3:
        raise InputError(
            f"needle: got a wire of {1e3 * needle.wire:.2f} mm; allowed: up to 2 mm, for the jaws"
        )
    rise = max(RISE, float(np.sin(_outside(needle))) + JAW_M / radius)
    if (share := WIDEST * room / radius) < 1.0:
        rise = max(rise, float(np.sqrt(1.0 - share**2)))
    wide = radius * float(np.sqrt(max(1.0 - rise**2, 0.0)))
    least = 0.5 * tissue.gap + LEAST_BITE_M
    if wide < least:
        raise InputError(
            f"needle of {1e3 * radius:.1f} mm radius and {np.degrees(needle.arc):.0f} deg bites"
            f" {1e3 * wide:.1f} mm wide where jaws stay {1e3 * JAW_M:.1f} mm clear of the"
            f" surface; needed: {1e3 * least:.1f} mm for a wound of {1e3 * tissue.gap:.1f} mm"
        )
    deep = radius * (1.0 - rise)
    if deep > 0.9 * tissue.depth or rise > MOST_RISE:
        raise InputError(
            f"needle of {1e3 * radius:.1f} mm radius bites {1e3 * wide:.1f} mm wide and"
            f" {1e3 * deep:.1f} mm deep; allowed: up to {900 * tissue.depth:.1f} mm deep, and a"
            f" radius of {1e3 * WIDEST * room / np.sqrt(1.0 - MOST_RISE**2):.1f} mm in halves of"
            f" {1e3 * tissue.width:.1f} mm"
        )
    return rise * radius


def _outside(needle: Needle) -> float:
    """Return the angle above the horizon at which both arms hold a needle that lies evenly."""
    return 0.5 * (np.pi + HOLD_SWAGE + HOLD_TIP - needle.arc)


def _draft(tissue: Tissue, where: tuple[Array, float], side: int, arms: tuple[str, str]) -> Stitch:
    """Return a stitch at a place of a wound by two arms, without grips."""
    needle, (wound, place) = tissue.wire, where
    height = circle_height(tissue)
    surface = float(np.arcsin(height / needle.radius))
    angles = (
        surface - BEFORE,
        np.pi + HOLD_TIP - _outside(needle),
        np.pi - surface + needle.arc + BEYOND,
    )
    points = stitch_points(tissue, place, needle.radius, height, float(side))
    none = Grip(0.0, 1, 1)
    return Stitch(
        wound,
        points,
        needle.radius,
        height,
        *angles,
        side,
        *arms,
        (none, none),
        (0.0, 0.0),
        ("", ""),
    )


def clearance(
    stitch: Stitch,
    needle: Needle,
    reaches: Mapping[str, TipWorkspace],
    scopes: Sequence[tuple[Array, Array]],
) -> float:
    """Return the least distance between axes of shafts while a stitch is made [m].

    Args:
        stitch: as it is planned
        needle: with which
        reaches: of the arms
        scopes: both ends of the shafts of endoscopes, in the world
    """

    def shaft(row: int, angle: float) -> tuple[Array, Array]:
        arm = (stitch.driver, stitch.taker)[row]
        T = stitch.needle_pose(needle, angle) @ stitch.grips[row].pose(needle)
        return T[:3, 3] - WRIST_M * T[:3, 2], reaches[arm].port

    gaps = [_apart(shaft(0, stitch.out), shaft(1, stitch.out))]
    for row, (first, last) in enumerate(((stitch.start, stitch.out), (stitch.out, stitch.end))):
        for angle in np.arange(first, last, 3.0 * STEP):
            gaps += [_apart(shaft(row, angle), scope) for scope in scopes]
    return min(gaps)


def _apart(one: tuple[Array, Array], two: tuple[Array, Array]) -> float:
    """Return the distance between two segments, of one of which points are looked at [m]."""
    points = one[0] + np.linspace(0.0, 1.0, ALONG)[:, None] * (one[1] - one[0])
    way = two[1] - two[0]
    share = np.clip((points - two[0]) @ way / (way @ way), 0.0, 1.0)
    return float(np.linalg.norm(points - two[0] - share[:, None] * way, axis=1).min())


def _check_view(world: World, stitch: Stitch) -> None:
    """Reject a stitch that an endoscope does not see.

    Raises:
        UnreachableError: which eye, and where in its image the stitch would be
    """
    seen = stitch.points @ stitch.wound[:3, :3].T + stitch.wound[:3, 3]
    for camera in world.cameras().values():
        if camera.kind != "endoscope" or not isinstance(camera.calibration, StereoCalibration):
            continue
        for side, lens, eye in zip(
            ("left", "right"), camera.calibration.eyes, camera.T_world_eyes, strict=True
        ):
            at = project(transform_points(inverse(eye), seen), lens.K, lens.distortion)
            out = ~((at >= 0.0) & (at < lens.size)).all(axis=1)
            if out.any():
                place = 1e3 * float(stitch.points[0, 0])
                raise UnreachableError(
                    f"stitch {place:.1f} mm along the wound: {camera.name}'s {side} eye does not"
                    f" see all of it: got a point at {at[out][0].round().tolist()} px; allowed:"
                    f" within {list(lens.size)} px"
                )


def _options(
    reaches: dict[str, TipWorkspace],
    tissue: Tissue,
    where: tuple[Array, float],
    needle_pose: Array,
    before: Stitch | None,
) -> Iterator[Stitch]:
    """Yield ways to make a stitch at a place of a wound; like the one before, if there is one."""
    needle = tissue.wire
    for (driver, taker), side in product(_pairs(reaches, needle_pose), (1, -1)):
        if before is not None and (driver, side) != (before.driver, before.side):
            continue
        draft = _draft(tissue, where, side, (driver, taker))
        pick = needle_pose if before is None else None
        inwards = np.arange(draft.start, draft.out + STEP, STEP), HOLD_SWAGE, pick
        hold = float(needle.arc - HOLD_TIP)
        outwards = np.arange(float(draft.out - STEP), float(draft.end + STEP), STEP), hold, None
        kept = (None, None) if before is None else before.grips
        one = _best_grip(reaches[driver], draft, tissue, inwards, kept[0])
        two = None if one is None else _best_grip(reaches[taker], draft, tissue, outwards, kept[1])
        if one is None or two is None:
            continue
        found = replace(
            draft, grips=(one[2], two[2]), margins=(one[0], two[0]), limited=(one[1], two[1])
        )
        yield found
        if min(found.margins) > ENOUGH:
            return


def _best_grip(
    reach: TipWorkspace,
    stitch: Stitch,
    tissue: Tissue,
    part: tuple[Array, float, Array | None],
    kept: Grip | None,
) -> tuple[float, str, Grip] | None:
    """Return least margin, its joint and the grip with which an arm turns a needle best.

    Of an arm that takes the needle, one with which it also pulls the thread, if there is one: two
    grips half a turn of the roll apart have the same room in the wrist, and not in the roll.

    Args:
        reach: of the arm
        stitch: as far as it is planned
        tissue: that is stitched, and the needle
        part: angles of the tip, where on the needle the jaw is, and where the needle lies that the
            arm picks up from above (4, 4), None: it takes it from the other arm
        kept: the grip, None: whichever is best
    """
    needle, (tips, angle, pick) = tissue.wire, part
    axis = stitch.needle_pose(needle, np.pi)[:3, 2]
    along = 1 if axis @ (stitch.wound[:3, 3] - reach.port) > 0.0 else -1
    if pick is not None and along * pick[2, 2] > 0.0:
        return None  # from above, the jaw would hold it the other way round
    best: tuple[bool, float, str, Grip] | None = None
    for grip in (Grip(angle, along, 1), Grip(angle, along, -1)) if kept is None else (kept,):
        held = grip.pose(needle)
        poses = [stitch.needle_pose(needle, tip) @ held for tip in tips]
        way = reach.along(poses)
        if way is None:
            continue
        room, pulled = way[:2], False
        if pick is not None:
            above = pick @ held
            above[2, 3] += ABOVE_M
            picks = [reach.margin(q) for q in reach.all(above)]
            room = min(room, max(picks, default=(-np.inf, "")))
        elif kept is None:
            pull = next(stitch.pulls(reach, tissue, poses[-1], held))
            last = reach.through(way[2], poses[1:])[2]
            pulled = reach.through(last, pull.poses(), LEAST)[0] >= LEAST
        if best is None or (pulled, room[0]) > best[:2]:
            best = pulled, *room, grip
    return None if best is None else best[1:]


def _pairs(reaches: dict[str, TipWorkspace], needle_pose: Array) -> list[tuple[str, str]]:
    """Return arms that drive and take, first with the one nearer to the needle."""
    near = sorted(reaches, key=lambda name: np.linalg.norm(reaches[name].port - needle_pose[:3, 3]))
    return [(one, two) for one in near for two in near if one != two]


def _why_not(
    reaches: dict[str, TipWorkspace],
    tissue: Tissue,
    where: tuple[Array, float],
    best: Stitch | None,
) -> str:
    """Return the reason that no arm reaches a stitch: the joint at its limit, and by how much."""
    needle, (wound, place) = tissue.wire, where
    yaw = np.degrees(np.arctan2(wound[1, 0], wound[0, 0]))
    at = np.round(1e3 * (wound @ [place, 0.0, 0.0, 1.0])[:3], 1).tolist()
    if best is not None:
        worst = int(np.argmin(best.margins))
        arm = (best.driver, best.taker)[worst]
        room, joint = best.margins[worst], best.limited[worst]
    else:
        arm, room, joint = max(
            (
                _nearest_miss(reach, tissue, where, side)
                for reach in reaches.values()
                for side in (1, -1)
            ),
            key=lambda found: found[1],
        )
    off = np.degrees(room)
    way = f"{off:.0f} deg from its limit" if off >= 0.0 else f"{-off:.0f} deg beyond its limit"
    reason = f"{arm}'s {joint} would be {way} at best" if joint else f"{arm} does not reach so far"
    return (
        f"stitch at {at} mm across a wound at {yaw:.0f} deg: {' and '.join(reaches)} do not reach"
        f" its whole arc of {1e3 * needle.radius:.1f} mm radius: {reason}; needed:"
        f" {np.degrees(LEAST):.0f} deg; allowed: within 45 deg of the line between the ports, and"
        " 30 mm"
    )


def _nearest_miss(
    reach: TipWorkspace, tissue: Tissue, where: tuple[Array, float], side: int
) -> tuple[str, float, str]:
    """Return an arm, the least margin of its joints on the arc as it drives it best, and of which.

    Each pose counts by itself, whether or not the arm gets from one to the next.
    """
    needle, draft = tissue.wire, _draft(tissue, where, side, ("", ""))
    best = (reach.arm.name, -np.inf, "")
    for along, across in product((1, -1), repeat=2):
        held = Grip(HOLD_SWAGE, along, across).pose(needle)
        least = (reach.arm.name, np.inf, "")
        for tip in np.arange(draft.start, draft.out, 3.0 * STEP):
            room = reach.room(draft.needle_pose(needle, tip) @ held)
            least = min(least, (reach.arm.name, *room), key=lambda one: one[1])
        best = max(best, least, key=lambda found: found[1])
    return best
