"""Scenes from TOML: a rig, the props on it, random placements, goals and a time limit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.cameras import load_stereo_camera
from trocar.descriptions.keys import key
from trocar.descriptions.props import read_bands, read_props
from trocar.descriptions.randomisation import NONE, Randomisation, TipSource, read_randomisation
from trocar.descriptions.records import (
    DynamicsKind,
    Generation,
    GraspKind,
    RigDescription,
    Surroundings,
)
from trocar.descriptions.robot_errors import robot_errors
from trocar.descriptions.sensors import read_sensors
from trocar.descriptions.table import Table
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import inverse, transform

Array = NDArray[np.float64]

#: Draws of a free place for an object. Source: our own choice.
TRIES = 100
#: Fall by which an object counts as dropped. Source: our own choice, two thirds of the height of a
#: peg. [m]
DROP_M = 0.008


def _origin() -> Array:
    return np.zeros(3)


@dataclass(frozen=True, eq=False)
class Placement:
    """The range of an object's pose at the beginning of an episode.

    Attributes:
        object: a movable prop
        on: an object placed before that it stays on, "" for the world
        spread: half the range about the prop's own place, along x, y and z of the world, (3,) [m]
        turn: half the range of its rotation about the world's z [rad]
        radius: of a circle about it, in x and y, that no other circle overlaps; 0: no circle [m]
    """

    object: str = field(metadata=key())
    on: str = field(metadata=key(default=""))
    spread: Array = field(metadata=key("length", size=3, least=0.0, default=_origin))
    turn: float = field(metadata=key("angle", least=0.0, default=0.0))
    radius: float = field(metadata=key("length", least=0.0, default=0.0))


@dataclass(frozen=True, eq=False)
class Goal:
    """The place where an object or a tip shall be in the end.

    Attributes:
        object, arm: a movable prop, or an arm for its tip; with both, the tip shall be beside the
            object, or, with `held`, hold it
        at: in the world; of a tip beside an object from there, along axes of the world, (3,) [m]
        spread: half the range that a reset draws it from, (3,) [m]
        radius: largest distance in x and y [m]
        height: largest distance in z [m]
        held: whether an arm, or `arm`, holds the object in the end; else it is released
        on: a movable prop in whose frame `at` is, "" for the world
        stage: goals count once all of earlier stages were met, which then stay met
    """

    object: str = field(metadata=key(default=""))
    arm: str = field(metadata=key(default=""))
    at: Array = field(metadata=key("length", size=3))
    spread: Array = field(metadata=key("length", size=3, least=0.0, default=_origin))
    radius: float = field(metadata=key("length", above=0.0))
    height: float = field(metadata=key("length", above=0.0))
    held: bool = field(default=False, metadata=key())
    on: str = field(default="", metadata=key())
    stage: int = field(default=0, metadata=key(least=0))


@dataclass(frozen=True, eq=False)
class SceneKeys:
    """Keys of a scene's file beside its blocks.

    Attributes:
        name, title, source: of the scene
        rig: a built-in or registered rig, or the path of its file
        task: name of the task's class, or the path of a Python file
        arms: PSMs and ECMs that a policy drives
        without: arms of the rig that the scene leaves out
        time_limit: of an episode [s]
        drop_height: an object that falls farther than this after it was held is dropped [m]
        hidden: objects that observations leave out, and with them places of goals on them
        camera: preset of the endoscope's camera; default: the rig's
        grasp, dynamics: as in the rig's file; default: the rig's
        surroundings: drawn about the scene's tissue: the rig's "table", or a body's "cavity", which
            touches nothing
        generation: Si: arms of an Si in place of the rig's, with the same ports, tips and tools
        errors: of the robots, "perfect", "lab" or "wide"; default: the rig's
        randomise: worlds are drawn anew at each reset: "none", "lab", "wide", or the path of a
            TOML file; its robot errors are those of the scene then
        tips: tips in observations are those that the "robot" measures, or corrected by images of a
            "camera"
    """

    name: str = field(metadata=key())
    title: str = field(metadata=key(default=""))
    source: str = field(metadata=key())
    rig: str = field(metadata=key())
    task: str = field(metadata=key())
    arms: tuple[str, ...] = field(metadata=key(default=()))
    without: tuple[str, ...] = field(metadata=key(default=()))
    time_limit: float = field(metadata=key("time", above=0.0))
    drop_height: float = field(metadata=key("length", above=0.0, default=DROP_M))
    hidden: tuple[str, ...] = field(metadata=key(default=()))
    camera: str = field(metadata=key(default=""))
    grasp: GraspKind | None = field(default=None, metadata=key())
    dynamics: DynamicsKind | None = field(default=None, metadata=key())
    surroundings: Surroundings = field(default="table", metadata=key())
    generation: Generation | None = field(default=None, metadata=key())
    errors: str = field(default="", metadata=key())
    randomise: str = field(default="", metadata=key())
    tips: TipSource = field(default="robot", metadata=key())


@dataclass(frozen=True, eq=False)
class Scene:
    """A task for arms.

    Attributes:
        name, title, source, file: of the scene
        rig: the rig with the scene's props and start pose
        task: the class of the task, see `trocar.tasks`
        arms: that a policy drives
        welded: other arms, which stay where they start; empty where a person may drive them
        placements, goals: of objects and tips; goals by stage
        time_limit: of an episode [s]
        drop_height: an object that falls farther counts as dropped [m]
        hidden: objects that observations leave out, and with them places of goals on them
        generation: "Si" of a scene whose arms are to be replaced (`on_si`), "" as the rig has them
        look: settings of `trocar.rendering.Look` for the images that the task looks at, by name;
            others are as the task has them
        randomisation: spreads by which each reset draws the world
        tips: source of the tips in observations
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
    generation: str = ""
    randomisation: Randomisation = field(default_factory=Randomisation)
    tips: TipSource = "robot"

    def with_errors(self, errors: str) -> Scene:
        """Return this scene with robots that have errors of a preset: "perfect", "lab" or "wide".

        No arm is welded then, as the encoders of those that stand still have errors as well.

        Raises:
            UnknownNameError: no such preset; the known ones are listed
        """
        found = robot_errors(errors)
        welded = self.welded if found is None else ()
        return replace(self, rig=replace(self.rig, errors=found), welded=welded)

    def randomised(
        self, randomisation: Randomisation | str | Path, tips: TipSource = "robot"
    ) -> Scene:
        """Return this scene with worlds that each reset draws anew.

        Success is judged by true poses; observations have tips and objects as the robots and
        cameras report them.

        Args:
            randomisation: spreads, a preset ("none", "lab", "wide"), or the path of a TOML file
            tips: "robot": by encoders and registration; "camera": corrected by images of the tips

        Raises:
            UnknownNameError, DescriptionError: as `read_randomisation`
            InputError: other tips
        """
        if tips not in get_args(TipSource):
            raise InputError(f"tips: got {tips!r}; allowed: {', '.join(get_args(TipSource))}")
        spreads = (
            randomisation
            if isinstance(randomisation, Randomisation)
            else read_randomisation(randomisation)
        )
        found = self.with_errors(spreads.errors) if spreads.errors else self
        return replace(found, randomisation=spreads, tips=tips)

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
    keys = table.record(SceneKeys)
    beside = path.parent
    base = load_rig(beside / keys.rig if keys.rig.endswith(".toml") else keys.rig)
    rig = replace(_rig(table, keys, _without(table, keys, base)), name=keys.name, file=str(path))
    known = [a.name for a in rig.arms if a.arm.type in ("PSM", "ECM")]
    if not keys.arms or not set(keys.arms) <= set(known) or len(set(keys.arms)) < len(keys.arms):
        raise table.fail("arms", f"got {list(keys.arms)}; allowed: some of {', '.join(known)}")
    free = [p.name for p in rig.objects if p.joint is None]
    placements: list[Placement] = []
    for row in table.tables("place"):
        placements.append(_read_placement(row, free, [p.object for p in placements]))
        row.done()
    if keys.surroundings == "cavity" and rig.tissue is None:
        raise table.fail("surroundings", 'got "cavity"; allowed: "table", or a scene with a prop of'
                         ' the material "tissue"')  # fmt: skip
    objects = [prop.name for prop in rig.objects]
    goals = list(table.each("goal", lambda row: _read_goal(row, objects, known)))
    if not goals:
        raise table.fail("goal", "is missing; a scene needs at least one")
    hidden = keys.hidden
    if not set(hidden) <= set(objects):
        raise table.fail("hidden", f"got {list(hidden)}; allowed: some of {', '.join(objects)}")
    table.done()
    # Arms without motors have no reading errors, so none is welded in a rig with errors.
    idle = {*known} - {*keys.arms}
    scene = Scene(
        name=keys.name,
        title=keys.title,
        source=keys.source,
        file=str(path),
        rig=rig,
        task=str(beside / keys.task) if keys.task.endswith(".py") else keys.task,
        arms=keys.arms,
        placements=tuple(placements),
        goals=tuple(sorted(goals, key=lambda goal: goal.stage)),
        time_limit=keys.time_limit,
        drop_height=keys.drop_height,
        hidden=hidden,
        generation=keys.generation or "",
        welded=() if rig.errors else tuple(a.name for a in rig.arms if a.name in idle),
    )
    try:
        scene = scene.with_errors(keys.errors) if keys.errors else scene
    except UnknownNameError as problem:
        raise table.fail("errors", str(problem)) from problem
    if not keys.randomise and keys.tips == "robot":
        return scene
    spreads = beside / keys.randomise if keys.randomise.endswith(".toml") else keys.randomise
    try:
        return scene.randomised(spreads or NONE, keys.tips)
    except UnknownNameError as problem:
        raise table.fail("randomise", str(problem)) from problem


