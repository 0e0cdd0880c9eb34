"""The mechanism as a model: pure functions of descriptions."""
