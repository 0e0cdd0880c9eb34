"""Tracks of the links of a simulated arm, as cameras would tell them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from trocar.apps.mocap.clusters import place_camera, place_clusters
from trocar.apps.mocap.dynamic import simulated_positions
from trocar.apps.mocap.linkage import marked_frames
from trocar.apps.mocap.noise import Noise, spoil
from trocar.apps.mocap.sweeps import STILL_S, has_remote_centre, sweep
from trocar.apps.mocap.truth import geometry
from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError
from trocar.kinematics.forward import coordinates
from trocar.kinematics.tree import frame_poses

Array = NDArray[np.float64]
Motion = Literal["dynamic", "kinematic"]
Parts = Literal["", "axes", "rcm", "both"]
PARTS: Mapping[str, tuple[str, ...]] = {
    "axes": ("axes",), "rcm": ("rcm",), "both": ("axes", "rcm"),
}  # fmt: skip
#: The rates that a camera system may have. [Hz]
RATES_HZ = (10.0, 1000.0)


@dataclass(frozen=True)
class MocapSettings:
    """How an arm is swept and seen.

    Attributes:
        motion: "dynamic" (joints simulated with their servos) or "kinematic" (exactly as told)
        parts: sweeps of the loops for their axes, about the remote centre, or both in turn; "" is
            both for an arm that has a remote centre, else "axes"
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
    noise: Noise = field(default_factory=Noise)
    seed: int = 0


@dataclass(frozen=True, eq=False)
class SimulatedTracks:
    """What the cameras tell, and the truth.

    Attributes:
        times: (n,) [s]
        poses: {body: T_camera_body (n, 4, 4)}, NaN where it is lost
        q: where the arm was told to be, (n, n_joints) [rad or m]
        rate_hz: samples a second
        truth: what a calibration should find, and how it was made, as plain data
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
        arm: with closed loops; for the part "rcm" with a remote centre
        settings: the default ones when omitted
        progress: is told (done, all) of the simulation's periods
        robot: what the truth shall call the arm

    Raises:
        InputError: settings that cannot be used, an arm without loops
        DivergedError: the simulation left the finite numbers
    """
    wanted = settings or MocapSettings()
    _check(wanted)
    parts = PARTS[wanted.parts or ("both" if has_remote_centre(arm) else "axes")]
    count = round(len(parts) * wanted.duration_s * wanted.rate_hz) + 1
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
    camera, clusters = place_camera(cameras), place_clusters(places, bodies)
    at = frame_poses(arm.mechanism, moved)
    seen = {
        body: spoil(
            camera @ at[arm.mechanism.frame_index[frame]] @ clusters[body], wanted.noise, spoiling
        )
        for body, frame in bodies.items()
    }
    truth = {
        "arm": arm.name,
        "robot": robot,
        **geometry(arm, clusters[next(iter(bodies))], _swing(arm, wanted)),
        **_set_up(bodies, clusters, camera),
        "parts_s": {part: list(span) for part, span in told.parts.items()},
        "swings_rad": told.swings,
        "settings": asdict(wanted),
    }
    return SimulatedTracks(times, seen, told.q, wanted.rate_hz, truth)


def _set_up(
    bodies: Mapping[str, str], clusters: Mapping[str, Array], camera: Array
) -> dict[str, Any]:
    """Return where the clusters and the cameras are, as plain data."""
    places = {
        body: {"frame": frame, "T_link_body": clusters[body].tolist()}
        for body, frame in bodies.items()
    }
    return {"bodies": places, "T_camera_root": camera.tolist()}


def _swing(arm: ArmDescription, settings: MocapSettings) -> Array | None:
    """Return joint positions about the remote centre, (n, n_joints), None where there is none."""
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
        raise InputError(f"seed: got {settings.seed}; allowed: a whole number from 0 on")
