"""Identify a robot's kinematic geometry from motion capture, and write a calibration overlay.

TRACKS holds the poses of marker clusters on the links: at least 0.5 s at rest, then a sweep of the
pitch joint (and of yaw and pitch for the remote centre of motion, in TRACKS or in --rcm FILE);
of setup joints and masters a sweep of each joint in turn, towards positive joint positions first.
See docs/calibration.md for the recording procedure. The nominal description is not modified.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING, Any

from trocar.cli.arguments import add_json, add_overwrite, allow, allow_overwrite, options
from trocar.cli.output import print_json, progress_steps, table, warn

if TYPE_CHECKING:
    from trocar.robot.calibration.calibrate import Calibration
    from trocar.robot.calibration.joints import JointsCalibration

SUMMARY = "identify an arm's geometry from motion capture"
ORDER = 110


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        tracks TRACKS                    motion-capture tracks: Motive CSV export or tidy CSV
        --arm ARM required               built-in arm (see trocar list arms) or TOML file
        -o,--output OVERLAY              overlay file to write
        --rcm FILE                       tracks of the remote-centre sweep, if in a separate file
        --bodies BODY=NAME,...           names of the bodies in the files, e.g. "psm_yaw=Rigid Body
                                         3"
        --closure parallelogram|general  parallelogram: constrain the loops to parallelograms
                                         (default if the description has them); general: four-bar
                                         loops with independent side lengths
        --report DIR                     write an HTML report with tables and figures to DIR
    """)  # fmt: skip
    add_overwrite(parser, "existing output files")
    add_json(parser)


def run(args: Namespace) -> int:
    """Calibrate, write the overlay, print."""
    from trocar.descriptions import load_arm
    from trocar.descriptions.overlay import write_overlay
    from trocar.outputs import check_file
    from trocar.robot.calibration import (
        calibrate,
        calibrate_joints,
        has_chain,
        parse_bodies,
        read_tracks,
    )
    from trocar.robot.calibration.report import check_report, write_report

    allow_overwrite(args, "output", "report")
    if args.report:
        check_report(args.report, args.overwrite)
    if args.output:
        check_file(args.output, args.overwrite)
    arm = load_arm(args.arm)
    bodies = parse_bodies(args.bodies) if args.bodies else {}
    looped = bool(arm.mechanism.closures)
    if not looped:
        allow(args, "with an arm that has closed loops", "rcm", "closure", "report")
    loops: Calibration | None = None
    joints: JointsCalibration | None = None
    with progress_steps() as watch:
        watch(f"reading {args.tracks}")
        tracks = read_tracks(args.tracks)
        sweep = read_tracks(args.rcm) if args.rcm else None
        if looped:
            loops = calibrate(tracks, arm, sweep, args.closure, bodies=bodies, watch=watch)
        if not looped or has_chain(tracks, arm, bodies):
            joints = calibrate_joints(tracks, arm, loops, bodies=bodies, watch=watch)
    found = [one for one in (loops, joints) if one is not None]
    if args.output:
        write_overlay(args.output, found[-1].overlay, overwrite=args.overwrite)
    page = None
    if args.report and loops is not None:
        page = write_report(args.report, loops, arm, overwrite=args.overwrite)
    for text in dict.fromkeys(text for one in found for text in one.warnings):
        warn(text)
    if args.json:
        print_json(_document(loops, joints))
    else:
        written = [place for place in (args.output, page) if place]
        tables = [] if loops is None else [_report(loops)]
        tables += [] if joints is None else [_joints(joints)]
        print("\n\n".join([*tables, *(f"written to {place}" for place in written)]))
    return 0


def _document(loops: Calibration | None, joints: JointsCalibration | None) -> dict[str, Any]:
    """Return one document of loops and chain."""
    if joints is None:
        return {} if loops is None else loops.as_dict()
    if loops is None:
        return joints.as_dict()
    both, chain = loops.as_dict(), joints.as_dict()
    both["residuals"]["joints"] = chain["residuals"]
    warnings = list(dict.fromkeys([*both["warnings"], *chain["warnings"]]))
    return {**both, "joints": chain["joints"], "warnings": warnings}


def _joints(found: JointsCalibration) -> str:
    rows = [
        [label, f"{1e3 * value.value:.4f}", "mm", f"{1e3 * value.sigma:.4f}",
         f"{1e3 * found.nominal['distances_m'][label]:.4f}"]
        for label, value in found.distances.items()
    ]  # fmt: skip
    rows += [
        [label, f"{value.value:.6f}", "rad", f"{value.sigma:.6f}",
         f"{found.nominal['angles_rad'][label]:.6f}"]
        for label, value in found.angles.items()
    ]  # fmt: skip
    left = [
        [name, f"{span:.3f}", f"{1e3 * position:.4f}", f"{1e3 * rotation:.4f}", f"{outliers}"]
        for name, (position, rotation, span, outliers) in found.residuals.items()
    ]
    return "\n\n".join(
        [
            f"{found.arm}: each axis of the chain and the next",
            table(["axes", "measured", "", "sigma", "nominal"], rows),
            table(["joint", "sweep [rad; m]", "RMS [mm]", "RMS [mrad]", "left out"], left),
        ]
    )


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
        f"{found.arm}: {left.samples} samples; pose residual {1e3 * left.position_rms:.4f} mm and"
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
        text = (
            f"Remote centre in {report.base}; displacement {1e3 * report.wander_rms:.4f} mm (RMS)"
        )
        if distance is not None:
            text += (
                f"; distance from the first axis {1e3 * distance.value:.4f} mm"
                f" (sigma {1e3 * distance.sigma:.4f})"
            )
        parts += [text, table(["", "[mm]", "sigma [mm]"], places)]
    return "\n\n".join(parts)
