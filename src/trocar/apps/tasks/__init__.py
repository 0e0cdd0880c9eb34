"""Scenes as tasks: episodes, scripted policies and scores."""

from trocar.apps.task import Episode, Task
from trocar.apps.tasks.play import play, run_episode
from trocar.apps.tasks.registry import TASKS, make_task

__all__ = ["TASKS", "Episode", "Task", "make_task", "play", "run_episode"]
