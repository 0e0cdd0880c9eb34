"""The model in time."""

from trocar.simulation.world import World

__all__ = ["World"]
