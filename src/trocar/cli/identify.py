"""Identify an arm's dynamics from logs of positions, velocities and efforts.

Masses, centres of mass and inertias of the closed-loop mechanism, friction with pre-sliding
hysteresis, rotors, springs and cables are fitted by convex optimisation, such that every body is
physically possible. The output is an overlay for --dynamics. LOG is a recording with efforts as for
`trocar replay`, or a recording of a simulation. See docs/dynamics.md and docs/recordings.md.
"""

from __future__ import annotations

import math
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from trocar.cli.arguments import add_json, add_overwrite, options
from trocar.cli.output import print_result, progress_steps, table
from trocar.cli.reading import add_reading, allow_reading, read_settings

if TYPE_CHECKING:
    from trocar.cli.arguments import Arguments
    from trocar.robot.identification import (
        Identified,
        Log,
        LogSettings,
        Prediction,
        Score,
        Weight,
    )

SUMMARY = "identify an arm's dynamics from logs of efforts"
ORDER = 52


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        log LOG ...  logs of one arm, used together
    """)  # fmt: skip
    add_log(parser)
    options(parser, """
        --weight KG[@FRAME[:X,Y,Z]]:weight ...  known weight strapped to the arm, X,Y,Z in metres in
                                            FRAME (default: at the tip); once per LOG in their
                                            order, 0 for none
        --mass-bounds LOWER,UPPER:bounds = 0.3,3  bounds of the masses as ratios of the CAD
                                            estimates (default: 0.3,3)
        --keep JOINT ...                    joint to leave as described (repeatable); joints that do
                                            not move or have no recorded efforts are, too
        --cross-validate                    also hold out each sixth of the trajectory's period in
                                            turn (first LOG)
        -o,--output OVERLAY required        overlay to write
        --report DIR                        new folder for result.json and plots of the efforts
    """, bounds=bounds, weight=weight)  # fmt: skip
    add_overwrite(parser)
    add_json(parser)


def add_log(parser: Arguments) -> None:
    """Add the arm of a log, and how to read the log."""
    options(parser, """
        --arm ARM                    built-in arm (see trocar list arms) or TOML file; with --rig,
                                     an arm of that rig (default: psm; with --rig its only one)
        --tool TOOL                  built-in tool or TOML file (default: the tool of the arm's
                                     description)
        --cutoff HZ:number           cut-off of the zero-phase filters (default: 16.96 for a PSM,
                                     5.65 for an MTM, a fifth of the rate of a slow log)
    """)  # fmt: skip
    add_standing(parser)
    add_reading(parser)


def add_standing(parser: Arguments) -> None:
    """Add how an arm stands."""
    options(parser, """
        --rig RIG            rig in which the arm stands, built-in or TOML file: it gives the
                             direction of gravity, setup joints at the pose "start"
    """)  # fmt: skip
    add_base_rpy(parser)


def add_base_rpy(parser: Arguments) -> None:
    """Add the rotation of an arm's base."""
    options(parser, """
        --base-rpy R,P,Y:angles  rotation of the arm's base in the world about its fixed axes x, y,
                             z, in degrees, as rpy_deg of a rig (default: upright, of a recording of
                             a simulation as its rig has it); write --base-rpy=-45,0,0
    """, angles=angles)  # fmt: skip


def log_settings(args: Namespace) -> LogSettings:
    """Return the settings from the options of `add_log`."""
    from trocar.robot.identification import LogSettings

    return LogSettings(args.tool, read_settings(args), args.cutoff, args.rig, args.base_rpy)


def angles(text: str) -> tuple[float, float, float]:
    """Return three angles in degrees [rad]."""
    try:
        roll, pitch, yaw = (math.radians(float(part)) for part in text.split(","))
    except ValueError:
        raise ArgumentTypeError(f"got {text!r}; allowed: R,P,Y in degrees, e.g. -45,0,0") from None
    return roll, pitch, yaw


def allow_log(args: Namespace, *files: str) -> None:
    """Reject options of `add_log` that concern logs of other kinds.

    Args:
        args: parsed arguments
        files: the logs
    """
    from trocar.robot.identification import log_kind

    allow_reading(args, {str(log_kind(file)) for file in files})


def report_read(logs: Sequence[Log]) -> None:
    """Print what was understood of logs on stderr."""
    for log in logs:
        if log.understood:
            print(log.understood, file=sys.stderr)


def weight(text: str) -> tuple[float, str, tuple[float, float, float]]:
    """Return mass, frame ("" for the tip) and point of a weight."""
    mass, _, place = text.partition("@")
    frame, _, point = place.partition(":")
    try:
        values = [float(v) for v in point.split(",")] if point else [0.0, 0.0, 0.0]
        kilograms = float(mass)
    except ValueError:
        values, kilograms = [], 0.0
    if len(values) != 3 or not 0.0 <= kilograms < 1e3 or not all(abs(v) < 1e3 for v in values):
        example = "0.105@pitch_top:0.35,0.02,0"
        raise ArgumentTypeError(f"got {text!r}; allowed: KG[@FRAME[:X,Y,Z]], e.g. {example}")
    return kilograms, frame, (values[0], values[1], values[2])


