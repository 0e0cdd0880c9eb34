"""Experiments that commands list and run by name, and print in one way.

`trocar verify` runs VERIFIED on arms, `trocar bench` runs BENCHED; `python -m benchmarks`, outside
the package, has a table of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from inspect import signature
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trocar.robot.verification.figures import Figure

Watch = Callable[[str], None]


@dataclass(frozen=True)
class Experiment:
    """A measurement with a name on the command line; its figures have units, bounds and sources.

    Attributes:
        name: on the command line
        title: noun phrase for lists
        home: its function as "module:name", imported when it runs
        options: {option of the command: keyword of the function}
        defaults: {keyword of the function: value where the option is not given}
        part: name within an experiment of several functions; "" otherwise
        usual: whether it runs when nothing is chosen
        steps: progress steps that it reports, 0 if unknown
        extra: extra that it needs; "" if none
    """

    name: str
    title: str
    home: str
    options: Mapping[str, str] = field(default_factory=dict[str, str])
    defaults: Mapping[str, Any] = field(default_factory=dict[str, Any])
    part: str = ""
    usual: bool = True
    steps: int = 0
    extra: str = ""

    def load(self) -> Callable[..., Any]:
        """Import the function."""
        module, _, name = self.home.partition(":")
        return getattr(import_module(module), name)

    def measure(self, given: Mapping[str, Any], watch: Watch) -> list[Figure]:
        """Run the function.

        Args:
            given: options of the command; those that are None or empty are left to the function
            watch: called with the step that begins

        Returns:
            the measured figures
        """
        function = self.load()
        values = {key: given[name] for name, key in self.options.items() if name in given}
        keywords = {**self.defaults, **{k: v for k, v in values.items() if v not in (None, [])}}
        if "watch" in signature(function).parameters:
            return [*function(**keywords, watch=watch)]
        watch(self.name)
        return [*function(**keywords)]


#: Parts of `trocar verify`, in display order. All but `realtime` are of an arm: a function
#: (subject), or (subject, sweeps) where motion is shared, returns the `ReportPart`.
VERIFIED = (
    Experiment(
        "closure",
        "loop error over the joint range",
        "trocar.robot.verification.linkage:closure",
    ),
    Experiment(
        "rcm",
        "remote centre of motion (Table 7, Figure 9)",
        "trocar.robot.verification.verify:rcm_of_sweeps",
    ),
    Experiment(
        "axes",
        "distances between hinge axes (Table 6)",
        "trocar.robot.verification.verify:axes_of_sweeps",
    ),
    Experiment(
        "tracking",
        "six joints along a sine (Figure 10)",
        "trocar.robot.verification.tracking:tracking",
    ),
    Experiment(
        "realtime",
        "speed (Table 9, no tolerance)",
        "trocar.robot.verification.tracking:realtime",
    ),
    Experiment(
        "formats",
        "frame poses of exported files, read by MuJoCo and, if they are installed, pinocchio and"
        " Drake, compared with the kinematics",
        "trocar.robot.verification.formats:formats",
        extra="export",
    ),
)

#: Experiments of `trocar bench`. `speed` returns rows of Table 9, the others figures; the last is
#: chosen by an option.
BENCHED = (
    Experiment(
        "speed",
        "configurations of the paper's Table 9 against bare MuJoCo in the same run",
        "trocar.robot.verification.speed:table9",
        {"duration": "duration_s", "passes": "passes", "overlays": "overlays"},
        steps=6,
    ),
    Experiment(
        "fidelity",
        "accuracy",
        "trocar.robot.verification.fidelity:fidelity",
        {"poses": "poses"},
        steps=11,
    ),
    Experiment(
        "core",
        "cost of API calls in physics steps",
        "trocar.robot.verification.verb_costs:core",
        usual=False,
        steps=10,
    ),
    Experiment(
        "calibration",
        "calibrations of simulated robots against the truth",
        "trocar.robot.verification.unseen_robots:unseen_robots",
        {"robots": "robots"},
        usual=False,
        steps=6,
    ),
    Experiment(
        "replay",
        "replay of a recording of a PSM",
        "trocar.robot.verification.fidelity:replayed",
        {"log": "log"},
        usual=False,
        steps=1,
    ),
)


def listed(experiments: Iterable[Experiment]) -> str:
    """List experiments for --help, as "name: title; name: title"."""
    return "; ".join(f"{e.name}: {e.title}" for e in experiments)


def names_of(experiments: Iterable[Experiment]) -> tuple[str, ...]:
    """List the names of experiments, each once, in their order."""
    return tuple(dict.fromkeys(e.name for e in experiments))


def chosen(experiments: Iterable[Experiment], names: Collection[str]) -> list[Experiment]:
    """Select experiments by name, in the registry's order; without names the usual ones."""
    return [e for e in experiments if (e.name in names if names else e.usual)]
