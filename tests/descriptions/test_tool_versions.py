"""Geared instruments: which version of a model is which tool."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.catalogue import load_tool, names
from trocar.descriptions.tool_versions import GEARED, full_name, tool_of_version
from trocar.errors import InputError, UnknownNameError

BUILT_IN = [name for name in names("tools") if name.endswith(GEARED)]


@pytest.mark.parametrize(
    ("name", "tool"),
    [
        ("LARGE_NEEDLE_DRIVER:420006", "LARGE_NEEDLE_DRIVER:420006"),
        ("LARGE_NEEDLE_DRIVER:420006[..]", "LARGE_NEEDLE_DRIVER:420006"),
        ("LARGE_NEEDLE_DRIVER:420006[..11]", "LARGE_NEEDLE_DRIVER:420006"),
        ("LARGE_NEEDLE_DRIVER:420006[11]", "LARGE_NEEDLE_DRIVER:420006"),
        ("LARGE_NEEDLE_DRIVER:420006[12]", "LARGE_NEEDLE_DRIVER:420006_GEARED"),
        ("LARGE_NEEDLE_DRIVER:420006[12..]", "LARGE_NEEDLE_DRIVER:420006_GEARED"),
        ("PROGRASP_FORCEPS:420093[13..20]", "PROGRASP_FORCEPS:420093"),
        ("LARGE_NEEDLE_DRIVER:400006[14]", "LARGE_NEEDLE_DRIVER:400006"),
    ],
)
def test_the_version_selects_the_geared_instrument(name, tool):
    assert tool_of_version(name) == tool
    assert load_tool(name).name == tool


@pytest.mark.parametrize("name", names("tools"))
def test_a_published_name_leads_back_to_its_tool(name):
    assert tool_of_version(full_name(name)) == name


@pytest.mark.parametrize("name", BUILT_IN)
def test_gears_change_the_ratio_of_the_roll_alone(name):
    geared, before = load_tool(name), load_tool(name.removesuffix(GEARED))
    assert geared.coupling is not None and before.coupling is not None
    A, B = geared.coupling.actuator_to_joint, before.coupling.actuator_to_joint
    assert A[0, 0] == 1.5333
    np.testing.assert_array_equal(A[1:], B[1:])
    assert geared.fits == before.fits


def test_two_geared_instruments_are_built_in():
    assert BUILT_IN == ["LARGE_NEEDLE_DRIVER:420006_GEARED", "PROGRASP_FORCEPS:420093_GEARED"]


@pytest.mark.parametrize("name", ["LARGE_NEEDLE_DRIVER:420006[x]", "LARGE_NEEDLE_DRIVER:420006[]"])
def test_brackets_without_versions_are_an_error(name):
    with pytest.raises(InputError, match=r"allowed: \[3\], \[3\.\.\], \[\.\.3\]"):
        load_tool(name)


def test_a_geared_instrument_that_is_not_built_in_says_why():
    with pytest.raises(UnknownNameError, match="it is not built in"):
        load_tool("MEGA_NEEDLE_DRIVER:420194[12..]")


def test_classic_instruments_do_not_fit_an_si_but_those_of_the_si_fit_a_classic():
    for classic in (name for name in names("tools") if ":400" in name):
        with pytest.raises(InputError, match="does not fit psm_si, which is of generation Si"):
            load_arm("psm_si", classic)
    for later in (name for name in names("tools") if ":420" in name):
        assert load_arm("psm", later).tool == load_arm("psm_si", later).tool == later
