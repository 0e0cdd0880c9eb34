"""Scenes from TOML: a rig, the props on it, random placements, goals and a time limit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.cameras import load_stereo_camera
from trocar.descriptions.props import read_bands, read_props
from trocar.descriptions.records import DynamicsKind, GraspKind, RigDescription
from trocar.descriptions.rigs import DYNAMICS, GRASPS
from trocar.descriptions.sensors import read_sensors
from trocar.descriptions.table import Table
from trocar.errors import InputError
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import inverse, transform

Array = NDArray[np.float64]

#: An object that has no free place after so many draws is rejected. Source: our own choice.
TRIES = 100
#: An object that falls farther than this after it was held is dropped. Source: our own choice, two
#: thirds of the height of a peg. [m]
DROP_M = 0.008


@dataclass(frozen=True, eq=False)
class Placement:
    """Where an object may lie when an episode begins.

    Attributes:
        object: name of a movable prop
        on: name of one placed before that it keeps its place on, "" for the world
        spread: half the range about the prop's own place, along x, y and z of the world, (3,) [m]
        turn: half the range of its rotation about the world's z [rad]
        radius: of the circle about it, in x and y, that no other circle overlaps; 0 for none [m]
    """

    object: str
    on: str
    spread: Array
    turn: float
    radius: float


@dataclass(frozen=True, eq=False)
class Goal:
    """Where an object or a tip shall be in the end.

    Attributes:
        object, arm: name of a movable prop, or of an arm whose tip it is, else ""; with both, the
            tip shall be beside the object, or, with `held`, hold it
        at: (3,) in the world; of a tip beside an object from there, along axes of the world [m]
        on: name of a movable prop in whose frame `at` is, "" for the world
        spread: half the range that a reset draws it from, (3,) [m]
        radius: largest distance in x and y [m]
        height: largest distance in z [m]
        held: whether an arm, or `arm`, holds the object in the end; else it is released
        stage: goals count once all of earlier stages were met, which then stay met
    """

    object: str
    arm: str
    at: Array
    spread: Array
    radius: float
    height: float
    held: bool = False
    on: str = ""
    stage: int = 0


@dataclass(frozen=True, eq=False)
class Scene:
    """A task for arms.

    Attributes:
        name, title, source, file: as in the file
        rig: the rig with the scene's props and start pose
        task: the class of the task, see `trocar.tasks`
        arms: that a policy drives
        welded: other arms, which stay where they start; empty where a person may drive them
        placements, goals: of objects and tips; goals by stage
        time_limit: of an episode [s]
        drop_height: an object that falls farther counts as dropped [m]
        hidden: objects that observations leave out, and with them places of goals on them
        look: settings of `trocar.rendering.Look` for the images that the task looks at, by name;
            others are as the task has them
    """

    name: str
    title: str
    source: str
    file: str
    rig: RigDescription
    task: str
    arms: tuple[str, ...]
    placements: tuple[Placement, ...]
    goals: tuple[Goal, ...]
    time_limit: float
    drop_height: float
    hidden: tuple[str, ...] = ()
    welded: tuple[str, ...] = ()
    look: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def placed(self, rng: np.random.Generator) -> dict[str, Array]:
        """Draw where its objects begin, {object: T_world_object (4, 4)}.

        Raises:
            InputError: no free place after 100 draws; the objects are named
        """
        found: dict[str, Array] = {}
        circles: list[tuple[Placement, Array]] = []
        props = {prop.name: prop for prop in self.rig.objects}
        for row in self.placements:
            nominal = props[row.object].pose
            if row.on:
                nominal = found[row.on] @ inverse(props[row.on].pose) @ nominal
            at, near = nominal[:3, 3], [row.object]
            tries = 0
            while near:
                if tries == TRIES:
                    raise InputError(
                        f"{self.name}: no free place for {row.object} after {TRIES} draws; it"
                        f" overlaps {', '.join(near)}; allowed: a wider spread or smaller radii"
                    )
                tries += 1
                at = nominal[:3, 3] + row.spread * rng.uniform(-1.0, 1.0, 3)
                near = [
                    other.object
                    for other, xy in circles
                    if row.radius
                    and other.radius
                    and np.hypot(*(at[:2] - xy)) < row.radius + other.radius
                ]
            turn = rotation_z(row.turn * rng.uniform(-1.0, 1.0))
            found[row.object] = transform(turn @ nominal[:3, :3], at)
            circles.append((row, at[:2]))
        return found


def is_scene(table: Table) -> bool:
    """Return whether a file's root table is a scene's and not a rig's."""
    return "task" in table


