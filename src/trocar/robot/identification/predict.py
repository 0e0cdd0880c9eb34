"""Predict the efforts along a log, and compare them with the recorded ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.calibrated import CAD, DYNAMICS, One, as_overlay
from trocar.descriptions.overlay_records import Drivetrain, FilterSettings
from trocar.errors import InputError
from trocar.outputs import json_text, whole_folder
from trocar.plotting.drawing import EFFORT, MEASURED, SETPOINT, new_figure, png
from trocar.robot.identification.drivetrains import described_trains
from trocar.robot.identification.logs import (
    FilteredLog,
    Log,
    default_filters,
    filtered,
    read_motion,
    slowed,
)
from trocar.robot.identification.regression import Weight, loaded, predicted_efforts
from trocar.robot.identification.validation import Score, score
from trocar.robot.recordings import ReadSettings
from trocar.robot.standing import StandingArm, standing_arm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LogSettings:
    """Settings for reading a log.

    Attributes:
        tool: that was mounted; None: the default of the description
        reading: how to read it
        cutoff_hz: of the filters instead of the dynamics' own; None: these [Hz]
        rig: rig in which the arm stands, whose names of arms count then
        base_rpy: rotation of the arm's base in the world, as for `standing_arm` [rad]
    """

    tool: str | None = None
    reading: ReadSettings = field(default_factory=ReadSettings)
    cutoff_hz: float | None = None
    rig: str | Path | None = None
    base_rpy: tuple[float, float, float] | None = None

    def standing(self, arm: str | Path | None) -> StandingArm:
        """Return an arm as it stands, by the name of its description or in the rig."""
        return standing_arm(arm, self.tool, self.rig, self.base_rpy)

    def read(self, file: str | Path, standing: StandingArm) -> Log:
        """Read a log of an arm."""
        known = self.rig is not None or self.base_rpy is not None
        return read_motion(
            file,
            standing.arm,
            self.reading,
            up=standing.up if known else None,
            name=standing.name,
        )

    def filters(self, usual: FilterSettings, rate_hz: float) -> FilterSettings:
        """Return the filters with the cut-off that is set here, or that a slow log has room for."""
        if self.cutoff_hz is None:
            return slowed(usual, rate_hz)
        if not self.cutoff_hz > 0.0:
            raise InputError(f"cut-off: got {self.cutoff_hz:g} Hz; allowed: more than 0")
        return replace(usual, cutoff_hz=self.cutoff_hz)


@dataclass(frozen=True, eq=False)
class Prediction:
    """Efforts along a log, filtered, without the samples at both ends.

    Attributes:
        log: the log and its filters
        arm: whose bodies were used
        dynamics: file, name of a built-in set, or "cad"
        weights: known weights strapped to the arm
        effort, predicted: (k, n) in the log's columns [N m or N]
        score: errors over all of these samples
    """

    log: FilteredLog
    arm: ArmDescription
    dynamics: str
    weights: tuple[Weight, ...]
    effort: Array
    predicted: Array
    score: Score

    def document(self) -> dict[str, Any]:
        """Convert to the table of a JSON document."""
        return {
            "log": self.log.log.file,
            "arm": self.arm.name,
            "tool": self.arm.tool or None,
            "dynamics": self.dynamics,
            "weights": self.weights,
            "samples": len(self.effort),
            "pieces": len(self.log.log.starts),
            "understood": self.log.log.understood,
            "relative_rms_percent": self.score.relative_rms_percent,
            "rms": self.score.rms,
            "up": self.log.log.up,
            "filters": {**asdict(self.log.settings), "rate_hz": self.log.log.rate_hz},
        }


def predict(
    file: str | Path,
    arm: str | Path | None = "psm",
    dynamics: One | None = None,
    weights: Sequence[Weight] = (),
    settings: LogSettings | None = None,
    first: int | None = None,
) -> Prediction:
    """Predict the efforts along a log by inverse dynamics.

    Args:
        file: as for `read_motion`
        arm: a built-in arm, or the path of a description; with `settings.rig`, the arm's name in it
        dynamics: an overlay with dynamics or its path, the name of a built-in one, or "cad" for the
            description's; None: the built-in one of the arm, the description's without one
        weights: known weights strapped to the arm
        settings: how to read the log; the defaults when omitted
        first: samples that are scored, from the first; all of them when omitted

    Raises:
        LogError: the log
        DescriptionError, InputError: the arm, the dynamics or a setting
    """
    how = settings or LogSettings()
    standing = how.standing(arm)
    nominal = standing.arm
    chosen = dynamics
    if chosen is None:
        chosen = nominal.name if (DYNAMICS / f"{nominal.name}.toml").is_file() else CAD
    described, trains, filters, name = with_dynamics(nominal, chosen)
    log = how.read(file, standing)
    found = filtered(log, nominal, how.filters(filters, log.rate_hz))
    count = log.q.shape[1]
    efforts = predicted_efforts(loaded(described, weights), trains, found.motion)[:, :count]
    effort, predicted = found.cut(found.effort), found.smooth(efforts @ log.joint_from_column)
    if first is not None:
        if not 1 <= first <= len(effort):
            raise InputError(f"samples: got {first}; allowed: 1 to {len(effort)}")
        effort, predicted = effort[:first], predicted[:first]
    return Prediction(
        found,
        described,
        name,
        tuple(weights),
        effort,
        predicted,
        score(log.columns, effort, predicted),
    )


def with_dynamics(
    nominal: ArmDescription, dynamics: One
) -> tuple[ArmDescription, Mapping[str, Drivetrain], FilterSettings, str]:
    """Return an arm with identified bodies, its drivetrains, filters, and the name of these.

    Raises:
        InputError: an overlay for another arm, or without dynamics
    """
    if dynamics == CAD:
        return nominal, described_trains(nominal), default_filters(nominal), CAD
    overlay = as_overlay(dynamics)
    name = overlay.file or "overlay"
    if overlay.dynamics is None:
        raise InputError(f"{name}: has no dynamics; allowed: an overlay of `trocar identify`")
    described = load_arm(nominal.file, nominal.tool or "none", overlay)
    built_in = isinstance(dynamics, str) and dynamics == nominal.name
    return (
        described,
        overlay.dynamics.drivetrains,
        overlay.dynamics.filters,
        str(dynamics) if built_in else name,
    )


def plot(prediction: Prediction) -> bytes:
    """Return measured and predicted efforts of each column over time as PNG.

    Raises:
        MissingExtraError: matplotlib is not installed
    """
    columns = prediction.log.log.columns
    figure: Any = new_figure(9.0, 1.35 * len(columns) + 0.6, "drawing efforts")
    axes = figure.subplots(len(columns), 1, sharex=True)
    time = np.arange(len(prediction.effort)) / prediction.log.log.rate_hz
    for k, (ax, name) in enumerate(
        zip(cast("list[Any]", np.atleast_1d(axes)), columns, strict=True)
    ):
        measured, predicted = prediction.effort[:, k], prediction.predicted[:, k]
        ax.plot(time, measured, color=MEASURED, linewidth=0.9, label="measured")
        ax.plot(time, predicted, color=SETPOINT, linewidth=0.9, label="predicted")
        ax.plot(time, measured - predicted, color=EFFORT, linewidth=0.7, label="difference")
        unit = "N" if _slides(prediction.arm, k) else "N m"
        ratio = prediction.score.relative_rms_percent[name]
        ax.set_ylabel(f"{name}\n[{unit}]", fontsize=8)
        ax.tick_params(labelsize=7)
        ax.margins(x=0.0)
        if ratio is not None:
            ax.text(0.995, 0.95, f"{ratio:.1f} %", transform=ax.transAxes, ha="right", va="top",
                    fontsize=8)  # fmt: skip
    figure.axes[0].legend(loc="upper left", fontsize=7, ncols=3, frameon=False)
    figure.axes[-1].set_xlabel("time [s]", fontsize=8)
    return png(figure)


def write_report(
    folder: str | Path,
    result: Any,
    predictions: Sequence[Prediction],
    overwrite: bool = False,
) -> None:
    """Write result.json and a plot of each prediction into a new folder.

    Args:
        folder: the new folder
        result: what result.json has, as for `trocar.outputs.document`
        predictions: to plot, as efforts_1.png, ...
        overwrite: replace a folder that exists

    Raises:
        InputError: the folder exists or cannot be made
        MissingExtraError: matplotlib is not installed
    """
    plots = [plot(one) for one in predictions]
    with whole_folder(folder, overwrite) as part:
        (part / "result.json").write_text(json_text(result), encoding="utf-8", newline="\n")
        for number, data in enumerate(plots, 1):
            (part / f"efforts_{number}.png").write_bytes(data)


def _slides(arm: ArmDescription, column: int) -> bool:
    return arm.joints[column].kind == "prismatic"
