"""Measure what is not a part of `trocar bench`, each figure beside its goal.

python -m benchmarks attack --help: attack a simulator and count what fails.
python -m benchmarks against --help: speed of an older commit and of this tree, in turn.
python -m benchmarks first-tip --help: seconds from a clone to a tip dragged in the web viewer.
python -m benchmarks genuine --help: answers beside those of the dVRK's own software.
"""

from __future__ import annotations

import os
import sys
from argparse import ArgumentTypeError, Namespace
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.experiments import EXPERIMENTS, PRESETS, STYLES
from trocar.cli.arguments import Parser, add_json, options
from trocar.cli.output import print_result, table
from trocar.errors import InputError, TrocarError
from trocar.robot.experiments import Experiment, chosen, names_of
from trocar.robot.verification.figures import figure_rows

NAMES = names_of(EXPERIMENTS)
PARTS = tuple(e.part for e in EXPERIMENTS if e.part)
PARTED = ", ".join(names_of(e for e in EXPERIMENTS if e.part))
TRANSPORTS = ("websocket", "ros1", "ros2")


def main(words: Sequence[str] | None = None) -> int:
    """Run benchmarks, print their figures, and return the exit status."""
    words = sys.argv[1:] if words is None else words
    if words[:1] == ["attack"]:
        from benchmarks.attack.__main__ import main as attack

        return attack(words[1:])
    if words[:1] == ["genuine"]:
        from benchmarks.genuine.__main__ import main as genuine

        return genuine(words[1:])
    if words[:1] == ["first-tip"]:
        from benchmarks.first_tip import main as first_tip

        return first_tip(words[1:])
    if words[:1] == ["against"]:
        from benchmarks.against import main as against

        return against(words[1:])
    try:
        args, experiments = parse(words)
        given = vars(args)
        found = [figure for each in experiments for figure in each.measure(given, watch)]
    except TrocarError as error:
        print(f"benchmarks: error: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1
    print_result(args, {"figures": found}, lambda: table(*figure_rows(found)))
    return 0


def parse(words: Sequence[str]) -> tuple[Namespace, list[Experiment]]:
    """Read a command line.

    Returns:
        its options, and the experiments to run

    Raises:
        InputError: an unknown name, a value out of range, or an option of none of the experiments
    """
    rows = [[e.name, e.part, e.title, e.extra] for e in EXPERIMENTS]
    listed = table(["NAME", "--only", "", "extra"], rows)
    parser = Parser(
        prog="benchmarks",
        usage="python -m benchmarks NAME [NAME ...] [options]",
        description=f"{__doc__}\n{listed}",
    )
    options(parser, f"""
        name NAME:name ...        {', '.join(NAMES)}
        --duration S:duration     {of('duration')}: time of each pass, subscription or episode
                                  (default: 4; interface: 10; bilateral: 60; soak: 3600;
                                  random-actions: 2)
        --passes N:count          {of('passes')}: number of passes (default: 31)
        --seeds N:seeds           {of('seeds')}: robots or trials (default: 20; assistance: 50)
        --only {'|'.join(PARTS)}  {PARTED}: this part (default: all; held is a part of needle)
        --short                   {of('short')}: judge by few seeds
        --style {'|'.join(STYLES)}    {of('style')} (needle, held): this ground (default: all)
        --first SEED:int          {of('first')} (held): the first robot (default: 0)
        --workers N:count         {of('workers')} (needle): processes (default: 1)
        --episodes N:count        {of('episodes')}: of each scene or case (default: 50;
                                  random-actions: 1000)
        --scene NAME ...          {of('scene')}: this one (repeatable; default: all)
        --case NAME ...           {of('case')}: one, noisy, four, random, ... (repeatable; default:
                                  all)
        --keep FILE:path          {of('keep')} (needle): keep episodes or runs in FILE, and do not
                                  run again those that it has
        --policy FILE:path        {of('policy')}: a policy (see trocar play) in place of the scenes'
                                  own; without --scene, on the scene that it was trained on
        --live S:duration         {of('live')}: time of the cart in real time, its page in a
                                  headless browser (default: 60)
        -o,--output PNG:path      {of('output')}: plot it
        --recordings DIR:path     {of('recordings')}: recordings of real arms (default:
                                  $TROCAR_HARDWARE_DATA)
    """, name=_name, count=_count(1), seeds=_count(2), path=Path)  # fmt: skip
    parser.add_argument("--preset", choices=PRESETS, help="vision (needle, held): this camera")
    parser.add_argument(
        "--transport",
        action="append",
        choices=TRANSPORTS,
        help="interface: transport (repeatable; default: websocket)",
    )
    parser.add_argument(
        "--no-browser",
        action="store_const",
        const="",
        help="scope: a program loads the page instead",
    )
    parser.add_argument(
        "--trust",
        action="store_const",
        const="",
        help="tasks: the archive of --policy may be unpickled, which can run any code",
    )
    add_json(parser)
    if folder := os.environ.get("TROCAR_HARDWARE_DATA"):
        parser.set_defaults(recordings=Path(folder))
    args = parser.parse_args(words)
    for option in ("style", "preset"):
        if value := getattr(args, option):
            setattr(args, option, [value])
    experiments = [
        e
        for e in chosen(EXPERIMENTS, args.name)
        if not e.part or (e.part == args.only if args.only else e.usual)
    ]
    parts = [e.part for e in EXPERIMENTS if e.part and e.name in args.name]
    if parts and args.only and args.only not in parts:
        got = f"{args.only} with {' and '.join(args.name)}"
        raise InputError(f"--only: got {got}; allowed: {', '.join(parts)}")
    owners = {option: of(option) for e in EXPERIMENTS for option in e.options} | {"only": PARTED}
    taken = {option for e in experiments for option in e.options}
    taken |= {"only"} if any(e.part for e in experiments) else set()
    for option in owners.keys() - taken:
        if getattr(args, option) != parser.get_default(option):
            whose = owners[option].replace(", ", " or ")
            raise InputError(f"--{option.replace('_', '-')}: allowed with {whose} only")
    plotted = [e.name for e in experiments if "output" in e.options]
    if args.output is not None and len(plotted) > 1:
        raise InputError(f"--output: got {' and '.join(plotted)}; allowed: one of them")
    return args, experiments


def of(option: str) -> str:
    """List the experiments that take an option."""
    return ", ".join(names_of(e for e in EXPERIMENTS if option in e.options))


def _name(text: str) -> str:
    if text not in NAMES:
        raise ArgumentTypeError(f"got {text!r}; allowed: {', '.join(NAMES)}")
    return text


def _count(least: int) -> Callable[[str], int]:
    """Make a converter to an integer of `least` or more."""

    def convert(text: str) -> int:
        if not text.isdecimal() or int(text) < least:
            raise ArgumentTypeError(f"got {text!r}; allowed: {least} or more")
        return int(text)

    return convert


def watch(what: str) -> None:
    """Report progress on stderr."""
    print(f"measuring {what} ...", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
