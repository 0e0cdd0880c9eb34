"""Errors of calibrations of unseen robots, and the inputs that calibrations reject."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.overlay import apply_overlay, overlay_between, write_overlay
from trocar.descriptions.serial_axes import serial_joints
from trocar.errors import LabelsError, TrocarError
from trocar.geometry import exp_twist
from trocar.kinematics.forward import poses
from trocar.robot.calibration import Tracks, calibrate, calibrate_joints
from trocar.robot.calibration.axes import Value
from trocar.robot.calibration.rcm import find_rcm
from trocar.robot.mocap import MarkerNoise, MocapSettings, broken, perturbed, simulate_tracks
from trocar.robot.mocap.simulate import Parts
from trocar.robot.verification import verify
from trocar.robot.verification.figures import Figure
from trocar.simulation import World

Array = NDArray[np.float64]

#: Source: `trocar mocap`.
NOISE = MarkerNoise(1e-4, float(np.radians(0.05)))
#: Goals of every sample seen, with this noise: axis distance, median and 95 %, and remote centre,
#: median. Source: our own choice. [m]
GOALS = (6e-6, 18e-6, 13e-6)
#: Loops of robots whose parallelograms are broken. Source: the closed-loop paper, Table 6. [m]
LOOPS_M = 1e-3
NAMES = ("psm", "ecm")
#: Arms whose joints are measured one after another, at this rate [Hz], a quarter as many of each.
CHAINS, CHAIN_HZ, CHAIN_SHARE = ("suj_psm1", "mtml"), 30.0, 4
WHERE = ("axes", "rcm", "both", "one file")
#: Poses at which last links are compared, and how much a turn counts. Source: our own choice. [m]
POSES, LEVER_M = 30, 0.3
#: Parts of `trocar verify` that depend on the geometry.
VERIFIED = ("closure", "rcm", "axes", "formats")


def unseen_robots(robots: int, watch: Callable[[str], None]) -> list[Figure]:
    """Calibrate robots of both kinds.

    Args:
        robots: of each kind
        watch: called with what is measured next
    """
    found: list[Figure] = []
    for title, noise, least, most in (
        ("white noise", NOISE, 0.93, 0.97),
        ("5 % lost, 1 % outliers", replace(NOISE, dropout=0.05, outliers=0.01), 0.92, 0.98),
    ):
        watch(title)
        found += accuracy(robots, noise, title, (least, most))
    watch("exchanged labels")
    found += exchanges()
    watch("broken loops")
    found += wandering(robots)
    found.append(free_arm())
    watch("setup joints and masters")
    found += chains(max(1, robots // CHAIN_SHARE))
    watch("calibrated robots, verified")
    found += verified()
    return found


@dataclass
class Errors:
    """Errors of many figures [m], and the same over their standard deviations."""

    values: list[float] = field(default_factory=list[float])
    scaled: list[float] = field(default_factory=list[float])

    def add(self, found: Mapping[str, Value], truth: Mapping[str, float]) -> None:
        """Count what was measured."""
        for name, value in found.items():
            self.values.append(abs(value.value - truth[name]))
            self.scaled.append(self.values[-1] / value.sigma)

    def add_place(self, place: Array, sigma: Array, truth: Array) -> None:
        """Count a point: its distance from the truth, and each coordinate's interval."""
        self.values.append(float(np.linalg.norm(place - truth)))
        self.scaled += np.abs((place - truth) / sigma).tolist()

    def quantile(self, part: float) -> float:
        """Return a quantile of the errors."""
        return float(np.quantile(self.values, part))

    @property
    def covered(self) -> float:
        """The share of 95 % intervals that hold the truth."""
        return float(np.mean(np.array(self.scaled) < 1.96))


def take(
    arm: ArmDescription, parts: Parts, noise: MarkerNoise, seed: int, rate_hz: float = 120.0
) -> tuple[Tracks, Mapping[str, Any]]:
    """Return 24 s of each sweep, 0.6 rad, and the truth."""
    settings = MocapSettings("kinematic", parts, noise=noise, seed=seed, rate_hz=rate_hz)
    made = simulate_tracks(arm, settings)
    return Tracks(f"{parts}.csv", "", made.times, made.poses, made.rate_hz), made.truth


