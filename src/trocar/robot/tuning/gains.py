"""Search gains with better step responses, joint by joint."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.records import DynamicsKind, Gains
from trocar.errors import DivergedError
from trocar.robot.tuning.steps import StepBench, StepResponse

#: Bounds of a tuned response. Source: our own choice: a little overshoot, a fifth of the motor's
#: effort kept for loads, and no more left of the step than dry friction leaves of it anyway.
MOST_OVERSHOOT = 0.05
MOST_EFFORT_SHARE = 0.8
MOST_STEADY_SHARE = 0.02
#: Largest factor of change of P and D: the simulated servo lacks the resonances of a real one.
#: Source: our own choice.
MOST_FACTOR = 4.0
#: Factors by which P and D are changed, coarse to fine. Source: our own choice.
FACTORS = (2.0, 2.0**0.5, 2.0**0.25, 2.0**0.125)
#: First ratio of D to P of a joint without D [s]. Source: our own choice.
FIRST_LEAD_S = 0.01
#: Resolution of settling times [s]. Source: a tenth of the physics step.
SETTLING_STEP_S = 1e-4


@dataclass(frozen=True)
class Bounds:
    """Bounds of a response; where the present response breaks one, its own value is the bound.

    Attributes:
        overshoot: share of the way
        effort_share: share of the joint's effort limit
        steady_error: either way [rad or m]
    """

    overshoot: float
    effort_share: float
    steady_error: float


def bounds(step: float, present: StepResponse) -> Bounds:
    """Return the bounds of the answer to a step [rad or m].

    Friction and weight leave a P servo an error: no more is asked than what the present gains keep.
    """
    left = max(MOST_STEADY_SHARE * abs(step), abs(present.steady_error))
    return Bounds(MOST_OVERSHOOT, MOST_EFFORT_SHARE, left)


def cost(response: StepResponse, allowed: Bounds) -> tuple[float, float]:
    """Return the criterion, smaller is better: first what breaks the bounds, then settling time."""
    pairs = (
        (response.overshoot, allowed.overshoot),
        (response.peak_effort_share, allowed.effort_share),
        (abs(response.steady_error), allowed.steady_error),
    )
    broken = sum(max(0.0, got / most - 1.0) for got, most in pairs if math.isfinite(got))
    if not math.isfinite(response.settling_time_s):
        return broken + 1.0, math.inf
    return broken, round(response.settling_time_s / SETTLING_STEP_S) * SETTLING_STEP_S


def search(
    answer: Callable[[Gains], StepResponse], present: Gains, step: float
) -> tuple[Gains, int]:
    """Return better gains than the present ones, or these, and how many were tried.

    A pattern search: the eight neighbours in (P, D), a factor away, are tried; the best one is the
    next centre while it is better, else the factor is made finer. I stays. Nothing is random.

    Args:
        answer: steps the joint with some gains
        present: where to begin
        step: its size [rad or m]
    """
    first = answer(present)
    allowed = bounds(step, first)
    tried = {present: cost(first, allowed)}

    def rate(gains: Gains) -> tuple[float, float]:
        if gains not in tried:
            try:
                tried[gains] = cost(answer(gains), allowed)
            except DivergedError:
                tried[gains] = (math.inf, math.inf)
        return tried[gains]

    best, centre = present, (present.p, present.d or FIRST_LEAD_S * present.p)
    for factor in FACTORS:
        while True:
            found = min(_neighbours((best.p, best.d or centre[1]), centre, present.i, factor),
                        key=rate)  # fmt: skip
            if rate(found) >= tried[best]:
                break
            best = found
    return best, len(tried)


def _neighbours(
    at: tuple[float, float], centre: tuple[float, float], i: float, factor: float
) -> list[Gains]:
    """Return the gains around a point, within reach of the centre, with three digits."""
    found: list[Gains] = []
    for up in (0, -1, 1):
        for damped in (0, 1, -1):
            pair = [
                float(f"{min(max(x * factor**k, c / MOST_FACTOR), c * MOST_FACTOR):.3g}")
                for x, c, k in zip(at, centre, (up, damped), strict=True)
            ]
            found.append(Gains(pair[0], i, pair[1]))
    return found


@dataclass(frozen=True)
class TuneSettings:
    """Settings of a tuning.

    Attributes:
        joints: names, all joints when empty
        tool: the mounted tool, the arm's default when omitted
        control, friction, dynamics: as for `World`
    """

    joints: tuple[str, ...] = ()
    tool: str | None = None
    control: Literal["dvrk", "paper"] = "dvrk"
    friction: Literal["identified", "paper"] = "identified"
    dynamics: DynamicsKind | None = None


@dataclass(frozen=True)
class GainTrial:
    """Gains and the response that they give."""

    gains: Gains
    response: StepResponse

    def document(self) -> dict[str, float]:
        """Convert to one table of both for JSON."""
        return vars(self.gains) | vars(self.response)


@dataclass(frozen=True)
class JointTuning:
    """Gains found for one joint.

    Attributes:
        joint, kind: its name; "revolute" or "prismatic"
        step: size of the step [rad or m]
        present, tuned: gains with their responses; the same where nothing better was found
        tried: how many gains were tried
    """

    joint: str
    kind: str
    step: float
    present: GainTrial
    tuned: GainTrial
    tried: int


@dataclass(frozen=True)
class TuningReport:
    """Result of `tune`.

    Attributes:
        arm, tool: names, the tool None without one
        control: the preset that the gains are from
        friction: the joint model
        joints: in the arm's order
        toml: {file: lines to put there}
    """

    arm: str
    tool: str | None
    control: str
    friction: str
    joints: tuple[JointTuning, ...]
    toml: dict[str, str]


def tune(
    arm: str | Path | ArmDescription,
    settings: TuneSettings | None = None,
    watch: Callable[[str], None] | None = None,
) -> TuningReport:
    """Step each joint of a lone arm and tune P and D from the answer.

    Args:
        arm: a built-in arm, the path of a description, or one that is loaded
        settings: the defaults when omitted
        watch: told what is tuned next

    Raises:
        UnknownNameError, DescriptionError: the arm, its tool or a joint
        InputError: an arm that cannot be simulated, a joint without P or effort limit
        DivergedError: the simulation left the finite numbers with the present gains
    """
    how = settings or TuneSettings()
    described = arm if isinstance(arm, ArmDescription) else load_arm(arm, how.tool)
    wanted = {described.joint(name).name for name in how.joints}
    bench = StepBench(described, how.control, how.friction, how.dynamics)
    for name in wanted:
        bench.step_size(name)  # what cannot be stepped is refused before anything is
    names = [name for name in bench.joints if not wanted or name in wanted]
    found: list[JointTuning] = []
    for number, name in enumerate(names, 1):
        if watch is not None:
            watch(f"{name} ({number} of {len(names)})")
        found.append(tune_joint(bench, name))
    preset = how.control if how.control in described.control else next(iter(described.control))
    return TuningReport(
        described.name,
        described.tool or None,
        preset,
        how.friction,
        tuple(found),
        toml_lines(described, preset, found),
    )


def tune_joint(bench: StepBench, joint: str) -> JointTuning:
    """Tune one joint on the bench."""
    step, present = bench.step_size(joint), bench.present(joint)
    best, tried = search(lambda gains: bench.step(joint, gains).response, present, step)
    before = GainTrial(present, bench.step(joint, present).response)
    after = before if best == present else GainTrial(best, bench.step(joint, best).response)
    return JointTuning(joint, bench.arm.joint(joint).kind, step, before, after, tried)


def toml_lines(arm: ArmDescription, preset: str, found: Sequence[JointTuning]) -> dict[str, str]:
    """Return {file: its table of gains} of every file with a tuned joint.

    Joints that were not tuned keep their gains; the arm's and the tool's are in files of their own.
    """
    tuned = {entry.joint: entry.tuned.gains for entry in found}
    own = set(load_arm(arm.file, "none").mechanism.joint_names) if arm.tool else None
    parts: dict[str, list[str]] = {}
    for joint in arm.joints:
        part = arm.tool if own is not None and joint.name not in own else arm.name
        parts.setdefault(part, []).append(joint.name)
    lines: dict[str, str] = {}
    for part, joints in parts.items():
        if tuned.keys().isdisjoint(joints):
            continue
        gains = {name: tuned.get(name, arm.control[preset].pid[name]) for name in joints}
        row = ", ".join(
            f"{n} = [{_toml(g.p)}, {_toml(g.i)}, {_toml(g.d)}]" for n, g in gains.items()
        )
        lines[part] = f"[control.{preset}]\npid = {{ {row} }}"
    return lines


def _toml(value: float) -> str:
    """Write a gain as TOML has it: a float, all digits."""
    return repr(float(value))
