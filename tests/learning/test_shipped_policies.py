"""The trained policies of examples/policies."""

import tomllib
from pathlib import Path

import pytest

from trocar.learning.policies import PolicyFile
from trocar.tasks import make_task, run_episode

FILES = sorted((Path(__file__).parents[2] / "examples" / "policies").glob("*.toml"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_shipped_policy_succeeds(file: Path) -> None:
    pytest.importorskip("safetensors", reason="safetensors is not installed (extra learn)")
    policy = PolicyFile(file)
    task = make_task(policy.scene)
    assert all(run_episode(task, seed, script=policy.script).success for seed in (50_000, 50_001))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_shipped_policy_is_small_and_has_the_command_that_makes_it(file: Path) -> None:
    table = tomllib.loads(file.read_text(encoding="utf-8"))
    assert table["training"]["command"].startswith(f"trocar learn train {table['scene']} --method")
    assert file.with_suffix(".safetensors").stat().st_size < 1e6


def test_needle_reach_and_needle_pick_are_shipped() -> None:
    assert {"needle-reach", "needle-pick"} <= {file.stem for file in FILES}