def read_scene(table: Table, load_rig: Callable[[str | Path], RigDescription]) -> Scene:
    """Read a scene from its file's root table; paths inside it are relative to its folder.

    Raises:
        UnknownNameError: no such rig; the known ones are listed
        DescriptionError: the file is broken; file, key, got and allowed are named
    """
    path = Path(table.file)
    table.check_schema()
    named, title, source = table.text("name"), table.text("title", ""), table.text("source")
    wanted = table.text("rig")
    base = load_rig(path.parent / wanted if wanted.endswith(".toml") else wanted)
    arms = table.texts("arms")
    rig = replace(_rig(table, _without(table, base, arms)), name=named, file=str(path))
    task = table.text("task")
    known = [a.name for a in rig.arms if a.arm.type in ("PSM", "ECM")]
    if not arms or not set(arms) <= set(known) or len(set(arms)) < len(arms):
        raise table.fail("arms", f"got {list(arms)}; allowed: some of {', '.join(known)}")
    free = [p.name for p in rig.objects if p.joint is None]
    placements: list[Placement] = []
    for row in table.tables("place"):
        placements.append(_read_placement(row, free, [p.object for p in placements]))
        row.done()
    objects = [prop.name for prop in rig.objects]
    goals = list(table.each("goal", lambda row: _read_goal(row, objects, known)))
    if not goals:
        raise table.fail("goal", "is missing; a scene needs at least one")
    limit = table.positive("time_limit", "time")
    drop = table.positive("drop_height", "length", default=DROP_M)
    hidden = table.texts("hidden")
    if not set(hidden) <= set(objects):
        raise table.fail("hidden", f"got {list(hidden)}; allowed: some of {', '.join(objects)}")
    table.done()
    task = str(path.parent / task) if task.endswith(".py") else task
    goals.sort(key=lambda goal: goal.stage)
    parts = (named, title, source, str(path), rig, task, arms, tuple(placements), tuple(goals))
    # what arms without motors read has no errors
    welded = () if rig.errors else tuple(a.name for a in rig.arms if a.name in {*known} - {*arms})
    return Scene(*parts, limit, drop, hidden, welded)


def _without(table: Table, rig: RigDescription, driven: Sequence[str]) -> RigDescription:
    """Return the rig without the arms that the scene leaves out."""
    gone = table.texts("without")
    carriers = {arm.on for arm in rig.arms if arm.name not in gone}
    carriers |= {one.arm for one in rig.cameras}
    carriers |= {rig.reference_arm} if rig.setup_joints else set()
    allowed = [arm.name for arm in rig.arms if arm.name not in (*driven, *carriers)]
    if not set(gone) <= set(allowed):
        raise table.fail(
            "without",
            f"got {list(gone)}; allowed: arms that the scene does not drive and nothing stands on"
            f" ({', '.join(allowed) or 'none'})",
        )
    return replace(
        rig,
        arms=tuple(arm for arm in rig.arms if arm.name not in gone),
        poses={
            pose: {arm: q for arm, q in row.items() if arm not in gone}
            for pose, row in rig.poses.items()
        },
        sensors=tuple(one for one in rig.sensors if getattr(one, "arm", "") not in gone),
        teleops=tuple(one for one in rig.teleops if one.slave not in gone),
    )


