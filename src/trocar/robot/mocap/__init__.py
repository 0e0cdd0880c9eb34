"""Tracks of a simulated arm before simulated cameras, with the truth beside them."""

from trocar.robot.mocap.robots import broken, perturbed, worn
from trocar.robot.mocap.simulate import MarkerNoise, MocapSettings, SimulatedTracks, simulate_tracks
from trocar.robot.mocap.writers import check_tracks, write_tracks

__all__ = [
    "MarkerNoise",
    "MocapSettings",
    "SimulatedTracks",
    "broken",
    "check_tracks",
    "perturbed",
    "simulate_tracks",
    "worn",
    "write_tracks",
]
