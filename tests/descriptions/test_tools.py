"""Every built-in tool: the dVRK's numbers, written out here a second time, and what it fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import fitting_tools, load_arm, load_rig, load_tool, names, rig_with_tool
from trocar.descriptions.catalogue import DATA
from trocar.descriptions.mounting import carried_over, with_tool
from trocar.descriptions.table import read_table
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.dh import modified_dh
from trocar.kinematics.forward import pose
from trocar.kinematics.inverse import inverse_kinematics

Array = NDArray[np.float64]
TOOLS = names("tools")
UNGEARED = tuple(tool for tool in TOOLS if not tool.endswith("_GEARED"))
RIGHT = np.pi / 2
#: Rounding of a product of ten transforms of metre size.
EXACT = 1e-12

NEEDLE = [[-1.5632, 0, 0, 0], [0, 1.0186, 0, 0], [0, -0.8306, 0.6089, 0.6089]]
NEEDLE += [[0, 0, -1.2177, 1.2177]]
BIPOLAR = [[-1.563233, 0, 0, 0], [0, 1, 0, 0], [0, -0.630273, 0.457982, 0.457982]]
BIPOLAR += [[0, 0, -0.915964, 0.915964]]
PROGRASP = [[-1.5631, 0, 0, 0], [0, 1, 0, 0], [0, -0.5068, -0.5135, -0.5135]]
PROGRASP += [[0, 0, -0.5279, 0.5279]]
#: Model number: wrist length [mm], limits [deg] of roll, wrist pitch and yaw, lower limit of the
#: jaw [deg], its effort [N m], coupling. Source: sawIntuitiveResearchKit share/tool/*.json.
PRINTED = {
    "400006": (9.1, (260, 80, 80), -40, 0.16, NEEDLE),
    "420006": (9.1, (260, 80, 80), -20, 0.16, NEEDLE),
    "400172": (10.7, (255, 70, 90), -20, 0.19, BIPOLAR),
    "420172": (10.7, (255, 70, 90), -20, 0.19, BIPOLAR),
    "400205": (10.7, (255, 70, 90), -40, 0.19, BIPOLAR),
    "420205": (10.7, (255, 70, 90), -40, 0.19, BIPOLAR),
    "400093": (10.7, (260, 80, 80), -20, 0.16, PROGRASP),
    "420093": (10.7, (260, 80, 80), -20, 0.16, PROGRASP),
    "400179": (9.1, (260, 80, 80), -20, 0.16, NEEDLE),
    "420179": (9.1, (260, 80, 80), -20, 0.16, NEEDLE),
}
#: The shaft of Classic tools and of those for S and Si [m]. Source: as above.
SHAFT = {"40": 0.4162, "42": 0.4670}


def code_of(tool: str) -> str:
    return tool.partition(":")[2]


def chain(q: Array, shaft: float, wrist: float) -> Array:
    """T_rcm_tip of a Classic PSM. Source: SAW PSM.json, share/tool, the tooltip-offset."""
    tooltip = np.array([[0.0, -1, 0, 0], [0, 0, 1, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    return (
        modified_dh(0.0, RIGHT, 0.0, q[0] + RIGHT)
        @ modified_dh(0.0, -RIGHT, 0.0, q[1] - RIGHT)
        @ modified_dh(0.0, RIGHT, q[2] - 0.4318, 0.0)
        @ modified_dh(0.0, 0.0, shaft, q[3])
        @ modified_dh(0.0, -RIGHT, 0.0, q[4] - RIGHT)
        @ modified_dh(wrist, -RIGHT, 0.0, q[5] - RIGHT)
        @ tooltip
    )


def test_the_issue_s_instruments_are_all_there() -> None:
    assert sorted(map(code_of, UNGEARED)) == sorted(PRINTED)


@pytest.mark.parametrize("tool", UNGEARED)
def test_a_tool_has_the_numbers_that_the_dvrk_has(tool: str) -> None:
    wrist, angles, shut, effort, coupling = PRINTED[code_of(tool)]
    arm = load_arm("psm", tool)
    limits = np.deg2rad(angles)
    np.testing.assert_allclose(arm.mechanism.upper[3:6], limits, rtol=0, atol=5e-5)
    np.testing.assert_allclose(arm.mechanism.lower[3:6], -limits, rtol=0, atol=5e-5)
    jaw = arm.joint("jaw")
    assert np.rad2deg([jaw.lower, jaw.upper]) == pytest.approx([shut, 80], abs=1e-3)
    assert (jaw.effort_max, jaw.stop_lower) == (effort, 0.0)
    assert arm.coupling is not None
    np.testing.assert_array_equal(arm.coupling.actuator_to_joint, coupling)
    shaft = SHAFT[code_of(tool)[:2]]
    for q in np.random.default_rng(3).uniform(arm.mechanism.lower, arm.mechanism.upper, (50, 7)):
        expected = chain(q, shaft, wrist / 1000)
        np.testing.assert_allclose(pose(arm.mechanism, q), expected, rtol=0, atol=EXACT)


@pytest.mark.parametrize("tool", TOOLS)
def test_inverse_kinematics_finds_the_pose_of_every_tool_again(tool: str) -> None:
    arm = load_arm("psm", tool)
    mechanism = arm.mechanism
    rng = np.random.default_rng(4)
    for q in rng.uniform(mechanism.lower, mechanism.upper, (50, 7)):
        q[2] = max(q[2], 0.03)  # past the remote centre
        found = inverse_kinematics(mechanism, "rcm_arm", pose(mechanism, q), q[:6])
        assert np.abs(found[0][:6] - q[:6]).max() < 1e-9


@pytest.mark.parametrize("tool", TOOLS)
def test_a_tool_says_where_its_numbers_are_from(tool: str) -> None:
    found = load_tool(tool)
    assert "sawIntuitiveResearchKit" in found.source
    sources = {**found.parts.block_sources, **found.parts.sources}
    for block in ("rotor", "friction identified", "friction paper", "control dvrk"):
        assert sources[block]
    assert all(source for name, source in found.parts.sources.items()), sources
    assert all(body.source for body in found.parts.bodies)


@pytest.mark.parametrize("code", ["40", "42"])
def test_each_instrument_has_jaws_of_its_own(code: str) -> None:
    looks = [
        [shape.size.tolist() for body in load_tool(t).parts.bodies for shape in body.shapes]
        for t in UNGEARED
        if code_of(t).startswith(code)
    ]
    assert len(looks) == 5
    assert all(one != other for k, one in enumerate(looks) for other in looks[:k])


def test_classic_tools_are_too_short_for_an_si_arm_and_long_ones_fit_both() -> None:
    assert fitting_tools(load_arm("psm")) == TOOLS
    assert fitting_tools(load_arm("psm_si")) == tuple(t for t in TOOLS if ":42" in t)
    assert fitting_tools(load_arm("ecm")) == ()
    with pytest.raises(InputError, match=r"400093: does not fit psm_si, .* Si; it fits Classic$"):
        load_arm("psm_si", "PROGRASP_FORCEPS:400093")


def test_an_unknown_tool_is_answered_with_those_that_are_known() -> None:
    with pytest.raises(UnknownNameError, match=r"PROGRASP_FORCEPS:420093'\?\); known: FENESTRATED"):
        load_tool("PROGRASP_FORCEP:420093")


def groups() -> dict[str, str]:
    """{instrument that is not built in: why}."""
    table = read_table(DATA / "instruments.toml")
    return {name: g.text("why") for g in table.tables("group") for name in g.texts("names")}


def test_instruments_that_are_not_built_in_are_named_with_the_reason() -> None:
    absent = groups()
    assert not set(absent) & set(TOOLS)
    for name, why in absent.items():
        with pytest.raises(UnknownNameError) as caught:
            load_tool(name)
        assert f"{name}: {why}" in str(caught.value)
        assert "docs/how-to/design-a-tool.md" in str(caught.value)


def test_a_rig_with_another_tool_differs_in_that_tool_alone() -> None:
    rig = load_rig("three_psm")
    other = rig_with_tool(rig, "PSM2", "MARYLAND_BIPOLAR_FORCEPS:420172")
    assert other.arm("PSM2").arm.tool == "MARYLAND_BIPOLAR_FORCEPS:420172"
    assert rig.arm("PSM2").arm.tool == "LARGE_NEEDLE_DRIVER:400006"
    assert [a for a in other.arms if a.name != "PSM2"] == [a for a in rig.arms if a.name != "PSM2"]
    np.testing.assert_array_equal(other.arm("PSM2").pose, rig.arm("PSM2").pose)
    lower, upper = other.arm("PSM2").arm.mechanism.lower, other.arm("PSM2").arm.mechanism.upper
    for by_arm in other.poses.values():
        assert ((by_arm["PSM2"] >= lower) & (by_arm["PSM2"] <= upper)).all()


def test_positions_are_carried_over_by_name_and_clipped() -> None:
    bare, driver = load_arm("psm", "none"), load_arm("psm")
    maryland = with_tool(driver, "MARYLAND_BIPOLAR_FORCEPS:400172")
    q = np.array([0.1, 0.2, 0.15, -4.53, 1.39, -0.4, 0.5])
    moved = carried_over(q, driver, maryland)
    assert moved.tolist() == [0.1, 0.2, 0.15, -4.4506, 1.2217, -0.4, 0.5]
    assert carried_over(q, driver, bare).tolist() == [0.1, 0.2, 0.15]
    assert carried_over(q[:3], bare, driver).tolist() == [0.1, 0.2, 0.15, 0, 0, 0, 0]


def test_an_arm_that_was_changed_in_python_is_not_read_again() -> None:
    """The change would be lost without a word."""
    arm = load_arm("psm")
    first, *others = arm.mechanism.closures
    loose = replace(arm.mechanism, closures=(replace(first, open=True), *others))
    with pytest.raises(InputError, match=r"psm: c1 differs from .*psm.toml; a tool is mounted on"):
        with_tool(replace(arm, mechanism=loose), "PROGRASP_FORCEPS:420093")
    yaw = replace(arm.joints[0], upper=1.0)
    with pytest.raises(InputError, match=r"psm: yaw differs from"):
        with_tool(replace(arm, joints=(yaw, *arm.joints[1:])), "PROGRASP_FORCEPS:420093")


@pytest.mark.parametrize(
    ("arm", "tool", "message"),
    [
        ("ECM", "PROGRASP_FORCEPS:400093", r"ECM: ecm: takes no tool; only arms with a tool_frame"),
        ("SUJ_PSM1", "PROGRASP_FORCEPS:400093", r"SUJ_PSM1: suj_psm1: takes no tool"),
        ("PSM9", "PROGRASP_FORCEPS:400093", r"unknown arm 'PSM9'.*known: .*PSM1"),
        ("PSM1", "SPATULA", r"unknown tool 'SPATULA'; known: FENESTRATED"),
        ("PSM1", "nowhere.toml", r"nowhere.toml: there is no such file"),
    ],
)
def test_a_tool_that_cannot_be_mounted_is_rejected(arm: str, tool: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        rig_with_tool(load_rig("full_cart"), arm, tool)
