"""Options that say how to read the recording of a real arm."""

from __future__ import annotations

import re
from argparse import Namespace
from typing import TYPE_CHECKING, Any, Literal

from trocar.cli.arguments import Arguments, allow, names_of, options
from trocar.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from trocar.robot.recordings import ReadSettings

#: Largest error of a quaternion's norm. Source: our own choice; four digits give less.
NORM_TOLERANCE = 1e-3


def add_reading(parser: Arguments) -> None:
    """Add the options."""
    options(parser, """
        --of ARM                     arm in the file, where it holds several, e.g. PSM2
        --rate HZ:number             rate of rows without times (default: 200, if the velocities
                                     agree); recordings with times are resampled to it
        --columns WHAT=COLUMNS[UNIT] ...
                                     columns of a table, e.g. time=0[ms],position=1:8[deg/mm] or
                                     PSM1.jaw=grip; WHAT: time, position, velocity, effort, jaw,
                                     tip, quaternion, rotation (default: by the header)
        --units ANGLE/LENGTH         units of columns that do not name theirs, e.g. deg/mm (default:
                                     rad/m)
        --base X,Y,Z,QW,QX,QY,QZ     the arm's base in the frame of the tip's poses [m], where a
                                     recording has no joints, or "centred": anywhere from where the
                                     mean pose is home (default: the poses are in the base)
        --episode N:int              episode of a dataset of LeRobot's
        --wrist motor|joint = motor  rows without header: side of the coupling on which a PSM's
                                     wrist and jaw, or an MTM's joints 2 to 4, were recorded
        --topic [ARM=]TOPIC          bag: topic of joint states or of poses of the tip (default: by
                                     its name)
        --jaw [ARM=]TOPIC            bag: topic of the jaw (default: that beside the arm's)
    """)  # fmt: skip


def read_settings(args: Namespace) -> ReadSettings:
    """Return the settings from the options of `add_reading`."""
    from trocar.robot.recordings import ReadSettings

    columns = [part for text in args.columns for part in re.split(r"[,\s]+", text) if part]
    topic, jaw = (text and text.rpartition("=")[2] for text in (args.topic, args.jaw))
    of = args.of or (args.topic.partition("=")[0] if "=" in (args.topic or "") else None)
    return ReadSettings(
        args.rate, args.wrist, topic, jaw, of if topic is None else None, tuple(columns),
        args.units, base_pose(args.base) if args.base else None, args.episode,
    )  # fmt: skip


def allow_reading(args: Namespace, kinds: set[str]) -> None:
    """Reject options that concern recordings of other kinds.

    Args:
        args: parsed arguments
        kinds: of the recordings, as `recording_kind` has them
    """
    if kinds <= {"recording"}:
        names = [name for name in names_of(add_reading) if name != "of"]
        allow(args, "with the log of a real arm", *names)
    if "bag" not in kinds:
        allow(args, "with a bag", "topic", "jaw")
    if not kinds & {"rows", "table"}:
        allow(args, "with a table", "columns", "units", "episode")
    if not kinds & {"rows", "table", "bag"}:
        allow(args, "with a table or a bag", "base")
    if "rows" not in kinds:
        allow(args, "with rows without a header", "wrist")


def base_pose(text: str) -> NDArray[np.float64] | Literal["centred"]:
    """Return the pose (4, 4) of seven numbers, or "centred".

    Raises:
        InputError: others
    """
    import numpy as np

    from trocar.geometry import matrix_from_quaternion, transform

    if text == "centred":
        return "centred"
    try:
        values: NDArray[Any] = np.array([float(word) for word in text.split(",")])
    except ValueError:
        values = np.zeros(0)
    norm = float(np.linalg.norm(values[3:]))
    if values.shape != (7,) or not np.isfinite(values).all() or abs(norm - 1.0) > NORM_TOLERANCE:
        raise InputError(
            f"--base: got {text!r}; allowed: X,Y,Z,QW,QX,QY,QZ with a unit quaternion, e.g."
            " 0,0,0,1,0,0,0, or centred"
        )
    return transform(matrix_from_quaternion(values[3:] / norm), values[:3])
