"""Where a scene can run: one world, batches on CPU threads, MuJoCo Warp, MJX."""

from __future__ import annotations

from trocar.descriptions.scenes import Scene
from trocar.tasks.registry import task_class
from trocar.tasks.task import Task

#: Rules of an episode that a class of tasks may replace, and only `Task` computes then.
RULES = ("begin", "measure", "met", "accomplished", "reward")


def own_rules(scene: Scene) -> list[str]:
    """Return the rules of an episode that the scene's class replaces."""
    kind = task_class(scene)
    return [name for name in RULES if getattr(kind, name) is not getattr(Task, name)]


def warp_obstacles(scene: Scene) -> list[str]:
    """Return what keeps a scene from `WarpScene`, empty where nothing does."""
    rig = scene.rig
    found: list[str] = []
    if rules := own_rules(scene):
        found.append(f"its class has rules of its own ({', '.join(rules)})")
    if task_class(scene).sees:
        found.append("its task looks at images")
    if rig.dynamics != "cad":
        found.append(f"dynamics {rig.dynamics!r} need PID servos")
    if rig.errors:
        found.append("robots with errors")
    if scripted := [prop.name for prop in rig.objects if prop.script]:
        found.append(f"scripts of {', '.join(scripted)}")
    if tissues := [prop.name for prop in rig.props if prop.tissue is not None]:
        found.append(f"soft tissue ({', '.join(tissues)})")
    if threads := [prop.name for prop in rig.objects if prop.thread]:
        found.append(f"threads ({', '.join(threads)})")
    if joined := [prop.name for prop in rig.objects if prop.joint]:
        found.append(f"objects on joints ({', '.join(joined)})")
    if standing := [place.name for place in rig.arms if place.on]:
        found.append(f"arms on others ({', '.join(standing)})")
    if calibrated := [place.name for place in rig.arms if place.arm.overlay is not None]:
        found.append(f"calibrated arms ({', '.join(calibrated)})")
    return found
