"""Classes of tasks, by the key `task` of scenes: each has its name in the attribute `task`."""
