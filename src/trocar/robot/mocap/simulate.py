"""Tracks of the links of a simulated arm, as cameras would tell them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from trocar.descriptions.axis_lines import Line, home_lines, line_angle, line_distance
from trocar.descriptions.calibration_plan import default_plan, hinge_side
from trocar.descriptions.records import ArmDescription
from trocar.descriptions.serial_axes import serial_figures, serial_joints
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_quaternion, matrix_from_rotation_vector
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.forward import coordinates, poses
from trocar.kinematics.tree import frame_poses
from trocar.robot.mocap.sweep import (
    STILL_S,
    chain_joints,
    has_remote_centre,
    marked_frames,
    part_ends,
    simulated_positions,
    sweep,
)

Array = NDArray[np.float64]
Motion = Literal["dynamic", "kinematic"]
Parts = Literal["", "axes", "rcm", "both", "chain"]
PARTS: Mapping[str, tuple[str, ...]] = {
    "axes": ("axes",), "rcm": ("rcm",), "both": ("axes", "rcm"), "chain": ("chain",),
}  # fmt: skip
#: The rates that a camera system may have. [Hz]
RATES_HZ = (10.0, 1000.0)

#: A body is lost for this many samples on average, and a gross error is this far off.
#: Source: our own choice; 20 mm is a marker taken for its neighbour. [samples, m]
BURST_SAMPLES, OUTLIER_M = 12, 0.020
#: Clusters lie within this of the origin of their link's frame, the camera's frame within this of
#: the arm's root, along each axis. Source: our own choice. [m]
ON_LINK_M, IN_ROOM_M = 0.15, 2.0


@dataclass(frozen=True)
class MarkerNoise:
    """Errors of the cameras.

    Attributes:
        position: standard deviation along each axis [m]
        rotation: standard deviation about each axis [rad]
        dropout: share of samples in which a body is lost, in bursts
        outliers: share of samples that are 20 mm off and turned anyhow
        correlation_s: time constant of position and rotation noise, 0 for white noise [s]
    """

    position: float = 0.0
    rotation: float = 0.0
    dropout: float = 0.0
    outliers: float = 0.0
    correlation_s: float = 0.0

    def __post_init__(self) -> None:
        for name, most in (("position", 1.0), ("rotation", 1.0), ("dropout", 0.9),
                           ("outliers", 0.5), ("correlation_s", 10.0)):  # fmt: skip
            got = getattr(self, name)
            if not 0.0 <= got <= most:
                raise InputError(f"noise, {name}: got {got!r}; allowed: 0 to {most:g}")


def spoil(
    poses: Array, noise: MarkerNoise, rng: np.random.Generator, rate_hz: float = 120.0
) -> Array:
    """Return one body's poses as cameras tell them, NaN where it is lost, (n, 4, 4).

    As many random numbers are drawn whatever the noise is, so that each kind can be had alone.
    """
    count = len(poses)
    shift, turn = rng.normal(size=(count, 3)), rng.normal(size=(count, 3))
    if noise.correlation_s:  # the first-order Gauss-Markov process, from its steady state
        keep = math.exp(-1.0 / (noise.correlation_s * rate_hz))
        for series in (shift, turn):
            series[1:] *= math.sqrt(1.0 - keep**2)
            series[:] = lfilter([1.0], [1.0, -keep], series, axis=0)
    way, anyhow = rng.normal(size=(count, 3)), random_rotations(rng, count)
    wrong = rng.uniform(size=count) < noise.outliers
    lost = _bursts(rng.uniform(size=count), noise.dropout)
    found = poses.copy()
    found[:, :3, 3] += noise.position * shift
    found[:, :3, :3] = found[:, :3, :3] @ matrix_from_rotation_vector(noise.rotation * turn)
    way *= OUTLIER_M / np.linalg.norm(way, axis=1, keepdims=True)
    found[wrong, :3, 3] += way[wrong]
    found[wrong, :3, :3] = anyhow[wrong]
    found[lost] = np.nan
    return found


def _bursts(chances: Array, share: float) -> NDArray[np.bool_]:
    """Return a mask of lost samples: two states that change by chance, (n,)."""
    end = 1.0 / BURST_SAMPLES
    begin = share * end / (1.0 - share)
    lost = np.zeros(len(chances), dtype=bool)
    state = bool(chances[0] < share)
    for index, chance in enumerate(chances[1:].tolist(), 1):
        lost[index - 1] = state
        state = chance >= end if state else chance < begin
    lost[-1] = state
    return lost


def random_rotations(rng: np.random.Generator, count: int) -> Array:
    """Return rotations of which none is more likely than another, (count, 3, 3)."""
    return matrix_from_quaternion(rng.normal(size=(count, 4)))


def random_pose(rng: np.random.Generator, reach: float) -> Array:
    """Return a pose in any orientation within a cube of half this edge, (4, 4)."""
    return transform(random_rotations(rng, 1)[0], rng.uniform(-reach, reach, 3))


def geometry(
    arm: ArmDescription, clusters: Mapping[str, Array], swing: Array | None
) -> dict[str, Any]:
    """Return axis distances, angles and the remote centre, as `trocar calibrate` names them.

    A remote centre that wanders is the point that fits best, with the RMS by which the link that
    carries the instrument misses it.

    Distances and angles of axes are given in the plane across them through the origin of the first
    axis' frame (see `descriptions.axis_lines`).

    Args:
        arm: as it is
        clusters: {frame: its marker cluster, T_frame_cluster (4, 4)}, the root's first
        swing: joint positions about the remote centre, (n, n_joints); None without one
    """
    mechanism = arm.mechanism
    joints: dict[str, Any] = {} if has_remote_centre(arm) else {"joints": _chain(arm, clusters)}
    if not mechanism.closures:
        return joints
    plan = arm.calibration or default_plan(mechanism)
    axes = home_lines(mechanism, plan.axes)
    pitch = next(iter(axes.values()))
    found: dict[str, Any] = joints | {
        "axis_distances_m": {
            f"{a}-{b}": line_distance(axes[a], axes[b], pitch.point) for a, b in plan.distances
        }
    }
    if plan.betas:
        found["beta_rad"] = {
            name: line_angle(
                (axes[to[0]], axes[to[1]]), (axes[start[0]], axes[start[1]]), pitch.point
            )
            - 0.5 * np.pi
            for name, (to, start) in plan.betas.items()
        }
    if swing is not None:
        body, _ = hinge_side(mechanism, mechanism.closures[-1])
        end = poses(mechanism, swing, arm.root)[body]
        centre, misses = _fixed_point(end)
        seen = inverse(clusters[arm.root]) @ np.append(centre, 1.0)
        found["rcm"] = {
            "position_in_base_body_m": seen[:3].tolist(),
            "distance_to_pitch_axis_m": line_distance(pitch, Line(centre, pitch.direction), centre),
            "rms_m": float(np.sqrt((misses**2).sum(axis=1).mean())),
        }
    return found


def _chain(arm: ArmDescription, clusters: Mapping[str, Array]) -> Mapping[str, Any]:
    """Return the figures of the chain's axes to one another, as `trocar calibrate` names them."""
    mechanism = arm.mechanism
    at = poses(mechanism, np.clip(np.zeros(len(arm.joints)), mechanism.lower, mechanism.upper),
               arm.root)  # fmt: skip
    return serial_figures(
        serial_joints(arm), {link: (at[link] @ T)[:3, 3] for link, T in clusters.items()}
    )


