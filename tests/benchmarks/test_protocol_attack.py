"""The attack on a core by fuzzed messages: its cases are clean, and what is not is found."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.attack import Tally
from benchmarks.attack.protocol import Target, attack, damaged, spoilt


def test_fuzzed_messages_leave_the_core_at_work():
    tally = attack(seed=2, seconds=1.0)
    assert tally.failed == []
    assert tally.clean == tally.tried > 0


@pytest.fixture
def target():
    found = Target("psm", homed=True)
    yield found
    found.close()


def failures(target: Target) -> list[str]:
    return list(target.attacked(np.random.default_rng(0), lambda: False, Tally("test")))


@pytest.mark.parametrize("where", ["decoding", "applying", "stepping"])
def test_a_defect_is_found_wherever_it_is(target: Target, where: str, monkeypatch):
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a defect")

    if where == "decoding":
        monkeypatch.setattr(target.core.loop, "post", broken)
    elif where == "applying":
        monkeypatch.setattr(target.world.arm("PSM1").runtime.states, "stop", broken)
    else:
        monkeypatch.setattr(target.world, "step", broken)
    (failure,) = failures(target)
    assert "ZeroDivisionError" in failure


def test_the_same_seed_spoils_in_the_same_way():
    message = {"position": [0.1, 0.2], "name": [], "header": {"stamp": {"secs": 1, "nsecs": 2}}}
    made = [
        [repr((spoilt(rng, message), damaged(rng, b"0123456789abcdef"))) for _ in range(50)]
        for rng in (np.random.default_rng(1), np.random.default_rng(1))
    ]
    assert made[0] == made[1]
    assert len(set(made[0])) > 30
    assert message["position"] == [0.1, 0.2]
