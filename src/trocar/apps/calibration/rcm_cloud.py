"""Where the remote centre was at each pose of the arm, as in the closed-loop paper's Figure 9."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.rcm_frame import HingesAbout
from trocar.fitting import PivotFit

Array = NDArray[np.float64]

# Source: our own choice; the cloud is averaged over so many cells of each joint's sweep, of those
# that have a few samples.
_CELLS, _LEAST_IN_CELL = 6, 5


@dataclass(frozen=True, eq=False)
class CloudPoint:
    """Where the remote centre is estimated about one pose of the arm, as in the paper's Fig 9.

    Attributes:
        q: of yaw and pitch, (2,) [rad], 0 at the start or, if the arm did not stand still
            there, in the middle of the sweep
        position: mean of R tip + p in the base body, (3,) [m]
        samples: that it is the mean of
    """

    q: Array
    position: Array
    samples: int


def centre_samples(hinges: HingesAbout, fit: PivotFit) -> tuple[Array, Array]:
    """Return joint positions (k, 2) [rad] and centres (k, 3) [m] of samples that have both."""
    seen = fit.used & np.isfinite(hinges.q).all(axis=1)
    return hinges.q[seen], fit.points[seen]


def over_cells(q: Array, points: Array) -> tuple[CloudPoint, ...]:
    """Average points over cells of yaw and pitch.

    Args:
        q: of each point, (n, 2) [rad]
        points: (n, 3) [m]
    """
    if len(q) < _LEAST_IN_CELL:
        return ()
    low, width = q.min(axis=0), np.maximum(np.ptp(q, axis=0), 1e-9) / _CELLS
    cells = np.minimum((q - low) // width, _CELLS - 1).astype(int)
    number = cells[:, 0] * _CELLS + cells[:, 1]
    return tuple(
        CloudPoint(q[inside].mean(axis=0), points[inside].mean(axis=0), int(inside.sum()))
        for inside in (number == cell for cell in np.unique(number))
        if inside.sum() >= _LEAST_IN_CELL
    )