def _fixed_point(poses: Array) -> tuple[Array, Array]:
    """Return the point that a body keeps stillest, (3,), and how far it misses it, (n, 3) [m].

    Source: closed-loop paper, equations 3 and 4.
    """
    R, p = poses[:, :3, :3], poses[:, :3, 3]
    rows = np.concatenate([R, np.broadcast_to(-np.eye(3), R.shape)], axis=2).reshape(-1, 6)
    both, *_ = np.linalg.lstsq(rows, -p.reshape(-1), rcond=None)
    tip, post = both[:3].astype(np.float64), both[3:].astype(np.float64)
    return post, R @ tip + p - post


@dataclass(frozen=True)
class MocapSettings:
    """Settings of an arm's sweep and of the cameras.

    Attributes:
        motion: "dynamic" (joints simulated with their servos) or "kinematic" (exactly as told)
        parts: sweeps of the loops for their axes, about the remote centre, or both in turn, or of
            the joints of the chain; "" is both for an arm that has a remote centre, else those of
            its loops and of its chain
        duration_s: of each part [s]
        amplitude: of the joints that are swept [rad]
        rate_hz: of the cameras [Hz]
        noise: how bad they are
        seed: of everything random
    """

    motion: Motion = "dynamic"
    parts: Parts = ""
    duration_s: float = 24.0
    amplitude: float = 0.6
    rate_hz: float = 120.0
    noise: MarkerNoise = field(default_factory=MarkerNoise)
    seed: int = 0


@dataclass(frozen=True, eq=False)
class SimulatedTracks:
    """Recording of the cameras, and the truth.

    Attributes:
        times: (n,) [s]
        poses: {body: T_camera_body (n, 4, 4)}, NaN where it is lost
        q: the arm's set-points, (n, n_joints) [rad or m]
        rate_hz: samples a second
        truth: the figures that a calibration should find, and the settings, as plain data
    """

    times: Array
    poses: Mapping[str, Array]
    q: Array
    rate_hz: float
    truth: Mapping[str, Any]


