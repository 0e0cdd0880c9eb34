"""Locate an arm's remote centre of motion from motion capture, by pivot calibration.

TRACKS is a CSV export of OptiTrack Motive or tidy CSV, recorded during a sweep of yaw and pitch.
Bodies are named ARM_LINK: psm_base, psm_yaw, psm_pitch_end. Exit status 2: the sweep does not
determine the centre, e.g. because only one joint moved. See docs/calibration.md for the method.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, options
from trocar.cli.output import fixed, print_result, progress_steps, table, warn

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from trocar.robot.calibration.rcm import RcmReport

    Array = NDArray[np.float64]

SUMMARY = "locate a remote centre of motion from motion capture"
ORDER = 90


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        tracks TRACKS           motion-capture tracks: Motive CSV export or tidy CSV
        --arm ARM required      psm, ecm, or a TOML file
        --bodies BODY=NAME,...  names of the bodies in the file, e.g. "psm_yaw=Rigid Body 3"
    """)  # fmt: skip
    add_json(parser)


def run(args: Namespace) -> int:
    """Print the centre."""
    from trocar.descriptions import load_arm
    from trocar.robot.calibration.rcm import find_rcm
    from trocar.robot.calibration.tracks import parse_bodies, read_tracks

    arm = load_arm(args.arm)
    bodies = parse_bodies(args.bodies) if args.bodies else {}
    with progress_steps() as watch:
        watch(f"reading {args.tracks}")
        tracks = read_tracks(args.tracks)
        watch("fitting")
        report = find_rcm(tracks, arm, bodies)
    for message in report.warnings:
        warn(message)
    print_result(args, report.as_dict(), lambda: _report(report))
    return 0


def _report(report: RcmReport) -> str:
    fit, table7 = report.fit, report.table7
    lines = [f"remote centre of {report.arm}: pivot of {report.body} in {report.base} [mm]\n"]
    rows = [
        ("b_post, in the base", fit.post, fit.sigma_post, fit.rms_axes),
        ("b_tip, in the body", fit.tip, fit.sigma_tip, None),
    ]
    if table7 is not None:
        rows.append(("from the pitch axis", table7.position, table7.sigma, table7.rms_axes))
    head = ("", "x", "y", "z", "sigma x", "sigma y", "sigma z", "RMS x", "RMS y", "RMS z")
    lines.append(table(head, [(name, *_cells(p, s, rms)) for name, p, s, rms in rows]))
    rms, noise = _mm(fit.rms, 4), _mm(report.noise_rms, 4)
    lines.append(f"\nRMS distance {rms} mm, of which noise {noise}")
    if report.distance is not None:
        value, sigma = _mm(report.distance.value, 3), _mm(report.distance.sigma, 4)
        lines.append(f"distance from the pitch axis {value} mm, sigma {sigma}")
    outliers = f"{fit.outliers} outliers excluded"
    lines.append(f"condition number {fit.condition:.3g}; {int(fit.used.sum())} samples, {outliers}")
    if report.cloud:
        lines.append(f"\nmean position per joint pose ({len(report.cloud)} poses):\n")
        head = ("yaw [rad]", "pitch [rad]", "x [mm]", "y [mm]", "z [mm]", "samples")
        poses = [
            (*(fixed(q, 2) for q in c.q), *(_mm(v, 3) for v in c.position), str(c.samples))
            for c in report.cloud
        ]
        lines.append(table(head, poses))
    return "\n".join(lines)


def _cells(position: Array, sigma: Array, rms: Array | None) -> list[str]:
    spread = [""] * 3 if rms is None else [_mm(v, 4) for v in rms]
    return [*(_mm(v, 3) for v in position), *(_mm(v, 4) for v in sigma), *spread]


def _mm(value: float, decimals: int) -> str:
    return fixed(1e3 * float(value), decimals)
