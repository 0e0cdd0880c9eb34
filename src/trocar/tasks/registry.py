"""Which class of tasks a scene names: one of ours, a registered one, or one in a Python file."""

from __future__ import annotations

import pkgutil
from pathlib import Path
from typing import Any

from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.plugins import load_registered, registered
from trocar.descriptions.scenes import Scene
from trocar.errors import InputError, UnknownNameError
from trocar.modeling.props import run_script
from trocar.tasks.scenes.dynamic import BandPull, BarCarry, Pendulum, Push, Stack, TrayCarry
from trocar.tasks.scenes.reach import ActiveTrack, Reach, Track
from trocar.tasks.scenes.thread import ThreadHandOver, ThreadKnot
from trocar.tasks.scenes.transfer import (
    HandOver,
    NeedleHandOver,
    NeedlePick,
    NeedleRegrasp,
    PegBoard,
    PickPlace,
    Retrieve,
    WallTransfer,
)
from trocar.tasks.task import Task

#: Classes by name; those outside this package as "module:class".
TASKS: dict[str, type[Task] | str] = {
    "task": Task,
    "pick-place": PickPlace,
    "peg-board": PegBoard,
    "hand-over": HandOver,
    "wall-transfer": WallTransfer,
    "needle-pick": NeedlePick,
    "needle-handover": NeedleHandOver,
    "needle-regrasp": NeedleRegrasp,
    "thread-handover": ThreadHandOver,
    "thread-knot": ThreadKnot,
    "retrieve": Retrieve,
    "push": Push,
    "stack": Stack,
    "pendulum": Pendulum,
    "band-pull": BandPull,
    "bar-carry": BarCarry,
    "tray-carry": TrayCarry,
    "reach": Reach,
    "track": Track,
    "active-track": ActiveTrack,
    "needle-tracking": "trocar.tasks.scenes.vision:NeedleTracking",
    "augmented-reality": "trocar.tasks.scenes.vision:AugmentedReality",
    "visual-servoing": "trocar.tasks.scenes.vision:VisualServoing",
    "suturing": "trocar.tasks.scenes.suturing:Suturing",
    "needle-through-phantom": "trocar.tasks.scenes.suturing:NeedleThroughPhantom",
}


def make_task(scene: Scene | str | Path) -> Task:
    """Return the task of a scene, with its world, after a reset with seed 0.

    Args:
        scene: a scene, its name, or the path of its TOML file

    Raises:
        UnknownNameError: no such scene or class; the known ones are listed
        DescriptionError: a broken file
        InputError: what a package or a file has under the name is no class of tasks
    """
    found = scene if isinstance(scene, Scene) else load_scene(scene)
    return task_class(found)(found)


def task_class(found: Scene) -> type[Task]:
    """Return the class of a scene's task.

    Raises:
        UnknownNameError: no such class; the known ones are listed
        InputError: what a package or a file has under the name is no class of tasks
    """
    kind: Any
    if found.task.endswith(".py"):
        kind = run_script(found.task, "SceneTask")
    elif found.task in TASKS:
        named = TASKS[found.task]
        kind = pkgutil.resolve_name(named) if isinstance(named, str) else named
    elif found.task in registered("tasks"):
        kind = load_registered("tasks", found.task)
    else:
        raise UnknownNameError("task", found.task, (*TASKS, *registered("tasks")), found.file)
    if not isinstance(kind, type) or not issubclass(kind, Task):
        raise InputError(f"{found.file}: task: got {kind!r}; allowed: a class that extends Task")
    return kind
