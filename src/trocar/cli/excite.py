"""Plan a trajectory that excites an arm's dynamics: run it on a robot, and identify from its log.

Fourier series of each joint within its limits of position, velocity and acceleration. The condition
number of the base parameters' regressor is minimised. The trajectory begins and ends at rest; check
it for collisions with `trocar sim` first. See docs/dynamics.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from trocar.cli.arguments import add_json, add_overwrite, options
from trocar.cli.identify import add_standing
from trocar.cli.output import print_result, progress_bar

SUMMARY = "plan a trajectory that excites an arm's dynamics"
ORDER = 51


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        --arm ARM                 built-in arm (see trocar list arms) or TOML file; with --rig, an
                                  arm of that rig (default: psm; with --rig its only one)
        --tool TOOL               built-in tool or TOML file (default: the tool of the arm's
                                  description)
        --period S:number = 10    of the series
        --repeats N:int = 3       number of periods
        --rate HZ:number = 200    sample rate
        --candidates N:int = 200  trajectories tried
        --seed N:int = 0          of the random numbers
        -o,--output CSV required  file to write: time, JOINT_position, JOINT_velocity (SI units)
    """)  # fmt: skip
    add_standing(parser)
    add_overwrite(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    """Plan, write and print the condition number."""
    from trocar.errors import InputError
    from trocar.outputs import check_file, write_text
    from trocar.robot.identification import excite, trajectory_csv
    from trocar.robot.standing import standing_arm

    check_file(args.output, args.overwrite)
    if args.seed < 0:
        raise InputError(f"--seed: got {args.seed}; allowed: 0 or more")
    standing = standing_arm(args.arm, args.tool, args.rig, args.base_rpy)
    arm = standing.arm
    with progress_bar("candidates") as watch:
        found = excite(
            arm,
            args.period,
            args.repeats,
            args.rate,
            args.candidates,
            args.seed,
            watch,
            standing.up,
        )
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
