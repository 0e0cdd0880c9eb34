"""The remote centre of an arm from tracks of motion capture, by pivot calibration.

TRACKS is a CSV export of OptiTrack Motive or tidy CSV, of a sweep of yaw and pitch; bodies are
called ARM_LINK, such as psm_base, psm_yaw, psm_pitch_end. Exit status 2 says that the sweep does
not fix the centre, as when only one joint turned. docs/calibration.md has the method.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json
from trocar.cli.output import fixed, print_json, table, warn

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from trocar.apps.calibration.rcm import RcmReport

    Array = NDArray[np.float64]


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument("tracks", metavar="TRACKS", help="a file of motion capture")
    parser.add_argument(
        "--arm", metavar="ARM", required=True, help="psm, ecm, or the TOML file of one of your own"
    )
    parser.add_argument(
        "--bodies",
        metavar="BODY=NAME,...",
        help='what bodies are called in the file, as in "psm_yaw=Rigid Body 3"',
    )
    add_json(parser)


def run(args: Namespace) -> int:
    """Print the centre."""
    from trocar.apps.calibration.rcm import find_rcm
    from trocar.apps.calibration.tracks import parse_bodies, read_tracks
    from trocar.descriptions import load_arm

    arm = load_arm(args.arm)
    bodies = parse_bodies(args.bodies) if args.bodies else {}
    report = find_rcm(read_tracks(args.tracks), arm, bodies)
    for message in report.warnings:
        warn(message)
    if args.json:
        print_json(report.as_dict())
    else:
        _print(report)
    return 0


def _print(report: RcmReport) -> None:
    fit, table7 = report.fit, report.table7
    print(f"remote centre of {report.arm}: where {report.body} turns, in {report.base} [mm]\n")
    rows = [
        ("b_post, in the base", fit.post, fit.sigma_post, fit.rms_axes),
        ("b_tip, in the body", fit.tip, fit.sigma_tip, None),
    ]
    if table7 is not None:
        rows.append(("from the pitch axis", table7.position, table7.sigma, table7.rms_axes))
    head = ("", "x", "y", "z", "sigma x", "sigma y", "sigma z", "RMS x", "RMS y", "RMS z")
    print(table(head, [(name, *_cells(p, s, rms)) for name, p, s, rms in rows]))
    print(f"\nRMS as a distance {_mm(fit.rms, 4)} mm, of which noise {_mm(report.noise_rms, 4)}")
    if report.distance is not None:
        value, sigma = report.distance
        print(f"distance from the pitch axis {_mm(value, 3)} mm, sigma {_mm(sigma, 4)}")
    outliers = f"{fit.outliers} outliers left out"
    print(f"condition number {fit.condition:.3g}; {int(fit.used.sum())} samples, {outliers}")
    if report.cloud:
        print(f"\nabout each pose, the mean of its samples ({len(report.cloud)} poses):\n")
        head = ("yaw [rad]", "pitch [rad]", "x [mm]", "y [mm]", "z [mm]", "samples")
        poses = [
            (*(fixed(q, 2) for q in c.q), *(_mm(v, 3) for v in c.position), str(c.samples))
            for c in report.cloud
        ]
        print(table(head, poses))


def _cells(position: Array, sigma: Array, rms: Array | None) -> list[str]:
    spread = [""] * 3 if rms is None else [_mm(v, 4) for v in rms]
    return [*(_mm(v, 3) for v in position), *(_mm(v, 4) for v in sigma), *spread]


def _mm(value: float, decimals: int) -> str:
    return fixed(1e3 * float(value), decimals)
