"""What a replay found, summed up as it goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ReplayMode = Literal["position", "effort"]


@dataclass(frozen=True)
class ReplayReport:
    """How near a simulated arm came to a recorded one.

    Attributes:
        log: the recording
        arm: the description that was driven
        mode: "position" or "effort"
        samples: rows of the recording
        clipped: rows with a position beyond a joint's limit
        tracking_rms: {joint: RMS of simulated minus recorded position} [rad or m]
        effort_rms: {joint: RMS of simulated minus recorded effort} [N m or N]
        effort_relative_rms: {joint: the same divided by the recorded effort's RMS}; None for a
            joint whose recorded effort is zero throughout
    """

    log: str
    arm: str
    mode: ReplayMode
    samples: int
    clipped: int
    tracking_rms: dict[str, float]
    effort_rms: dict[str, float]
    effort_relative_rms: dict[str, float | None]

    def as_dict(self) -> dict[str, object]:
        """Return the report as plain values, for JSON."""
        return asdict(self)


@dataclass
class Sums:
    """Sums of squares over the samples so far, (n,) each; nothing else is kept of a sample."""

    joints: Sequence[str]
    count: int = 0
    position: Array = field(init=False)
    effort: Array = field(init=False)
    recorded: Array = field(init=False)

    def __post_init__(self) -> None:
        """Start from nothing."""
        self.position, self.effort, self.recorded = np.zeros((3, len(self.joints)))

    def add(self, position_error: Array, effort_error: Array, recorded_effort: Array) -> None:
        """Take in samples, (k, n) each."""
        self.count += len(position_error)
        self.position += (position_error**2).sum(axis=0)
        self.effort += (effort_error**2).sum(axis=0)
        self.recorded += (recorded_effort**2).sum(axis=0)

    def tracking_rms(self) -> dict[str, float]:
        """Return {joint: RMS of the position error}."""
        return self._named(np.sqrt(self.position / self.count))

    def effort_rms(self) -> dict[str, float]:
        """Return {joint: RMS of the effort error}."""
        return self._named(np.sqrt(self.effort / self.count))

    def effort_relative_rms(self) -> dict[str, float | None]:
        """Return {joint: effort error relative to the recorded effort}, None where that is 0."""
        pairs = zip(self.joints, self.effort, self.recorded, strict=True)
        return {name: float(np.sqrt(e / r)) if r > 0.0 else None for name, e, r in pairs}

    def _named(self, values: Array) -> dict[str, float]:
        return {name: float(value) for name, value in zip(self.joints, values, strict=True)}
