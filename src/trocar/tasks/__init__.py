"""Scenes as tasks: episodes, scripted policies and scores."""

from trocar.tasks.play import play, run_episode
from trocar.tasks.referee import Ending
from trocar.tasks.registry import make_task, scene_with, task_names
from trocar.tasks.task import Episode, Task

__all__ = [
    "Ending",
    "Episode",
    "Task",
    "make_task",
    "play",
    "run_episode",
    "scene_with",
    "task_names",
]
