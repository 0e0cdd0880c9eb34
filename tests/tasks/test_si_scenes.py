"""Scripted policies on arms of an Si."""

from __future__ import annotations

import pytest

from trocar.tasks import make_task, run_episode, scene_with

SLOW = [
    pytest.param(name, marks=pytest.mark.slow)
    for name in ("needle-handover", "bi-peg-transfer", "peg-board", "suturing")
]


@pytest.mark.parametrize("name", ["needle-reach", "needle-pick", *SLOW])
def test_a_scripted_policy_succeeds_on_an_si(name):
    task = make_task(scene_with(name, {"generation": "Si"}))
    for seed in (7, 11):
        episode = run_episode(task, seed)
        assert episode.success, (seed, episode.reason)
