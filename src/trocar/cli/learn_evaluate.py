"""Evaluate a policy on many seeds of a scene, beside the scripted one.

Success has Wilson's 95 % interval; time is the mean of the successes. Results do not depend on the
number of workers.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trocar.cli.arguments import add_json, allow, options
from trocar.cli.learn_train import add_drawn, drawn
from trocar.cli.output import fixed, print_result, progress_bar, table
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.learning.evaluation import Evaluation

SUMMARY = "success of a policy over many seeds, with its interval"
ORDER = 18


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        scene SCENE                 built-in scene (see trocar list scenes) or TOML file
        --policy FILE|scripted ...  policy file (see trocar play), or the scene's own policy;
                                    repeatable (default: scripted, which is always measured, too)
        --trust                     allow archives of Stable-Baselines3, which can run any code
        --seeds N:int = 100         number of episodes of each policy
        --first-seed N:int = 50000  seed of the first one
        --errors PRESET             robot errors: perfect, lab or wide (default: those of
                                    --randomise, or the rig's)
        --workers N:int = 1         processes that episodes run on; results do not depend on it
        --cluster ADDRESS           run the episodes on the Ray cluster at HOST:PORT, or on a local
                                    one of --workers processes: local (extra cluster)
    """)  # fmt: skip
    add_drawn(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    """Evaluate and print."""
    limits = (("seeds", args.seeds, 1), ("first-seed", args.first_seed, 0))
    for name, value, least in (*limits, ("workers", args.workers, 1)):
        if value < least:
            raise InputError(f"--{name}: got {value}; allowed: {least} or more")
    if all(Path(name).suffix.lower() != ".zip" for name in args.policy):
        allow(args, "with --policy FILE.zip", "trust")
    if args.cluster not in (None, "local"):
        allow(args, "without --cluster HOST:PORT", "workers")
    from trocar.descriptions.catalogue import load_scene
    from trocar.learning.evaluation import summarise
    from trocar.learning.policies import PolicyFile
    from trocar.tasks import Task, play
    from trocar.tasks.play import scripted
    from trocar.tasks.registry import task_class

    scene = drawn(args, load_scene(args.scene))
    if args.errors is not None:
        scene = scene.with_errors(args.errors)
    files = [PolicyFile(name, args.trust) for name in args.policy if name != "scripted"]
    for file in files:
        file.check(scene)
    scripts: list[tuple[str, Any]] = [(file.name, file.script) for file in files]
    if task_class(scene).policy is not Task.policy or not files:
        scripts.append(("scripted", scripted))
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    found: list[Evaluation] = []
    with progress_bar("episodes") as draw:
        for k, (name, script) in enumerate(scripts):
            episodes = play(scene, seeds, args.workers, args.cluster or "", script=script)
            rows: list[Any] = []
            for episode in episodes:
                rows.append(episode)
                draw(k * len(seeds) + len(rows), len(scripts) * len(seeds))
            found.append(summarise(name, rows))
    document = {
        "scene": scene.name,
        "first_seed": args.first_seed,
        "errors": args.errors,
        "randomise": args.randomise,
        "tips": args.tips,
        "policies": found,
    }
    print_result(args, document, lambda: _report(scene.name, args, found))
    return 0


def _report(scene: str, args: Namespace, found: list[Evaluation]) -> str:
    head = ["policy", "success", "95 % interval", "time [s]", "force [N]", "largest [N]",
            "grip [N]", "drops", "path [mm]", "stalled [s]"]  # fmt: skip
    rows = [
        [
            one.policy,
            f"{one.successes} of {one.episodes}",
            " to ".join(fixed(100.0 * end, 1) for end in one.interval) + " %",
            fixed(one.time_s, 2),
            fixed(one.force_n[0], 2),
            fixed(one.force_n[1], 2),
            fixed(one.grip_n, 2),
            str(one.drops),
            fixed(1e3 * one.distance_m, 0),
            fixed(one.stalled_s, 2),
        ]
        for one in found
    ]
    errors = f", robot errors {args.errors}" if args.errors else ""
    errors += f", randomised {args.randomise}" if args.randomise else ""
    last = args.first_seed + args.seeds - 1
    lines = [f"{scene}: seeds {args.first_seed} to {last}{errors}", "", table(head, rows)]
    for one in found:
        if one.failures:
            why = "; ".join(f"{count} {reason}" for reason, count in one.failures.items())
            lines += ["", f"{one.policy}, failures: {why}"]
    return "\n".join(lines)
