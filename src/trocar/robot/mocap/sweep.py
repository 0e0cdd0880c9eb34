"""Sweep of an arm before the cameras: still, then its loops folded, then about its centre.

Of an arm without a remote centre every other joint of its chain is swept, too, one after another.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.calibration_plan import hinge_side
from trocar.descriptions.records import ArmDescription
from trocar.descriptions.rigs import lone_arm_rig
from trocar.descriptions.serial_axes import serial_joints
from trocar.errors import InputError
from trocar.simulation import World

Array = NDArray[np.float64]

#: The arm stands still at the start for this long, where a calibration finds its home; each
#: sweep grows in and dies out over a ramp. Source: our own choice. [s]
STILL_S, RAMP_S = 2.0, 1.0
#: A slide is swept by this, and each joint of a chain for this share of a part's duration. Source:
#: our own choice. [m]
SLIDE_M, CHAIN_SHARE = 0.1, 0.6
#: Periods of a sweep a second, at most. Source: closed-loop paper 4.3, its test trajectory. [Hz]
SWEEP_HZ = 0.1
#: About the remote centre the second joint makes three swings to two of the first.
SWINGS_ABOUT_CENTRE = (1.0, 1.5)
#: A sweep stays this far from the limits, and below this share of a joint's velocity limit.
#: Source: our own choice.
MARGIN_RAD, SPEED_SHARE = 0.01, 0.8
#: Steepest slope of a ramp, 10 r^3 - 15 r^4 + 6 r^5, and share of a slide's velocity limit that it
#: takes. Source: our own choice: with the sweep's share below the limit.
STEEPEST, RAMP_SHARE = 1.875, 0.45
SHORTEST_S = STILL_S + 4.0 * RAMP_S
#: Steps that are simulated between two reports of progress. Source: our own choice.
PIECE = 1000
#: The arm settles at its home before the cameras begin. Source: our own choice. [s]
SETTLE_S = 1.0


@dataclass(frozen=True, eq=False)
class Sweep:
    """Set-points of an arm.

    Attributes:
        q: (n, n_joints) [rad or m]
        parts: {"still" | "axes" | "rcm" | "chain": (from, to)} [s]
        swings: {part: {joint: amplitude}} [rad or m]
        spans: {joints that move at once, as "yaw + pitch": (from, to)} [s]
    """

    q: Array
    parts: dict[str, tuple[float, float]]
    swings: dict[str, dict[str, float]]
    spans: dict[str, tuple[float, float]]


def sweep(
    arm: ArmDescription, times: Array, duration_s: float, amplitude: float, parts: tuple[str, ...]
) -> Sweep:
    """Return set-points at given times.

    Args:
        arm: with loops; for the part "rcm" with a remote centre too
        times: (n,), from 0 on [s]
        duration_s: of each part; the still start belongs to the first [s]
        amplitude: of every joint that is swept, less where its range is narrower [rad]
        parts: of "axes", "rcm" and "chain", in this order

    Raises:
        InputError: too short, no amplitude, or an arm without a remote centre
    """
    if not SHORTEST_S <= duration_s < math.inf:
        raise InputError(
            f"duration: got {duration_s:g} s; allowed: at least {SHORTEST_S:g} s, including"
            f" {STILL_S:g} s at rest"
        )
    if not 0.0 < amplitude <= math.pi:
        raise InputError(f"amplitude: got {amplitude:g} rad; allowed: above 0 to pi")
    # Swept joints stand still at 0, the others at the pose "home".
    mechanism = arm.mechanism
    start = np.array(arm.poses.get("home", np.zeros(len(mechanism.joints))), dtype=np.float64)
    swept = folding_joints(arm) if mechanism.closures else []
    start[: max([*swept, *chain_joints(arm)], default=-1) + 1] = 0.0
    start = np.clip(start, mechanism.lower, mechanism.upper)
    q = np.tile(start, (len(times), 1))
    spans = {"still": (0.0, STILL_S)}
    swings: dict[str, dict[str, float]] = {}
    together: dict[tuple[float, float], list[str]] = {}
    begin = STILL_S
    for part, end in zip(parts, part_ends(arm, duration_s, parts), strict=True):
        spans[part], swings[part] = (begin, end), {}
        for joint, from_s, length, share in _turns(arm, part, begin, end):
            # About 0, where the range allows it.
            lower = arm.joints[joint].lower + MARGIN_RAD
            upper = arm.joints[joint].upper - MARGIN_RAD
            most = SLIDE_M if mechanism.joints[joint].kind == "prismatic" else amplitude
            swing = min(most, 0.5 * (upper - lower))
            middle = float(np.clip(0.0, lower + swing, upper - swing))
            name = arm.joints[joint].name
            fastest = SPEED_SHARE * arm.joints[joint].velocity_max / (2.0 * np.pi * swing) / 1.5
            periods = max(1, math.floor(min(SWEEP_HZ, fastest) * length + 1e-9)) * share
            since = times - from_s
            phase = 2.0 * np.pi * periods / length * since
            away = middle - start[joint] + swing * np.sin(phase)
            # Grow from 0 to 1 and die out again, smoothly.
            ramp = RAMP_S
            if mechanism.joints[joint].kind == "prismatic":  # from a stop to the middle of a sweep
                reach = abs(middle - start[joint]) + swing
                ramp = max(ramp, STEEPEST * reach / (RAMP_SHARE * arm.joints[joint].velocity_max))
            r = np.clip(np.minimum(since, length - since) / ramp, 0.0, 1.0)
            q[:, joint] += r**3 * (10.0 - 15.0 * r + 6.0 * r**2) * away
            swings[part][name] = swing
            together.setdefault((from_s, from_s + length), []).append(name)
        begin = end
    return Sweep(q, spans, swings, {" + ".join(n): span for span, n in together.items()})


def part_ends(arm: ArmDescription, duration_s: float, parts: tuple[str, ...]) -> list[float]:
    """Return until when each part lasts [s]."""
    chain = CHAIN_SHARE * duration_s * len(chain_joints(arm))
    lengths = [chain if part == "chain" else duration_s for part in parts]
    if parts[:1] == ("chain",):
        lengths[0] += STILL_S
    return np.cumsum(lengths).tolist()


def chain_joints(arm: ArmDescription) -> list[int]:
    """Return the joints of an arm's chain that are swept one by one: not those of its loops.

    None of an arm with a remote centre that its loops make.
    """
    if has_remote_centre(arm):
        return []
    folding = folding_joints(arm) if arm.mechanism.closures else []
    return [j.column for j in serial_joints(arm) if j.column >= 0 and j.column not in folding]


def has_remote_centre(arm: ArmDescription) -> bool:
    """Tell whether two joints of an arm, of which the second folds its loops, swing about one."""
    if not arm.mechanism.closures:
        return False
    folding = folding_joints(arm)
    return "rcm" in arm.mechanism.frame_index and len(folding) == 1 and folding[0] > 0


def _turns(
    arm: ArmDescription, part: str, begin: float, end: float
) -> list[tuple[int, float, float, float]]:
    """Return (joint, from, length, share of swings) of one part: one by one, or all at once."""
    if part == "chain":
        chain = chain_joints(arm)
        length = (end - begin) / len(chain)
        return [(j, begin + n * length, length, 1.0) for n, j in enumerate(chain)]
    folding = folding_joints(arm)
    if part == "axes":
        length = (end - begin) / len(folding)
        return [(j, begin + n * length, length, 1.0) for n, j in enumerate(folding)]
    if not has_remote_centre(arm):
        raise InputError(f'{arm.name}: has no remote centre; allowed: part "axes" only')
    joints = (folding[0] - 1, folding[0])
    return [
        (j, begin, end - begin, s) for j, s in zip(joints, SWINGS_ABOUT_CENTRE, strict=True)
    ]  # fmt: skip


def marked_frames(arm: ArmDescription) -> dict[str, str]:
    """Return {body: frame} of the links of an arm's loops and of the joints that are swept."""
    mechanism = arm.mechanism
    ends = {frame for c in mechanism.closures for frame in (c.frame_a, c.frame_b)}
    ends |= {joint.frame for joint in serial_joints(arm) if not has_remote_centre(arm)}
    pins = {hinge_side(mechanism, c)[1] for c in mechanism.closures}
    frames = [mechanism.frames[i] for i in sorted({i for n in ends for i in mechanism.chain(n)})]
    links = [f.name for f in frames if f.motion != "fixed" and f.name not in pins]
    return {f"{arm.name}_{name}": name for name in (arm.root, *links)}


