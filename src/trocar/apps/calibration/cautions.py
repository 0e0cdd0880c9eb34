"""What a user should know of a calibration: warnings in whole sentences."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trocar.apps.calibration.axes import Value
from trocar.apps.calibration.datum import Datum
from trocar.apps.calibration.home import Home
from trocar.apps.calibration.records import ClosureKind
from trocar.apps.calibration.refine import Refined

#: A side that differs from the closed geometry by this many standard deviations and this much is
#: worth a warning. Source: our own choice. [m]
SIGMAS, ABSORBED_M = 5.0, 1e-4
#: Axes that lean by more are worth a warning where their plane is not known. Source: our own
#: choice; over the size of a cluster of markers it makes 10 um. [rad]
SKEW_RAD = 1e-4


def home_warnings(home: Home, wanted: bool) -> tuple[str, ...]:
    """Say what a missing still start does.

    Args:
        home: as found
        wanted: whether angles at home are told of this arm
    """
    if home.still:
        return ()
    return (
        "no still start of 0.5 s, so joint position 0 is taken where the linkage looks as the"
        " description has it there" + ("; the betas are absent" if wanted else ""),
    )


def datum_warnings(datum: Datum, refined: Refined, has_centre: bool) -> tuple[str, ...]:
    """Say how much hangs on where along skew axes the datum is, where the tracks do not show it."""
    tilts = [float(np.linalg.norm(tilt)) for tilt in refined.robot.tilts.values()]
    if datum.shown or not tilts or max(tilts) < SKEW_RAD:
        return ()
    help_ = "; sweep the base's joint too" if has_centre else ""
    return (
        f"where along the axes the drawing's plane is does not show: distances are taken midway"
        f" between the clusters of the first axis' two links, and axes lean by up to"
        f" {1e3 * max(tilts):.2f} mrad, which is as many um for each mm{help_}",
    )


def rest_warnings(refined: Refined) -> tuple[str, ...]:
    """Say that the refinement has not come to rest."""
    if refined.settled:
        return ()
    return (
        f"the refinement has not come to rest after {len(refined.history) - 1} rounds, so the"
        " closed geometry is not quite the likeliest: longer or wider sweeps help",
    )


def closing_warnings(
    closure: ClosureKind,
    measured: Mapping[str, Value],
    closed: Mapping[str, float],
    refined: Refined,
    wander: float | None,
) -> tuple[str, ...]:
    """Say what the closed geometry cannot explain."""
    if closure == "general":
        if wander is not None and wander > ABSORBED_M:
            return (
                f"the remote centre of this linkage wanders by {1e3 * wander:.2f} mm (RMS): no"
                " fixed one exists",
            )
        return ()
    off = {
        label: value.value - closed[label]
        for label, value in measured.items()
        if abs(value.value - closed[label]) > max(SIGMAS * value.sigma, ABSORBED_M)
    }
    if not off:
        return ()
    sides = ", ".join(f"{label} by {1e3 * by:+.2f} mm" for label, by in off.items())
    return (
        f"the loops do not close as parallelograms: measured sides differ from the closed geometry"
        f" ({sides}), so no fixed remote centre exists; the covariance is scaled by"
        f" {refined.misfit:.3g}. --closure general keeps the sides as they are",
    )
