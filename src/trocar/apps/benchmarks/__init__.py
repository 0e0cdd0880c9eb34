"""The benchmarks of `trocar bench`: fidelity, and the cost of verbs and readings."""
