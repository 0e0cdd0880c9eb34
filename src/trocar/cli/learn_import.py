"""Make recordings of a LeRobot dataset, which trocar replay replays on the arms.

Reads v3.0 and v2. The joints of arms are found by the names of numbers in meta/info.json, such as
PSM1.yaw_rad or psm1_joint_1, or chosen with --columns. Units are radians and metres, or those at
the end of a name (_deg, _mm). Then: trocar replay FILE --arm psm --topic /PSM1/measured_js. Needs
the extras learn and record. See docs/learning-data.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from trocar.cli.arguments import add_json, add_overwrite, options
from trocar.cli.output import print_result

SUMMARY = "make recordings of a LeRobot dataset"
ORDER = 18


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        dataset DATASET            folder of the dataset
        -o,--output PATH required  new or empty folder; with --episode the file (MCAP)
        --episode N:int            import this episode only (default: all)
        --columns ARM=COLUMN[A:B] ...
                                   joints of ARM, in its order: numbers A to B - 1 of COLUMN, e.g.
                                   PSM1=observation.state[0:7] (repeatable)
    """)  # fmt: skip
    add_overwrite(parser, "existing files")
    add_json(parser)


def run(args: Namespace) -> int:
    """Import and print the files."""
    from trocar.learning.recordings import import_dataset

    files = import_dataset(
        args.dataset,
        args.output,
        episode=args.episode,
        columns=args.columns,
        overwrite=args.overwrite,
    )
    print_result(args, {"files": files}, lambda: "\n".join(str(file) for file in files))
    return 0
