"""Motion in time: six joints along a sine (Figure 10), and the real-time factor (Table 9)."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.rendering import Endoscope
from trocar.robot.verification.figures import Figure, ReportPart
from trocar.robot.verification.speed import CONFIGURATIONS, time_beside_bare
from trocar.robot.verification.subject import Model, Subject
from trocar.simulation import World
from trocar.simulation.trials import RAMP_S, TICK_S, begin_trajectory, paper_sine, periods_per_tick

Array = NDArray[np.float64]

#: Duration of one period of the sine and of the second in which it grows [s]. Source: closed-loop
#: paper 4.3, 0.1 Hz.
DURATION_S = 11.0
#: {model: {kind of joint: most RMS error}} [rad, m]. Source: the project's own goals: with Table
#: 8's gains 5 mrad and 0.15 mm, with the dVRK's what a replay of a recording is allowed.
LIMITS: dict[Model, dict[str, float]] = {
    "paper": {"revolute": 5e-3, "prismatic": 0.15e-3},
    "dvrk": {"revolute": 10e-3, "prismatic": 1e-3},
}
TOLD: dict[Model, str] = {"paper": "Table 8's gains", "dvrk": "the dVRK's gains"}


@dataclass(frozen=True, eq=False)
class TrackedJoints:
    """Commanded and actual joint positions with one set of gains.

    Attributes:
        model: which gains and which friction
        joints, kinds: of the arm alone, without the jaw
        gains: (P, I, D) of each joint
        time: (k,) [s]
        commanded, actual: (k, n) [rad or m]
    """

    model: Model
    joints: tuple[str, ...]
    kinds: tuple[str, ...]
    gains: tuple[tuple[float, float, float], ...]
    time: Array
    commanded: Array
    actual: Array

    @property
    def error(self) -> Array:
        """Actual minus commanded, (k, n) [rad or m]."""
        return self.actual - self.commanded

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Samples after the first second, in which the sine grows, (k,)."""
        return self.time > RAMP_S


def tracking(subject: Subject) -> ReportPart:
    """Follow the paper's sine with Table 8's gains and with the dVRK's."""
    title = "Tracking: Figure 10 of the paper"
    command = subject.command("tracking")
    if subject.arm.type != "PSM" or not subject.simulated:
        note = ("Figure 10 and Table 8 are of a PSM that is simulated",)
        return ReportPart("tracking", subject.name, title, (), command, note)
    tracks = (track(subject, "paper"), track(subject, "dvrk"))
    figures = [figure for each in tracks for figure in _figures(each)]
    figures += _hanging(track(subject, "paper", compensated=False))
    notes = (
        "Sine of 0.1 Hz about the middle of each joint's range, 1 rad or 0.1 m, at most 95 % of"
        " half the range (which the pitch is held to). It grows in during the first second, which"
        " does not count.",
        "Gravity is compensated, so that it is the gains that are judged. Without that, as the"
        " paper has it, the links sag by gravity over stiffness, which is stated. With Table 8's"
        " gains joints have the paper's damping of 0.1 and no dry friction, with the dVRK's the"
        " friction identified on a real PSM.",
        'The paper draws Figure 10 and says "good stability and minimal delay"; it has no numbers.',
    )
    return ReportPart("tracking", subject.name, title, tuple(figures), command, notes, tracks)


def track(subject: Subject, model: Model, compensated: bool = True) -> TrackedJoints:
    """Play the sine once, with gravity compensated or not."""
    world, arm = subject.world(model), subject.arm
    sine = paper_sine(world.rig, DURATION_S, TICK_S)
    begin_trajectory(world, sine)
    world.arm(subject.place).joints.use_gravity_compensation(compensated)
    played = world.play(sine.positions, sine.velocities, every=periods_per_tick(world))
    name, own = subject.place, arm.own_joints
    joints = arm.joints[:own]
    return TrackedJoints(
        model,
        tuple(j.name for j in joints),
        tuple(j.kind for j in joints),
        tuple(world.arm(name).joints.gains(j.name) for j in joints),
        played.time,
        sine.expected[name][:, :own],
        played.positions[name][:, :own],
    )


def delays(found: TrackedJoints) -> Array:
    """Estimate the lag of each joint behind its set-point by least squares, (n,) [s].

    A joint that is late by t is off by -t times its speed.
    """
    speed = np.gradient(found.commanded, found.time, axis=0)[found.counted]
    error = found.error[found.counted]
    return -np.sum(error * speed, axis=0) / np.sum(speed**2, axis=0)


