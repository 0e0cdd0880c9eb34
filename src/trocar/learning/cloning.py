"""Behaviour cloning: successful episodes train a network that plans chunks of set-points."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, MissingExtraError
from trocar.learning.features import SceneFeatures, SetpointPlans
from trocar.learning.networks import EnsembleSettings, Perceptron, make_perceptron
from trocar.learning.readings import SceneReadings, read_task
from trocar.tasks import Task

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

    Source: chosen on needle-pick, with seeds 10,000 to 10,049.

    Attributes:
        length: periods of 20 ms in a plan
        width, hidden: neurons of a hidden layer, and number of these
        steps: gradient steps
        batch: rows of a gradient step
        noise: added to features, in their standard deviations
        rate: greatest learning rate, of the one cycle that it goes through
        seed: of initial weights, order and noise
    """

    length: int = 20
    width: int = 256
    hidden: int = 3
    steps: int = 6000
    batch: int = 512
    noise: float = 0.02
    rate: float = 3e-3
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Episodes to clone, period by period.

    Attributes:
        inputs: features, (n, size) of `SceneFeatures`
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
    length: int = CloneSettings.length,
    watch: Callable[[int], None] = lambda _: None,
) -> Demonstrations:
    """Run the scripted policy of a task.

    Args:
        task: with a scripted policy
        seeds: of the episodes
        length: periods of a plan
        watch: called with the number of episodes so far, after each

    Raises:
        InputError: the task has no scripted policy, or no episode succeeds
    """
    features, planner = SceneFeatures(task), SetpointPlans(task)
    inputs: list[Floats] = []
    plans: list[Floats] = []
    failures = 0
    for count, seed in enumerate(seeds, 1):
        task.reset(seed)
        script = task.policy()
        seen: list[SceneReadings] = []
        actions: list[Array] = []
        while not task.done:
            action = next(script, None)
            seen.append(read_task(task))
            actions.append(task.stay() if action is None else action)
            task.command(actions[-1])
        if task.reason == "done":
            readings = joined(seen)
            inputs.append(features.encode(readings))
            plans.append(planner.labels(readings, actions, length))
        else:
            failures += 1
        watch(count)
    if not inputs:
        raise InputError(f"{task.scene.name}: no episode succeeded; allowed: one or more")
    return Demonstrations(np.concatenate(inputs), np.concatenate(plans), len(inputs), failures)


def joined(readings: Sequence[SceneReadings]) -> SceneReadings:
    """Join readings of one scene along their first axis, as of so many worlds."""
    found: dict[str, Any] = {}
    for name in (one.name for one in fields(SceneReadings)):
        values = [getattr(one, name) for one in readings]
        if isinstance(values[0], tuple):
            found[name] = values[0]
        elif isinstance(values[0], np.ndarray):
            found[name] = np.concatenate(values)
        else:
            found[name] = {key: np.concatenate([v[key] for v in values]) for key in values[0]}
    return SceneReadings(**found)


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


def _normalised(values: Floats) -> tuple[Floats, Floats, Floats]:
    """Return values in standard deviations from the mean, and both."""
    mean, std = values.mean(0), values.std(0) + np.float32(FLOOR)
    return (values - mean) / std, mean, std


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
    inputs, plans = torch.tensor(x, device=device), torch.tensor(y, device=device)
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
