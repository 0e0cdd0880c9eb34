"""Train a policy for needle-reach with SAC and HER of Stable-Baselines3, then try it.

    pip install 'trocar[learn]'
    python examples/learning/sac_her.py [STEPS]

One sees: how many of ten episodes succeed, of seeds that were not trained on. 4,000 steps take a
minute of a processor and reach all ten; the default of 300 only shows that it runs.
"""

import sys

import gymnasium
import torch
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 300


class WayToGoal(BaseFeaturesExtractor):
    """The observation, and the way to the goal, which HER's other goals change with it."""

    def __init__(self, space):
        size = space["observation"].shape[0] + 2 * space["achieved_goal"].shape[0]
        super().__init__(space, size)

    def forward(self, seen):
        way = seen["desired_goal"] - seen["achieved_goal"]
        return torch.cat([seen["observation"], 5.0 * way, torch.tanh(25.0 * way)], dim=1)


torch.set_num_threads(1)
env = gymnasium.make(
    "trocar/NeedleReach-v0", obs="goal", action="surrol", action_period=0.2, max_steps=20
)
model = SAC(
    "MultiInputPolicy",
    env,
    replay_buffer_class=HerReplayBuffer,
    replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
    learning_rate=1e-3,
    learning_starts=100,
    batch_size=128,
    gamma=0.95,
    policy_kwargs={"net_arch": [64, 64], "features_extractor_class": WayToGoal},
    seed=0,
)
model.learn(STEPS)

successes = 0
for seed in range(1000, 1010):
    seen, info = env.reset(seed=seed)
    over = False
    while not over:
        action, _ = model.predict(seen, deterministic=True)
        seen, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
    successes += info["is_success"]
print(f"{STEPS} steps: {successes} of 10 episodes succeed")
env.close()