def simulate_tracks(
    arm: ArmDescription,
    settings: MocapSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
    robot: str = "as drawn",
) -> SimulatedTracks:
    """Sweep an arm before cameras.

    With dynamics the joints are where servos, friction and gravity leave them; the other links are
    where the loops, closed exactly, have them at these joint positions. The gaps of the simulated
    loops are a matter of the simulation and not in the tracks.

    Clusters sit at random places on the links, the cameras at a random place of the room; both
    depend on the seed alone, not on noise or motion.

    Args:
        arm: for the part "axes" with closed loops, for "rcm" with a remote centre
        settings: the default ones when omitted
        progress: is told (done, all) of the simulation's periods
        robot: what the truth shall call the arm

    Raises:
        InputError: settings that cannot be used, an arm without what is to be swept
        DivergedError: the simulation left the finite numbers
    """
    wanted = settings or MocapSettings()
    _check(wanted)
    parts = _parts(arm, wanted.parts)
    end = part_ends(arm, wanted.duration_s, parts)[-1]
    count = round(end * wanted.rate_hz) + 1
    times = np.arange(count) / wanted.rate_hz
    told = sweep(arm, times, wanted.duration_s, wanted.amplitude, parts)

    def at_times(other: Array) -> Array:
        return sweep(arm, other, wanted.duration_s, wanted.amplitude, parts).q

    q = told.q
    if wanted.motion == "dynamic":
        q = simulated_positions(arm, times, at_times, progress)
    moved = coordinates(arm.mechanism, q)  # loops as rigid links close them, not the simulation's
    bodies = marked_frames(arm)
    places, cameras, spoiling = (
        np.random.default_rng(s) for s in np.random.SeedSequence(wanted.seed).spawn(3)
    )
    camera = random_pose(cameras, IN_ROOM_M)  # T_camera_root
    clusters = {body: random_pose(places, ON_LINK_M) for body in bodies}
    at = frame_poses(arm.mechanism, moved)
    seen = {
        body: spoil(
            camera @ at[arm.mechanism.frame_index[frame]] @ clusters[body],
            wanted.noise,
            spoiling,
            wanted.rate_hz,
        )
        for body, frame in bodies.items()
    }
    truth = {
        "arm": arm.name,
        "robot": robot,
        **geometry(arm, {bodies[b]: T for b, T in clusters.items()}, _swing(arm, wanted)),
        "bodies": {
            body: {"frame": frame, "T_link_body": clusters[body].tolist()}
            for body, frame in bodies.items()
        },
        "T_camera_root": camera.tolist(),
        "parts_s": {part: list(span) for part, span in told.parts.items()},
        "swings_rad": told.swings,
        "sweeps_s": {joints: list(span) for joints, span in told.spans.items()},
        "settings": asdict(wanted),
    }
    return SimulatedTracks(times, seen, told.q, wanted.rate_hz, truth)


def _parts(arm: ArmDescription, asked: Parts) -> tuple[str, ...]:
    """Return the parts of a sweep, in turn."""
    if asked == "chain" and not chain_joints(arm):
        raise InputError(f'{arm.name}: parts: got "chain"; allowed: axes, rcm, both')
    if asked:
        return PARTS[asked]
    if has_remote_centre(arm):
        return PARTS["both"]
    return (
        *(("axes",) if arm.mechanism.closures else ()),
        *(("chain",) if chain_joints(arm) else ()),
    )


def _swing(arm: ArmDescription, settings: MocapSettings) -> Array | None:
    """Return joint positions about the remote centre, (n, n_joints), or None without one."""
    if not has_remote_centre(arm):
        return None
    times = np.linspace(STILL_S, settings.duration_s, 400)
    return sweep(arm, times, settings.duration_s, settings.amplitude, ("rcm",)).q


def _check(settings: MocapSettings) -> None:
    for name, got, allowed in (
        ("motion", settings.motion, ("dynamic", "kinematic")),
        ("parts", settings.parts or "both", tuple(PARTS)),
    ):
        if got not in allowed:
            raise InputError(f"{name}: got {got!r}; allowed: {', '.join(allowed)}")
    if not RATES_HZ[0] <= settings.rate_hz <= RATES_HZ[1]:
        low, high = RATES_HZ
        raise InputError(f"rate: got {settings.rate_hz:g}; allowed: {low:g} to {high:g} Hz")
    if settings.seed < 0:
        raise InputError(f"seed: got {settings.seed}; allowed: an integer of 0 or more")
