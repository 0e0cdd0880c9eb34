"""The robot's bodies as parametric solids, drawn on the axes of its description."""
