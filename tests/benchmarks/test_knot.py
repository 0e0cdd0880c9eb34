"""The measures of an attempt to tie a knot."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.knot import linking


@pytest.mark.parametrize(("turns", "beside"), [(1, 0.0), (2, 0.0), (-1, 0.0), (1, 3.0)])
def test_a_closed_coil_is_linked_with_a_line_as_often_as_it_turns_about_it(
    turns: int, beside: float
) -> None:
    angle = 0.3 + np.linspace(0.0, 2.0 * np.pi * turns, 61 * abs(turns))
    wide = np.linspace(1.0, 1.2, len(angle))
    coil = np.column_stack([beside + wide * np.cos(angle), wide * np.sin(angle), 0.1 * angle])
    closed = np.concatenate([coil, coil[:1]])
    line = np.column_stack([np.zeros(3), np.zeros(3), [-999.0, 0.3, 999.0]])
    assert linking(closed, line) == pytest.approx(0.0 if beside else turns)