def draws(robots: int) -> Iterator[tuple[ArmDescription, int]]:
    """Yield each kind of arm with so many seeds of its own.

    With the same seeds the two kinds would have the same noise on their bases, so that the errors
    of one remote centre are those of the other, and half of the intervals show nothing new.
    """
    for kind, name in enumerate(NAMES):
        for k in range(robots):
            yield load_arm(name), kind + len(NAMES) * k


def accuracy(
    robots: int, noise: MarkerNoise, title: str, covered: tuple[float, float]
) -> Iterator[Figure]:
    """Calibrate perturbed robots."""
    distances, betas, centres = Errors(), Errors(), Errors()
    for nominal, seed in draws(robots):
        robot = perturbed(nominal, np.random.default_rng(seed))
        tracks, truth = take(robot, "both", noise, seed)
        found = calibrate(tracks, nominal)
        distances.add(found.axis_distances, truth["axis_distances_m"])
        betas.add(found.betas, truth["beta_rad"])
        if found.centre is not None:
            fit, place = found.centre.fit, truth["rcm"]["position_in_base_body_m"]
            centres.add_place(fit.post, fit.sigma_post, np.array(place))
    every = distances.scaled + betas.scaled + centres.scaled
    source = f"{robots} perturbed robots of each of {', '.join(NAMES)}"
    for what, value, most in (
        ("axis distance, median", distances.quantile(0.5), GOALS[0]),
        ("axis distance, 95 %", distances.quantile(0.95), GOALS[1]),
        ("remote centre, median", centres.quantile(0.5), GOALS[2]),
    ):
        goal = most if noise == NOISE else None
        yield Figure(f"{what}, {title}", value, "m", goal, shown="um", source=source)
    low, high = covered
    share = float(np.mean(np.array(every) < 1.96))
    yield Figure(f"95 % intervals that hold, {title}", share, "", high, low, source=source)
    for what, part in (("distances", distances), ("betas", betas), ("remote centres", centres)):
        yield Figure(f"  of which of {what}", part.covered, "", source=source)


def exchanges() -> Iterator[Figure]:
    """Exchange each pair of labels: in either take, in both, in one file."""
    for name in NAMES:
        arm = load_arm(name)
        robot = perturbed(arm, np.random.default_rng(5))
        takes = {p: take(robot, p, NOISE, 5)[0] for p in ("axes", "rcm", "both")}
        named = [
            exchange_is_named(arm, takes, pair, where)
            for pair in combinations(takes["both"].poses, 2)
            for where in WHERE
        ]
        label = f"{name}: exchanged labels named, of {len(named)} exchanges"
        yield Figure(label, float(np.mean(named)), "", lower=1.0)


def exchange_is_named(
    arm: ArmDescription, takes: Mapping[str, Tracks], pair: tuple[str, str], where: str
) -> bool:
    """Return whether tracks with two exchanged labels are rejected, and these two named."""

    def exchanged(tracks: Tracks) -> Tracks:
        poses, (one, two) = dict(tracks.poses), pair
        poses[one], poses[two] = poses[two], poses[one]
        return replace(tracks, poses=poses)

    axes, rcm = takes["axes"], takes["rcm"]
    try:
        if where == "one file":
            calibrate(exchanged(takes["both"]), arm)
        else:
            calibrate(
                axes if where == "rcm" else exchanged(axes),
                arm,
                rcm if where == "axes" else exchanged(rcm),
            )
    except LabelsError as error:
        files = ["both.csv"] if where == "one file" else ["axes.csv", "rcm.csv"]
        wrong = [f for f in files if where in ("both", "one file") or f == f"{where}.csv"]
        return all(
            {b for b, label in labels.items() if b != label}
            == (set(pair) if file in wrong else set())
            for file, labels in error.labels.items()
        )
    except TrocarError:
        pass
    return False


def wandering(robots: int) -> Iterator[Figure]:
    """Find the point of smallest error of robots with broken loops."""
    centres = Errors()
    for nominal, seed in draws(robots):
        rng = np.random.default_rng(seed)
        tracks, truth = take(broken(perturbed(nominal, rng), rng, LOOPS_M), "both", NOISE, seed)
        fit = find_rcm(tracks, nominal).fit
        place = np.array(truth["rcm"]["position_in_base_body_m"])
        centres.add_place(fit.post, fit.sigma_post, place)
    label = f"remote centre, loops broken by {1e3 * LOOPS_M:g} mm"
    yield Figure(f"{label}, median", centres.quantile(0.5), "m", shown="um")
    yield Figure(f"{label}: 95 % intervals that hold", centres.covered, "", lower=0.92)


