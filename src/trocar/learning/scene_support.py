"""Support of scenes by batches on CPU threads, MuJoCo Warp and MJX."""

from __future__ import annotations

from dataclasses import dataclass

from trocar.descriptions.scenes import Scene
from trocar.learning.batch_rules import REPLACED, obstacle
from trocar.tasks.registry import task_class
from trocar.tasks.task import Task


@dataclass(frozen=True)
class SceneSupport:
    """Obstacles of a scene, "" without any; every scene runs in one world.

    Attributes:
        batch: in `SceneBatch`
        warp: in `WarpScene`
        mjx: as the MJX file of an export, which has the scene's bodies, joints, contacts and
            position servos, and nothing of its task
    """

    batch: str
    warp: str
    mjx: str


def scene_support(scene: Scene) -> SceneSupport:
    """Return the obstacles of a scene to each way of running it.

    Raises:
        UnknownNameError, InputError: as `task_class`
    """
    return SceneSupport(obstacle(scene), warp_obstacle(scene), _mjx_obstacle(scene))


def warp_obstacle(scene: Scene) -> str:
    """Return the obstacle of a scene to `WarpScene`, "" without any.

    Raises:
        UnknownNameError, InputError: as `task_class`
    """
    rig, kind = scene.rig, task_class(scene)
    own = [name for name in REPLACED if getattr(kind, name) is not getattr(Task, name)]
    names = {
        "soft tissue": [prop.name for prop in rig.props if prop.tissue is not None],
        "threads": [prop.name for prop in rig.objects if prop.thread],
        "objects on joints": [prop.name for prop in rig.objects if prop.joint],
        "scripts of objects": [prop.name for prop in rig.objects if prop.script],
        "arms on others": [place.name for place in rig.arms if place.on],
        "calibrated arms": [place.name for place in rig.arms if place.arm.overlay is not None],
        "goals of other arms": sorted({goal.arm for goal in scene.goals} - {"", *scene.arms}),
    }
    for what, found in names.items():
        if found:
            return f"has {what} ({', '.join(found)}); allowed on a GPU: none"
    if rig.errors is not None:
        return f"has errors of robots ({rig.errors.name}); allowed on a GPU: perfect sensors"
    if rig.dynamics != "cad":
        return f"has dynamics {rig.dynamics!r}, which need PID servos; allowed on a GPU: 'cad'"
    if kind.sees:
        return "looks at images; allowed on a GPU: tasks that read the physics"
    if own:
        return (
            f"its class {kind.__name__} has its own {', '.join(own)}; allowed on a GPU: those of"
            " Task"
        )
    return ""


def _mjx_obstacle(scene: Scene) -> str:
    """Return the obstacle of a scene to its MJX file, "" without any."""
    if tissues := [prop.name for prop in scene.rig.props if prop.tissue is not None]:
        return f"has soft tissue ({', '.join(tissues)}), which files lack"
    if scripts := [prop.name for prop in scene.rig.objects if prop.script]:
        return f"has scripts of objects ({', '.join(scripts)}), which files lack"
    return ""
