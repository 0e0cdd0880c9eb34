"""From motion capture to a robot's own geometry: an overlay of its description.

The tracks hold the poses of marker clusters on the links: a still start of half a second or more,
then a sweep of the pitch (and of yaw and pitch for the remote centre, here or in --rcm FILE).
docs/calibration.md says how to record them. No description is changed.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json
from trocar.cli.output import print_json, progress_steps, table, warn

if TYPE_CHECKING:
    from trocar.apps.calibration.calibrate import Calibration


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument("tracks", metavar="TRACKS", help="a CSV export of Motive, or tidy CSV")
    parser.add_argument(
        "--arm", required=True, metavar="ARM", help="a built-in arm (trocar list), or a TOML file"
    )
    parser.add_argument("-o", "--output", metavar="OVERLAY", help="where to write the overlay")
    parser.add_argument("--rcm", metavar="FILE", help="the sweep of the remote centre, if apart")
    parser.add_argument(
        "--bodies",
        metavar="BODY=NAME,...",
        help="what bodies are called in the files, as psm_yaw=Rigid Body 3",
    )
    parser.add_argument(
        "--closure",
        choices=("parallelogram", "general"),
        help="parallelogram: loops that close exactly, the default where the description has them;"
        " general: four-bars with the sides as they are",
    )
    parser.add_argument("--report", metavar="DIR", help="write a page with tables and pictures")
    add_json(parser)


def run(args: Namespace) -> int:
    """Calibrate, write the overlay, print."""
    from trocar.apps.calibration import calibrate, parse_bodies, read_tracks
    from trocar.apps.calibration.report import check_report, write_report
    from trocar.descriptions import load_arm
    from trocar.descriptions.overlay import write_overlay

    if args.report:
        check_report(args.report)
    arm = load_arm(args.arm)
    bodies = parse_bodies(args.bodies) if args.bodies else {}
    with progress_steps() as watch:
        watch("reading")
        tracks = read_tracks(args.tracks)
        sweep = read_tracks(args.rcm) if args.rcm else None
        found = calibrate(tracks, arm, sweep, args.closure, bodies=bodies, watch=watch)
    if args.output:
        write_overlay(args.output, found.overlay)
    page = write_report(args.report, found, arm) if args.report else None
    for text in found.warnings:
        warn(text)
    if args.json:
        print_json(found.as_dict())
    else:
        written = [place for place in (args.output, page) if place]
        print("\n\n".join([_report(found), *(f"written to {place}" for place in written)]))
    return 0


def _report(found: Calibration) -> str:
    rows = [
        [label, f"{1e3 * v.value:.4f}", f"{1e3 * v.sigma:.4f}",
         f"{1e3 * found.closed_distances[label]:.4f}",
         f"{1e3 * found.absorbed[label]:+.4f}"]
        for label, v in found.axis_distances.items()
    ]  # fmt: skip
    head = ["axes", "measured [mm]", "sigma [mm]", f"{found.closure} [mm]", "absorbed [mm]"]
    left = found.refined
    parts = [
        f"{found.arm}: {left.samples} samples; left of a pose {1e3 * left.position_rms:.4f} mm and"
        f" {1e3 * left.rotation_rms:.4f} mrad per axis (RMS)",
        table(head, rows),
    ]
    if found.betas:
        angles = [[n, f"{v.value:.6f}", f"{v.sigma:.6f}"] for n, v in found.betas.items()]
        parts.append(table(["angle at q = 0", "[rad]", "sigma [rad]"], angles))
    if found.centre is not None:
        report, distance = found.centre, found.centre.distance
        places = [
            [axis, f"{1e3 * p:.4f}", f"{1e3 * s:.4f}"]
            for axis, p, s in zip("xyz", report.fit.post, report.fit.sigma_post, strict=True)
        ]
        text = f"Remote centre in {report.base}; wanders by {1e3 * report.wander_rms:.4f} mm (RMS)"
        if distance is not None:
            text += (
                f"; {1e3 * distance.value:.4f} mm (sigma {1e3 * distance.sigma:.4f}) from the"
                " first axis"
            )
        parts += [text, table(["", "[mm]", "sigma [mm]"], places)]
    return "\n\n".join(parts)
