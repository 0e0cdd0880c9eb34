"""A script for SurRoL's NeedleReach: its id, its actions of 10 mm, its goals as a dict.

It said `import gym, surrol.gym` and `gym.make("NeedleReach-v0")`, `reset` gave the observation
alone, and positions were in metres: here 50 mm are 1 (docs/learning.md).

One sees: the number of steps in which the tip comes to its goal above the needle.
"""

import gymnasium
import numpy as np

STEP = 0.2  # 10 mm

env = gymnasium.make("SurRoL/NeedleReach-v0")
for seed in range(3):
    obs, info = env.reset(seed=seed)
    reward = steps = 0
    while not info["is_success"] and steps < 50:
        way = (obs["desired_goal"] - obs["achieved_goal"]) / STEP
        action = np.zeros(5, np.float32)  # dx, dy, dz, dyaw, jaw
        action[:3] = way / max(np.abs(way).max(), 1.0)
        obs, reward, terminated, truncated, info = env.step(action)
        steps += 1
    print(f"seed {seed}: {info['ending']} after {steps} steps, the last reward {reward:g}")
env.close()
