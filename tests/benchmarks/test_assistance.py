"""The modelled operator of the benchmark, and what it prints."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import assistance
from benchmarks.assistance import CONDITIONS, PATHS, Trial, figures, interval, noise, trials


def test_noise_is_the_seed_s_own_and_as_large_as_stated() -> None:
    one, again, other = noise(3), noise(3), noise(4)
    assert (one == again).all()
    assert (one != other).any()
    expected = np.hypot(assistance.DRIFT_M, assistance.TREMOR_M)
    np.testing.assert_allclose(one.std(axis=0), expected, rtol=0.02)


def test_an_interval_is_student_s() -> None:
    # t(0.975, 4) = 2.776
    assert interval(np.array([1.0, 2.0, 3.0, 4.0, 5.0])) == pytest.approx(
        (3.0, 2.776 * np.sqrt(2.5 / 5.0)), rel=1e-3
    )


def test_figures_compare_the_same_seeds() -> None:
    def runs(error: float) -> list[Trial]:
        return [Trial(error + 0.1 * k, 2 * error, 3.0, np.zeros((1, 3))) for k in range(4)]

    found = figures(
        {"line": {c: runs(e) for c, e in zip(CONDITIONS, (2.0, 1.0, 3.0), strict=True)}}
    )
    by_name = {one.name: one for one in found}
    assert by_name["line, force: error RMS, saved at least (95 %)"].value == pytest.approx(1.0)
    assert by_name["line, force: error RMS, saved at least (95 %)"].met is True
    assert by_name["line, filter: error RMS, saved at least (95 %)"].met is False


@pytest.mark.slow
@pytest.mark.parametrize("name", PATHS)
def test_fixtures_help_the_operator_and_a_seed_repeats(name: str) -> None:
    plain, force, again = (trials(name, c, 1)[0] for c in ("none", "force", "force"))
    assert force.rms < 0.7 * plain.rms
    assert force.time < plain.time
    assert (force.tips == again.tips).all()
