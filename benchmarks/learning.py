"""Trained policies on fresh seeds: success, and the processor time of all that led to them.

Settings were chosen with seeds 10,000 to 10,049; nothing was chosen with those that judge here.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from trocar.learning.baselines import SAC_HER, train_actor
from trocar.learning.cloning import CloneSettings, clone, demonstrate, ensemble
from trocar.learning.evaluation import Evaluation, summarise
from trocar.learning.features import SceneFeatures
from trocar.learning.policies import PolicyFile, TrainedPolicy, save_policy
from trocar.robot.verification.figures import Figure
from trocar.tasks import make_task, run_episode

Watch = Callable[[str], None]
#: A figure, its value (None: not measured), its unit, and its goal: ">= 95", "<= 0.2", a number as
#: the upper bound; for none "", "printed" or None.
Row = tuple[str, float | None, str, str | float | None]

#: First of the fresh seeds, and number of them; fewer with --short.
FRESH, SEEDS, FEW = 50_000, 100, 20
#: Training seeds of an actor, and demonstrations of a clone. Source: our own goals.
TRAININGS, EPISODES = (0, 1, 2), 250
#: Settings of clones that are not the usual ones. Source: chosen with the seeds 10,000 to 10,049.
CLONES = {"bi-peg-transfer": CloneSettings(shift_m=2e-3, turn_rad=0.05)}
#: Anchors. Source: Xu et al., IROS 2021; Wu et al., SurgicAI, NeurIPS 2024.
SURROL, SURGICAI = "SurRoL: DDPG with HER", "SurgicAI: TD3 with HER and BC"
#: Source: measured, two cores; Schmidgall et al., Surgical Gym, ICRA 2024.
SURROL_SPEED = "SurRoL: 209 steps of 0.2 s a second, 42 simulated s/s"
SURGICAL_GYM = "Surgical Gym: 345,000 physics steps a second, serial arms"


def reach(watch: Watch, short: bool = False) -> list[Figure]:
    """Train needle-reach by SAC with HER, 5,000 steps of the environment, and judge it."""
    rows: list[Row] = []
    for seed in TRAININGS[: 1 if short else None]:
        watch(f"needle-reach, SAC with HER, training seed {seed}")
        begin = time.process_time()
        policy = train_actor("needle-reach", "sac-her", replace(SAC_HER, seed=seed))
        cpu_s = time.process_time() - begin
        label = f"needle-reach, SAC+HER, {SAC_HER.steps} steps, training seed {seed}"
        rows += judged(label, policy, cpu_s, (">= 0.95", "<= 120"), short)
    return figures(rows, SURROL)


def pick(watch: Watch, short: bool = False) -> list[Figure]:
    """Clone the scripted needle-pick, and judge it."""
    return figures(cloned("needle-pick", (">= 0.95", "<= 180"), watch, short), SURGICAI)


def peg(watch: Watch, short: bool = False) -> list[Figure]:
    """Clone the scripted peg-transfer, and judge it."""
    return figures(cloned("peg-transfer", (">= 0.95", ""), watch, short))


def two_arms(watch: Watch, short: bool = False) -> list[Figure]:
    """Clone the scripted bi-peg-transfer, and judge it."""
    return figures(cloned("bi-peg-transfer", (">= 0.8", ""), watch, short))


def single() -> list[Figure]:
    """Measure one environment beside its physics."""
    return figures(_function("learning_single", "single")())


def batch(watch: Watch, short: bool = False) -> list[Figure]:
    """Measure batches of scenes on two threads."""
    return figures(_function("learning_batch", "batches")(watch, short), SURROL_SPEED)


def gpu() -> list[Figure]:
    """Measure scenes on a GPU."""
    return figures(_function("learning_gpu", "rows")(), SURGICAL_GYM)


def _function(module: str, name: str) -> Callable[..., list[Row]]:
    """Import a function that returns rows; its module may need an extra that others do not."""
    return getattr(import_module(f"benchmarks.{module}"), name)


def cloned(scene: str, goals: tuple[str, str], watch: Watch, short: bool) -> list[Row]:
    """Clone the scripted policy of a scene; return its rows.

    Args:
        scene: its name
        goals: of success and of processor time
        watch: function that reports progress
        short: whether to judge by few seeds
    """
    watch(f"{scene}, behaviour cloning of {EPISODES} episodes")
    begin = time.process_time()
    task, settings = make_task(scene), CLONES.get(scene, CloneSettings())
    network = clone(demonstrate(task, range(EPISODES), settings), settings)
    cpu_s = time.process_time() - begin
    policy = TrainedPolicy(
        "clone",
        scene,
        network,
        features=SceneFeatures(task).names,
        ensemble=ensemble(settings),
    )
    return judged(f"{scene}, BC of {EPISODES} episodes", policy, cpu_s, goals, short)


def judged(
    label: str, policy: TrainedPolicy, cpu_s: float, goals: tuple[str, str], short: bool
) -> list[Row]:
    """Return the rows of a policy that was trained.

    Args:
        label: begin of the figures' names
        policy: to judge by fresh seeds
        cpu_s: processor time of all that led to it [s]
        goals: of success and of processor time
        short: whether to judge by few seeds
    """
    found = evaluated(policy, FEW if short else SEEDS)
    low, high = (100.0 * end for end in found.interval)
    ratio = f"{label}: success on {found.episodes} fresh seeds ({low:.1f} to {high:.1f} %)"
    return [
        (ratio, found.successes / found.episodes, "", goals[0]),
        (f"{label}: time of a success", found.time_s, "s", ""),
        (f"{label}: processor time of demonstrations and training", cpu_s, "s", goals[1]),
    ]


def evaluated(policy: TrainedPolicy, count: int, first: int = FRESH) -> Evaluation:
    """Run a policy on seeds, from its file as a user would."""
    task = make_task(policy.scene)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "policy.toml"
        save_policy(path, policy)
        script = PolicyFile(path).script
        episodes = [run_episode(task, first + k, script=script) for k in range(count)]
    return summarise(policy.scene, episodes)


def figures(rows: Sequence[Row], source: str = "") -> list[Figure]:
    """Return rows as figures.

    Args:
        rows: see `Row`
        source: anchor of the goals

    Raises:
        ValueError: a goal that is none
    """
    found: list[Figure] = []
    for name, value, unit, goal in rows:
        words = f"<= {goal}" if isinstance(goal, float | int) else goal or ""
        words = "" if words == "printed" else words
        sense, _, bound = words.partition(" ")
        if words and sense not in (">=", "<="):
            raise ValueError(f"{name}: got the goal {goal!r}; allowed: >= and <= with a number")
        measured = float("nan") if value is None else value
        upper = float(bound) if sense == "<=" else None
        lower = float(bound) if sense == ">=" else None
        if value is None:  # what was not measured is not missed
            upper = lower = None
        found.append(Figure(name, measured, unit, upper, lower, source=source))
    return found
