"""Compare the simulation's answers, step by step, with those of the dVRK's own software.

Plans run on the simulation, as `trocar run` runs scripts, or with --live on a ROS 1 graph. Exit
codes: 0, every step is as the robot's or differs on purpose; 1, some step differs; 2, bad input.
"""

from __future__ import annotations

import gzip
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.genuine.compare import Row, before_parting, compared
from benchmarks.genuine.plans import PLANS
from benchmarks.genuine.purpose import PURPOSE
from benchmarks.genuine.walks import WALKS
from trocar.cli.arguments import Parser, add_json, options
from trocar.cli.output import print_json, table
from trocar.errors import InputError, TrocarError

ROOT = Path(__file__).parents[2]
#: Recorded answers, one compressed JSON document for each plan.
RECORDED = ROOT / "tests" / "genuine" / "recorded"
#: Plans that the simulation runs.
SIMULATED = tuple(name for name, plan in PLANS.items() if plan.rig)
DRIVER = Path(__file__).parent / "drive.py"
MARKS = {"differs": "!", "follows": "~", "purpose": "=", "same": " "}


def main(words: Sequence[str] | None = None) -> int:
    """Run plans, print how many steps are as the robot's, and return the exit status."""
    parser = Parser(prog="python -m benchmarks genuine", description=__doc__)
    options(parser, f"""
        --plan {'|'.join(SIMULATED)} ...  run this plan (repeatable; default: all)
        --only PARTS                  these parts of the plan, such as A,C (default: all)
        -v,--verbose                  print steps that differ: ! here first, ~ follows from a step
                                      before, = on purpose
    """)  # fmt: skip
    add_json(parser)
    parser.add_argument(
        "--live",
        action="store_true",
        help="run on the ROS 1 graph of ROS_MASTER_URI instead, such as the dVRK's own software",
    )
    parser.add_argument(
        "--keep", type=Path, metavar="DIR", help="keep the answers as DIR/PLAN.json.gz"
    )
    args = parser.parse_args(words)
    try:
        found = {
            plan: rows(plan, args.only or "", live=args.live, keep=args.keep)
            for plan in args.plan or SIMULATED
        }
    except TrocarError as error:
        print(f"benchmarks: error: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1
    if args.json:
        print_json({plan: [asdict(row) for row in each] for plan, each in found.items()})
    else:
        print(report(found, args.verbose))
    return int(
        any(row.verdict in ("differs", "follows") for each in found.values() for row in each)
    )


def rows(plan: str, only: str = "", *, live: bool = False, keep: Path | None = None) -> list[Row]:
    """Run a plan and compare its record with the recorded answers."""
    got = answers(plan, only, live=live)
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        write(keep / f"{plan}.json.gz", got)
    recorded = read(RECORDED / f"{plan}.json.gz")
    if only:
        here = {step["step"] for step in got["steps"]} | set(got["facts"])
        recorded["steps"] = [step for step in recorded["steps"] if step["step"] in here]
        recorded["facts"] = {k: v for k, v in recorded["facts"].items() if k in here}
    return compared(got, recorded, PURPOSE.get(plan, {}))


def answers(plan: str, only: str = "", *, live: bool = False) -> dict[str, Any]:
    """Run a plan in a process of its own and return its record.

    Raises:
        InputError: a part that the plan does not have
        TrocarError: the process failed
    """
    for part in only.split(",") if only else ():
        if part not in PLANS[plan].parts:
            allowed = ", ".join(PLANS[plan].parts)
            raise InputError(f"--only: plan {plan}: got {part}; allowed: {allowed}")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "record.json"
        own = [plan, "-o", str(out), *(["--only", only] if only else [])]
        run = ["-m", "trocar", "run", "--rig", PLANS[plan].rig, "--speed", "max", str(DRIVER), "--"]
        command = [sys.executable, *(["-m", "benchmarks.genuine.drive"] if live else run), *own]
        path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        environment = {**os.environ, "PYTHONPATH": path}
        ended = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False
        )
        if ended.returncode != 0:
            problem = (ended.stderr or ended.stdout).strip().splitlines()[-1:]
            raise TrocarError(f"plan {plan}: exit status {ended.returncode}: {' '.join(problem)}")
        return json.loads(out.read_text())


def read(path: Path) -> dict[str, Any]:
    """Read a record."""
    return json.loads(gzip.decompress(path.read_bytes()))


def write(path: Path, record: Mapping[str, Any]) -> None:
    """Write a record; the same record makes the same bytes."""
    path.write_bytes(gzip.compress(json.dumps(record).encode(), mtime=0))


def counts(found: Sequence[Row]) -> dict[str, int]:
    """Return the number of rows of each verdict."""
    return {verdict: sum(row.verdict == verdict for row in found) for verdict in MARKS}


def report(found: Mapping[str, Sequence[Row]], verbose: bool) -> str:
    """Return counts as a table, and steps that differ above it."""
    lines = []
    for plan, each in found.items():
        for row in each if verbose else ():
            if row.differences:
                why = f" ({row.reason})" if row.reason else ""
                lines.append(
                    f"{plan} {MARKS[row.verdict]} {row.step}{why} | {'; '.join(row.differences)}"
                )
    head = [
        "plan",
        "steps",
        "as the robot's",
        "on purpose",
        "differ first",
        "follow",
        "parts after",
    ]
    body = []
    for plan, each in found.items():
        n = counts(each)
        numbers = (len(each), n["same"], n["purpose"], n["differs"], n["follows"])
        walks = before_parting(each).values() if plan in WALKS else ()
        same, count = sum(walk[0] for walk in walks), sum(walk[1] for walk in walks)
        share = f"{same} of {count} ({same / count:.0%})" if count else ""
        body.append([plan, *map(str, numbers), share])
    return "\n".join([*lines, table(head, body)])


if __name__ == "__main__":
    sys.exit(main())
