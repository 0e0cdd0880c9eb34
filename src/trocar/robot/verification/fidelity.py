"""Accuracy of the simulation: each figure measured, beside its bound."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_arm, names
from trocar.descriptions.inertial import apparent_inertias, holding_efforts
from trocar.descriptions.paper import load_printed
from trocar.errors import TrocarError
from trocar.geometry.dh import modified_dh
from trocar.geometry.se3 import pose_difference
from trocar.kinematics import forward
from trocar.kinematics.inverse import inverse_kinematics
from trocar.kinematics.loops import NEAR_FLAT_RAD, flattenings
from trocar.robot.follow import replay
from trocar.robot.verification.figures import Figure
from trocar.simulation import World
from trocar.simulation.arm import Arm
from trocar.simulation.trials import (
    FREQUENCY_HZ,
    TICK_S,
    amplitudes,
    begin_trajectory,
    compiled_poses,
    loop_health,
    paper_sine,
    random_positions,
    tracking_rms,
    whole_pitch,
)

Array = NDArray[np.float64]

FrictionModel = Literal["identified", "paper"]
FRICTIONS: tuple[FrictionModel, ...] = ("identified", "paper")
SEED = 9
POSES = 20
FLOAT_S = 10.0
#: Time in which friction stops a servo [s]. Source: measured, an MTM rests after 0.5 s.
SETTLE_S = 1.0
#: Longest move of an arm [s]; a whole turn of a slow joint takes 8 s.
MOVE_S = 30.0
HALF = np.pi / 2.0
TOOLTIP = np.array([[0, -1, 0, 0], [0, 0, 1, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]])
#: Tip of an endoscope in its last row. Source: SAW mtsIntuitiveResearchKitECM.cpp,
#: set_endoscope_type.
SCOPE_TIP = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def fidelity(watch: Callable[[str], None] | None = None, poses: int = 10_000) -> list[Figure]:
    """Measure every figure but the speeds.

    Args:
        watch: told what is measured next
        poses: random poses of the inverse kinematics
    """
    parts: list[tuple[str, Callable[[], Iterator[Figure]]]] = [
        ("serial chains", serial_chains),
        ("analytic and compiled frames", compiled_frames),
        ("inverse kinematics", lambda: inverse_poses(poses)),
        ("flattening of loops", flat_loops),
        ("static gravity", static_gravity),
        ("loops under 10 N", loops_under_load),
        ("tracking", tracking),
        ("released insertion", released_insertion),
        ("masters in motion", masters_loops),
        ("masters hands-off", hands_off),
        ("set-points at rest", at_set_points),
    ]
    found: list[Figure] = []
    for label, part in parts:
        if watch is not None:
            watch(label)
        found += part()
    return found


def serial_chains() -> Iterator[Figure]:
    """Compare PSM and ECM tips with the dVRK's serial chains over the joint ranges.

    Source: sawIntuitiveResearchKit@9e535e6 share/kinematic/PSM.json, ECM.json, share/tool.
    """
    for name, chain in (("psm", dvrk_psm), ("ecm", dvrk_ecm)):
        arm = load_arm(name)
        q = random_positions(arm, SEED, 10_000)
        metres, radians = pose_difference(forward.pose(arm.mechanism, q), chain(q))
        yield Figure(f"{name} tip against the dVRK's chain", 1e6 * metres.max(), "um", 10.0)
        yield Figure(f"{name} tip against the dVRK's chain", radians.max(), "rad", 1e-9)


def dvrk_psm(q: Array) -> Array:
    """Return the dVRK's own PSM chain with a Large Needle Driver 400006, (..., 4, 4)."""
    zero = np.zeros(q.shape[:-1])
    return (
        modified_dh(0.0, HALF, 0.0, q[..., 0] + HALF)
        @ modified_dh(0.0, -HALF, 0.0, q[..., 1] - HALF)
        @ modified_dh(0.0, HALF, q[..., 2] - 0.4318, zero)
        @ modified_dh(0.0, 0.0, 0.4162, q[..., 3])
        @ modified_dh(0.0, -HALF, 0.0, q[..., 4] - HALF)
        @ modified_dh(0.0091, -HALF, 0.0, q[..., 5] - HALF)
        @ TOOLTIP
    )


