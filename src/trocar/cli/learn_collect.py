"""Collect episodes of a training scene as a dataset of LeRobot's, v3.0.

Each episode follows from the scene, its seed and the options, on any number of workers. Episodes
that end without success are left out. Ctrl-C ends the dataset after the last whole episode. Beside
the data are a card (README.md, card.toml) and, with --mcap, recordings that trocar replay repeats.
Needs the extra learn, and video for images. See docs/learning-data.md.
"""

from __future__ import annotations

import re
import shlex
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path

from trocar.cli.arguments import add_json, add_overwrite, allow, options
from trocar.cli.learn_train import add_drawn, drawn
from trocar.cli.output import print_result, progress_bar
from trocar.cli.worlds import script_of
from trocar.descriptions.catalogue import load_scene
from trocar.errors import InputError

SUMMARY = "collect episodes of a scene as a LeRobot dataset"
ORDER = 16

#: Options that a card leaves out: the data do not depend on them.
HOW = ("output", "overwrite", "json", "workers", "cluster")


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        scene SCENE              built-in scene (see trocar list scenes) or TOML file
        -o,--output DIR required  new or empty folder of the dataset
        --episodes N:int = 100   episodes to run, with the seeds that follow
        --seed N:int = 0         seed of the first episode
        --policy POLICY = scripted
                                 scripted: the scene's own policy; FILE: a policy of one's own (see
                                 trocar play); for episodes of a person see trocar learn export
        --trust                  of --policy FILE.zip: unpickle it, which can run any code
        --noise X:number = 0     noise that is added to the policy's velocities, as a ratio of the
                                 largest; the dataset keeps the policy's own actions
        --mcap                   also record each episode as MCAP
        --keep-failures          also keep episodes that end without success
        --workers N:int = 1      processes that episodes run on
        --cluster ADDRESS        run the episodes on the Ray cluster at HOST:PORT, or on a local one
                                 of --workers processes: local (extra cluster)
    """)  # fmt: skip
    parser.add_argument(
        "--images",
        metavar="WxH",
        nargs="?",
        type=_size,
        const=(84, 84),
        help="also keep the endoscope's left images, as video (default size: 84x84)",
    )
    add_drawn(parser)
    add_overwrite(parser, "existing files in DIR")
    add_json(parser)


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if found is None:
        raise ArgumentTypeError(f"got {text!r}; allowed: WIDTHxHEIGHT, e.g. 84x84")
    return int(found[1]), int(found[2])


def run(args: Namespace) -> int:
    """Collect and print the counts."""
    for name, least in (("episodes", 1), ("seed", 0), ("workers", 1)):
        if (value := getattr(args, name)) < least:
            raise InputError(f"--{name}: got {value}; allowed: {least} or more")
    if args.policy == "teleop":
        raise InputError(
            f"--policy: got teleop; record with `trocar play {args.scene} --policy none --record"
            " FILE`, then `trocar learn export FILE -o DIR`; allowed: scripted, or a policy file"
        )
    if Path(args.policy).suffix.lower() != ".zip":
        allow(args, "with --policy FILE.zip", "trust")
    if args.cluster not in (None, "local"):
        allow(args, "without --cluster HOST:PORT", "workers")
    from trocar.learning.collecting import Collection, collect

    scene = drawn(args, load_scene(args.scene))
    script, name = script_of(args.policy, scene, args.trust)
    collection = Collection(scene, script, name, args.noise, args.images, args.mcap)
    seeds = range(args.seed, args.seed + args.episodes)
    with progress_bar("episodes") as draw:
        found = collect(
            collection,
            seeds,
            args.output,
            workers=args.workers,
            cluster=args.cluster or "",
            keep_failures=args.keep_failures,
            overwrite=args.overwrite,
            command=_command(args),
            watch=lambda count: draw(count, len(seeds)),
        )
    successes = sum(one.success for one in found.episodes)
    document = {
        "folder": args.output,
        "successes": successes,
        "kept": found.kept,
        "frames": found.frames,
        "episodes": found.episodes,
    }
    print_result(
        args,
        document,
        lambda: (
            f"{args.scene}: {successes} of {len(found.episodes)} successful; {found.kept} episodes,"
            f" {found.frames} frames in {args.output}"
        ),
    )
    return 0


def _command(args: Namespace) -> str:
    """Return the command that makes the same data."""
    words = ["trocar", "learn", "collect", str(args.scene)]
    for name, option in args.given.items():
        if name in HOW:
            continue
        words.append(option)
        if name == "images":
            words.append("{}x{}".format(*args.images))
        elif not isinstance(value := getattr(args, name), bool):
            words.append(str(value))
    return shlex.join([*words, "-o", "DIR"])
