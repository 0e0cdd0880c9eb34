"""Sweep a simulated arm before simulated cameras, and write the tracks of its links.

Clusters of markers sit at random places on the links, cameras at a random place of the room. The
arm stands still, then its linkage is swept, then it swings about its remote centre; dynamics and
servo errors are simulated unless --motion kinematic. The truth, which a calibration should find, is
written beside the tracks, as FILE.truth.json.
"""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, number
from trocar.cli.output import print_json, progress_bar, table
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.apps.mocap import SimulatedTracks
    from trocar.descriptions import ArmDescription

#: Makes the random numbers of wear others than those of a perturbed robot with the same seed.
WEAR = 1
#: Noise of a cluster's pose, 1 sigma. Source: OptiTrack PrimeX 22 cameras were within 0.12 mm
#: across their line of sight (Krumpek, Kroeger, Mohr 2025, arXiv 2502.21189); over the 115 mm to a
#: marker of a cluster 0.1 mm turn it by 0.05 deg.
NOISE_MM, NOISE_DEG = 0.1, 0.05


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument(
        "--arm", required=True, help="psm, ecm or another arm with loops, or its TOML file"
    )
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="the tracks")
    parser.add_argument(
        "--format", choices=("tidy", "motive"), default="tidy", help="of FILE; default: tidy"
    )
    _add_robot(parser)
    _add_sweep(parser)
    _add_cameras(parser)
    add_json(parser)


def _add_robot(parser: ArgumentParser) -> None:
    robot = parser.add_mutually_exclusive_group()
    robot.add_argument(
        "--calibration", metavar="OVERLAY", help="a calibrated robot in place of the drawn one"
    )
    parser.add_argument(
        "--worn",
        action="store_true",
        help="unequal sides (0.3 mm) and skew axes (1 mrad) besides: the remote centre wanders",
    )
    robot.add_argument(
        "--perturb",
        type=int,
        metavar="SEED",
        help="a robot that is not as drawn: link lengths off by up to 3 mm, angles by up to 1 deg",
    )


def _add_sweep(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--parts",
        choices=("axes", "rcm", "both"),
        default="",
        help="default: both, of an arm that has a remote centre",
    )
    parser.add_argument(
        "--duration", type=number, default=24.0, metavar="S", help="of each part; default: 24 s"
    )
    parser.add_argument(
        "--amplitude", type=number, default=0.6, metavar="RAD", help="of a sweep; default: 0.6 rad"
    )
    parser.add_argument(
        "--motion",
        choices=("dynamic", "kinematic"),
        default="dynamic",
        help="as the servos make it, or exactly as told; default: dynamic",
    )


def _add_cameras(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--rate", type=number, default=120.0, metavar="HZ", help="of the cameras; default: 120"
    )
    parser.add_argument(
        "--noise-mm",
        type=number,
        default=NOISE_MM,
        metavar="MM",
        help=f"noise of each coordinate, 1 sigma; default: {NOISE_MM}; 0: none",
    )
    parser.add_argument(
        "--noise-deg",
        type=number,
        default=NOISE_DEG,
        metavar="DEG",
        help=f"noise about each axis, 1 sigma; default: {NOISE_DEG}; 0: none",
    )
    parser.add_argument(
        "--dropout", type=number, default=0.0, metavar="SHARE", help="lost in bursts, as 0.05"
    )
    parser.add_argument(
        "--outliers", type=number, default=0.0, metavar="SHARE", help="20 mm off, as 0.01"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of clusters, cameras, noise; default: 0"
    )


def run(args: Namespace) -> int:
    """Simulate, write, and say what was written."""
    from trocar.apps.mocap import MocapSettings, Noise, simulate_tracks, write_tracks

    settings = MocapSettings(
        motion=args.motion,
        parts=args.parts,
        duration_s=args.duration,
        amplitude=args.amplitude,
        rate_hz=args.rate,
        noise=Noise(
            1e-3 * args.noise_mm, math.radians(args.noise_deg), args.dropout, args.outliers
        ),
        seed=args.seed,
    )
    arm, robot = _robot(args)
    with progress_bar("periods", not args.json) as watch:
        tracks = simulate_tracks(arm, settings, watch, robot)
    truth = write_tracks(args.output, tracks, args.format)
    if args.json:
        told = {"file": args.output, "format": args.format, "truth_file": str(truth)}
        print_json({**told, **tracks.truth})
    else:
        print(_report(args.output, str(truth), tracks))
    return 0


def _robot(args: Namespace) -> tuple[ArmDescription, str]:
    """Return the arm and what it is called: as drawn, perturbed, or calibrated."""
    from numpy.random import default_rng

    from trocar.apps.mocap import perturbed, worn
    from trocar.descriptions import load_arm

    if args.worn and args.calibration is not None:
        raise InputError("--worn: a calibrated robot is as it is; give --perturb or neither")
    arm, robot = load_arm(args.arm, calibration=args.calibration), "as drawn"
    if args.calibration is not None:
        robot = f"calibrated by {args.calibration}"
    if args.perturb is not None:
        if args.perturb < 0:
            raise InputError(f"--perturb: got {args.perturb}; allowed: a whole number from 0 on")
        arm, robot = (
            perturbed(arm, default_rng(args.perturb)),
            f"perturbed with seed {args.perturb}",
        )
    if args.worn:
        arm, robot = worn(arm, default_rng([args.perturb or 0, WEAR])), f"{robot}, worn"
    return arm, robot


def _report(file: str, truth_file: str, tracks: SimulatedTracks) -> str:
    truth = tracks.truth
    spans = ", ".join(f"{p} {a:g} to {b:g} s" for p, (a, b) in truth["parts_s"].items())
    rows = [[pair, f"{1e3 * value:.4f}", "mm"] for pair, value in truth["axis_distances_m"].items()]
    rows += [[name, f"{value:.6f}", "rad"] for name, value in truth.get("beta_rad", {}).items()]
    if "rcm" in truth:
        away = truth["rcm"]["distance_to_pitch_axis_m"]
        rows.append(["remote centre to pitch axis", f"{1e3 * away:.4f}", "mm"])
        rows.append(["it wanders by (RMS)", f"{1e3 * truth['rcm']['rms_m']:.4f}", "mm"])
    return (
        f"{file}: {truth['arm']} {truth['robot']}, {len(tracks.poses)} bodies,"
        f" {len(tracks.times)} samples at {tracks.rate_hz:g} Hz\n"
        f"  {spans}\n"
        f"  truth in {truth_file}\n\n" + table(["truth", "", ""], rows)
    )
