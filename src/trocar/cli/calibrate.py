"""Identify a robot's kinematic geometry from motion capture, and write a calibration overlay.

TRACKS holds the poses of marker clusters on the links: at least 0.5 s at rest, then a sweep of the
pitch joint (and of yaw and pitch for the remote centre of motion, in TRACKS or in --rcm FILE);
of setup joints and masters a sweep of each joint in turn, towards positive joint positions first.
See docs/calibration.md for the recording procedure. The nominal description is not modified.
"""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from trocar.cli.arguments import add_json, add_overwrite, allow, allow_overwrite, options
from trocar.cli.output import print_json, print_result, progress_steps, table, warn
from trocar.errors import InputError

if TYPE_CHECKING:
    from argparse import _ArgumentGroup  # pyright: ignore[reportPrivateUsage]  it has no public name

    from trocar.robot.calibration.budget import Budget
    from trocar.robot.calibration.calibrate import Calibration
    from trocar.robot.calibration.joints import JointsCalibration
    from trocar.robot.calibration.paper_robot import PaperTwin
    from trocar.robot.calibration.registration import Base

#: Defaults of a plan. Source: sweeps and rate as of `trocar mocap`; OptiTrack PrimeX 22 cameras
#: were within 0.12 mm across their line of sight (Krumpek, Kroeger, Mohr 2025, arXiv 2502.21189);
#: cluster: our own choice.
PLAN = {
    "duration": 24.0,
    "amplitude": 0.6,
    "rate": 120.0,
    "marker_noise_mm": 0.12,
    "markers": 4,
    "spread_mm": 60.0,
}
#: Other amplitudes that a plan compares. Source: our own choice. [rad]
AMPLITUDES = (0.3, 0.6, 0.8)
#: Rate at which a plan follows the motion; sigmas are scaled to the cameras'. Source: our own
#: choice; at 0.1 Hz, 300 samples a swing. [Hz]
PLAN_HZ = 30.0

SUMMARY = "identify an arm's geometry from motion capture"
ORDER = 110


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        tracks TRACKS ?                  motion-capture tracks: Motive CSV export or tidy CSV
        --from tracks|kinematics|paper as source = tracks
                                         tracks: motion capture (default); kinematics: joint
                                         readings of arms that touch known points or hold a board in
                                         front of a camera (TRACKS is a TOML file as of trocar
                                         touches); paper: Tables 6 and 7 of the closed-loop paper
                                         (psm and ecm, without TRACKS)
        --arm ARM                        built-in arm (see trocar list arms) or TOML file; required
                                         except with --from kinematics
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
    _add_plan(parser.add_argument_group("error budget"))


def _add_plan(group: _ArgumentGroup) -> None:
    options(group, f"""
        --plan                       predict the standard deviations of a recording as planned and
                                     with each sweep twice as long, without TRACKS; --report draws
                                     them
        --duration S:number          with --plan: duration of each sweep (default:
                                     {PLAN['duration']:g})
        --amplitude RAD:number       with --plan: amplitude of each sweep (default:
                                     {PLAN['amplitude']:g})
        --rate HZ:number             with --plan: sample rate of the cameras (default:
                                     {PLAN['rate']:g})
        --marker-noise-mm MM:number  with --plan: position noise of a marker per axis, 1 sigma
                                     (default: {PLAN['marker_noise_mm']:g})
        --markers N:int              with --plan: markers per cluster (default: {PLAN['markers']})
        --spread-mm MM:number        with --plan: RMS distance of a cluster's markers from their
                                     centre (default: {PLAN['spread_mm']:g})
    """)  # fmt: skip


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
    if not args.plan:
        allow(args, "with --plan", *PLAN)
    if args.source == "kinematics" and not args.plan:
        return _kinematics(args)
    if args.arm is None:
        raise InputError("calibrate: --arm is missing; allowed: a built-in arm or TOML file")
    if args.plan:
        return _plan(args)
    if args.source == "paper":
        return _paper(args)
    if args.tracks is None:
        raise InputError("calibrate: TRACKS is missing; allowed: a file, or --from paper or --plan")
    if args.report:
        check_report(args.report, args.overwrite)
    if args.output:
        check_file(args.output, args.overwrite)
    arm = load_arm(args.arm)
    bodies = parse_bodies(args.bodies) if args.bodies else {}
    looped = bool(arm.mechanism.closures)
    if not looped:
        _allow_none(f"{arm.name} (no closed loop)", args, ("rcm", "closure", "report"))
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


def _kinematics(args: Namespace) -> int:
    """Register bases and joint offsets from the arms' own readings."""
    from trocar.descriptions.table import toml_text
    from trocar.outputs import check_file, write_text
    from trocar.robot.calibration.registration import register, registration_dict
    from trocar.robot.calibration.touches import read_touches

    _allow_none("--from kinematics", args, ("arm", "rcm", "bodies", "closure", "report"))
    if args.tracks is None:
        raise InputError("calibrate: the TOML file of touches is missing (see trocar touches)")
    if args.output:
        check_file(args.output, args.overwrite)
    with progress_steps() as watch:
        watch(f"reading {args.tracks}")
        readings = read_touches(args.tracks)
        found = register(readings, watch)
    boards = next(iter(readings.values())).boards is not None
    document = registration_dict(found, "camera" if boards else "block")
    if args.output:
        write_text(args.output, toml_text({"schema": 1, **document}), args.overwrite)
    for text in document["warnings"]:
        warn(text)
    written = [f"written to {args.output}"] if args.output else []
    print_result(args, document, lambda: "\n\n".join([_registration(found, document), *written]))
    return 0


