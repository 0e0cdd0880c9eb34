"""Measure the speed of an older tree and of this one in turn, and print both and their ratio.

COMMIT (default: the last release; before there is one, 689c4fe) is unpacked into a temporary folder
and run by this Python with these packages. Runs alternate (then, now, now, then, ...), so that
load of other programs meets both: compare ratios, which are medians of pairs. steps: physics steps
beside bare mj_step of the same model. live: a PSM at 1 kHz over the WebSocket, to a subscriber in
another process. busy: six arms and 20 objects at 220 Hz. first: time from a servo_jp to the first
measured motion. Late: by more than 2 ms. Processor time, read from /proc, is left out where there
is no such thing.

With --worst, the exit status is 1 if a ratio of times exceeds it. Percentages near zero have no
steady ratio: 10 % of late and 1 % of lost messages are taken off before. What exceeds it is
measured again with more pairs before it fails.
"""

from __future__ import annotations

import asyncio
import gc
import io
import json
import math
import os
import statistics
import subprocess
import sys
import zipfile
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import aclosing, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any, cast

from benchmarks.client import messages, stamp_ns
from benchmarks.interface import (
    ARMS,
    FAST_HZ,
    PSM1,
    RATE_HZ,
    TRANSPORTS,
    arrived,
    busy_rig,
    result,
)
from benchmarks.served import Served, served
from trocar.cli.output import print_json, table
from trocar.errors import InputError, TrocarError
from trocar.robot.verification.figures import Figure

ROOT = Path(__file__).parents[1]
#: Compared with until there is a release. Source: the speeds that the goals are relative to.
FIRST_BASE = "689c4fe"
#: Times that what exceeds --worst is measured again. Source: our own choice.
REPEATS = 2
#: Time limit of a subscription beyond its own length. [s]
PATIENCE_S = 30.0


@dataclass(frozen=True)
class Plan:
    """Lengths of the measurements.

    Attributes:
        pairs: runs of each tree
        blocks: of steps, in a run
        warm_up_s, window_s: subscription before and during the measurement [s]
        commands: of a run of `first`
        parts: measured by default
    """

    pairs: int
    blocks: int
    warm_up_s: float
    window_s: float
    commands: int
    parts: tuple[str, ...]


#: Source: seven and two minutes on two cores.
FULL = Plan(4, 15, 3.0, 8.0, 40, ("steps", "live", "busy", "first"))
SHORT = Plan(3, 9, 1.0, 2.5, 20, ("steps", "live", "busy"))


@dataclass(frozen=True)
class Quantity:
    """What is compared.

    Attributes:
        name, unit: of the display
        goal: largest value now; None: none
        goal_ratio: largest ratio of now to then; None: none
        steady: what is up to this now meets `goal_ratio`, since its ratios are not steady [unit]
        judged: whether --worst bounds the ratio
        slack: of now, taken off before the ratio is judged [unit]
    """

    name: str
    unit: str
    goal: float | None = None
    goal_ratio: float | None = None
    steady: float = 0.0
    judged: bool = False
    slack: float = 0.0


#: One kind of run of a tree; values by key of `QUANTITIES`.
Run = Mapping[str, float]
Pair = tuple[Run, Run]


