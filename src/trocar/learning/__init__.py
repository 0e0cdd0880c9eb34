"""Train and run policies on scenes: environments, batches of worlds, datasets and baselines."""