def dvrk_ecm(q: Array) -> Array:
    """Return the dVRK's own ECM chain, (..., 4, 4)."""
    zero = np.zeros(q.shape[:-1])
    return (
        modified_dh(0.0, HALF, 0.0, q[..., 0] + HALF)
        @ modified_dh(0.0, -HALF, 0.0, q[..., 1] - HALF)
        @ modified_dh(0.0, HALF, q[..., 2] - 0.3822, zero)
        @ modified_dh(0.0, 0.0, 0.3829, q[..., 3])
        @ SCOPE_TIP
    )


def compiled_frames() -> Iterator[Figure]:
    """Compare every body of the compiled models with the analytic chain, over random joints."""
    worst = 0.0
    for name in names("arms"):
        arm = load_arm(name)
        q = random_positions(arm, SEED, 100)
        try:
            compiled = compiled_poses(arm, q)
        except TrocarError:
            continue  # kinematics only: no masses are known
        analytic = forward.poses(arm.mechanism, q, relative_to=arm.root)
        for frame, pose in compiled.items():
            worst = max(worst, float(np.abs(pose - analytic[frame])[:, :3, 3].max()))
    yield Figure("analytic chain against the compiled model, every frame", worst, "m", 1e-9)


def inverse_poses(count: int) -> Iterator[Figure]:
    """Invert random reachable poses: FK(IK(T)) = T, with the generating q among the solutions."""
    for name in ("psm", "ecm", "mtmr"):
        arm = load_arm(name, "none" if name != "psm" else None)
        mechanism = arm.mechanism
        q = random_positions(arm, SEED, count)
        if name == "psm":
            q[:, 2] = np.where(np.abs(q[:, 2] - 0.0156) > 1e-3, q[:, 2], 0.1)
            q[:, 6:] = 0.0
        if name == "ecm":
            q[:, 2] = np.maximum(q[:, 2], 1e-3)
        target = forward.pose(mechanism, q)
        off, missed = 0.0, 0.0
        for row, pose in zip(q, target, strict=True):
            given = {"platform_angle": row[3]} if name == "mtmr" else {}
            solutions = inverse_kinematics(mechanism, arm.inverse_kinematics, pose, **given)
            wide = np.tile(row, (len(solutions), 1))  # jaw and gripper do not move the tip
            wide[:, : solutions.shape[1]] = solutions
            off = max(off, float(np.abs(forward.pose(mechanism, wide) - pose).max()))
            missed = max(missed, float(np.abs(wide - row).max(axis=1).min()))
        yield Figure(f"{name}: FK(IK(T)) - T, {count} poses", off, "m, rad", 1e-9)
        yield Figure(f"{name}: nearest solution to the generating q", missed, "rad, m", 1e-9)


def flat_loops() -> Iterator[Figure]:
    """Yield each joint range's margin to a singular loop, and the printed tables' singularities."""
    for name in names("arms"):
        found = [f.margin for f in flattenings(load_arm(name).mechanism)]
        if found:
            yield Figure(
                f"{name}: joint range to the nearest flat loop",
                min(found),
                "rad",
                lower=NEAR_FLAT_RAD,
            )
    for table, arm in (("table4", "psm"), ("table5", "ecm")):
        flat = flattenings(load_printed(table).mechanism)
        yield Figure(f"printed {table} ({arm}) flattens at", max(f.below for f in flat), "rad")


