"""Networks of trained policies, evaluated in numpy: no PyTorch plays them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf  # pyright: ignore[reportMissingTypeStubs]

from trocar.errors import InputError, UnknownNameError
from trocar.learning.features import SceneFeatures, SetpointPlans
from trocar.learning.readings import SceneReadings
from trocar.tasks import Task

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

ROOT2 = np.float32(np.sqrt(2.0))


def _relu(x: Floats) -> Floats:
    return np.maximum(x, np.float32(0.0))


def _elu(x: Floats) -> Floats:
    return np.where(x > 0.0, x, np.expm1(np.minimum(x, np.float32(0.0))))


def _gelu(x: Floats) -> Floats:
    return np.float32(0.5) * x * (np.float32(1.0) + erf(x / ROOT2))


def _identity(x: Floats) -> Floats:
    return x


#: Functions between layers and after the last, by name; gelu is the exact one, as PyTorch's.
ACTIVATIONS: Mapping[str, Callable[[Floats], Floats]] = {
    "identity": _identity,
    "relu": _relu,
    "tanh": np.tanh,
    "elu": _elu,
    "gelu": _gelu,
}
#: Factors of the ways from achieved to desired goals, plain and within tanh, whose unit is that of
#: `TaskEnv`'s observations (50 mm): SAC with HER learns in half the steps from them.
#: Source: our own choice; measured with needle-reach.
WAY, NEAR_WAY = 5.0, 25.0


@dataclass(frozen=True, eq=False)
class Perceptron:
    """A multilayer perceptron: `y = output((x - mean) / std ...) * output_std + output_mean`.

    Attributes:
        layers: weights (outputs, inputs) and biases (outputs,), as PyTorch has them, float32
        activation: between layers, one of `ACTIVATIONS`
        output: after the last, one of `ACTIVATIONS`
        input_mean, input_std: of the inputs, (inputs,)
        output_mean, output_std: of the outputs, (outputs,)
    """

    layers: tuple[tuple[Floats, Floats], ...]
    activation: str
    output: str
    input_mean: Floats
    input_std: Floats
    output_mean: Floats
    output_std: Floats

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of inputs, of each hidden layer's neurons, and of outputs."""
        return (self.layers[0][0].shape[1], *(len(bias) for _, bias in self.layers))

    def __call__(self, x: Floats) -> Floats:
        """Evaluate.

        Args:
            x: (n, inputs)

        Returns:
            (n, outputs)
        """
        y = (x - self.input_mean) / self.input_std
        for k, (weight, bias) in enumerate(self.layers, 1):
            name = self.output if k == len(self.layers) else self.activation
            y = ACTIVATIONS[name](y @ weight.T + bias)
        return y * self.output_std + self.output_mean

    def tensors(self) -> dict[str, Floats]:
        """Return the numbers by name; `perceptron_from_tensors` undoes it."""
        found = {
            "input.mean": self.input_mean,
            "input.std": self.input_std,
            "output.mean": self.output_mean,
            "output.std": self.output_std,
        }
        for k, (weight, bias) in enumerate(self.layers):
            found |= {f"layers.{k}.weight": weight, f"layers.{k}.bias": bias}
        return {name: np.ascontiguousarray(value) for name, value in found.items()}


def make_perceptron(
    layers: Sequence[tuple[ArrayLike, ArrayLike]],
    activation: str,
    output: str = "identity",
    inputs: tuple[ArrayLike, ArrayLike] = (0.0, 1.0),
    outputs: tuple[ArrayLike, ArrayLike] = (0.0, 1.0),
) -> Perceptron:
    """Make a network.

    Args:
        layers: weight (outputs, inputs) and bias (outputs,) of each
        activation, output: see `Perceptron`
        inputs, outputs: mean and standard deviation, numbers or one for each column

    Raises:
        UnknownNameError: no such activation; the known ones are listed
        InputError: shapes that do not fit, no layer, or numbers that are not finite
    """
    made = [(np.array(w, np.float32), np.array(b, np.float32)) for w, b in layers]
    if not made or made[0][0].ndim != 2:
        raise InputError("network: got no layers of weights (outputs, inputs); allowed: 1 or more")
    widths = made[0][0].shape[1], len(made[-1][1])
    tensors: dict[str, Floats] = {}
    for name, pair, width in (("input", inputs, widths[0]), ("output", outputs, widths[1])):
        for of, value in zip(("mean", "std"), pair, strict=True):
            whole = np.asarray(value, np.float32)
            tensors[f"{name}.{of}"] = np.full(width, whole) if whole.ndim == 0 else whole
    for k, (weight, bias) in enumerate(made):
        tensors |= {f"layers.{k}.weight": weight, f"layers.{k}.bias": bias}
    sizes = (widths[0], *(len(bias) for _, bias in made))
    return perceptron_from_tensors(tensors, sizes, activation, output, "network")


