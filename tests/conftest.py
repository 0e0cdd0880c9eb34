"""What several rooms' tests share: seeded random joint positions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription


@pytest.fixture
def rng() -> np.random.Generator:
    """Return the generator that every test starts from."""
    return np.random.default_rng(20260 + 1)


Sampler = Callable[[ArmDescription, np.random.Generator, int], NDArray[np.float64]]


@pytest.fixture
def random_positions() -> Sampler:
    """Return the function that draws joint positions over an arm's whole range."""
    return _random_positions


def _random_positions(
    arm: ArmDescription, rng: np.random.Generator, count: int
) -> NDArray[np.float64]:
    """Return joint positions, jaws from shut on, (count, n)."""
    mechanism = arm.mechanism
    q = rng.uniform(mechanism.lower, mechanism.upper, (count, len(mechanism.joints)))
    if arm.has_jaw:
        q[:, -1] = np.abs(q[:, -1])
    return q
