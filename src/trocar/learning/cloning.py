"""Behaviour cloning: successful episodes train a network that plans chunks of set-points."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, LogError, MissingExtraError
from trocar.geometry.rotations import matrix_from_quaternion, matrix_from_rotation_vector
from trocar.learning.cards import scene_of_card
from trocar.learning.collecting import EpisodeColumns
from trocar.learning.episodes import record_episode
from trocar.learning.features import SceneFeatures, SetpointPlans
from trocar.learning.lerobot import Dataset, open_dataset
from trocar.learning.networks import EnsembleSettings, Perceptron, make_perceptron
from trocar.learning.observations import SCALE
from trocar.learning.readings import NOTHING, SceneReadings, read_task
from trocar.tasks import Task
from trocar.tasks.play import Script, scripted

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
#: Called with the gradient steps so far, their number, and the mean loss since the last call.
Watch = Callable[[int, int, float], None]

#: Gradient steps between two points of a curve. Source: our own choice.
CURVE_STEPS = 100
#: Added to standard deviations, as columns that hardly vary would magnify what is new. Source: our
#: own choice. [features have a unit of 50 mm, plans of 20 mm]
FLOOR = 1e-2
#: Learning rate at the start, and weight decay of AdamW. Source: our own choice.
RATE, DECAY = 1e-3, 1e-3


@dataclass(frozen=True)
class CloneSettings:
    """Settings of a training by behaviour cloning.

    Source: chosen on needle-pick and peg-transfer, with seeds 10,000 to 10,049.

    Attributes:
        length: periods of 20 ms in a plan
        width, hidden: neurons of a hidden layer, and number of these
        steps: gradient steps
        batch: rows of a gradient step
        noise: added to features, in their standard deviations
        copies: of each period, in which tips are displaced while the set-points stay, so that the
            policy returns to them
        shift_m, turn_rad: of these, the greatest standard deviation along and about each axis
        rate: greatest learning rate, of the one cycle that it goes through
        seed: of initial weights, order and noise
    """

    length: int = 20
    width: int = 256
    hidden: int = 3
    steps: int = 8000
    batch: int = 512
    noise: float = 0.02
    copies: int = 1
    shift_m: float = 1e-3
    turn_rad: float = 0.025
    rate: float = 3e-3
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Episodes to clone, period by period.

    Attributes:
        inputs: features, (n, size) of `SceneFeatures`, copies included
        plans: that would have led to the set-points of the next periods, (n, length * width) of
            `SetpointPlans`
        episodes: number of those that are used
        failures: number of those that did not succeed, which are not
    """

    inputs: Floats
    plans: Floats
    episodes: int
    failures: int


def demonstrate(
    task: Task,
    seeds: Iterable[int],
    settings: CloneSettings,
    script: Script = scripted,
    watch: Callable[[int], None] = lambda _: None,
) -> Demonstrations:
    """Run a policy on a task, and keep the episodes that succeed.

    Args:
        task: of the scene
        seeds: of the episodes
        settings: of the training
        script: the policy; default: that of the task
        watch: called with the number of episodes so far, after each

    Raises:
        InputError: the task has no scripted policy, or no episode succeeds
    """
    found: list[tuple[SceneReadings, Array]] = []
    count = 0
    for count, seed in enumerate(seeds, 1):
        log = record_episode(task, seed, script)
        if log.result.success:
            # nothing follows the last readings: the arms stay
            found.append((log.readings, np.concatenate([log.actions, log.actions[-1:]])))
        watch(count)
    return _demonstrations(task, found, settings, count - len(found))


def read_demonstrations(folder: str | Path, task: Task, settings: CloneSettings) -> Demonstrations:
    """Read the successful episodes of a dataset of `trocar learn collect`.

    Args:
        folder: of the dataset
        task: of the same scene
        settings: of the training

    Raises:
        InputError: no dataset, one of another scene or without what a clone needs, or no episode
            succeeded
        LogError: a torn file, or numbers that are not finite; the file is named
        MissingExtraError: the extra `learn` is not installed
    """
    dataset, columns = open_dataset(folder), EpisodeColumns(task).features
    if (scene := scene_of_card(dataset.root)) not in ("", task.scene.name):
        raise InputError(
            f"{folder}: is of the scene {scene}; allowed: a dataset of trocar learn collect"
            f" {task.scene.name}"
        )
    for name, feature in columns.items():
        if name not in dataset.features or dataset.features[name].names != feature.names:
            raise InputError(
                f"{folder}: column {name}: is missing, or has other numbers than those of"
                f" {task.scene.name}; allowed: a dataset of trocar learn collect"
                f" {task.scene.name}"
            )
    found: list[tuple[SceneReadings, Array]] = []
    for episode in range(len(dataset)):
        rows = dataset.rows(episode)
        for name in columns:
            if not np.isfinite(rows[name]).all():
                raise LogError(
                    str(dataset.data_file(episode)),
                    f"{name}: episode {episode} has numbers that are not finite",
                )
        if rows["next.success"].any():
            found.append((_readings(task, dataset, rows), rows["action"].astype(np.float64)))
    return _demonstrations(task, found, settings, len(dataset) - len(found))


