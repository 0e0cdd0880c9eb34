"""Predict the accuracy of a calibration from a recording as planned, without one.

Standard deviations follow from the noise of the cameras and the sweeps, also for each sweep twice
as long and for other amplitudes. See docs/calibration.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, add_overwrite, allow_overwrite, options
from trocar.cli.output import print_result, progress_steps, table
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.robot.calibration.budget import Budget

#: Other amplitudes that a plan compares. Source: our own choice. [rad]
AMPLITUDES = (0.3, 0.6, 0.8)
#: Rate at which a plan follows the motion; sigmas are scaled to the cameras'. Source: our own
#: choice; at 0.1 Hz, 300 samples a swing. [Hz]
PLAN_HZ = 30.0

SUMMARY = "predict the accuracy of a planned recording"
ORDER = 109


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    # Sweeps and rate as of `trocar mocap`; OptiTrack PrimeX 22 cameras were within 0.12 mm across
    # their line of sight (Krumpek, Kroeger, Mohr 2025, arXiv 2502.21189); cluster: our own choice.
    options(parser, """
        --arm ARM required                  built-in arm (see trocar list arms) or TOML file
        --duration S:number = 24            duration of each sweep
        --amplitude RAD:number = 0.6        amplitude of each sweep
        --rate HZ:number = 120              sample rate of the cameras
        --marker-noise-mm MM:number = 0.12  position noise of a marker per axis, 1 sigma
        --markers N:int = 4                 markers per cluster
        --spread-mm MM:number = 60          RMS distance of a cluster's markers from their centre
        --report DIR                        write an HTML report with tables and figures to DIR
    """)  # fmt: skip
    add_overwrite(parser, "an existing report")
    add_json(parser)


def run(args: Namespace) -> int:
    """Predict, draw, print."""
    from trocar.descriptions import load_arm
    from trocar.robot.calibration import Tracks
    from trocar.robot.calibration.budget import error_budget, pose_noise, write_budget
    from trocar.robot.calibration.report import check_report
    from trocar.robot.mocap import MocapSettings, simulate_tracks

    allow_overwrite(args, "report")
    if args.report:
        check_report(args.report, args.overwrite)
    if not 1.0 <= args.rate <= 10000.0:
        raise InputError(f"--rate: got {args.rate:g}; allowed: 1 to 10000 Hz")
    noise = pose_noise(1e-3 * args.marker_noise_mm, args.markers, 1e-3 * args.spread_mm)
    arm = load_arm(args.arm)

    def budget(amplitude: float) -> Budget:
        settings = MocapSettings("kinematic", "", args.duration, amplitude, PLAN_HZ)
        made = simulate_tracks(arm, settings)
        tracks = Tracks("plan", "", made.times, made.poses, made.rate_hz)
        return error_budget(tracks, arm, noise, made.truth["sweeps_s"], args.rate)

    with progress_steps("planning") as watch:
        budgets: dict[float, Budget] = {}
        for amplitude in sorted({*AMPLITUDES, args.amplitude}):
            watch(f"amplitude {amplitude:g} rad")
            budgets[amplitude] = budget(amplitude)
    found = budgets[args.amplitude]
    page = write_budget(args.report, found, budgets, args.overwrite) if args.report else None
    document = {
        **found.as_dict(),
        "amplitude_rad": args.amplitude,
        "by_amplitude": [{"amplitude_rad": a, "sigma": dict(b.sigma)} for a, b in budgets.items()],
    }
    written = [f"written to {page}"] if page else []
    print_result(args, document, lambda: "\n\n".join([_budget(found, budgets), *written]))
    return 0


def _budget(found: Budget, budgets: dict[float, Budget]) -> str:
    from trocar.robot.calibration.budget import budget_rows

    sweeps = ", ".join(f"{joints} {seconds:g} s" for joints, seconds in found.seconds.items())
    rows = [
        [figure, *(f"{1e6 * b.sigma[figure]:.3g}" for b in budgets.values())]
        for figure in found.sigma
    ]
    return "\n\n".join(
        [
            f"{found.arm}: sweeps of {sweeps} at {found.rate_hz:g} Hz; noise of a pose"
            f" {1e3 * found.noise[0]:.3g} mm and {1e3 * found.noise[1]:.3g} mrad per axis",
            table(*budget_rows(found)),
            table(["amplitude [rad]", *(f"{a:g}" for a in budgets)], rows),
        ]
    )
