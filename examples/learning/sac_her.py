"""Train a policy for needle-reach with SAC and HER of Stable-Baselines3, then try it.

    pip install 'trocar[learn]'
    python examples/learning/sac_her.py [STEPS]

One sees: how many of ten episodes succeed, of seeds that were not trained on. It takes minutes with
3,000 steps; the default of 300 shows that it runs.
"""

import sys

import gymnasium
from stable_baselines3 import SAC, HerReplayBuffer

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 300

env = gymnasium.make(
    "trocar/NeedleReach-v0", obs="goal", action="surrol", action_period=0.2, max_steps=20
)
model = SAC(
    "MultiInputPolicy",
    env,
    replay_buffer_class=HerReplayBuffer,
    replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
    learning_starts=100,
    gamma=0.95,
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