@dataclass(frozen=True)
class Comparison:
    """A quantity of two trees, measured in pairs.

    Attributes:
        quantity: what is compared
        then, now: values of the older and the newer tree, paired; then: empty where it has none
    """

    quantity: Quantity
    then: tuple[float, ...]
    now: tuple[float, ...]

    @property
    def ratios(self) -> tuple[float, ...]:
        """Now over then, of each pair."""
        return self._ratios(0.0)

    def _ratios(self, slack: float) -> tuple[float, ...]:
        return tuple(
            max(now - slack, 0.0) / then if then > 0.0 else math.inf if now > slack else 1.0
            for then, now in zip(self.then, self.now, strict=False)
        )

    @property
    def ratio(self) -> float | None:
        """The median ratio; None without values of then."""
        return statistics.median(self.ratios) if self.then else None

    @property
    def met(self) -> bool | None:
        """Whether the goal is met; None without a goal, or without values of then to compare."""
        if self.quantity.goal is not None:
            return statistics.median(self.now) <= self.quantity.goal
        if self.quantity.goal_ratio is None or self.ratio is None:
            return None
        small = statistics.median(self.now) <= self.quantity.steady
        return small or self.ratio <= self.quantity.goal_ratio

    @property
    def judged_ratio(self) -> float:
        """The median ratio that --worst bounds; 0 without values of then, and where none does."""
        if not self.then or not self.quantity.judged:
            return 0.0
        return statistics.median(self._ratios(self.quantity.slack))

    def exceeds(self, worst: float) -> bool:
        """Return whether it became worse than is allowed."""
        return self.judged_ratio > worst

    def complaint(self, worst: float) -> str:
        """Return what exceeded the bound, as a sentence."""
        less = (
            f" less {_text(slack)} {self.quantity.unit}" if (slack := self.quantity.slack) else ""
        )
        return f"{self.quantity.name}{less}: ratio {self.judged_ratio:.3f}, allowed {worst:g}"

    def row(self) -> list[str]:
        """Return a row of the table that `HEAD` is the head of."""
        quantity = self.quantity
        goal = "" if quantity.goal is None else f"<= {_text(quantity.goal)}"
        if quantity.goal_ratio is not None:
            goal = f"<= {_text(quantity.goal_ratio)} x"
            goal += f" or {_text(quantity.steady)}" if quantity.steady else ""
        return [
            quantity.name,
            _text(statistics.median(self.then)) if self.then else "-",
            _text(statistics.median(self.now)),
            quantity.unit,
            "-" if self.ratio is None else f"{self.ratio:.3f}",
            f"{min(self.ratios):.2f} to {max(self.ratios):.2f}" if self.then else "",
            goal,
            {None: "", True: "met", False: "MISSED"}[self.met],
        ]

    def document(self) -> dict[str, Any]:
        """Return the comparison as it stands in the JSON document."""
        return {
            **asdict(self.quantity),
            "then": statistics.median(self.then) if self.then else None,
            "now": statistics.median(self.now),
            "ratio": self.ratio,
            "ratios": self.ratios,
            "met": self.met,
        }


HEAD = ["figure", "then", "now", "unit", "ratio", "of pairs", "goal", ""]


def _text(value: float) -> str:
    return Figure("", value, "").text(value)


@dataclass(frozen=True)
class Case:
    """Steps of a rig.

    Attributes:
        name: of `steps`, RIG or RIG:DYNAMICS
        title: of the display
        count: steps of a block, about 25 ms
        single, many: goals of step(1) and step(20) over bare `mj_step`; single: None: not shown
    """

    name: str
    title: str
    count: int
    single: float | None
    many: float


#: Source of goals: the project's own.
CASES = (
    Case("psm", "PSM", 2000, 1.25, 1.15),
    Case("psm:cad", "PSM, dynamics cad", 2000, None, 1.06),
    Case("full_cart", "full cart", 400, 1.12, 1.07),
)


def _of_steps() -> dict[str, Quantity]:
    found: dict[str, Quantity] = {}
    for case in CASES:
        name, title = case.name, case.title
        if case.single is not None:
            found[f"{name} us"] = Quantity(f"{title}: step(1)", "us")
            found[f"{name} single"] = Quantity(
                f"{title}: step(1) over mj_step", "", case.single, judged=True
            )
        found[f"{name} many"] = Quantity(
            f"{title}: a step of step(20) over mj_step", "", case.many, judged=True
        )
    return found


