"""A calibrated arm beside the hardware that it is calibrated to, and beside its description."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.figures import Figure
from trocar.apps.verification.rcm import Cloud, cloud, is_general, swept_ranges
from trocar.apps.verification.subject import Ranges, Subject, sweep

Array = NDArray[np.float64]

#: How far the remote centre of an arm with general loops may be from its hardware's, and its
#: spread. Source: the project's own goal; the paper's simulation misses its hardware by 3.46 and
#: 3.91 mm. [m]
MOST_MISSED_M = 1e-3
#: Noise is told to 4 % of its RMS, whose square is 0.3 of that. Source: our own measurement, tracks
#: of 1000 to 6000 samples.
NOISE_SHARE = 0.3


def beside_hardware(subject: Subject, ranges: Ranges) -> list[Figure]:
    """Compare the remote centre of a calibrated arm with its hardware and its description.

    Args:
        subject: a calibrated arm
        ranges: over which its hardware was swept; empty: not known

    Returns:
        the spread as it was measured, and over the same ranges place and spread in the axes of
        Table 7 where the hardware's are known, and the spread as a distance; of an arm with general
        loops, bounds on what is missed
    """
    overlay = subject.arm.overlay
    found: dict[str, Any] = {} if overlay is None else overlay.measured.get("rcm", {})
    if overlay is None or not found:
        return []
    file = overlay.source.get("file", overlay.file)
    figures: list[Figure] = []
    if isinstance(rms := found.get("rms_m"), float):
        source = f"measured, noise included: {file}"
        figures.append(Figure("measured: RMS distance", rms, "m", shown="mm", source=source))
    if not ranges or subject.nominal is None:
        return figures
    motion = sweep(subject, "set", ranges)
    drawn = replace(subject, arm=subject.nominal)
    ours, nominal = cloud(subject, motion), cloud(drawn, sweep(drawn, "set", ranges))
    source = (
        f"hardware: {file}; nominal and calibrated: without servo error, over its range"
        f" ({swept_ranges(subject, motion)})"
    )
    wander, noise = found.get("wander_rms_m"), found.get("noise_rms_m")
    told = source
    if isinstance(noise, float):
        told += (
            "; of the hardware's, noise is taken off as squares, and less than"
            f" {1e3 * NOISE_SHARE * noise:.2g} mm may be noise still"
        )
    figures.append(
        Figure("as measured: RMS distance", ours.rms_distance, "m", shown="mm",
               hardware=wander if isinstance(wander, float) else None,
               nominal=nominal.rms_distance, source=told)
    )  # fmt: skip
    table: dict[str, Any] = found.get("table7", {})
    if {"position_m", "rms_xyz_m"} <= table.keys():
        place = np.array(table["position_m"], dtype=np.float64)
        square = np.array(table["rms_xyz_m"], dtype=np.float64) ** 2
        spread = np.sqrt(np.maximum(square - (noise or 0.0) ** 2 / 3.0, 0.0))
        figures += _by_axis(place, spread, nominal, ours, (source, told))
        figures += _missed(subject, place, spread, nominal, ours)
    return figures


def _by_axis(
    place: Array, spread: Array, nominal: Cloud, ours: Cloud, sources: tuple[str, str]
) -> list[Figure]:
    """State place and spread along each axis."""
    rows = (
        ("position", place, nominal.centre, ours.centre, sources[0]),
        ("RMS", spread, nominal.rms, ours.rms, sources[1]),
    )
    return [
        Figure(f"as measured: {what} {axis}", float(of_ours[index]), "m", shown="mm",
               hardware=float(hardware[index]), nominal=float(of_nominal[index]), source=source)
        for what, hardware, of_nominal, of_ours, source in rows
        for index, axis in enumerate("XYZ")
    ]  # fmt: skip


def _missed(
    subject: Subject, place: Array, spread: Array, nominal: Cloud, ours: Cloud
) -> list[Figure]:
    """State by how much the hardware is missed, with a bound where the loops are general."""
    most = MOST_MISSED_M if is_general(subject) else None
    limit = "; limit: the project's own goal" if most else ""
    rows = (
        ("distance from the hardware's", place, nominal.centre, ours.centre, "of the centres"),
        ("spread missed", spread, nominal.rms, ours.rms,
         "root of the sum of squares of the differences along the three axes"),
    )  # fmt: skip
    return [
        Figure(
            f"as measured: {what}",
            float(np.linalg.norm(of_ours - hardware)),
            "m",
            shown="mm",
            upper=most,
            nominal=float(np.linalg.norm(of_nominal - hardware)),
            source=f"ours: {how}{limit}",
        )
        for what, hardware, of_nominal, of_ours, how in rows
    ]
