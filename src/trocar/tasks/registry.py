"""The class of a scene's task: one of `trocar.tasks.scenes`, a registered one, or a file's."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.plugins import load_registered, registered
from trocar.descriptions.scenes import Scene
from trocar.errors import InputError, UnknownNameError
from trocar.modeling.props import run_script
from trocar.tasks.task import Task

SCENES = Path(__file__).parent / "scenes"
#: The line of a class that names it.
NAMED = re.compile(r'^    task = "([^"]+)"$', re.MULTILINE)


@cache
def task_names() -> dict[str, str]:
    """Return the names of the package's classes of tasks, {name: module}.

    The modules are read, not imported: those of images and of suturing take a tenth of a second.
    """
    found = {Task.task: Task.__module__}
    for path in sorted(SCENES.glob("*.py")):
        module = f"{__package__}.scenes.{path.stem}"
        found |= dict.fromkeys(NAMED.findall(path.read_text(encoding="utf-8")), module)
    return found


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


def scene_with(name: str | Path, settings: Mapping[str, Any]) -> Scene:
    """Load a scene with settings, and with those that its class derives from them.

    Args:
        name: of the scene, or the path of its TOML file
        settings: {dotted path: value}, as for `load_scene`

    Raises:
        UnknownNameError, DescriptionError, InputError: as `load_scene` and `task_class`
    """
    scene = load_scene(name, settings)
    derived = task_class(scene).derived_settings(scene, load_scene(name))
    return load_scene(name, {**derived, **settings}) if derived else scene


def task_class(found: Scene) -> type[Task]:
    """Return the class of a scene's task.

    Raises:
        UnknownNameError: no such class; the known ones are listed
        InputError: what a package or a file has under the name is no class of tasks
    """
    kind: Any
    own = task_names()
    if found.task.endswith(".py"):
        kind = run_script(found.task, "SceneTask")
    elif found.task in own:
        classes = [v for v in vars(import_module(own[found.task])).values() if isinstance(v, type)]
        kind = next(one for one in classes if vars(one).get("task") == found.task)
    elif found.task in registered("tasks"):
        kind = load_registered("tasks", found.task)
    else:
        raise UnknownNameError("task", found.task, (*own, *registered("tasks")), found.file)
    if not isinstance(kind, type) or not issubclass(kind, Task):
        raise InputError(f"{found.file}: task: got {kind!r}; allowed: a class that extends Task")
    return kind