def _of_subscriptions(title: str, late: Mapping[str, float]) -> dict[str, Quantity]:
    late_name, lost_name = f"{title}: late by more than 2 ms", f"{title}: lost"
    return {
        "processor": Quantity(f"{title}: processor time", "s", goal_ratio=0.9, judged=True),
        "late": Quantity(late_name, "%", **late, judged=True, slack=10.0),
        "lost": Quantity(lost_name, "%", 0.0, judged=True, slack=1.0),
    }


QUANTITIES = {
    "steps": _of_steps(),
    "live": _of_subscriptions("PSM at 1 kHz", {"goal": 3.0}),
    # One sample that the machine holds up is 0.06 % of a window.
    "busy": _of_subscriptions("6 arms, 20 objects at 220 Hz", {"goal_ratio": 1.0, "steady": 0.5}),
    "first": {
        "first": Quantity("servo_jp to first measured motion", "ms", goal_ratio=1.0, judged=True)
    },
}


def environment(tree: Path) -> dict[str, str]:
    """Return the variables of a process that runs the package of a tree."""
    others = filter(None, [os.environ.get("PYTHONPATH")])
    path = os.pathsep.join([str(tree / "src"), *others])
    return {"PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"}


@contextmanager
def unpacked(commit: str, root: Path = ROOT) -> Iterator[Path]:
    """Unpack the package of a commit into a folder that is removed when the block ends.

    Raises:
        InputError: this clone has no such commit, or the commit no package
    """
    words = ["git", "archive", "--format=zip", "--", f"{commit}^{{commit}}", "src/trocar"]
    try:
        packed = subprocess.run(words, cwd=root, capture_output=True, check=False)
    except FileNotFoundError:
        raise InputError("against: git is not installed; allowed: with git, in a clone") from None
    if packed.returncode != 0:
        raise InputError(
            f"against: got {commit!r}: {packed.stderr.decode(errors='replace').strip()}; allowed:"
            " a commit, tag or branch of this clone that has src/trocar (a shallow clone has few:"
            " git fetch --unshallow)"
        )
    with TemporaryDirectory(prefix="trocar-against-") as folder:
        zipfile.ZipFile(io.BytesIO(packed.stdout)).extractall(folder)
        yield Path(folder)


