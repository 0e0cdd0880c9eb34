"""Make a LeRobot dataset of recordings: of worlds (--record) or bags of real arms.

Rows are at even times: joints, jaws, set-points, tips, and objects where they were recorded. Each
recording is an episode; one more begins where its time goes back, as at a reset of the world, so
that a person's episodes of trocar play SCENE --policy none --record FILE are episodes here. Needs
the extras learn and bags. See docs/learning-data.md.
"""

from __future__ import annotations

import shlex
from argparse import ArgumentParser, Namespace

from trocar.cli.arguments import add_json, add_overwrite, options
from trocar.cli.output import print_result, progress_bar

SUMMARY = "make a LeRobot dataset of recordings"
ORDER = 17


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        recordings RECORDING ...  recordings of simulations (MCAP), or bags with /ARM/measured_js:
                                  rosbag 1, rosbag 2, MCAP; all of the same arms and objects
        -o,--output DIR required  new or empty folder of the dataset
        --arm ARM ...             keep this arm only (repeatable; default: all)
        --rate HZ:int = 50        rows a second
        --task TEXT               the task in words (default: name of the file)
    """)  # fmt: skip
    add_overwrite(parser, "existing files in DIR")
    add_json(parser)


def run(args: Namespace) -> int:
    """Export and print the counts."""
    from trocar.learning.exporting import export

    words = ["trocar", "learn", "export", *args.recordings, "-o", "DIR", "--rate", str(args.rate)]
    for arm in args.arm:
        words += ["--arm", arm]
    with progress_bar("recordings") as draw:
        found = export(
            args.recordings,
            args.output,
            rate_hz=args.rate,
            arms=args.arm,
            task=args.task or "",
            overwrite=args.overwrite,
            command=shlex.join(words),
            watch=lambda count: draw(count, len(args.recordings)),
        )
    print_result(
        args,
        {"folder": args.output, "episodes": found.episodes, "frames": found.frames},
        lambda: (
            f"{found.episodes} episode{'s' * (found.episodes != 1)}, {found.frames} frames of"
            f" {', '.join(found.arms)} in {args.output}"
        ),
    )
    return 0
