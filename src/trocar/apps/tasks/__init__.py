"""Scenes as tasks: episodes, scripted policies and scores."""

from trocar.apps.tasks.episode import Episode
from trocar.apps.tasks.play import play, run_episode
from trocar.apps.tasks.registry import TASKS, make_task
from trocar.apps.tasks.task import Task

__all__ = ["TASKS", "Episode", "Task", "make_task", "play", "run_episode"]