def weights(
    given: list[tuple[float, str, tuple[float, float, float]]], tip: str
) -> list[list[Weight]]:
    """Return the weights of each log; a mass of 0 means no weight."""
    from trocar.robot.identification import Weight

    return [[Weight(kg, frame or tip, point)] if kg else [] for kg, frame, point in given]


def bounds(text: str) -> tuple[float, float]:
    """Return two numbers."""
    try:
        lower, upper = (float(part) for part in text.split(","))
    except ValueError:
        raise ArgumentTypeError(f"got {text!r}; allowed: LOWER,UPPER, e.g. 0.3,3") from None
    return lower, upper


def run(args: Namespace) -> int:
    """Identify, write the overlay, and print what was found."""
    from trocar import __version__
    from trocar.descriptions.overlay import write_overlay
    from trocar.outputs import check_file, check_folder
    from trocar.robot.identification import (
        cross_validate,
        default_filters,
        filtered,
        identify,
        predict,
    )
    from trocar.robot.identification.predict import write_report

    check_file(args.output, args.overwrite)
    if args.report is not None:
        check_folder(args.report, args.overwrite)
    allow_log(args, *args.log)
    how = log_settings(args)
    standing = how.standing(args.arm)
    arm = standing.arm
    known = weights(args.weight, arm.mechanism.tip)
    strapped = known or [[] for _ in args.log]
    with progress_steps() as watch:
        read: list[Log] = []
        for file in args.log:
            watch(f"reading {file}")
            read.append(how.read(file, standing))
        filters = how.filters(default_filters(arm), min(log.rate_hz for log in read))
        logs = [filtered(log, arm, filters) for log in read]
        found = identify(logs, arm, known, args.mass_bounds, watch, args.keep)
        overlay = found.overlay(__version__)
        scored: list[Prediction] = []
        for file, own in zip(args.log, strapped, strict=True):
            watch(f"predicting {file}")
            scored.append(predict(file, args.arm, overlay, own, how))
        held_out = None
        if args.cross_validate:
            held_out = cross_validate(logs[0], arm, args.mass_bounds, watch, args.keep)
    report_read(read)
    document = _document(found, scored, held_out, args.output)
    write_overlay(args.output, overlay, overwrite=args.overwrite)
    if args.report is not None:
        write_report(args.report, document, scored, args.overwrite)
    print_result(args, document, lambda: _text(found, scored, held_out, args.output))
    return 0


def _document(
    found: Identified, scored: list[Prediction], held_out: Score | None, output: str
) -> dict[str, Any]:
    base = found.base
    return {
        "arm": found.model.arm.name,
        "overlay": output,
        "logs": scored,
        "cross_validation_percent": held_out and held_out.relative_rms_percent,
        "bodies": {
            name: {
                "mass_kg": body.mass,
                "mass_sigma_kg": body.mass_sigma,
                "mass_bounds_kg": [found.bounds[name].lower, found.bounds[name].upper],
                "com_m": body.com,
            }
            for name, body in found.dynamics.bodies.items()
        },
        "parameters": len(found.parameters),
        "base_parameters": [
            {"name": name, "value": value, "sigma": sigma}
            for name, value, sigma in zip(base.names, base.values, base.sigma, strict=True)
        ],
        "condition_number": base.condition,
        "identifiable": list(base.identifiable),
        "kept_as_described": found.kept,
    }


def _text(found: Identified, scored: list[Prediction], held_out: Score | None, output: str) -> str:
    rows = [
        [name, f"{body.mass:.3f}", f"{body.mass_sigma:.3f}", *(f"{1e3 * c:.1f}" for c in body.com)]
        for name, body in found.dynamics.bodies.items()
    ]
    base = found.base
    parts = [
        f"{found.model.arm.name}: {len(found.parameters)} parameters, {len(base.names)} base"
        f" parameters (condition number {base.condition:.3g}), {len(base.identifiable)} of them"
        f" identifiable to 10 %\n",
        table(["body", "mass [kg]", "sigma", "x [mm]", "y [mm]", "z [mm]"], rows),
        "",
        errors(scored, held_out),
        *(
            ["", *(f"kept as described: {name} ({why})" for name, why in found.kept.items())]
            if found.kept
            else []
        ),
        f"\nwritten: {output}",
    ]
    return "\n".join(parts)


def errors(scored: list[Prediction], held_out: Score | None = None) -> str:
    """Return the relative errors of predictions as a table, a column per log."""
    columns = [one.score.relative_rms_percent for one in scored]
    head = ["error [%]", *(f"log {k}" for k in range(1, len(scored) + 1))]
    if held_out is not None:
        columns, head = [*columns, held_out.relative_rms_percent], [*head, "held out"]
    rows = [
        [name, *("-" if (v := column[name]) is None else f"{v:.1f}" for column in columns)]
        for name in columns[0]
    ]
    return table(head, rows)
