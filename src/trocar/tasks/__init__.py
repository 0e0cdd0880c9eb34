"""Scenes as tasks: episodes, scripted policies and scores."""

from trocar.tasks.play import play, run_episode
from trocar.tasks.registry import TASKS, make_task
from trocar.tasks.task import Episode, Task

__all__ = ["TASKS", "Episode", "Task", "make_task", "play", "run_episode"]