def ensemble(settings: CloneSettings) -> EnsembleSettings:
    """Return the settings by which a clone is run."""
    return EnsembleSettings(length=settings.length)


def clone(
    demonstrations: Demonstrations,
    settings: CloneSettings,
    device: str = "cpu",
    watch: Watch = lambda _step, _steps, _loss: None,
) -> Perceptron:
    """Train a network from features to plans; on one thread, so that a seed gives one network.

    Args:
        demonstrations: rows to learn from
        settings: of the training
        device: "cpu" or "cuda"
        watch: called now and then with the loss: smooth L1 of plans in standard deviations

    Raises:
        InputError: fewer rows than a batch, or no such device
        MissingExtraError: PyTorch is not installed
    """
    torch = torch_on(device)
    rows = len(demonstrations.inputs)
    if rows < settings.batch:
        raise InputError(f"got {rows} periods to clone; allowed: {settings.batch} or more")
    x, x_mean, x_std = _normalised(demonstrations.inputs)
    y, y_mean, y_std = _normalised(demonstrations.plans)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(settings.seed)
            layers = _trained(torch, x, y, settings, device, watch)
    finally:
        torch.set_num_threads(threads)
    return make_perceptron(layers, "gelu", inputs=(x_mean, x_std), outputs=(y_mean, y_std))


def torch_on(device: str) -> Any:
    """Import PyTorch, to train on a device.

    Raises:
        MissingExtraError: it is not installed
        InputError: another device, or one that this machine or this PyTorch lacks
    """
    try:
        import torch
    except ImportError as problem:
        raise MissingExtraError("PyTorch", "learn", "training a policy") from problem
    if device not in ("cpu", "cuda"):
        raise InputError(f"device: got {device!r}; allowed: cpu, cuda")
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError(
            f"device: got 'cuda', but PyTorch {torch.__version__} finds no GPU; allowed: cpu"
        )
    return torch


def _demonstrations(
    task: Task,
    episodes: Sequence[tuple[SceneReadings, Array]],
    settings: CloneSettings,
    failures: int,
) -> Demonstrations:
    """Compute features and plans of episodes, as they were and with tips displaced."""
    if not episodes:
        raise InputError(f"{task.scene.name}: no episode succeeded; allowed: one or more")
    features, planner = SceneFeatures(task), SetpointPlans(task)
    rng = np.random.default_rng(settings.seed)
    inputs: list[Floats] = []
    plans: list[Floats] = []
    for copy in range(1 + settings.copies):
        for readings, actions in episodes:
            seen = _displaced(rng, readings, settings) if copy else readings
            inputs.append(features.encode(seen))
            plans.append(planner.labels(seen, actions, settings.length))
    return Demonstrations(np.concatenate(inputs), np.concatenate(plans), len(episodes), failures)


def _displaced(
    rng: np.random.Generator, readings: SceneReadings, settings: CloneSettings
) -> SceneReadings:
    """Return readings with each tip elsewhere; plans from there lead back to the set-points."""
    tips: dict[str, Array] = {}
    for name, T in readings.tips.items():
        ratio = rng.uniform(0.0, 1.0, (len(T), 1))
        turn = matrix_from_rotation_vector(
            settings.turn_rad * ratio * rng.standard_normal((len(T), 3))
        )
        tips[name] = T.copy()
        tips[name][:, :3, 3] += settings.shift_m * ratio * rng.standard_normal((len(T), 3))
        tips[name][:, :3, :3] = turn @ T[:, :3, :3]
    return replace(readings, tips=tips)


