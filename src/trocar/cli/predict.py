"""Predict the efforts along a log by inverse dynamics, and compare them with the recorded ones.

The error of each column is the RMS of recorded minus predicted effort, relative to the RMS of the
recorded effort, both behind the same zero-phase filter, without the first and last second.
See docs/dynamics.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, add_overwrite, allow_overwrite, options
from trocar.cli.identify import add_log, allow_log, log_settings, weight, weights
from trocar.cli.output import print_result, progress_steps, table

if TYPE_CHECKING:
    from trocar.robot.identification import Prediction

SUMMARY = "predict the efforts along a log"
ORDER = 53


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        log LOG  log of one arm, as for `trocar identify`
    """)  # fmt: skip
    add_log(parser)
    options(parser, """
        --dynamics OVERLAY                  overlay of `trocar identify`, built-in (psm, mtmr), or
                                            "cad" for the masses and friction of the description
                                            (default: the built-in one of the arm, else cad)
        --weight KG[@FRAME[:X,Y,Z]]:weight ...  known weight strapped to the arm, X,Y,Z in metres in
                                            FRAME (default: at the tip; repeatable)
        --samples N:int                     score the first N samples (default: all; published: 1111
                                            of a PSM, 2000 of an MTM)
        --report DIR                        new folder for result.json and a plot of the efforts
    """, weight=weight)  # fmt: skip
    add_overwrite(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    """Predict and print the errors."""
    from trocar.descriptions import load_arm
    from trocar.outputs import check_folder
    from trocar.robot.identification import predict
    from trocar.robot.identification.predict import write_report

    allow_log(args, args.log)
    allow_overwrite(args, "report")
    if args.report is not None:
        check_folder(args.report, args.overwrite)
    tip = load_arm(args.arm, args.tool).mechanism.tip
    known = [one for each in weights(args.weight, tip) for one in each]
    with progress_steps() as watch:
        watch(f"predicting {args.log}")
        found = predict(args.log, args.arm, args.dynamics, known, log_settings(args), args.samples)
    if args.report is not None:
        write_report(args.report, found, [found], args.overwrite)
    print_result(args, found, lambda: _text(found))
    return 0


def _text(found: Prediction) -> str:
    score = found.score
    rows = [
        [name, "-" if ratio is None else f"{ratio:.1f}", f"{score.rms[name]:.4g}"]
        for name, ratio in score.relative_rms_percent.items()
    ]
    return (
        f"{found.arm.name} along {found.log.log.file}, dynamics {found.dynamics}:"
        f" {len(found.effort)} samples, cut-off {found.log.settings.cutoff_hz:g} Hz\n\n"
        f"{table(['column', 'error [%]', 'RMS [N m or N]'], rows)}"
    )
