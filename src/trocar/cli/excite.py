"""Plan a trajectory that excites an arm's dynamics: run it on a robot, and identify from its log.

Fourier series of each joint within its limits of position, velocity and acceleration. The condition
number of the base parameters' regressor is minimised. The trajectory begins and ends at rest; check
it for collisions with `trocar sim` first. See docs/dynamics.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from trocar.cli.arguments import add_json, add_overwrite, number
from trocar.cli.output import print_result

SUMMARY = "plan a trajectory that excites an arm's dynamics"
ORDER = 51


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument(
        "--arm",
        default="psm",
        help="built-in arm (see trocar list arms) or TOML file (default: psm)",
    )
    parser.add_argument(
        "--tool", help="built-in tool or TOML file (default: the tool of the arm's description)"
    )
    parser.add_argument(
        "--period", type=number, default=10.0, metavar="S", help="of the series (default: 10)"
    )
    parser.add_argument(
        "--repeats", type=int, default=3, metavar="N", help="number of periods (default: 3)"
    )
    parser.add_argument(
        "--rate", type=number, default=200.0, metavar="HZ", help="sample rate (default: 200)"
    )
    parser.add_argument(
        "--candidates", type=int, default=200, metavar="N", help="trajectories tried (default: 200)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of the random numbers (default: 0)"
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="CSV",
        required=True,
        help="file to write: time, JOINT_position, JOINT_velocity (SI units)",
    )
    add_overwrite(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    """Plan, write and print the condition number."""
    from trocar.apps.identification import excite, trajectory_csv
    from trocar.descriptions import load_arm
    from trocar.errors import InputError
    from trocar.outputs import check_file, write_text

    check_file(args.output, args.overwrite)
    if args.seed < 0:
        raise InputError(f"--seed: got {args.seed}; allowed: 0 or more")
    arm = load_arm(args.arm, args.tool)
    found = excite(arm, args.period, args.repeats, args.rate, args.candidates, args.seed)
    write_text(args.output, trajectory_csv(found), args.overwrite)
    document = {
        "arm": arm.name,
        "output": args.output,
        "samples": len(found.q),
        "rate_hz": found.rate_hz,
        "base_parameters": found.base_parameters,
        "condition_number": found.condition,
        "first_condition_number": found.first_condition,
    }
    print_result(
        args,
        document,
        lambda: (
            f"{arm.name}: {len(found.q)} samples at {found.rate_hz:g} Hz, condition number of"
            f" {found.base_parameters} base parameters {found.condition:.4g} (first candidate:"
            f" {found.first_condition:.4g})\nwritten: {args.output}"
        ),
    )
    return 0
