"""Where jaws hold things."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.pads import pads
from trocar.errors import InputError


def test_pads_of_a_large_needle_driver_reach_from_its_axis_to_10_5_mm() -> None:
    found = pads(load_arm("psm", tool="LARGE_NEEDLE_DRIVER:400006"))
    ends = found.T_tip[2, 3] + np.array([-0.5, 0.5]) * found.length
    assert ends == pytest.approx([0.0003, 0.0105])
    assert found.width == pytest.approx(0.0036)
    assert found.T_tip[:2, 3] == pytest.approx([0.0, 0.0])


def test_an_arm_without_a_jaw_has_no_pads() -> None:
    with pytest.raises(InputError, match="has no jaw"):
        pads(load_arm("ecm"))
