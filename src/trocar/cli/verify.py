"""Reproduce the experiments of the closed-loop paper in simulation, and compare the figures.

Each figure stands beside the paper's. Exit status 1: a figure is out of tolerance. See
docs/calibration.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from typing import TYPE_CHECKING, Any

from trocar.cli.arguments import add_json, add_overwrite, allow_overwrite, options
from trocar.cli.output import print_result, progress_steps, table
from trocar.outputs import document
from trocar.robot.experiments import VERIFIED, listed, names_of

if TYPE_CHECKING:
    from trocar.robot.verification import Verification
    from trocar.robot.verification.figures import ReportPart

SUMMARY = "reproduce the experiments of the closed-loop paper"
ORDER = 190

PARTS = names_of(VERIFIED)


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, f"""
        --only PART,...:parts = {','.join(PARTS)}
                                         run only these parts (default: all). {listed(VERIFIED)}
        --arm ARM ...                    built-in arm or TOML file (repeatable; default: the
                                         calibrated arms, else psm and ecm)
        --calibration OVERLAY.toml ...   verify this calibrated robot (repeatable)
        --report DIR                     write an HTML report to DIR/index.html
    """, parts=_parts)  # fmt: skip
    add_overwrite(parser, "an existing report")
    add_json(parser)


def run(args: Namespace) -> int:
    """Verify, print, and return 1 if a figure is out of tolerance."""
    from trocar.robot.verification import check_report, verify, write_report

    allow_overwrite(args, "report")
    if args.report is not None:
        check_report(args.report, args.overwrite)
    written = None
    robots = len(args.arm) or len(args.calibration) or 2
    with progress_steps("verifying", robots * len(args.only)) as watch:
        found = verify(args.arm, args.calibration, args.only, watch)
        if args.report is not None:
            watch("the report")
            written = write_report(args.report, found, overwrite=args.overwrite)
    page = "" if written is None else f"\n\n{written}"
    print_result(args, _document(found, written), lambda: _tables(found) + page)
    return 1 if found.missed else 0


def _parts(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        if name not in PARTS:
            raise ArgumentTypeError(f"got {name!r}; allowed: {', '.join(PARTS)}")
    return names


def _document(found: Verification, report: str | None) -> dict[str, Any]:
    figures = [
        {"part": p.name, "arm": p.arm or None, **document(figure), "command": p.command}
        for p in found.parts
        for figure in p.figures
    ]
    return {
        "met": found.met,
        "judged": found.judged,
        "stated": found.stated,
        "missed": [f["name"] for f in figures if f["met"] is False],
        "figures": figures,
        "parts": [
            {"part": p.name, "arm": p.arm or None, "title": p.title, "notes": p.notes}
            for p in found.parts
        ],
        "report": report,
    }


def _tables(found: Verification) -> str:
    return "\n\n".join([*(_block(part) for part in found.parts), found.summary])


def _block(part: ReportPart) -> str:
    from trocar.robot.verification.figures import figure_rows

    heading = f"{part.arm}: {part.title}" if part.arm else part.title
    if part.figures:
        return f"{heading}\n{table(*figure_rows(part.figures))}"
    return "\n".join([heading, *(f"  {note}" for note in part.notes)])
