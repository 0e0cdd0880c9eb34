"""Make recordings of a LeRobot dataset, which trocar replay replays on the arms.

Reads v3.0 and v2. The joints of arms are found by the names of numbers in meta/info.json, such as
PSM1.yaw_rad or psm1_joint_1, or chosen with --columns; where there are only poses of the tips, such
as psm1_pose.position.x, they are solved with --base. Units are radians and metres, or those at the
end of a name (_deg, _mm). Then: trocar replay FILE --arm psm --topic /PSM1/measured_js. Needs the
extras learn and record. See docs/learning-data.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, add_overwrite, options
from trocar.cli.output import print_result

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SUMMARY = "make recordings of a LeRobot dataset"
ORDER = 18

#: Largest error of a quaternion's norm. Source: our own choice; four digits give less.
NORM_TOLERANCE = 1e-3


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        dataset DATASET            folder of the dataset
        -o,--output PATH required  new or empty folder; with --episode the file (MCAP)
        --episode N:int            import this episode only (default: all)
        --columns ARM=COLUMN[A:B] ...
                                   joints of ARM, in its order: numbers A to B - 1 of COLUMN, e.g.
                                   PSM1=observation.state[0:7] (repeatable)
        --base ARM=X,Y,Z,QW,QX,QY,QZ:base ...
                                   use the poses of ARM's tip; its base in their frame [m],
                                   0,0,0,1,0,0,0 where they are in the base itself (repeatable)
    """, base=_base)  # fmt: skip
    add_overwrite(parser, "existing files")
    add_json(parser)


def _base(text: str) -> tuple[str, NDArray[np.float64]]:
    import numpy as np

    from trocar.geometry import matrix_from_quaternion, transform

    arm, _, numbers = text.partition("=")
    try:
        values = np.array([float(word) for word in numbers.split(",")])
    except ValueError:
        values = np.zeros(0)
    norm = float(np.linalg.norm(values[3:]))
    if values.shape != (7,) or not np.isfinite(values).all() or abs(norm - 1.0) > NORM_TOLERANCE:
        raise ArgumentTypeError(
            f"got {text!r}; allowed: ARM=X,Y,Z,QW,QX,QY,QZ with a unit quaternion, e.g."
            " PSM1=0,0,0,1,0,0,0"
        )
    return arm.upper(), transform(matrix_from_quaternion(values[3:] / norm), values[:3])


def run(args: Namespace) -> int:
    """Import and print the files."""
    from trocar.learning.importing import import_dataset

    files = import_dataset(
        args.dataset,
        args.output,
        episode=args.episode,
        columns=args.columns,
        bases=dict(args.base),
        overwrite=args.overwrite,
    )
    print_result(args, {"files": files}, lambda: "\n".join(str(file) for file in files))
    return 0
