"""Effort prediction on recordings of real arms: held-out blocks of a trajectory, and weights."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from trocar.descriptions import load_arm
from trocar.errors import InputError
from trocar.robot.identification import (
    Weight,
    cross_validate,
    default_filters,
    filtered,
    identify,
    predict,
    read_motion,
)
from trocar.robot.verification.figures import Figure

SOURCE = (
    "goal: below the published model (Wang 2019) on an unseen trajectory, as cross-validated by six"
    " blocks of the trajectory's phase"
)
#: Goals of the cross-validated errors [%]. Source: the roadmap's acceptance criteria.
GOALS = {
    "psm": (5.0, 16.0, 17.0, 10.0, 12.0, 13.0, 13.0),
    "mtmr": (8.0, 20.0, 15.0, 13.0, 29.0, 22.0, 30.0),
}
FILES = {"psm": "psm_one_results.csv.gz", "mtmr": "mtm_one_results.csv.gz"}


@dataclass(frozen=True)
class Loaded:
    """A recording with a known weight: on the upper long link, 165 mm from its end at the shaft.

    Source: photographs in dvrk_dynamics_identification; 20 mm above the link.
    """

    file: str
    mass: float

    @property
    def weight(self) -> Weight:
        """The weight as a point mass."""
        return Weight(self.mass, "pitch_top", (0.351, 0.02, 0.0))


LOADED = (
    Loaded("psm_one_105_grams_parallel_results.csv.gz", 0.105),
    Loaded("psm_one_205_grams_parallel_results.csv.gz", 0.205),
)


def dynamics(folder: Path | None = None) -> list[Figure]:
    """Measure relative errors [%]: held out, and of recordings with a weight, nothing refitted.

    Args:
        folder: of recordings of real arms; None: nothing is measured

    Raises:
        InputError: the recordings are not there
    """
    if folder is None:
        print("dynamics: skipped, no folder of recordings is named", file=sys.stderr)
        return []
    if not folder.is_dir():
        raise InputError(
            f"dynamics: {folder} is no folder; allowed: one with the recordings"
            f" {', '.join(FILES.values())}, ..."
        )
    figures: list[Figure] = []
    for name, file in FILES.items():
        arm = load_arm(name)
        log = filtered(read_motion(folder / file, arm), arm, default_filters(arm))
        held_out = cross_validate(log, arm).relative_rms_percent
        for (column, value), goal in zip(held_out.items(), GOALS[name], strict=True):
            figures.append(
                Figure(f"{name} {column} held out", value or 0.0, "%", goal, source=SOURCE)
            )
        if name != "psm":
            continue
        overlay = identify([log], arm).overlay("benchmark")
        for one in LOADED:
            for with_weight in (False, True):
                known = [one.weight] if with_weight else []
                found = predict(folder / one.file, name, overlay, known).score
                label = f"{1e3 * one.mass:.0f} g {'in' if with_weight else 'not in'} the model"
                for column in ("yaw", "pitch"):
                    value = found.relative_rms_percent[column] or 0.0
                    figures.append(Figure(f"psm {column}, {label}", value, "%"))
    return figures