def _figures(found: TrackedJoints) -> list[Figure]:
    figures: list[Figure] = []
    error = found.error[found.counted]
    rms, most = np.sqrt(np.mean(error**2, axis=0)), np.abs(error).max(axis=0)
    source = (
        f"closed-loop paper 4.3, Figure 10; limit: the project's own goal for {TOLD[found.model]}"
    )
    for joint, kind, *values in zip(
        found.joints, found.kinds, rms, most, delays(found), strict=True
    ):
        unit, shown = ("m", "mm") if kind == "prismatic" else ("rad", "mrad")
        label = f"{joint}, {TOLD[found.model]}"
        limit = LIMITS[found.model][kind]
        off, peak, late = map(float, values)
        figures += [
            Figure(f"{label}: error, RMS", off, unit, limit, shown=shown, source=source),
            Figure(f"{label}: largest error", peak, unit, shown=shown, source=source),
            Figure(f"{label}: delay", late, "s", shown="ms", source=source),
        ]
    return figures


def _hanging(found: TrackedJoints) -> list[Figure]:
    """State what the paper's gains alone come to, gravity and all."""
    rms = np.sqrt(np.mean(found.error[found.counted] ** 2, axis=0))
    source = "closed-loop paper 4.3 and 3.5.1: no gravity compensation; stated"
    return [
        Figure(
            f"{joint}, {TOLD[found.model]}, gravity not compensated: error, RMS",
            float(off),
            "m" if kind == "prismatic" else "rad",
            shown="mm" if kind == "prismatic" else "mrad",
            source=source,
        )
        for joint, kind, off in zip(found.joints, found.kinds, rms, strict=True)
    ]


#: Simulated time of a pass, and passes of which the median counts. Source: our own choice. [s]
REALTIME_S = 2.0
PASSES = 3
#: The row with the camera: the paper's figure, whose camera it is here, and how often a pair of
#: pictures is drawn. Source: closed-loop paper, Table 9; facts, section 6 (the slides' 60 Hz).
CAMERA = "SUJ + 3 PSM + ECM + camera"
PAPER_CAMERA, PRESET, RATE_HZ = 0.47, "dvrk_sd_640x480", 60.0
SOURCE = "closed-loop paper, Table 9 (Gazebo, i7-4770K); stated, since it depends on the machine"


def realtime(
    watch: Callable[[str], None] | None = None, duration_s: float | None = None
) -> ReportPart:
    """Drive each configuration of Table 9 along the test sine at 1 kHz, on one core.

    Args:
        watch: told which configuration is next
        duration_s: simulated time of a pass; REALTIME_S when omitted [s]
    """
    duration_s = REALTIME_S if duration_s is None else duration_s
    figures: list[Figure] = []
    for label, rig, setup, paper, _ in CONFIGURATIONS:
        if setup != "braked":
            continue  # not a row of the paper's
        if watch is not None:
            watch(f"realtime: {label}")
        world = World(rig, control="paper", friction="paper", setup_joints=setup)
        sine = paper_sine(world.rig, duration_s, TICK_S)
        timing = time_beside_bare(world, sine, periods_per_tick(world), PASSES)
        figures.append(
            Figure(label, timing.real_time_factor, "", paper_simulation=paper, source=SOURCE)
        )
    if watch is not None:
        watch(f"realtime: {CAMERA}")
    drawn = _with_camera(duration_s)
    if isinstance(drawn, Figure):
        figures.append(drawn)
        camera = (
            f"With the camera, every pair of pictures is drawn, {PRESET} at {RATE_HZ:g} Hz, in one"
            " pass; what draws may use all cores."
        )
    else:
        camera = f"The row with the camera is left out: {drawn}."
    notes = (
        "Real-time coefficient: simulated over wall-clock time, as fast as it goes, with bodies"
        " that collide. Gazebo's cannot exceed 1. Ours depends on the machine; nominal arms.",
        f"Median of {PASSES} passes of {duration_s:g} s at 1 kHz on one core, without the camera.",
        camera,
    )
    command = "trocar verify --only realtime"
    return ReportPart("realtime", "", "Speed: Table 9 of the paper", tuple(figures), command, notes)


def _with_camera(duration_s: float) -> Figure | str:
    """Drive the whole cart while its endoscope is drawn, or say why it cannot be."""
    world = World("full_cart", control="paper", friction="paper")
    with ExitStack() as stack:
        try:
            scope = stack.enter_context(closing(Endoscope(world, "endoscope", preset=PRESET)))
            scope.capture()  # the first takes long: everything is made then
        except TrocarError as problem:
            return str(problem)
        factor = _factor_with(scope, world, duration_s)
    return Figure(CAMERA, factor, "", paper_simulation=PAPER_CAMERA, source=SOURCE)


def _factor_with(scope: Endoscope, world: World, duration_s: float) -> float:
    sine = paper_sine(world.rig, duration_s, TICK_S)
    begin_trajectory(world, sine)
    begun, begun_at, drawn = time.perf_counter(), world.time, 0

    def look() -> None:
        nonlocal drawn
        if world.time - begun_at >= drawn / RATE_HZ:
            scope.capture_next()
            drawn += 1

    leave = world.observe(look, every=5)
    world.play(sine.positions, sine.velocities, every=periods_per_tick(world), record=False)
    factor = (world.time - begun_at) / (time.perf_counter() - begun)
    leave()
    return factor
