"""Run the paper's experiments on the simulation, each figure beside the paper's."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from inspect import signature
from pathlib import Path

from trocar.descriptions import load_arm
from trocar.descriptions.overlay import Overlay, apply_overlay, read_overlay
from trocar.errors import InputError
from trocar.robot.experiments import VERIFIED, Watch, chosen, names_of
from trocar.robot.verification.figures import Figure, ReportPart
from trocar.robot.verification.linkage import axes
from trocar.robot.verification.rcm import beside_hardware, has_remote_centre, rcm
from trocar.robot.verification.subject import Subject, Sweeps, measured_ranges, swept_joints
from trocar.robot.verification.tracking import realtime

#: Names of the parts, in display order.
PARTS = names_of(VERIFIED)
#: The arms of the paper's experiments.
ARMS = ("psm", "ecm")


@dataclass(frozen=True, eq=False)
class Verification:
    """The parts of a verification."""

    parts: tuple[ReportPart, ...]

    @property
    def missed(self) -> tuple[Figure, ...]:
        """The figures that left their tolerance."""
        return tuple(f for part in self.parts for f in part.figures if f.met is False)

    @property
    def judged(self) -> int:
        """Number of figures with a tolerance."""
        return sum(f.met is not None for part in self.parts for f in part.figures)

    @property
    def stated(self) -> int:
        """Number of figures without a tolerance."""
        return sum(f.met is None for part in self.parts for f in part.figures)

    @property
    def met(self) -> bool | None:
        """Whether every figure with a tolerance is within it; None if none has one."""
        return None if not self.judged else not self.missed

    @property
    def summary(self) -> str:
        """The counts as a sentence."""
        if not self.judged:
            return f"No figure has a tolerance; {self.stated} are stated without."
        within = self.judged - len(self.missed)
        counted = f"{within} of {self.judged} figures with a tolerance are within it"
        return f"{counted}; {self.stated} more have none." if self.stated else f"{counted}."


def verify(
    arms: Sequence[str | Path] = (),
    calibrations: Sequence[str | Path] = (),
    parts: Sequence[str] = PARTS,
    watch: Watch | None = None,
) -> Verification:
    """Verify arms.

    Args:
        arms: built-in arms or TOML files; when omitted those of the calibrations, or PSM and ECM
        calibrations: overlays, each laid over the arm that it is of
        parts: what to verify, of PARTS
        watch: called with the step that begins

    Raises:
        InputError: no such part or arm, an overlay of another arm, or nothing to verify
        DivergedError: the simulation left the finite numbers
    """
    for part in parts:
        if part not in PARTS:
            raise InputError(f"part: got {part!r}; allowed: {', '.join(PARTS)}")
    subjects = _subjects(arms, calibrations)
    say = watch or _say_nothing
    found = [each for s in subjects for each in _of_arm(s, parts, say)]
    if "realtime" in parts:
        found.append(realtime(say))
    if not any(part.figures for part in found):
        whom = ", ".join(s.name for s in subjects)
        raise InputError(f"verify: nothing of {', '.join(parts)} applies to {whom}")
    order = {part: index for index, part in enumerate(PARTS)}
    return Verification(tuple(sorted(found, key=lambda part: order[part.name])))


def _say_nothing(_: str) -> None:
    pass


def _subjects(arms: Sequence[str | Path], calibrations: Sequence[str | Path]) -> list[Subject]:
    """Load every arm with the overlay that is for it.

    Raises:
        InputError: an overlay of an arm that is not verified, or two of one arm
    """
    overlays: dict[str, tuple[Overlay, str]] = {}
    for file in calibrations:
        overlay = read_overlay(file)
        if overlay.arm in overlays:
            raise InputError(f"{file}: got a second overlay of {overlay.arm}; allowed: one")
        overlays[overlay.arm] = (overlay, str(file))
    subjects: list[Subject] = []
    for name in map(str, arms or list(overlays) or ARMS):
        arm, nominal = load_arm(name), None
        words: tuple[str, ...] = ("--arm", name)
        if arm.name in overlays:
            overlay, file = overlays.pop(arm.name)
            nominal, words = arm, (*words, "--calibration", file)
            arm = apply_overlay(arm, overlay)
        subjects.append(Subject(name, arm, words, nominal))
    for other, (_, file) in overlays.items():
        known = ", ".join(s.arm.name for s in subjects)
        raise InputError(f"{file}: got an overlay of {other!r}; allowed: one of {known}")
    return subjects


def rcm_of_sweeps(subject: Subject, sweeps: Sweeps) -> ReportPart:
    """Estimate the remote centre from the shared sweeps, and beside a calibrated arm's hardware."""
    if not (has_remote_centre(subject.arm.mechanism) and subject.simulated):
        return rcm(subject, ())
    beside = beside_hardware(subject, measured_ranges(subject))
    return rcm(subject, (sweeps.sweep("set"), sweeps.sweep("servo")), beside)


def axes_of_sweeps(subject: Subject, sweeps: Sweeps) -> ReportPart:
    """Compare the distances of axes with Table 6, also in motion where an arm can be swept."""
    able = subject.simulated and bool(swept_joints(subject.arm.mechanism))
    return axes(subject, sweeps.sweep("servo") if able else None)


def _of_arm(subject: Subject, parts: Collection[str], say: Watch) -> Iterator[ReportPart]:
    """Run the parts that are of one arm."""
    sweeps = Sweeps(subject, say)
    for experiment in chosen(VERIFIED, parts):
        if experiment.name == "realtime":
            continue
        say(f"{subject.name}: {experiment.name}")
        measure = experiment.load()
        shared = (sweeps,) if "sweeps" in signature(measure).parameters else ()
        yield measure(subject, *shared)
