"""Reach a place: the tip moves towards the goal in proportion to its distance.

Play it with `trocar play needle-reach --policy examples/policies/reach.py`, and `--headless`.
"""

import numpy as np

#: Of the environment whose observations and actions the policy has, see docs/learning-policies.md.
SETTINGS = {"obs": "goal", "action": "tip", "action_period": 0.02}
#: Ratio of the largest speed, 0.2 m/s, at a distance of 50 mm.
GAIN = 1.5


def make_policy(env):
    """Return a function from an observation to an action; called at the begin of each episode."""
    size = len(env.actions.low)  # x, y, z and rotations about them, jaw

    def act(obs):
        action = np.zeros(size)
        action[:3] = np.clip(GAIN * (obs["desired_goal"] - obs["achieved_goal"]), -1.0, 1.0)
        return action

    return act