def last_release(root: Path = ROOT) -> str:
    """Return the newest tag before this tree, or `FIRST_BASE`."""
    words = ["git", "describe", "--tags", "--abbrev=0"]
    try:
        done = subprocess.run(words, cwd=root, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return FIRST_BASE
    return done.stdout.strip() if done.returncode == 0 else FIRST_BASE


class Stepper:
    """A process that measures steps of a tree when it is asked (`steps`)."""

    def __init__(self, process: subprocess.Popen[str], tree: Path) -> None:
        self._process = process
        ready = self._line()
        self.cases: list[str] = ready["cases"]
        if not Path(ready["package"]).is_relative_to(tree):
            raise TrocarError(f"steps: {ready['package']} was measured instead of {tree}")

    def measure(self, case: Case) -> list[float]:
        """Return times of step(1), `mj_step`, and a step in step(20) [us]."""
        stdin = cast(IO[str], self._process.stdin)
        stdin.write(f"{case.name} {case.count}\n")
        stdin.flush()
        return self._line()

    def _line(self) -> Any:
        line = cast(IO[str], self._process.stdout).readline()
        if not line:
            raise TrocarError(f"steps: the process ended with exit code {self._process.wait()}")
        return json.loads(line)


@contextmanager
def stepper(tree: Path) -> Iterator[Stepper]:
    """Run `steps` with the package of a tree until the block ends."""
    program = str(Path(__file__).with_name("steps.py"))
    with subprocess.Popen(
        [sys.executable, "-P", program, *(case.name for case in CASES)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment(tree)},
    ) as process:
        try:
            yield Stepper(process, tree)
        finally:
            process.kill()


def steps(first: Path, second: Path, plan: Plan) -> Pair:
    """Compare steps of two trees, whose blocks alternate."""
    with stepper(first) as a, stepper(second) as b:
        both: tuple[dict[str, float], dict[str, float]] = {}, {}
        for case in CASES:
            blocks: tuple[list[list[float]], list[list[float]]] = [], []
            for k in range(plan.blocks):
                for which in (0, 1) if k % 2 == 0 else (1, 0):
                    if case.name in (a, b)[which].cases:
                        blocks[which].append((a, b)[which].measure(case))
            for run, found in zip(both, blocks, strict=True):
                if found:
                    run[f"{case.name} us"] = statistics.median(one for one, _, _ in found)
                    run[f"{case.name} single"] = statistics.median(s / bare for s, bare, _ in found)
                    run[f"{case.name} many"] = statistics.median(m / bare for _, bare, m in found)
    return both


async def received(
    server: Served, topics: Sequence[str], plan: Plan
) -> tuple[dict[str, list[tuple[int, int]]], float]:
    """Subscribe, and return stamps and arrivals [ns] of a window, and the server's processor time.

    Messages are parsed after the window.
    """
    noted: list[tuple[str, str, int]] = []
    begin, end, before = 0, 0, 0.0
    async with (
        asyncio.timeout(plan.warm_up_s + plan.window_s + PATIENCE_S),
        aclosing(messages(server.address, [f"/{topic}" for topic in topics])) as stream,
    ):
        async for message in stream:
            now = message[2]
            if not begin:
                begin = now + round(1e9 * plan.warm_up_s)
                end = begin + round(1e9 * plan.window_s)
            if now < begin:
                continue
            if not noted:
                before = server.processor_s()
            elif now > end:
                break
            noted.append(message)
        used = server.processor_s() - before
    heard: dict[str, list[tuple[int, int]]] = {topic: [] for topic in topics}
    for topic, text, came in noted:
        heard[topic.removeprefix("/")].append((stamp_ns(text), came))
    return heard, used


def subscribed(tree: Path, plan: Plan, rig: str, rate_hz: float, topics: Sequence[str]) -> Run:
    """Serve a rig, subscribe to its topics, and return processor time, late and lost messages.

    A simulator that is late or skips does less: the time is that of all states of the window.
    """
    words = ["--rig", rig, "--rate", f"{rate_hz:g}", "--websocket-port", "0", "--no-page"]
    with served(words, r"ws://\S+", environment(tree)) as server:
        gc.collect()
        gc.disable()  # a collection over what was noted would delay the subscriber
        try:
            heard, used = asyncio.run(received(server, topics, plan))
        except TimeoutError:
            raise TrocarError(f"{tree}: {rig} published nothing for {PATIENCE_S:g} s") from None
        finally:
            gc.enable()
    seen = arrived(heard, rate_hz)
    run = {"late": seen.late_percent, "lost": 100.0 * seen.lost / (seen.received + seen.lost)}
    if used > 0.0:
        run["processor"] = used * len(topics) * rate_hz * plan.window_s / seen.received
    return run


def live(tree: Path, plan: Plan) -> Run:
    """Measure a PSM at 1 kHz."""
    return subscribed(tree, plan, "psm", FAST_HZ, PSM1)


def busy(tree: Path, plan: Plan) -> Run:
    """Measure six arms beside 20 objects at 220 Hz."""
    data = next((tree / "src").rglob("rigs/full_cart_mtm.toml")).parents[1]
    with TemporaryDirectory() as folder:
        return subscribed(tree, plan, busy_rig(folder, data), RATE_HZ, ARMS)


def first_motion(tree: Path, plan: Plan) -> Run:
    """Measure the time from a servo_jp to the first measured_js that shows motion, at 1 kHz."""
    words = ["--rig", "psm", "--rate", f"{FAST_HZ:g}", "--websocket-port", "0", "--no-page"]
    with served(words, r"ws://\S+", environment(tree)) as server:
        client = TRANSPORTS["websocket"].start("answers", server.address, str(plan.commands))
        return {"first": 1e3 * statistics.median(result(client))}


def _in_turn(run: Callable[[Path, Plan], Run]) -> Callable[[Path, Path, Plan], Pair]:
    return lambda first, second, plan: (run(first, plan), run(second, plan))


#: Measures a tree, then another one.
PARTS: Mapping[str, Callable[[Path, Path, Plan], Pair]] = {
    "steps": steps,
    "live": _in_turn(live),
    "busy": _in_turn(busy),
    "first": _in_turn(first_motion),
}


def compared(part: str, pairs: Sequence[Pair]) -> list[Comparison]:
    """Collect the quantities of a part from pairs of runs, (then, now) each."""
    return [
        Comparison(
            quantity,
            tuple(then[key] for then, _ in pairs if key in then),
            tuple(now[key] for _, now in pairs),
        )
        for key, quantity in QUANTITIES[part].items()
        if all(key in now for _, now in pairs)
    ]


def against(
    then: Path, parts: Sequence[str], plan: Plan, worst: float, watch: Callable[[str], None]
) -> list[Comparison]:
    """Compare this tree with an older one.

    Args:
        then: the older tree
        parts: of `PARTS`
        plan: lengths of the measurements
        worst: largest ratio of times; parts that exceed it are measured again
        watch: called with what is measured next

    Raises:
        TrocarError: a simulator or a client failed
    """
    found: list[Comparison] = []
    for part in parts:
        pairs: list[Pair] = []
        figures: list[Comparison] = []
        for again in range(1 + REPEATS):
            if again:
                if not any(figure.exceeds(worst) for figure in figures):
                    break
                watch(f"{part}: above the bound, again")
            for k in range(plan.pairs):
                watch(f"{part}: pair {len(pairs) + 1} of {plan.pairs * (1 + again)}")
                if k % 2 == 0:
                    old, new = PARTS[part](then, ROOT, plan)
                else:
                    new, old = PARTS[part](ROOT, then, plan)
                pairs.append((old, new))
            figures = compared(part, pairs)
        found += figures
    return found


def main(words: Sequence[str]) -> int:
    """Compare, print, and return the exit status."""
    parser = ArgumentParser(
        "python -m benchmarks against",
        description=__doc__,
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument("commit", nargs="?", metavar="COMMIT", help="commit, tag or branch")
    parser.add_argument(
        "--only",
        action="append",
        choices=tuple(PARTS),
        help="measure this part (repeatable; default: all)",
    )
    parser.add_argument(
        "--short", action="store_true", help="two minutes instead of seven, without first"
    )
    parser.add_argument("--pairs", type=int, metavar="N", help="runs of each tree (4; short: 3)")
    parser.add_argument(
        "--worst", type=float, metavar="RATIO", help="largest ratio (default: all pass)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    args = parser.parse_args(words)
    plan = SHORT if args.short else FULL
    worst = math.inf if args.worst is None else args.worst
    try:
        if args.pairs is not None:
            if args.pairs < 1:
                raise InputError(f"--pairs: got {args.pairs}; allowed: 1 or more")
            plan = replace(plan, pairs=args.pairs)
        if not worst > 0.0:
            raise InputError(f"--worst: got {worst:g}; allowed: above 0")
        commit = args.commit or last_release()
        with unpacked(commit) as then:
            found = against(then, args.only or plan.parts, plan, worst, _watch)
    except TrocarError as error:
        print(f"benchmarks: error: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1
    exceeding = [figure for figure in found if args.worst is not None and figure.exceeds(worst)]
    if args.json:
        names = [figure.quantity.name for figure in exceeding]
        print_json({"commit": commit, "worst": args.worst, "exceeded": names, "figures": found})
    else:
        print(f"then: {commit}; now: this tree; medians of pairs in turn")
        print(table(HEAD, [figure.row() for figure in found]))
    for figure in exceeding:
        print(f"against: {figure.complaint(worst)}", file=sys.stderr)
    return 1 if exceeding else 0


def _watch(what: str) -> None:
    print(f"measuring {what} ...", file=sys.stderr, flush=True)