def _rig(table: Table, rig: RigDescription) -> RigDescription:
    """Return the rig with the scene's props, bands, sensors, camera and start pose."""
    new = read_props(table, [arm.name for arm in rig.arms])
    taken = {prop.name for prop in rig.props} & {prop.name for prop in new}
    if taken:
        raise table.fail("prop", f"got {', '.join(sorted(taken))}, which the rig has already")
    props = *rig.props, *new
    bands = *rig.bands, *read_bands(table, props)
    sensors = *rig.sensors, *read_sensors(table, rig.arms, props, bands)
    start = dict(rig.poses["start"])
    if "start_q_rad_m" in table:
        row = table.table("start_q_rad_m")
        start |= _read_start(row, rig, start)
    grasp = cast(GraspKind, table.text("grasp", rig.grasp, allowed=GRASPS))
    dynamics = cast(DynamicsKind, table.text("dynamics", rig.dynamics, allowed=DYNAMICS))
    cameras, preset = rig.cameras, table.text("camera", "")
    if preset:
        sees = load_stereo_camera(preset)
        scopes = [one.name for one in cameras if one.kind == "endoscope"]
        if not scopes:
            raise table.fail("camera", f"got {preset!r}, but the rig {rig.name} has no endoscope")
        cameras = tuple(
            replace(one, calibration=sees) if one.name == scopes[0] else one for one in cameras
        )
    poses = {**rig.poses, "start": start}
    parts = {"props": props, "bands": bands, "sensors": sensors, "cameras": cameras}
    return replace(rig, grasp=grasp, dynamics=dynamics, poses=poses, **parts)


def _read_start(row: Table, rig: RigDescription, start: Mapping[str, Array]) -> dict[str, Array]:
    found: dict[str, Array] = {}
    for name in row.entries():
        if name not in start:
            raise row.fail(name, f"is no arm; allowed: {', '.join(start)}")
        mechanism = rig.arm(name).arm.mechanism
        found[name] = row.within(name, mechanism.lower, mechanism.upper)
    row.done()
    return found


def _read_placement(row: Table, free: Sequence[str], before: Sequence[str]) -> Placement:
    name = row.text("object", allowed=tuple(free))
    if name in before:
        raise row.fail("object", f"got {name!r} a second time")
    on = row.text("on", "", allowed=("", *before))
    spread = row.vector("spread", 3, "length", default=np.zeros(3))
    turn = row.quantity("turn", "angle", default=0.0)
    radius = row.quantity("radius", "length", default=0.0)
    if (spread < 0.0).any() or turn < 0.0 or radius < 0.0:
        raise row.fail("spread", "allowed: spread, turn and radius of 0 or more")
    return Placement(name, on, spread, turn, radius)


def _read_goal(row: Table, objects: Sequence[str], arms: Sequence[str]) -> Goal:
    if "object" not in row and "arm" not in row:
        raise row.fail("object", "is missing; allowed: an object, an arm, or both")
    name = row.text("object", "", allowed=("", *objects))
    arm = row.text("arm", "", allowed=("", *arms))
    at = row.vector("at", 3, "length")
    spread = row.vector("spread", 3, "length", default=np.zeros(3))
    stage = row.number("stage", 0.0)
    if stage < 0.0 or stage != int(stage):
        raise row.fail("stage", f"got {stage:g}; allowed: 0, 1, 2 and so on")
    goal = Goal(
        name,
        arm,
        at,
        spread,
        row.positive("radius", "length"),
        row.positive("height", "length"),
        row.flag("held", False),
        row.text("on", "", allowed=("", *objects)),
        int(stage),
    )
    if goal.held and not name:
        raise row.fail("held", "got true; allowed: with an object")
    if (spread < 0.0).any():
        raise row.fail("spread", f"got {spread.tolist()}; allowed: 0 or more")
    return goal
