"""One arm's figure: a row per joint, with position, error and effort over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.drawing import EFFORT, ERROR, MEASURED, SETPOINT, WARNING, new_figure
from trocar.apps.plotting.thin import thinned
from trocar.recording import ArmStates

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: Stretches that a curve is thinned to: more than a figure has pixels. Source: our own choice.
BINS = 1500
WIDTH_IN, ROW_IN, HEAD_IN, LONE_ROW_IN = 15.0, 1.75, 1.1, 4.0
#: Half of the least height of an axis in its unit, so that a joint at rest looks at rest.
#: Source: our own choice.
LEAST = 1e-3


@dataclass(frozen=True)
class Units:
    """Units of a joint, and what its position, error and effort are multiplied by."""

    position: str
    error: str
    effort: str
    factors: tuple[float, float, float]


REVOLUTE = Units("deg", "mrad", "N m", (180.0 / np.pi, 1e3, 1.0))
PRISMATIC = Units("mm", "mm", "N", (1e3, 1e3, 1.0))


def units_of(kind: str) -> Units:
    """Return the units of a kind of joint."""
    return PRISMATIC if kind == "prismatic" else REVOLUTE


def arm_figure(
    states: ArmStates, which: Sequence[int], title: str, warnings: Sequence[float]
) -> Figure:
    """Draw joints of one arm.

    Args:
        states: the arm over time
        which: indices of the joints
        title: above it all
        warnings: times of warnings and faults [s]

    Raises:
        MissingExtraError: matplotlib is not installed
    """
    height = HEAD_IN + (ROW_IN * len(which) if len(which) > 1 else LONE_ROW_IN)
    figure = new_figure(WIDTH_IN, height, "drawing a recording")
    figure.suptitle(title, fontsize=13, fontweight="bold")
    axes: Any = figure.subplots(len(which), 3, sharex=True, squeeze=False)
    for row, joint in zip(axes, which, strict=True):
        _draw_joint(row, states, joint, warnings)
    for axis, head in zip(
        axes[0], ("position", "error (set-point - measured)", "effort"), strict=True
    ):
        axis.set_title(head, fontsize=11)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    handles = {
        label: handle
        for axis in axes[0]
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=5, frameon=False
    )
    return figure


def _draw_joint(row: Any, states: ArmStates, joint: int, warnings: Sequence[float]) -> None:
    units = units_of(states.arm.kinds[joint])
    names = (units.position, units.error, units.effort)
    position, setpoint = states.position[:, joint], states.setpoint[:, joint]
    curves = (
        [(setpoint, SETPOINT, "set-point", 2.2), (position, MEASURED, "measured", 1.1)],
        [(setpoint - position, ERROR, "error", 1.0)],
        [(states.effort[:, joint], EFFORT, "effort", 1.0)],
    )
    for axis, drawn, unit, factor in zip(row, curves, names, units.factors, strict=True):
        for values, colour, label, width in drawn:
            axis.plot(
                *thinned(states.time, factor * values, BINS),
                color=colour,
                linewidth=width,
                label=label,
            )
        for index, time in enumerate(warnings):
            label = "warning or fault" if index == 0 else None
            axis.axvline(time, color=WARNING, linewidth=0.8, linestyle="--", label=label)
        axis.set_ylabel(f"[{unit}]")
        axis.grid(visible=True, color="#dddddd", linewidth=0.6)
        axis.margins(x=0.0)
        axis.ticklabel_format(axis="y", useOffset=False)
        _widen(axis)
    row[0].set_ylabel(f"{states.arm.joints[joint]}\n[{units.position}]", fontweight="bold")


def _widen(axis: Any) -> None:
    """Give an axis a least height: what is far below any meaning shall not fill it."""
    low, high = axis.get_ylim()
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if np.isfinite(half) and half < LEAST:
        axis.set_ylim(middle - LEAST, middle + LEAST)
