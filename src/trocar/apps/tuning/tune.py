"""Measure every joint's step response and tune its gains from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from trocar.apps.tuning.response import StepResponse
from trocar.apps.tuning.search import search
from trocar.apps.tuning.step_bench import StepBench
from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.records import Gains


@dataclass(frozen=True)
class TuneSettings:
    """What to tune.

    Attributes:
        joints: names, all joints when empty
        tool: the mounted tool, the arm's default when omitted
        control, friction: as for `World`
    """

    joints: tuple[str, ...] = ()
    tool: str | None = None
    control: Literal["dvrk", "paper"] = "dvrk"
    friction: Literal["identified", "paper"] = "identified"


@dataclass(frozen=True)
class Tried:
    """Gains and the response that they give."""

    gains: Gains
    response: StepResponse


@dataclass(frozen=True)
class JointTuning:
    """What was found for one joint.

    Attributes:
        joint, kind: its name; "revolute" or "prismatic"
        step: size of the step [rad or m]
        present, tuned: gains with their responses; the same where nothing better was found
        tried: how many gains were tried
    """

    joint: str
    kind: str
    step: float
    present: Tried
    tuned: Tried
    tried: int


@dataclass(frozen=True)
class TuningReport:
    """What `tune` found.

    Attributes:
        arm, tool: names, the tool "" when none
        control: the preset that the gains are from
        friction: the joint model
        joints: in the arm's order
        toml: {file: lines to put there}
    """

    arm: str
    tool: str
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
    bench = StepBench(described, how.control, how.friction)
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
        described.tool,
        preset,
        how.friction,
        tuple(found),
        toml_lines(described, preset, found),
    )


def tune_joint(bench: StepBench, joint: str) -> JointTuning:
    """Tune one joint on the bench."""
    step, present = bench.step_size(joint), bench.present(joint)
    best, tried = search(lambda gains: bench.step(joint, gains).response, present, step)
    before = Tried(present, bench.step(joint, present).response)
    after = before if best == present else Tried(best, bench.step(joint, best).response)
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