def chains(robots: int) -> Iterator[Figure]:
    """Calibrate setup joints and masters with lost and wrong samples."""
    noise = replace(NOISE, dropout=0.05, outliers=0.01)
    for name in CHAINS:
        nominal = load_arm(name)
        distances, angles = Errors(), Errors()
        ends: list[tuple[float, float]] = []
        for seed in range(robots):
            robot = perturbed(nominal, np.random.default_rng(seed))
            tracks, truth = take(robot, "", noise, seed, CHAIN_HZ)
            loops = calibrate(tracks, nominal) if nominal.mechanism.closures else None
            found = calibrate_joints(tracks, nominal, loops)
            distances.add(found.distances, truth["joints"]["distances_m"])
            angles.add(found.angles, truth["joints"]["angles_rad"])
            mine = apply_overlay(nominal, found.overlay)
            ends.append((last_link(mine, robot), last_link(nominal, robot)))
        every, end = distances.scaled + angles.scaled, np.median(ends, axis=0)
        source = f"{robots} perturbed robots, 5 % lost, 1 % outliers, {CHAIN_HZ:g} Hz"
        label = f"{name}: axis to axis"
        yield Figure(f"{label}, median", distances.quantile(0.5), "m", shown="um", source=source)
        yield Figure(f"{label}, 95 %", distances.quantile(0.95), "m", shown="um", source=source)
        share = float(np.mean(np.array(every) < 1.96))
        yield Figure(f"{label}: 95 % intervals that hold", share, "", source=source)
        for what, off in zip(("calibrated", "as drawn"), end, strict=True):
            label = f"{name}: last link {what}, RMS, median"
            yield Figure(label, float(off), "m", shown="mm", source=source)


def last_link(arm: ArmDescription, robot: ArmDescription) -> float:
    """Return the RMS distance of an arm's last link from a robot's over their ranges [m].

    What tracks cannot tell is fitted: the place of the arm, and of the frame on its last link.
    """
    mechanism = robot.mechanism
    low, high = np.maximum(mechanism.lower, -1.0), np.minimum(mechanism.upper, 1.0)
    q = np.random.default_rng(0).uniform(low, high, (POSES, len(mechanism.joints)))
    last = serial_joints(robot)[-1].frame
    ours, true = (poses(a.mechanism, q, a.root)[last] for a in (arm, robot))

    def left(x: Array) -> Array:
        away = exp_twist(x[:6]) @ true @ exp_twist(x[6:]) - ours
        return np.concatenate([away[:, :3, 3].ravel(), LEVER_M * away[:, :3, :3].ravel()])

    fitted = cast(Any, least_squares(left, np.zeros(12), xtol=1e-15, ftol=1e-15))
    return float(np.linalg.norm(fitted.fun[: 3 * POSES]) / np.sqrt(POSES))


def free_arm() -> Figure:
    """Let a PSM with broken loops go, without dry friction, under gravity compensation."""
    nominal = load_arm("psm")
    overlay = overlay_between(nominal, broken(nominal, np.random.default_rng(0), LOOPS_M))
    world = World("psm", calibration=overlay, friction="paper")
    arm = world.arm("PSM1")
    arm.free()
    before = arm.measured_js().position[:2]
    world.step(round(5.0 / world.timestep))
    drift = float(np.abs(arm.measured_js().position[:2] - before).max())
    return Figure("psm: drift of a free arm with broken loops in 5 s", drift, "rad", 1e-3,
                  shown="mrad")  # fmt: skip


def verified() -> Iterator[Figure]:
    """Count what `trocar verify` finds wrong with a calibrated robot of each kind."""
    for name in NAMES:
        nominal = load_arm(name)
        tracks, _ = take(perturbed(nominal, np.random.default_rng(5)), "both", NOISE, 5)
        with TemporaryDirectory() as folder:
            file = Path(folder) / "robot.toml"
            write_overlay(file, calibrate(tracks, nominal).overlay)
            found = verify((), (file,), VERIFIED)
        label = f"{name}: figures of a calibrated robot that verify misses, of {found.judged}"
        yield Figure(label, len(found.missed), "", upper=0.0)