def _without(table: Table, keys: SceneKeys, rig: RigDescription) -> RigDescription:
    """Return the rig without the arms that the scene leaves out."""
    gone = keys.without
    carriers = {arm.on for arm in rig.arms if arm.name not in gone}
    carriers |= {one.arm for one in rig.cameras}
    carriers |= {rig.reference_arm} if rig.setup_joints else set()
    allowed = [arm.name for arm in rig.arms if arm.name not in (*keys.arms, *carriers)]
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


def _rig(table: Table, keys: SceneKeys, rig: RigDescription) -> RigDescription:
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
        start |= _read_start(table.table("start_q_rad_m"), rig, start)
    cameras = rig.cameras
    if keys.camera:
        sees = load_stereo_camera(keys.camera)
        scopes = [one.name for one in cameras if one.kind == "endoscope"]
        if not scopes:
            raise table.fail(
                "camera", f"got {keys.camera!r}, but the rig {rig.name} has no endoscope"
            )
        cameras = tuple(
            replace(one, calibration=sees) if one.name == scopes[0] else one for one in cameras
        )
    return replace(
        rig,
        grasp=keys.grasp or rig.grasp,
        dynamics=keys.dynamics or rig.dynamics,
        surroundings=keys.surroundings,
        poses={**rig.poses, "start": start},
        props=props,
        bands=bands,
        sensors=sensors,
        cameras=cameras,
    )


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
    placement = row.record(Placement, choices={"object": free, "on": ("", *before)})
    if placement.object in before:
        raise row.fail("object", f"got {placement.object!r} a second time")
    return placement


def _read_goal(row: Table, objects: Sequence[str], arms: Sequence[str]) -> Goal:
    if "object" not in row and "arm" not in row:
        raise row.fail("object", "is missing; allowed: an object, an arm, or both")
    named = "", *objects
    goal = row.record(Goal, choices={"object": named, "arm": ("", *arms), "on": named})
    if goal.held and not goal.object:
        raise row.fail("held", "got true; allowed: with an object")
    return goal
