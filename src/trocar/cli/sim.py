"""Simulate a rig, live for browser and clients, or headless along the paper's trajectory.

Live (default): serve the web viewer and a rosbridge WebSocket, on this machine only, and print
their addresses. Headless: move all arms except setup joints along the paper's sine trajectory and
report speed, loop error and tracking error. --record writes a file that `trocar replay` reproduces;
a headless run records one additional pass.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from contextlib import ExitStack
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, allow, allow_overwrite, names_of, options
from trocar.cli.output import print_result, progress_steps, table
from trocar.cli.serving import add_serving, allow_headless, serve, serve_chosen
from trocar.cli.worlds import (
    add_look,
    add_pose,
    add_record,
    add_world,
    images_of_headless,
    make_world,
    recording,
    take_pose,
)
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.robot.verification.speed import HeadlessReport

SUMMARY = "simulate a rig, live in the browser or headless"
ORDER = 10

HEADLESS_DURATION_S = 10.0


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        --headless             run without web viewer and clients, and print a report
        --duration S:duration  stop after S seconds of simulated time (headless default: 10)
        --speed SPEED:speed    realtime; max, as fast as possible; or a factor of real time: 0.2 is
                               slow motion (default: realtime, headless: max)
    """)  # fmt: skip
    add_json(parser)
    world = add_world(parser)
    options(world, """
        --tip-load NEWTON:number = 0  apply a rotating force of NEWTON at every tool tip
    """)  # fmt: skip
    add_pose(world)
    add_record(parser)
    add_serving(parser)


def run(args: Namespace) -> int:
    """Simulate."""
    if not 0.0 <= args.tip_load < float("inf"):
        raise InputError(f"--tip-load: got {args.tip_load:g}; allowed: 0 N or more")
    if args.json and not args.headless:
        raise InputError("--json: allowed with --headless only, which prints a report")
    allow_overwrite(args, "record", "foxglove_record")
    if args.headless:
        allow_headless(args)
        allow(args, "without --headless", "pose")
        if not args.record_images:
            allow(args, "without --headless, or with --record-images", *names_of(add_look))
    if not args.headless:
        print(f"trocar: {args.rig}: starting ...", file=sys.stderr, flush=True)
        world = make_world(args, args.tip_load)
        take_pose(world, args.pose)
        serve_chosen(serve(world, args, loads=True), args)
        return 0
    if isinstance(args.speed, float):
        raise InputError(f"--speed: got {args.speed:g} with --headless; allowed: realtime, max")
    from trocar.robot.verification.speed import run_headless

    with ExitStack() as stack:
        watch = stack.enter_context(progress_steps())
        watch(f"building {args.rig}")
        world = make_world(args, args.tip_load)
        stack.enter_context(images_of_headless(world, args))
        report = run_headless(
            world,
            HEADLESS_DURATION_S if args.duration is None else args.duration,
            realtime=args.speed == "realtime",
            record=recording(world, args) if args.record else None,
            watch=watch,
        )
    print_result(args, report, lambda: _report(report))
    return 0


def _report(report: HeadlessReport) -> str:
    rows = [
        [arm, joint, f"{1e3 * rms:.3f}", "mm" if joint == "insertion" else "mrad"]
        for arm, joints in report.tracking_rms.items()
        for joint, rms in joints.items()
    ]
    branch = "correct" if report.branch_ok else "WRONG"
    rcm, wander_um = report.rcm_error_um_max, report.rcm_wander_um_max or 0.0
    centre = "none" if rcm is None else f"{rcm:.3f} um max"
    if wander_um >= 1.0:
        centre += f" (of which {wander_um:.0f} um due to the calibrated geometry)"
    return (
        f"{report.rig}: {report.simulated_s:g} s simulated in {report.pass_s:.3f} s"
        f" at {1e3 * report.timestep_s:g} ms ({report.wall_s:.1f} s with repetitions, bare MuJoCo"
        " and checks)\n"
        f"  real-time factor   {report.real_time_factor:.1f}"
        f"  (bare MuJoCo {report.bare_real_time_factor:.1f}, overhead {report.overhead:.3f})\n"
        f"  loop error         {report.loop_gap_um_max:.4f} um max\n"
        f"  RCM error          {centre}\n"
        f"  assembly branch    {branch}\n\n" + table(["arm", "joint", "tracking RMS", ""], rows)
    )
