"""Predict the efforts along a log by inverse dynamics, and compare them with the recorded ones.

The error of each column is the RMS of recorded minus predicted effort, relative to the RMS of the
recorded effort, both behind the same zero-phase filter, without the first and last second.
See docs/dynamics.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, add_overwrite, allow_overwrite, options
from trocar.cli.identify import (
    add_log,
    allow_log,
    log_settings,
    report_read,
    weight,
    weights,
)
from trocar.cli.output import leaning, print_result, progress_steps, table

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
        --dynamics OVERLAY                  overlay of `trocar identify`, built-in (psm, mtmr,
                                            psm_si_cad), or "cad" for the masses and friction of the
                                            description (default: the built-in one of the arm, else
                                            cad)
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
    from trocar.outputs import check_folder
    from trocar.robot.identification import predict
    from trocar.robot.identification.predict import write_report

    allow_overwrite(args, "report")
    if args.report is not None:
        check_folder(args.report, args.overwrite)
    allow_log(args, args.log)
    how = log_settings(args)
    found: list[Prediction] = []
    with progress_steps() as watch:
        for arm in _arms(args):
            watch(f"predicting {args.log}")
            tip = how.standing(arm).arm.mechanism.tip
            known = [one for each in weights(args.weight, tip) for one in each]
            found.append(predict(args.log, arm, args.dynamics, known, how, args.samples))
    report_read([one.log.log for one in found])
    document = found[0] if len(found) == 1 else {"predictions": found}
    if args.report is not None:
        write_report(args.report, document, found, args.overwrite)
    print_result(args, document, lambda: "\n\n".join(_text(one) for one in found))
    return 0


def _arms(args: Namespace) -> Sequence[str | None]:
    """Return the arms to predict: of an episode and a rig, all that both have."""
    from trocar.descriptions import load_rig
    from trocar.errors import InputError
    from trocar.robot.identification.episodes import episode_arms
    from trocar.robot.identification.logs import log_kind

    if args.rig is None or args.arm is not None or log_kind(args.log) != "episode":
        return [args.arm]
    recorded, rig = episode_arms(args.log), load_rig(args.rig)
    names = [arm.name for arm in rig.arms]
    if both := [name for name in recorded if name in names]:
        return both
    raise InputError(
        f"{args.log}: has joint states of {', '.join(recorded)}; allowed: one of the rig"
        f" {rig.name}'s {', '.join(names)}"
    )


def _text(found: Prediction) -> str:
    score = found.score
    rows = [
        [name, "-" if ratio is None else f"{ratio:.1f}", f"{score.rms[name]:.4g}"]
        for name, ratio in score.relative_rms_percent.items()
    ]
    return (
        f"{found.arm.name} along {found.log.log.file}, dynamics {found.dynamics}:"
        f" {len(found.effort)} {_kind(found)}{leaning(found.log.log.up.tolist())}\n\n"
        f"{table(['column', 'error [%]', 'RMS [N m or N]'], rows)}"
    )


def _kind(found: Prediction) -> str:
    log = found.log
    return (
        "poses at rest"
        if log.log.poses
        else f"samples at {log.log.rate_hz:.4g} Hz, cut-off {log.settings.cutoff_hz:.4g} Hz"
    )