def _registration(found: Mapping[str, Base], document: dict[str, Any]) -> str:
    placed = {
        f"{name} in the {document['reference']}": one for name, one in document["arms"].items()
    }
    placed |= document["bases"]
    rows = [
        [what, *(f"{1e3 * v:.3f}" for v in one["xyz_m"]),
         *(f"{1e3 * v:.3f}" for v in one["xyz_sigma_m"]),
         *(f"{math.degrees(v):.4f}" for v in one["rpy_rad"]),
         *(f"{math.degrees(v):.4f}" for v in one["turn_sigma_rad"])]
        for what, one in placed.items()
    ]  # fmt: skip
    head = ["base", "x [mm]", "y", "z", "sigma x", "y", "z", "roll [deg]", "pitch", "yaw",
            "sigma about x", "y", "z"]  # fmt: skip
    offsets = [
        [name, joint, f"{1e3 * v.value:.3f}", f"{1e3 * v.sigma:.3f}",
         "not determined" if joint in base.undetermined else ""]
        for name, base in found.items()
        for joint, v in base.offsets.items()
    ]  # fmt: skip
    left = "; ".join(
        f"{name}: {base.readings} readings, {1e3 * base.position_rms:.3f} mm RMS residual per axis"
        for name, base in found.items()
    )
    return "\n\n".join(
        [
            left,
            table(head, rows),
            table(["arm", "joint", "offset [mrad; mm]", "sigma", ""], offsets),
        ]
    )


def _allow_none(what: str, args: Namespace, options: Sequence[str]) -> None:
    """Reject options that do not apply."""
    for given in (name for name in options if getattr(args, name) is not None):
        name = "TRACKS" if given == "tracks" else f"--{given}"
        raise InputError(
            f"{what}: got {name} {getattr(args, given)}; allowed: {what} without {name}"
        )


def _plan(args: Namespace) -> int:
    """Predict the standard deviations of a recording."""
    from trocar.descriptions import load_arm
    from trocar.robot.calibration import Tracks
    from trocar.robot.calibration.budget import error_budget, pose_noise, write_budget
    from trocar.robot.calibration.report import check_report
    from trocar.robot.mocap import MocapSettings, simulate_tracks

    _allow_none("--plan", args, ("tracks", "rcm", "bodies", "closure", "output"))
    if args.source != "tracks":
        raise InputError(f"--plan: got --from {args.source}; allowed: --from tracks")
    if args.report:
        check_report(args.report, args.overwrite)
    given = {k: v if getattr(args, k) is None else getattr(args, k) for k, v in PLAN.items()}
    if not 1.0 <= given["rate"] <= 10000.0:
        raise InputError(f"--rate: got {given['rate']:g}; allowed: 1 to 10000 Hz")
    marker_m, spread_m = 1e-3 * given["marker_noise_mm"], 1e-3 * given["spread_mm"]
    noise = pose_noise(marker_m, int(given["markers"]), spread_m)
    arm = load_arm(args.arm)

    def budget(amplitude: float) -> Budget:
        settings = MocapSettings("kinematic", "", given["duration"], amplitude, PLAN_HZ)
        made = simulate_tracks(arm, settings)
        tracks = Tracks("plan", "", made.times, made.poses, made.rate_hz)
        return error_budget(tracks, arm, noise, made.truth["sweeps_s"], given["rate"])

    with progress_steps("planning") as watch:
        budgets: dict[float, Budget] = {}
        for amplitude in sorted({*AMPLITUDES, given["amplitude"]}):
            watch(f"amplitude {amplitude:g} rad")
            budgets[amplitude] = budget(amplitude)
    found = budgets[given["amplitude"]]
    page = write_budget(args.report, found, budgets, args.overwrite) if args.report else None
    document = {
        **found.as_dict(),
        "amplitude_rad": given["amplitude"],
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


def _paper(args: Namespace) -> int:
    """Fit a geometry to the figures of the paper."""
    from trocar.descriptions import load_arm
    from trocar.descriptions.overlay import write_overlay
    from trocar.outputs import check_file
    from trocar.robot.calibration.paper_robot import paper_twin

    _allow_none("--from paper", args, ("tracks", "rcm", "bodies", "closure", "report"))
    if args.output:
        check_file(args.output, args.overwrite)
    with progress_steps() as watch:
        found = paper_twin(load_arm(args.arm), watch)
    if args.output:
        write_overlay(args.output, found.overlay, overwrite=args.overwrite)
    written = [f"written to {args.output}"] if args.output else []
    print_result(args, found.as_dict(), lambda: "\n\n".join([_twin(found), *written]))
    return 0


def _twin(found: PaperTwin) -> str:
    columns = (
        (found.hardware.position, found.hardware.rms),
        (found.nominal.position, found.nominal.rms_axes),
        (found.twin.position, found.twin.rms_axes),
    )
    rows = [
        [f"axes {label}", *(f"{1e3 * v:.2f}" for v in values)]
        for label, values in found.distances.items()
    ]
    rows += [
        [f"remote centre, {what} {axis}", *(f"{1e3 * column[part][i]:.2f}" for column in columns)]
        for part, what in enumerate(("position", "RMS"))
        for i, axis in enumerate("XYZ")
    ]
    both = [found.missed(found.nominal), found.missed(found.twin)]
    rows += [
        [f"remote centre, {what}", "", *(f"{1e3 * one[part]:.2f}" for one in both)]
        for part, what in enumerate(("distance from the hardware's", "spread missed"))
    ]
    head = ["[mm]", "hardware", "nominal", "calibrated"]
    return f"{found.overlay.arm}: the closed-loop paper's own robot\n{table(head, rows)}"


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
