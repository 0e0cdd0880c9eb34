"""The gallery of the web viewer: its cards, and the world of a choice."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.tasks.served import ServedTask
    from trocar.viewer import Card, Choice, Gallery, SceneControls


def gallery(running: str) -> Gallery:
    """Return the gallery of all scenes and rigs.

    Args:
        running: name of the rig or scene that is served
    """
    from trocar.descriptions import names
    from trocar.viewer import Card, Choice, Gallery

    def cards() -> list[Card]:
        scenes = [
            Card(Choice("scene", name), _title("scenes", name), figures_of(name))
            for name in names("scenes")
        ]
        return scenes + [Card(Choice("rig", n), _title("rigs", n)) for n in names("rigs")]

    return Gallery(cards, running)


def figures_of(scene: str) -> str:
    """Return difficulty and success of a scene in a few words, "" for one of the user's own."""
    from trocar.viewer.gallery import PICTURES

    figures: dict[str, dict[str, Any]] = tomllib.loads(
        PICTURES.joinpath("figures.toml").read_text(encoding="utf-8")
    )
    found = figures.get(scene, {})
    words = [found["difficulty"]] if found else []
    if "success" in found:
        met, of = found["success"]
        words.append(f"scripted policy {met} of {of}, {found['time_s']:.1f} s")
    return "; ".join(words)


def load(choice: Choice) -> tuple[World, ServedTask | None]:
    """Return the world of a choice, and the task of a scene, with its own policy if it has one.

    Raises:
        TrocarError: its file is broken
    """
    from trocar.descriptions.catalogue import load_scene

    if choice.kind == "rig":
        from trocar.simulation import World

        return World(choice.name), None
    from trocar.tasks import Task, make_task
    from trocar.tasks.play import scripted
    from trocar.tasks.served import ServedTask

    task = make_task(load_scene(choice.name))
    script = None if type(task).policy is Task.policy else scripted
    return task.world, ServedTask(task, 0, script=script)


def controls(served: ServedTask) -> SceneControls:
    """Return a served scene as the web viewer shows and drives it."""
    from trocar.viewer import SceneControls, SceneScore

    task = served.task

    def score() -> SceneScore:
        found = served.state()
        return SceneScore(**{key: found[key] for key in SceneScore.__dataclass_fields__})

    def repeat(on: bool) -> None:
        served.repeating = on

    return SceneControls(
        name=task.scene.name,
        title=task.scene.title,
        limit_s=task.scene.time_limit,
        driver=served.driver,
        arms=task.arms,
        score=score,
        take=served.take_control,
        give=served.give_back,
        begin=served.begin,
        repeat=repeat,
        repeating=lambda: served.repeating,
    )


def _title(shelf: Any, name: str) -> str:
    from trocar.descriptions.catalogue import find
    from trocar.descriptions.table import read_table

    return str(read_table(find(shelf, name)).raw("title", ""))
