"""Episodes of a policy file on a local cluster of two workers."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

POLICY = Path(__file__).parents[2] / "examples" / "policies" / "reach.py"


@pytest.mark.slow
@pytest.mark.parametrize("settings", [[], ["--set", "randomise=lab", "--set", "tips=camera"]])
def test_a_cluster_plays_a_policy_file_as_one_process_does(settings: list[str]) -> None:
    pytest.importorskip("ray", reason="the extra cluster is not installed")
    words = ["play", "needle-reach", "--headless", "--json", "--episodes", "3", *settings]
    words += ["--policy", str(POLICY)]
    found = []
    for more in ([], ["--workers", "2", "--cluster", "local"]):
        done = subprocess.run(
            [sys.executable, "-m", "trocar", *words, *more],
            capture_output=True,
            text=True,
            timeout=900,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        found.append(json.loads(done.stdout[done.stdout.index("{") :])["episodes"])
    assert len(found[0]) == 3
    assert found[0] == found[1]
