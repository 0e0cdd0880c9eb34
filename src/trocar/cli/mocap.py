"""Simulate motion capture of an arm, and write the tracks of its links.

Marker clusters and cameras are placed at random. The arm rests, then sweeps its linkage, then
moves about its remote centre of motion; setup joints and masters sweep every joint in turn. The
ground truth is written to FILE.truth.json. See docs/calibration.md.
"""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, add_overwrite, options
from trocar.cli.output import print_result, progress_bar, table
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.cli.arguments import Arguments
    from trocar.descriptions import ArmDescription
    from trocar.robot.mocap import SimulatedTracks

SUMMARY = "simulate motion capture of an arm"
ORDER = 80

#: Second seeds of the random numbers of wear and of broken loops, beside that of a perturbed robot.
WEAR, LOOPS = 1, 2
#: Largest displacement of the hinges that close loops [mm]; with more, loops lock up within the
#: joint ranges. Source: our own choice, five times the paper's Table 6.
LOOPS_MM = 5.0
#: Noise of a cluster's pose, 1 sigma. Source: OptiTrack PrimeX 22 cameras were within 0.12 mm
#: across their line of sight (Krumpek, Kroeger, Mohr 2025, arXiv 2502.21189); over the 115 mm to a
#: marker of a cluster 0.1 mm turn it by 0.05 deg.
NOISE_MM, NOISE_DEG = 0.1, 0.05


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        --arm ARM required         built-in arm (see trocar list arms) or TOML file
        -o,--output FILE required  tracks file to write
    """)  # fmt: skip
    add_overwrite(parser, "existing tracks")
    options(parser, """
        --format tidy|motive = tidy  format of FILE
    """)  # fmt: skip
    add_json(parser)
    robot = parser.add_argument_group("robot")
    _add_robot(robot, robot.add_mutually_exclusive_group())
    _add_sweep(parser.add_argument_group("motion"))
    _add_cameras(parser.add_argument_group("cameras"))


def _add_robot(group: Arguments, robot: Arguments) -> None:
    options(robot, """
        --calibration OVERLAY  calibration overlay, replaces nominal geometry (trocar calibrate)
        --perturb SEED:int     perturb the geometry at random: lengths by up to 3 mm, angles by up
                               to 1 deg
    """)  # fmt: skip
    options(group, """
        --loops-mm MM:number = 0  displace the hinge that closes each loop by MM, so that no loop is
                                  a parallelogram (default: 0; the paper's Table 6: 1)
        --worn                    add unequal side lengths (0.3 mm) and skew axes (1 mrad), so that
                                  the remote centre moves
    """)  # fmt: skip


def _add_sweep(group: Arguments) -> None:
    group.add_argument(
        "--parts",
        choices=("axes", "rcm", "both", "chain"),
        default="",
        help="sweeps to simulate: of the loops, about the remote centre, both, or of each joint of"
        " the chain in turn (default: both, if the loops make a remote centre; else of the loops"
        " and of the chain)",
    )
    options(group, """
        --duration S:number = 24            duration of each sweep, of each joint of a chain 0.6 of
                                            it
        --amplitude RAD:number = 0.6        amplitude of each sweep
        --motion dynamic|kinematic = dynamic  simulate dynamics and servos, or follow the trajectory
                                            exactly
    """)  # fmt: skip


def _add_cameras(group: Arguments) -> None:
    options(group, f"""
        --rate HZ:number = 120              sample rate
        --noise-mm MM:number = {NOISE_MM}   position noise per coordinate, 1 sigma (default:
                                            {NOISE_MM}, 0 = none)
        --noise-deg DEG:number = {NOISE_DEG}  rotation noise per axis, 1 sigma (default:
                                            {NOISE_DEG}, 0 = none)
        --noise-time S:number = 0           time constant of the noise (default: 0, white)
        --dropout RATIO:number = 0          ratio of samples lost in bursts, e.g. 0.05
        --outliers RATIO:number = 0         ratio of samples displaced by 20 mm, e.g. 0.01
        --seed N:int = 0                    random seed of clusters, cameras and noise
    """)  # fmt: skip


def run(args: Namespace) -> int:
    """Simulate, write, and print what was written."""
    from trocar.robot.mocap import (
        MarkerNoise,
        MocapSettings,
        check_tracks,
        simulate_tracks,
        write_tracks,
    )

    settings = MocapSettings(
        motion=args.motion,
        parts=args.parts,
        duration_s=args.duration,
        amplitude=args.amplitude,
        rate_hz=args.rate,
        noise=MarkerNoise(
            1e-3 * args.noise_mm,
            math.radians(args.noise_deg),
            args.dropout,
            args.outliers,
            args.noise_time,
        ),
        seed=args.seed,
    )
    check_tracks(args.output, args.overwrite)
    arm, robot = _robot(args)
    with progress_bar("steps") as watch:
        tracks = simulate_tracks(arm, settings, watch, robot)
    truth = write_tracks(args.output, tracks, args.format, overwrite=args.overwrite)
    files = {"file": args.output, "format": args.format, "truth_file": truth}
    print_result(args, {**files, **tracks.truth}, lambda: _report(args.output, str(truth), tracks))
    return 0


def _robot(args: Namespace) -> tuple[ArmDescription, str]:
    """Return the arm and its label: as drawn, perturbed, or calibrated."""
    from numpy.random import default_rng

    from trocar.descriptions import load_arm
    from trocar.robot.mocap import broken, perturbed, worn

    if not 0.0 <= args.loops_mm <= LOOPS_MM:
        raise InputError(f"--loops-mm: got {args.loops_mm:g}; allowed: 0 to {LOOPS_MM:g} mm")
    changes = [name for name, given in (("--worn", args.worn), ("--loops-mm", args.loops_mm))
               if given]  # fmt: skip
    if changes and args.calibration is not None:
        raise InputError(
            f"{changes[0]}: got --calibration too; allowed: {changes[0]} alone or with --perturb"
        )
    if len(changes) == 2:
        raise InputError("--worn: got --loops-mm too; allowed: one of them")
    arm, robot = load_arm(args.arm, calibration=args.calibration), "as drawn"
    if args.calibration is not None:
        robot = f"calibrated by {args.calibration}"
    if args.perturb is not None:
        if args.perturb < 0:
            raise InputError(f"--perturb: got {args.perturb}; allowed: an integer of 0 or more")
        arm, robot = (
            perturbed(arm, default_rng(args.perturb)),
            f"perturbed with seed {args.perturb}",
        )
    if args.loops_mm:
        rng = default_rng([args.perturb or 0, LOOPS])
        arm = broken(arm, rng, 1e-3 * args.loops_mm)
        robot = f"{robot}, loops broken by {args.loops_mm:g} mm"
    if args.worn:
        arm, robot = worn(arm, default_rng([args.perturb or 0, WEAR])), f"{robot}, worn"
    return arm, robot


def _report(file: str, truth_file: str, tracks: SimulatedTracks) -> str:
    truth = tracks.truth
    spans = ", ".join(f"{p} {a:g} to {b:g} s" for p, (a, b) in truth["parts_s"].items())
    chain = truth.get("joints", {"distances_m": {}, "angles_rad": {}})
    distances = {**truth.get("axis_distances_m", {}), **chain["distances_m"]}
    rows = [[pair, f"{1e3 * value:.4f}", "mm"] for pair, value in distances.items()]
    rows += [[pair, f"{value:.6f}", "rad"] for pair, value in chain["angles_rad"].items()]
    rows += [[name, f"{value:.6f}", "rad"] for name, value in truth.get("beta_rad", {}).items()]
    if "rcm" in truth:
        away = truth["rcm"]["distance_to_pitch_axis_m"]
        rows.append(["remote centre to pitch axis", f"{1e3 * away:.4f}", "mm"])
        rows.append(["remote centre motion (RMS)", f"{1e3 * truth['rcm']['rms_m']:.4f}", "mm"])
    return (
        f"{file}: {truth['arm']} {truth['robot']}, {len(tracks.poses)} bodies,"
        f" {len(tracks.times)} samples at {tracks.rate_hz:g} Hz\n"
        f"  {spans}\n"
        f"  ground truth in {truth_file}\n\n" + table(["ground truth", "", ""], rows)
    )
