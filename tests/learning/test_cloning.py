"""Behaviour cloning: demonstrations, datasets and training."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trocar.errors import InputError, LogError
from trocar.learning.cloning import (
    CloneSettings,
    Demonstrations,
    clone,
    demonstrate,
    read_demonstrations,
    torch_on,
)
from trocar.learning.collecting import Collection, collect
from trocar.learning.features import SetpointPlans
from trocar.learning.readings import read_task
from trocar.tasks import Task, make_task

PLAIN = replace(CloneSettings(), copies=0)
SMALL = replace(CloneSettings(), width=16, hidden=1, steps=60, batch=32)


@pytest.fixture(scope="module")
def reach() -> Task:
    return make_task("needle-reach")


@pytest.fixture(scope="module")
def shown(reach: Task) -> Demonstrations:
    return demonstrate(reach, range(2), PLAIN)


def random_rows(n: int = 200) -> Demonstrations:
    """Return plans that are a linear function of the features."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((n, 5)).astype(np.float32)
    return Demonstrations(x, x @ rng.standard_normal((5, 3)).astype(np.float32), 1, 0)


def test_copies_keep_the_periods_and_add_displaced_ones(reach: Task, shown: Demonstrations) -> None:
    found = demonstrate(reach, range(2), replace(PLAIN, copies=1))
    count = len(shown.inputs)
    assert len(found.inputs) == 2 * count
    np.testing.assert_array_equal(found.inputs[:count], shown.inputs)
    np.testing.assert_array_equal(found.plans[:count], shown.plans)
    # the tip and the plan from it move against one another: the set-point stays
    width, scale = SetpointPlans(reach).width, SetpointPlans(reach).scale
    moved = (found.inputs[count:, :3] - shown.inputs[:, :3]) / 20.0
    plans = (found.plans[count:] - shown.plans).reshape(count, -1, width) / scale
    assert np.abs(moved).max() > 1e-3
    np.testing.assert_allclose(
        plans[:, :, :3], -np.broadcast_to(moved[:, None], (*plans.shape[:2], 3)), atol=1e-6
    )


def test_a_dataset_gives_the_rows_of_its_episodes(
    reach: Task, shown: Demonstrations, tmp_path: Path
) -> None:
    pytest.importorskip("pyarrow", reason="datasets need pyarrow")
    collect(Collection("needle-reach"), range(2), tmp_path / "data")
    found = read_demonstrations(tmp_path / "data", reach, PLAIN)
    assert (found.episodes, found.failures) == (2, 0)
    # a dataset lacks the readings after the last period
    lasts = np.flatnonzero(np.isin(np.arange(len(shown.inputs)), _lasts(reach)))
    inputs, plans = np.delete(shown.inputs, lasts, 0), np.delete(shown.plans, lasts, 0)
    np.testing.assert_allclose(found.inputs, inputs, atol=1e-5)  # float32 of metres, times 20
    # set-points of a dataset are float32, and a period's begin where the last ended
    np.testing.assert_allclose(found.plans, plans, atol=1e-3)


def _lasts(task: Task) -> list[int]:
    """Return the rows after the last periods of the episodes."""
    rows: list[int] = []
    count = -1
    for seed in range(2):
        task.reset(seed)
        script = task.policy()
        while not task.done:
            task.command(next(script, task.stay()))
            count += 1
        count += 1
        rows.append(count)
    return rows


def test_a_dataset_of_another_scene_is_rejected(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="datasets need pyarrow")
    collect(Collection("needle-reach"), range(1), tmp_path / "data")
    (tmp_path / "data/card.toml").unlink()
    with pytest.raises(InputError, match=r"column observation.state: .* peg-transfer; allowed"):
        read_demonstrations(tmp_path / "data", make_task("peg-transfer"), PLAIN)


def test_the_card_of_a_dataset_has_its_scene_where_columns_are_alike(
    reach: Task, tmp_path: Path
) -> None:
    pytest.importorskip("pyarrow", reason="datasets need pyarrow")
    collect(Collection("needle-pick"), range(1), tmp_path / "data")
    with pytest.raises(InputError, match=r"data: is of the scene needle-pick; allowed: a dataset"):
        read_demonstrations(tmp_path / "data", reach, PLAIN)
    (tmp_path / "data/card.toml").write_text("scene = ", encoding="utf-8")
    with pytest.raises(LogError, match=r"card\.toml: is torn or no card"):
        read_demonstrations(tmp_path / "data", reach, PLAIN)


def test_numbers_of_a_dataset_that_are_not_finite_are_named(reach: Task, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="datasets need pyarrow")
    collect(Collection("needle-reach"), range(2), tmp_path / "data")
    (path,) = (tmp_path / "data/data").rglob("*.parquet")
    table = parquet.read_table(path)
    rewards = table["next.reward"].to_numpy().copy()
    rewards[-1] = np.nan
    row = table.column_names.index("next.reward")
    parquet.write_table(table.set_column(row, table.field(row), [rewards]), path)
    with pytest.raises(
        LogError, match=r"parquet: next\.reward: episode 1 has numbers that are not"
    ):
        read_demonstrations(tmp_path / "data", reach, PLAIN)


def test_no_success_is_an_error(reach: Task) -> None:
    with pytest.raises(InputError, match="no episode succeeded; allowed: one or more"):
        demonstrate(reach, (), PLAIN)


def test_a_seed_trains_one_network() -> None:
    pytest.importorskip("torch", reason="training needs PyTorch")
    rows = random_rows()
    one, two, other = (clone(rows, replace(SMALL, seed=seed)) for seed in (3, 3, 4))
    for (w, b), (w2, b2), (w3, _) in zip(one.layers, two.layers, other.layers, strict=True):
        np.testing.assert_array_equal(w, w2)
        np.testing.assert_array_equal(b, b2)
        assert not np.array_equal(w, w3)


def test_a_clone_predicts_plans_in_their_own_units() -> None:
    pytest.importorskip("torch", reason="training needs PyTorch")
    rows = random_rows()
    rows = replace(rows, plans=100.0 + 10.0 * rows.plans)
    losses: list[float] = []
    network = clone(rows, replace(SMALL, steps=600), watch=lambda _k, _n, loss: losses.append(loss))
    off = network(rows.inputs) - rows.plans
    assert off.std() < 0.2 * rows.plans.std()
    assert len(losses) == 6
    assert losses[-1] < 0.2 * losses[0]


def test_too_few_periods_are_an_error() -> None:
    pytest.importorskip("torch", reason="training needs PyTorch")
    with pytest.raises(InputError, match="got 10 periods to clone; allowed: 32 or more"):
        clone(random_rows(10), SMALL)


def test_devices_that_are_not_there_are_errors() -> None:
    torch = pytest.importorskip("torch", reason="training needs PyTorch")
    with pytest.raises(InputError, match="device: got 'tpu'; allowed: cpu, cuda"):
        torch_on("tpu")
    if not torch.cuda.is_available():
        with pytest.raises(InputError, match=r"device: got 'cuda', but PyTorch .* finds no GPU"):
            torch_on("cuda")


def test_demonstrations_begin_where_the_task_does(reach: Task, shown: Demonstrations) -> None:
    reach.reset(0)
    tip = read_task(reach).tips["PSM1"][0, :3, 3]
    np.testing.assert_allclose(shown.inputs[0, :3], 20.0 * tip, atol=1e-6)
