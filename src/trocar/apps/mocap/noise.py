"""What cameras do to poses: noise, bursts in which a body is lost, and gross errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.mocap.clusters import random_rotations
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_rotation_vector

Array = NDArray[np.float64]

#: A body is lost for this many samples on average, and a gross error is this far off.
#: Source: our own choice; 20 mm is a marker taken for its neighbour. [samples, m]
BURST_SAMPLES, OUTLIER_M = 12, 0.020


@dataclass(frozen=True)
class Noise:
    """How bad the cameras are.

    Attributes:
        position: standard deviation along each axis [m]
        rotation: standard deviation about each axis [rad]
        dropout: share of samples in which a body is lost, in bursts
        outliers: share of samples that are 20 mm off and turned anyhow
    """

    position: float = 0.0
    rotation: float = 0.0
    dropout: float = 0.0
    outliers: float = 0.0

    def __post_init__(self) -> None:
        for name, most in (("position", 1.0), ("rotation", 1.0), ("dropout", 0.9),
                           ("outliers", 0.5)):  # fmt: skip
            got = getattr(self, name)
            if not 0.0 <= got <= most:
                raise InputError(f"noise, {name}: got {got!r}; allowed: 0 to {most:g}")


def spoil(poses: Array, noise: Noise, rng: np.random.Generator) -> Array:
    """Return one body's poses as cameras tell them, NaN where it is lost, (n, 4, 4).

    As many random numbers are drawn whatever the noise is, so that each kind can be had alone.
    """
    count = len(poses)
    shift, turn = rng.normal(size=(count, 3)), rng.normal(size=(count, 3))
    way, anyhow = rng.normal(size=(count, 3)), random_rotations(rng, count)
    wrong = rng.uniform(size=count) < noise.outliers
    lost = _bursts(rng.uniform(size=count), noise.dropout)
    found = poses.copy()
    found[:, :3, 3] += noise.position * shift
    found[:, :3, :3] = found[:, :3, :3] @ matrix_from_rotation_vector(noise.rotation * turn)
    way *= OUTLIER_M / np.linalg.norm(way, axis=1, keepdims=True)
    found[wrong, :3, 3] += way[wrong]
    found[wrong, :3, :3] = anyhow[wrong]
    found[lost] = np.nan
    return found


def _bursts(chances: Array, share: float) -> NDArray[np.bool_]:
    """Tell which samples are lost: two states that change by chance, (n,)."""
    end = 1.0 / BURST_SAMPLES
    begin = share * end / (1.0 - share)
    lost = np.zeros(len(chances), dtype=bool)
    state = bool(chances[0] < share)
    for index, chance in enumerate(chances[1:].tolist(), 1):
        lost[index - 1] = state
        state = chance >= end if state else chance < begin
    lost[-1] = state
    return lost