def folding_joints(arm: ArmDescription) -> list[int]:
    """Return the indices of the joints that fold an arm's loops, in their order.

    Raises:
        InputError: the arm has no loop
    """
    mechanism = arm.mechanism
    if not mechanism.closures:
        raise InputError(f"{arm.name}: has no closed loop; allowed: an arm with closed loops")
    ends = [(mechanism.chain(c.frame_a), mechanism.chain(c.frame_b)) for c in mechanism.closures]
    hinges = sorted({i for a, b in ends for i in set(a) ^ set(b)})
    return [int(i) for i in np.flatnonzero(np.any(mechanism.ratios[hinges] != 0.0, axis=0))]


def simulated_positions(
    arm: ArmDescription,
    times: Array,
    told: Callable[[Array], Array],
    progress: Callable[[int, int], None] | None = None,
) -> Array:
    """Return the joint positions at given times, (n, n_joints) [rad or m].

    A sample is the state at the end of the physics period that is nearest: all joints of a sample
    are of one moment.

    Args:
        arm: simulated alone, with the dVRK's gains
        times: increasing, from 0 on, (n,) [s]
        told: set-points of given times
        progress: called with (done, all) steps

    Raises:
        InputError: the sweep is faster than a joint may move, or leaves its limits
        DivergedError: the simulation left the finite numbers
    """
    world = World(lone_arm_rig(arm), dynamics="cad")
    (name,) = world.arms
    period = world.timestep
    count = round(float(times[-1]) / period) + 1
    ends = period * np.arange(count, dtype=np.float64)
    goal = told(ends)
    speed = np.asarray(np.gradient(goal, period, axis=0), dtype=np.float64)
    _check(arm, goal, speed)
    world.set_state(name, goal[0])
    world.play({name: np.tile(goal[:1], (round(SETTLE_S / period), 1))}, every=1, record=False)
    found: list[Array] = []
    for begin in range(0, count, PIECE):
        piece = slice(begin, begin + PIECE)
        run = world.play({name: goal[piece]}, {name: speed[piece]}, every=1)
        found.append(run.positions[name])
        if progress is not None:
            progress(min(begin + PIECE, count), count)
    return np.concatenate(found)[np.rint(times / period).astype(int)]


def _check(arm: ArmDescription, goal: Array, speed: Array) -> None:
    for index, joint in enumerate(arm.joints):
        fastest = float(np.abs(speed[:, index]).max())
        if fastest > joint.velocity_max:
            unit = "m/s" if joint.kind == "prismatic" else "rad/s"
            raise InputError(
                f"{arm.name}: {joint.name} would be swept at {fastest:.3g} {unit}; allowed:"
                f" {joint.velocity_max:.3g} {unit}; increase the duration"
            )
        low, high = float(goal[:, index].min()), float(goal[:, index].max())
        if low < joint.lower or high > joint.upper:
            raise InputError(
                f"{arm.name}: {joint.name} would be swept from {low:.3g} to {high:.3g}; allowed:"
                f" {joint.lower:.3g} to {joint.upper:.3g}"
            )
