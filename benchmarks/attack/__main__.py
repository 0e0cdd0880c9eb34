"""Attack a simulator: fuzzed messages, random commands, damaged files, hostile clients, faults.

Prints what each attack tried, and each failure with the command that repeats it. Exit codes: 0,
nothing failed; 1, something failed; 2, bad input.
"""

from __future__ import annotations

import sys
import traceback
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path

from benchmarks.attack import Tally
from trocar.cli.output import print_json, table
from trocar.errors import InputError

#: Time of each attack. Source: the project's own goal for continuous integration. [s]
SECONDS = 60.0


def main(words: Sequence[str] | None = None) -> int:
    """Run attacks, print their tallies, and return the exit status."""
    names = attacks()
    parser = ArgumentParser(
        "python -m benchmarks attack",
        description=__doc__,
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--seconds", type=float, default=SECONDS, metavar="S", help="time of each attack (60)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the cases (0)")
    parser.add_argument(
        "--only", action="append", choices=names, help="one attack (repeatable; default: all)"
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=1,
        metavar="N",
        help="run N attacks at a time, but for those that measure times (1)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    args = parser.parse_args(words)
    try:
        if not 0.0 < args.seconds < float("inf"):
            raise InputError(f"--seconds: got {args.seconds:g}; allowed: above 0")
        if args.jobs < 1 or args.seed < 0:
            raise InputError("--jobs: allowed: 1 or more; --seed: allowed: 0 or more")
        tallies: dict[str, Tally] = {}
        for tally in run(args.only or names, args.seed, args.seconds, args.jobs):
            tallies[tally.name] = tally
            line = f"{tally.name}: {tally.tried} tried, {len(tally.failed)} failed"
            print(line, file=sys.stderr, flush=True)
    except InputError as error:
        print(f"benchmarks: error: {error}", file=sys.stderr)
        return 2
    found = [tallies[name] for name in names if name in tallies]
    if args.json:
        document = [{**asdict(tally), "clean": tally.clean} for tally in found]
        print_json({"seed": args.seed, "seconds": args.seconds, "attacks": document})
    else:
        print(report(found, args.seed, args.seconds))
    return int(any(tally.failed for tally in found))


def attacks() -> list[str]:
    """Return the names of all attacks: the modules of this package without an underscore."""
    files = Path(__file__).parent.glob("[!_]*.py")
    return sorted(file.stem for file in files)


def run(names: Sequence[str], seed: int, seconds: float, jobs: int) -> Iterator[Tally]:
    """Yield the tallies of attacks as they end, several at a time but for those that go alone."""
    alone = [name for name in names if is_alone(name)]
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        others = [name for name in names if name not in alone]
        pending = [pool.submit(tally_of, name, seed, seconds) for name in others]
        yield from (done.result() for done in as_completed(pending))
        for name in alone:
            yield pool.submit(tally_of, name, seed, seconds).result()


def is_alone(name: str) -> bool:
    """Return whether an attack measures times, so that nothing else may run beside it."""
    return bool(getattr(import_module(f"benchmarks.attack.{name}"), "ALONE", False))


def tally_of(name: str, seed: int, seconds: float) -> Tally:
    """Run one attack; one that breaks off has failed."""
    try:
        tally = import_module(f"benchmarks.attack.{name}").attack(seed, seconds)
    except Exception:  # noqa: BLE001  reported whole as a failure
        return Tally(name, 1, [f"the attack broke off:\n{traceback.format_exc()}"])
    tally.name = name
    return tally


def report(tallies: Sequence[Tally], seed: int, seconds: float) -> str:
    """Return tallies as tables, and each failure with the command that repeats it."""
    rows = [[t.name, str(t.tried), str(t.clean), str(len(t.failed))] for t in tallies]
    parts = [table(["attack", "tried", "clean", "failed"], rows)]
    parts += [table(tally.table[0], tally.table[1:]) for tally in tallies if tally.table]
    for tally in tallies:
        if tally.failed:
            again = f"--only {tally.name} --seed {seed} --seconds {seconds:g}"
            lines = "\n".join(f"  {line}" for line in tally.failed)
            parts.append(f"{tally.name} failed (python -m benchmarks attack {again}):\n{lines}")
    return "\n\n".join(parts)


if __name__ == "__main__":
    sys.exit(main())