def static_gravity() -> Iterator[Figure]:
    """Compare the efforts that hold PSM and ECM with half of their limits, over the range."""
    for name in ("psm", "ecm"):
        arm = load_arm(name)
        lower, upper = arm.mechanism.lower[:3], arm.mechanism.upper[:3]
        axes = [cast("Array", np.linspace(a, b, 11)) for a, b in zip(lower, upper, strict=True)]
        grid = np.meshgrid(*axes)
        q = np.zeros((11**3, len(arm.joints)))
        q[:, :3] = np.stack([g.ravel() for g in grid], axis=-1)
        limits = np.array([j.effort_max for j in arm.joints])
        share = np.abs(holding_efforts(arm, q)).max(axis=0) / limits
        yield Figure(f"{name}: static gravity, largest share of a limit", share.max(), "", 0.5)


def loops_under_load() -> Iterator[Figure]:
    """Turn 10 N about the tip while the pitch sweeps its whole range at 1 ms."""
    for rig in ("psm", "ecm"):
        world = World(rig, tip_load_n=10.0, dynamics="cad")
        sweep = whole_pitch(paper_sine(world.rig, 10.0, TICK_S), world)
        gap, rcm, branch = loop_health(world, sweep, round(TICK_S / world.timestep))
        yield Figure(f"{rig}: loop gap under 10 N", 1e6 * gap, "um", 0.1)
        yield Figure(f"{rig}: remote-centre error under 10 N", 1e6 * rcm, "um", 3.0)
        yield Figure(f"{rig}: branch flips", float(not branch), "", 0.0)


def tracking() -> Iterator[Figure]:
    """Follow Figure 10's sine with Table 8's gains and gravity compensation.

    With the paper's joint model it is bounded, beside what inertia explains (M q'' / P); with the
    identified friction it is reported.
    """
    for friction in ("paper", "identified"):
        world = World(
            "psm", control="paper", friction=friction, gravity_compensation=True, dynamics="cad"
        )
        sine = paper_sine(world.rig, 10.0, TICK_S)
        begin_trajectory(world, sine)
        every = round(TICK_S / world.timestep)
        played = world.play(sine.positions, sine.velocities, every=every)
        for arm, joints in tracking_rms(world, sine, played).items():
            described = world.rig.arm(arm).arm
            inertia = apparent_inertias(described, sine.start[arm])
            swing = amplitudes(described) * (2.0 * np.pi * FREQUENCY_HZ) ** 2 / np.sqrt(2.0)
            for index, (joint, rms) in enumerate(joints.items()):
                if not swing[index]:
                    continue  # the jaw rests, whatever its servo does
                slides = described.joints[index].kind == "prismatic"
                unit, limit = ("mm", 0.15) if slides else ("mrad", 5.0)
                bounded = limit if friction == "paper" else None
                label = f"tracking of {joint}, {friction} friction"
                yield Figure(label, 1e3 * rms, unit, bounded)
                if friction == "paper":
                    gain = world.arms[arm].joints.gains(joint)[0]
                    share = 1e3 * inertia[index] * swing[index] / gain
                    yield Figure(f"  of which inertia explains (M q'' / P) in {joint}", share, unit)


def released_insertion() -> Iterator[Figure]:
    """Release the insertion for a second, without dry friction: how far does it drift?

    The pitch leans it, so that it is the counterweight and the compensation that hold it.
    """
    world = World("psm", friction="paper")
    world.set_state("PSM1", np.array([0.3, 0.6, 0.12, 0.0, 0.0, 0.0, 0.0]))
    arm = next(iter(world.arms.values()))
    arm.joints.set_mode("effort", ["insertion"])
    before = arm.measured_js().position[2]
    world.step(round(1.0 / world.timestep))
    drift = abs(arm.measured_js().position[2] - before)
    yield Figure("psm: drift of the released insertion in 1 s", 1e3 * drift, "mm", 1.0)


def hands_off() -> Iterator[Figure]:
    """Let both masters go (mode effort, no effort) from random poses: how far do their tips drift?

    Without collisions, for at random poses the two would reach through each other.
    """
    for friction in FRICTIONS:
        said = ", no dry friction" if friction == "paper" else ""
        drift = max(drifts("mtm", friction))
        yield Figure(f"mtm: hands-off drift of a tip in 10 s{said}", 1e3 * drift, "mm", 5.0)