def _readings(task: Task, dataset: Dataset, rows: Mapping[str, NDArray[Any]]) -> SceneReadings:
    """Return the readings of an episode of a dataset, as of n worlds."""
    count = len(rows["timestamp"])
    state = dict(zip(dataset.features["observation.state"].names, rows["observation.state"].T,
                     strict=True))  # fmt: skip

    def parts(column: str, names: Sequence[str], sizes: Sequence[int]) -> dict[str, Array]:
        if not names:
            return {}
        values = rows[column].astype(np.float64)
        return dict(zip(names, np.split(values, np.cumsum(sizes)[:-1], axis=1), strict=True))

    def later(column: str, first: str) -> NDArray[Any]:
        """Return a column as of the begin of each period, from its values at the ends."""
        return np.concatenate([rows[first][:1], rows[column][:-1]])

    nominal = read_task(task)
    psms, arms, objects = [*nominal.tips], [*nominal.q], [*nominal.objects]
    joints = [nominal.q[name].shape[1] for name in arms]
    poses = [7] * len(psms)
    shifted = {**rows}
    if psms:
        shifted["next.tip_setpoints"] = later("next.tip_setpoints", "observation.tips")
    shifted["next.setpoints"] = later("next.setpoints", "observation.joints")
    rows = shifted
    goals = np.zeros((count, nominal.goals.shape[1], 3))
    if goals.size:
        goals = rows["observation.goals"].astype(np.float64).reshape(goals.shape)
    numbers = range(1, goals.shape[1] + 1)
    ways = np.array([[state[f"goal{k}.way.{axis}"] for axis in "xyz"] for k in numbers])
    ways = ways.reshape(-1, 3, count).transpose(2, 0, 1) / SCALE
    return SceneReadings(
        time=rows["timestamp"].astype(np.float64),
        tips=_matrices(parts("observation.tips", psms, poses)),
        targets=_matrices(parts("next.tip_setpoints", psms, poses)),
        q=parts("observation.joints", arms, joints),
        v=parts("observation.velocities", arms, joints),
        setpoints=parts("next.setpoints", arms, joints),
        objects=parts("observation.objects", objects, [7] * len(objects)),
        held={name: _held(state, name, objects, nominal.names) for name in psms},
        names=nominal.names,
        stalled={name: state[f"{name}.stalled"] > 0.5 for name in psms},
        goals=goals,
        achieved=goals - ways,
        met=np.array([state[f"goal{k}.met"] > 0.5 for k in numbers]).reshape(-1, count).T,
    )


def _held(
    state: Mapping[str, NDArray[Any]], psm: str, objects: Sequence[str], names: Sequence[str]
) -> NDArray[np.intp]:
    """Return the rows of the objects that a PSM holds; a hidden one counts as the first."""
    held = np.where(state[f"{psm}.holds"] > 0.5, 0, NOTHING)
    for name in objects:
        held[state[f"{name}.in_{psm}"] > 0.5] = names.index(name)
    return held


def _matrices(poses: Mapping[str, Array]) -> dict[str, Array]:
    """Return poses of position and quaternion wxyz (n, 7) as (n, 4, 4)."""
    found: dict[str, Array] = {}
    for name, pose in poses.items():
        T = np.tile(np.eye(4), (len(pose), 1, 1))
        T[:, :3, 3] = pose[:, :3]
        T[:, :3, :3] = matrix_from_quaternion(pose[:, 3:])
        found[name] = T
    return found


def _normalised(values: Floats) -> tuple[Floats, Floats, Floats]:
    """Return values in standard deviations from the mean, and both."""
    mean, std = values.mean(0), values.std(0) + np.float32(FLOOR)
    found = values - mean
    found /= std
    return found, mean, std


def _trained(
    torch: Any, x: Floats, y: Floats, settings: CloneSettings, device: str, watch: Watch
) -> list[tuple[Floats, Floats]]:
    """Return weights and biases of the layers after the training."""
    nn = torch.nn
    sizes = [x.shape[1], *[settings.width] * settings.hidden, y.shape[1]]
    linear = [nn.Linear(a, b) for a, b in pairwise(sizes)]
    stack: list[Any] = []
    for layer in linear:
        stack += [layer, nn.GELU()]
    net = nn.Sequential(*stack[:-1]).to(device)
    inputs, plans = torch.from_numpy(x).to(device), torch.from_numpy(y).to(device)
    adam = torch.optim.AdamW(net.parameters(), RATE, weight_decay=DECAY)
    cycle = torch.optim.lr_scheduler.OneCycleLR(adam, settings.rate, total_steps=settings.steps + 1)
    order, total = torch.empty(0, dtype=torch.int64), 0.0
    for step in range(1, settings.steps + 1):
        if len(order) < settings.batch:
            order = torch.randperm(len(x)).to(device)
        rows, order = order[: settings.batch], order[settings.batch :]
        noisy = inputs[rows]
        noisy = noisy + settings.noise * torch.randn(noisy.shape).to(device)
        loss = nn.functional.smooth_l1_loss(net(noisy), plans[rows])
        adam.zero_grad()
        loss.backward()
        adam.step()
        cycle.step()
        total += loss.detach()
        if step % CURVE_STEPS == 0 or step == settings.steps:
            watch(step, settings.steps, float(total) / ((step - 1) % CURVE_STEPS + 1))
            total = 0.0
    return [(one.weight.detach().cpu().numpy(), one.bias.detach().cpu().numpy()) for one in linear]
