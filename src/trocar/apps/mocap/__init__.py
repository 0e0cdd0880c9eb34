"""Tracks of a simulated arm before simulated cameras, with the truth beside them."""

from trocar.apps.mocap.noise import Noise
from trocar.apps.mocap.perturb import perturbed
from trocar.apps.mocap.simulate import MocapSettings, SimulatedTracks, simulate_tracks
from trocar.apps.mocap.wear import worn
from trocar.apps.mocap.writers import write_tracks

__all__ = [
    "MocapSettings",
    "Noise",
    "SimulatedTracks",
    "perturbed",
    "simulate_tracks",
    "worn",
    "write_tracks",
]