def perceptron_from_tensors(
    tensors: Mapping[str, Floats], sizes: Sequence[int], activation: str, output: str, where: str
) -> Perceptron:
    """Make a network of the tensors of a file.

    Args:
        tensors: see `Perceptron.tensors`
        sizes: see `Perceptron.sizes`
        activation, output: see `Perceptron`
        where: label of error messages

    Raises:
        UnknownNameError: no such activation; the known ones are listed
        InputError: a tensor is missing or unknown, of another shape or type, or not finite
    """
    for name in (activation, output):
        if name not in ACTIVATIONS:
            raise UnknownNameError("activation", name, ACTIVATIONS, where)
    shapes: dict[str, tuple[int, ...]] = {}
    for name, width in (("input", sizes[0]), ("output", sizes[-1])):
        shapes |= {f"{name}.mean": (width,), f"{name}.std": (width,)}
    for k, (before, after) in enumerate(pairwise(sizes)):
        shapes |= {f"layers.{k}.weight": (after, before), f"layers.{k}.bias": (after,)}
    if off := sorted(set(tensors) ^ set(shapes)):
        got = ", ".join(sorted(tensors)) or "none"
        raise InputError(f"{where}: tensor {off[0]}: got {got}; allowed: {', '.join(shapes)}")
    for name, shape in shapes.items():
        found = tensors[name]
        if found.shape != shape or found.dtype != np.float32:
            raise InputError(
                f"{where}: tensor {name}: got {found.dtype} of shape {found.shape}; allowed:"
                f" float32 of shape {shape}"
            )
        if not np.isfinite(found).all():
            raise InputError(f"{where}: tensor {name}: got numbers that are not finite")
    if not (tensors["input.std"] > 0.0).all():
        raise InputError(f"{where}: tensor input.std: got 0 or less; allowed: above 0")
    layers = tuple(
        (tensors[f"layers.{k}.weight"], tensors[f"layers.{k}.bias"]) for k in range(len(sizes) - 1)
    )
    ends = (tensors[f"{name}.{of}"] for name in ("input", "output") for of in ("mean", "std"))
    return Perceptron(layers, activation, output, *ends)


def goal_difference(observation: ArrayLike, achieved: ArrayLike, desired: ArrayLike) -> Floats:
    """Return observations with the ways from achieved to desired goals, plain and within tanh.

    An actor that reads these is relabelled with the goals of HER.

    Args:
        observation: (n, d)
        achieved, desired: (n, g)

    Returns:
        (n, d + 2 g)
    """
    way = np.asarray(desired, np.float32) - np.asarray(achieved, np.float32)
    near = np.tanh(np.float32(NEAR_WAY) * way)
    found = [np.asarray(observation, np.float32), np.float32(WAY) * way, near]
    return np.concatenate(found, axis=1)


@dataclass(frozen=True)
class EnsembleSettings:
    """Settings of a temporal ensemble.

    Attributes:
        length: periods that a plan lasts
        most: plans that are averaged, the last ones
        decay: of the weights `exp(-decay k)`, k counted from the oldest plan. Source: ACT (Zhao et
            al., RSS 2023), whose oldest plan counts most, too
        speed_m_s, spin_rad_s: greatest speed of a tip and of its rotation. Source: measured with
            needle-pick; jumps between plans faster than these end in FAULT [m/s, rad/s]
    """

    length: int = 20
    most: int = 10
    decay: float = 0.1
    speed_m_s: float = 0.15
    spin_rad_s: float = 2.5


class TemporalEnsemble:
    """Plans in every period, and acts by the mean of what the last plans have for that period.

    Args:
        network: from `SceneFeatures` to plans of `SetpointPlans`
        settings: of the ensemble
        task: of the scene; only its arms, objects and goals count

    Raises:
        InputError: the network has other numbers of inputs or outputs
    """

    def __init__(self, network: Perceptron, settings: EnsembleSettings, task: Task) -> None:
        self._network, self._settings = network, settings
        self._features, self._plans = SceneFeatures(task), SetpointPlans(task)
        allowed = self._features.size, settings.length * self._plans.width
        found = network.sizes[0], network.sizes[-1]
        if found != allowed:
            raise InputError(
                f"network: got {found[0]} inputs and {found[1]} outputs; allowed for"
                f" {task.scene.name}: {allowed[0]} and {allowed[1]}"
            )
        self._made: list[Array] = []  # set-points of the last plans

    def begin(self) -> None:
        """Forget all plans, at the begin of an episode."""
        self._made.clear()

    def act(self, readings: SceneReadings) -> Array:
        """Compute the actions of this period; call it once in each.

        Args:
            readings: of n worlds, whose episodes began together

        Returns:
            actions of `TipController`, (n, k)
        """
        plans, settings = self._plans, self._settings
        made = self._network(self._features.encode(readings)).astype(np.float64)
        made = made.reshape(len(readings), settings.length, plans.width)
        self._made.append(plans.setpoints(made, readings))
        self._made = self._made[-min(settings.most, settings.length) :]
        count = len(self._made)
        due = np.stack([one[:, count - 1 - k] for k, one in enumerate(self._made)], axis=1)
        weights = np.exp(-settings.decay * np.arange(count))
        total = weights / weights.sum() @ plans.actions(due, readings)
        return plans.capped(total, settings.speed_m_s, settings.spin_rad_s)