def drifts(
    rig: str, friction: FrictionModel, poses: int = POSES, seconds: float = FLOAT_S
) -> list[float]:
    """Measure the drift of the tip of each arm hands-off, from random poses [m]."""
    world = World(rig, friction=friction, collisions=False, dynamics="cad")
    rng = np.random.default_rng(SEED)
    found: list[float] = []
    for _ in range(poses):
        world.reset()
        for name, arm in world.arms.items():
            world.set_state(name, rng.uniform(arm.joints.lower, arm.joints.upper))
            arm.joints.set_mode("effort")
            arm.servo_jf(np.zeros(len(arm.measured_js().position)))
        before = {name: arm.local.measured_cp().matrix[:3, 3] for name, arm in world.arms.items()}
        world.step(round(seconds / world.timestep))
        for name, arm in world.arms.items():
            found.append(
                float(np.linalg.norm(arm.local.measured_cp().matrix[:3, 3] - before[name]))
            )
    return found


def at_set_points() -> Iterator[Figure]:
    """Move every kind of arm to random goals with the dVRK's gains: how near does it come to rest?

    The goals are inside the limits by a tenth of the range, so that no mechanical stop helps.
    """
    for rig in ("psm", "ecm", "mtm"):
        worst = rest_errors(rig)
        for kind, unit, limit in (("revolute", "mrad", 2.0), ("prismatic", "mm", 0.1)):
            found = [error for (_, moves), error in worst.items() if moves == kind]
            if found:
                label = f"{rig}: set-point against measured at rest, {unit}"
                yield Figure(label, 1e3 * max(found), unit, limit)


def rest_errors(rig: str, goals: int = POSES) -> dict[tuple[str, str], float]:
    """Return the largest error at rest of each joint, {(arm/joint, kind): rad or m}."""
    world = World(rig, collisions=False, dynamics="cad")
    rng = np.random.default_rng(SEED)
    found: dict[tuple[str, str], float] = {}
    for _ in range(goals):
        moves = [arm.move_jp(_goal(arm, rng)) for arm in world.arms.values()]
        for move in moves:
            move.wait(MOVE_S)
        world.step(round(SETTLE_S / world.timestep))
        for name, arm in world.arms.items():
            measured, told = arm.measured_js(), arm.setpoint_js()
            for k, joint in enumerate(measured.name):
                key = (f"{name}/{joint}", arm.description.joints[k].kind)
                off = abs(float(measured.position[k] - told.position[k]))
                found[key] = max(found.get(key, 0.0), off)
    return found


def _goal(arm: Arm, rng: np.random.Generator) -> np.ndarray:
    count = len(arm.measured_js().position)
    lower, upper = arm.joints.lower[:count], arm.joints.upper[:count]
    return rng.uniform(lower + 0.1 * (upper - lower), upper - 0.1 * (upper - lower))


def masters_loops() -> Iterator[Figure]:
    """Drive both masters along the whole test sine: largest loop error of their parallelograms."""
    world = World("mtm", dynamics="cad")
    sine = paper_sine(world.rig, 10.0, TICK_S)
    gap, _, branch = loop_health(world, sine, round(TICK_S / world.timestep))
    yield Figure("mtm: loop gap along the test sine", 1e6 * gap, "um", 0.1)
    yield Figure("mtm: branch flips", float(not branch), "", 0.0)


def replayed(log: str | Path) -> Iterator[Figure]:
    """Drive a PSM along a recording of a real one (`trocar.robot.follow`).

    Args:
        log: recording, as for `replay`
    """
    report = replay(log, "psm")
    for joint, rms in report.tracking_rms.items():
        unit, limit = ("mm", 1.0) if joint == "insertion" else ("mrad", 10.0)
        yield Figure(f"replay: tracking of {joint}", 1e3 * rms, unit, limit)
    for joint, rms in report.effort_rms.items():
        limit = 0.5 if joint in ("yaw", "pitch") else None
        unit = "N" if joint == "insertion" else "N m"
        yield Figure(f"replay: effort of {joint}, simulated - recorded", rms, unit, limit)
