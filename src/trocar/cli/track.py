"""Track a needle in images of a real endoscope: a bag's, a video's or a video device's.

Prints where the needle is in the left eye's frame, with standard deviations. Images of a video
device show both eyes side by side, left first. The needle lies, or moves slowly before the camera;
for one in the jaws of an arm, use trocar.tasks.vision.NeedleTracker with the arm's measured_cp.
See docs/vision.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trocar.cli.arguments import add_json, allow, options
from trocar.cli.output import fixed, print_result, progress_bar, table
from trocar.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from trocar.tasks.vision import NeedleEstimate
    from trocar.tasks.vision.streams import Pair

SUMMARY = "track a needle in images of a real endoscope"
ORDER = 112


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--bag", metavar="FILE", help="rosbag 1, rosbag 2 or MCAP with images")
    source.add_argument(
        "--camera",
        metavar="URL",
        help="video file, number of a video device or an address, with both eyes side by side",
    )
    parser.add_argument(
        "--calibration",
        nargs="+",
        required=True,
        metavar="FILE",
        help="camera_info of both eyes or an OpenCV file, or the name of a built-in camera",
    )
    options(parser, """
        --needle SIZE = half_26  size of docs/descriptions.md, or ARC_DEG,RADIUS_MM,WIRE_MM,TAPER_MM
        --left TOPIC             of the left eye's images in the bag (default: found by its name)
        --right TOPIC            of the right eye's
        --images N:int           stop after so many pairs
    """)  # fmt: skip
    add_json(parser)


def run(args: Namespace) -> int:
    """Track and print."""
    from trocar.cameras import StereoCalibration, read_calibration
    from trocar.descriptions.cameras import load_camera
    from trocar.descriptions.needles import needle_named
    from trocar.recording.bags import open_bag
    from trocar.tasks.vision import NeedleTracker
    from trocar.tasks.vision.streams import bag_pairs, eye_topics, video_pairs

    if args.images is not None and args.images < 1:
        raise InputError(f"--images: got {args.images}; allowed: 1 or more")
    if args.bag is None:
        allow(args, "with --bag", "left", "right")
    files = args.calibration
    known = len(files) == 1 and not Path(files[0]).suffix
    eyes = load_camera(files[0]) if known else read_calibration([Path(one) for one in files])
    if not isinstance(eyes, StereoCalibration):
        raise InputError(f"--calibration: {files[0]} has one eye; allowed: two")
    pairs: Iterator[Pair]
    if args.bag is not None:
        bag = open_bag(args.bag)
        pairs = bag_pairs(bag, *eye_topics(bag, args.left or "", args.right or ""))
    else:
        pairs = video_pairs(args.camera)
    tracker = NeedleTracker(eyes, needle_named(args.needle))
    found: list[NeedleEstimate] = []
    with progress_bar("pairs of images tracked") as watch:
        for pair in pairs:
            found.append(tracker.update(pair.time, pair.left, pair.right))
            watch(len(found), args.images)
            if len(found) == args.images:
                break
    document = {
        "images": len(found),
        "tracked": sum(one.status == "tracking" for one in found),
        "estimates": [_row(one) for one in found],
    }
    print_result(args, document, lambda: _report(found))
    return 0


def _row(one: NeedleEstimate) -> dict[str, Any]:
    from trocar.geometry import quaternion_from_matrix

    T = one.T_left_needle
    if T is None:
        return {"time_s": one.time, "status": one.status}
    return {
        "time_s": one.time,
        "status": one.status,
        "position_m": T[:3, 3].tolist(),
        "quaternion_wxyz": quaternion_from_matrix(T[:3, :3]).tolist(),
        "sigma": {
            "position_m": one.position_sigma,
            "normal_rad": one.normal_sigma,
            "roll_rad": one.roll_sigma,
        },
    }


def _report(found: list[NeedleEstimate]) -> str:
    tracked = [one for one in found if one.status == "tracking"]
    line = f"needle seen in {len(tracked)} of {len(found)} pairs of images"
    if not tracked:
        return f"{line}; it was never found"
    rows = [
        [
            fixed(one.time, 3),
            one.status,
            *(fixed(1e3 * value, 2) for value in one.T_left_needle[:3, 3]),
            fixed(1e3 * one.position_sigma, 2),
        ]
        for one in (tracked[0], tracked[-1])
        if one.T_left_needle is not None
    ]
    return f"{line}\n\n" + table(["time [s]", "", "x [mm]", "y", "z", "sigma"], rows)
