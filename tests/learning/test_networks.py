"""Networks in numpy agree with PyTorch's; ensembles average what plans have for now."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from trocar.errors import InputError, UnknownNameError
from trocar.learning.features import SceneFeatures, SetpointPlans
from trocar.learning.networks import (
    EnsembleSettings,
    Perceptron,
    TemporalEnsemble,
    goal_difference,
    make_perceptron,
    perceptron_from_tensors,
)
from trocar.learning.readings import read_task
from trocar.tasks import Task, make_task


def random_network(sizes: tuple[int, ...], activation: str = "gelu", **more: Any) -> Perceptron:
    rng = np.random.default_rng(0)
    layers = [
        (rng.normal(size=(b, a)) / np.sqrt(a), rng.normal(size=b)) for a, b in pairwise(sizes)
    ]
    return make_perceptron(layers, activation, **more)


@pytest.mark.parametrize(
    ("activation", "module"),
    [
        ("relu", "ReLU"),
        ("tanh", "Tanh"),
        ("elu", "ELU"),
        ("gelu", "GELU"),
        ("identity", "Identity"),
    ],
)
def test_a_network_is_that_of_pytorch(activation: str, module: str) -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed (extra learn)")
    of = random_network((6, 16, 8, 3), activation, output="tanh", outputs=([1.0, 2.0, 3.0], 0.5))
    parts: list[Any] = []
    for weight, bias in of.layers:
        linear = torch.nn.Linear(*reversed(weight.shape))
        linear.load_state_dict({"weight": torch.tensor(weight), "bias": torch.tensor(bias)})
        parts += [linear, getattr(torch.nn, module)()]
    net = torch.nn.Sequential(*parts[:-1], torch.nn.Tanh())
    x = np.random.default_rng(1).normal(size=(5, 6)).astype(np.float32)
    with torch.no_grad():
        wanted = net(torch.tensor(x)).numpy() * 0.5 + [1.0, 2.0, 3.0]
    found = of(x)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, wanted, atol=2e-6)  # float32, sums of 16 terms


def test_inputs_are_normalised() -> None:
    of = random_network((2, 3), inputs=([1.0, -1.0], [2.0, 4.0]))
    weight, bias = of.layers[0]
    found = of(np.array([[3.0, 3.0]], np.float32))
    np.testing.assert_allclose(found[0], weight @ [1.0, 1.0] + bias, rtol=1e-6)


def test_tensors_make_the_network_again() -> None:
    of = random_network((4, 5, 2))
    again = perceptron_from_tensors(of.tensors(), of.sizes, "gelu", "identity", "a file")
    x = np.ones((1, 4), np.float32)
    np.testing.assert_array_equal(of(x), again(x))


def changed(**given: Any) -> dict[str, Any]:
    found: dict[str, Any] = dict(random_network((4, 5, 2)).tensors())
    for name, value in given.items():
        found[name.replace("_", ".")] = value
    return {name: value for name, value in found.items() if value is not None}


@pytest.mark.parametrize(
    ("tensors", "message"),
    [
        (changed(layers_1_bias=None), "a file: tensor layers.1.bias: got "),
        (changed(extra=np.zeros(1, np.float32)), "a file: tensor extra: got "),
        (changed(layers_0_bias=np.zeros(5)), "got float64 of shape .5,.; allowed: float32"),
        (changed(input_std=np.zeros(4, np.float32)), "input.std: got 0 or less"),
        (changed(input_mean=np.full(4, np.nan, np.float32)), "numbers that are not finite"),
    ],
)
def test_broken_tensors_are_one_error(tensors: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        perceptron_from_tensors(tensors, (4, 5, 2), "gelu", "identity", "a file")


def test_an_unknown_activation_is_one_error() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown activation 'relo' \(did you mean 'relu'"):
        random_network((4, 2), "relo")


def test_goal_differences_are_zero_at_the_goal() -> None:
    goal = np.array([[0.3, -0.2, 0.1]])
    found = goal_difference([[1.0, 2.0]], goal, goal)
    np.testing.assert_array_equal(found, np.array([[1.0, 2.0, 0, 0, 0, 0, 0, 0]], np.float32))
    found = goal_difference([[1.0, 2.0]], goal, goal + np.array([0.1, 0.0, 0.0]))
    np.testing.assert_allclose(found[0, [2, 5]], [0.5, np.tanh(2.5)], rtol=1e-6)


@pytest.fixture(scope="module")
def task() -> Task:
    return make_task("needle-pick")


def test_an_ensemble_of_one_plan_reaches_its_first_set_point(task: Task) -> None:
    task.reset(3)
    settings = EnsembleSettings(length=4, most=1)
    plans, features = SetpointPlans(task), SceneFeatures(task)
    of = random_network((features.size, 4 * plans.width), outputs=(0.0, 1e-3))
    ensemble = TemporalEnsemble(of, settings, task)
    for _ in range(3):
        now = read_task(task)
        made = of(features.encode(now)).astype(np.float64).reshape(1, 4, plans.width)
        wanted = plans.actions(plans.setpoints(made, now)[:, :1], now)[:, 0]
        action = ensemble.act(now)
        np.testing.assert_allclose(action, wanted, rtol=1e-12)
        task.command(action[0])


def test_an_ensemble_weighs_the_oldest_plan_most(task: Task) -> None:
    task.reset(3)
    settings = EnsembleSettings(length=3, most=2, decay=0.5, speed_m_s=10.0, spin_rad_s=100.0)
    plans, features = SetpointPlans(task), SceneFeatures(task)
    of = random_network((features.size, 3 * plans.width), outputs=(0.0, 1e-2))
    ensemble = TemporalEnsemble(of, settings, task)
    made: list[np.ndarray] = []
    now, action = read_task(task), np.zeros((1, 7))
    for _ in range(4):
        now = read_task(task)
        plan = of(features.encode(now)).astype(np.float64).reshape(1, 3, plans.width)
        made.append(plans.setpoints(plan, now))
        action = ensemble.act(now)
        task.command(action[0])
    older = plans.actions(made[2][:, 1:2], now)[:, 0]
    newer = plans.actions(made[3][:, :1], now)[:, 0]
    share = 1.0 / (1.0 + np.exp(-0.5))
    np.testing.assert_allclose(action, share * older + (1.0 - share) * newer, rtol=1e-9)
    ensemble.begin()
    np.testing.assert_allclose(ensemble.act(now), newer, rtol=1e-12)


def test_a_network_of_another_scene_is_one_error(task: Task) -> None:
    of = random_network((12, 140))
    with pytest.raises(InputError, match="got 12 inputs and 140 outputs; allowed for needle-pick"):
        TemporalEnsemble(of, EnsembleSettings(), task)
