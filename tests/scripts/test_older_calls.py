"""Scripts of dVRK 1.x and 2.0 to 2.2: their calls move the arm as those of 2.4 do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.scripts.playing import play
from trocar.scripts.dvrk_older import CALLS, END_READINGS, READINGS

NEW = """
import crtk, dvrk, json, math, numpy as np, PyKDL
ral = crtk.ral("new")
p = dvrk.psm(ral, "PSM1")
"""
OLD = """
import dvrk, json, math, numpy as np, PyKDL
p = dvrk.psm("PSM1")
"""
HOME = """
p.home()
p.move_jp(np.array([0.1, -0.1, 0.12, 0.2, 0.1, 0.3])).wait()
"""
KEEP = """
with open("FOLDER/q.json", "w") as file:
    json.dump([list(map(float, one)) for one in (JOINTS, JAW)], file)
"""

#: {call of 1.x: the same in 2.4}
SAME = {
    "p.move_joint(np.array([0.2, 0.0, 0.13, 0.1, 0.2, 0.1]))": (
        "p.move_jp(np.array([0.2, 0.0, 0.13, 0.1, 0.2, 0.1])).wait()"
    ),
    "p.move_joint(np.array([[0.2, 0.0, 0.13, 0.1, 0.2, 0.1]]))": (
        "p.move_jp(np.array([0.2, 0.0, 0.13, 0.1, 0.2, 0.1])).wait()"
    ),
    "p.dmove_joint(0.02 * np.ones(6))": "p.move_jp(p.setpoint_jp()[0] + 0.02).wait()",
    "p.move_joint_one(0.14, 2)": "p.insert_jp(0.14).wait()",
    "p.dmove_joint_one(0.02, 2)": "p.insert_jp(0.14).wait()",
    "p.insert_tool(0.14)": "p.insert_jp(0.14).wait()",
    "p.dinsert_tool(0.02)": "p.insert_jp(0.14).wait()",
    "p.insert_jp(0.14).wait()": "p.insert_jp(0.14).wait()",
    "p.move_joint_some(np.array([0.3, 0.4]), np.array([0, 5]))": (
        "q = np.array(p.setpoint_jp()[0]); q[[0, 5]] = 0.3, 0.4; p.move_jp(q).wait()"
    ),
    "p.dmove_joint_some(np.array([0.1, 0.2]), np.array([0, 5]))": (
        "q = np.array(p.setpoint_jp()[0]); q[[0, 5]] += 0.1, 0.2; p.move_jp(q).wait()"
    ),
    "p.dmove(PyKDL.Vector(0.0, 0.01, 0.0))": (
        "f = p.setpoint_cp()[0]; f.p += PyKDL.Vector(0.0, 0.01, 0.0); p.move_cp(f).wait()"
    ),
    "p.dmove(PyKDL.Rotation.RotZ(0.1))": (
        "f = PyKDL.Frame(PyKDL.Rotation.RotZ(0.1)) * p.setpoint_cp()[0]; p.move_cp(f).wait()"
    ),
    "p.dmove(PyKDL.Frame(PyKDL.Rotation.RotZ(0.1), PyKDL.Vector(0.01, 0, 0)))": (
        "f = PyKDL.Frame(PyKDL.Rotation.RotZ(0.1), PyKDL.Vector(0.01, 0, 0))"
        " * p.setpoint_cp()[0]; p.move_cp(f).wait()"
    ),
    "p.move(p.get_current_position().p + PyKDL.Vector(0.01, 0, 0))": (
        "f = p.setpoint_cp()[0]; f.p = p.measured_cp()[0].p + PyKDL.Vector(0.01, 0, 0);"
        " p.move_cp(f).wait()"
    ),
    "p.move(PyKDL.Rotation.RotZ(0.1) * p.get_desired_position().M)": (
        "f = p.setpoint_cp()[0]; f.M = PyKDL.Rotation.RotZ(0.1) * f.M; p.move_cp(f).wait()"
    ),
    "p.move_jaw(0.5)": "p.jaw.move_jp(np.array([0.5])).wait()",
    "p.close_jaw()": "p.jaw.close().wait()",
    "p.open_jaw()": "p.jaw.move_jp(np.array([math.radians(80)])).wait()",
}


def end(folder: Path, head: str, text: str, joints: str, jaw: str) -> list[list[float]]:
    keep = KEEP.replace("FOLDER", str(folder)).replace("JOINTS", joints).replace("JAW", jaw)
    assert play(folder, head + HOME + text + keep).status == 0
    return json.loads((folder / "q.json").read_text())


@pytest.mark.parametrize("old", SAME)
def test_a_call_of_1_x_moves_as_that_of_2_4(tmp_path: Path, old: str) -> None:
    found = end(tmp_path, OLD, old, "p.setpoint_jp()", "p.jaw.setpoint_jp()")
    same = end(tmp_path, NEW, SAME[old], "p.setpoint_jp()[0]", "p.jaw.setpoint_jp()[0]")
    before = end(tmp_path, NEW, "", "p.setpoint_jp()[0]", "p.jaw.setpoint_jp()[0]")
    for k in range(2):
        np.testing.assert_allclose(found[k], same[k], atol=1e-9)
    changed = [abs(np.subtract(found[k], before[k])).max() for k in range(2)]
    assert max(changed) > 1e-3 or "close" in old


READ = "p.get_current_joint_position()"


@pytest.mark.parametrize(("blocking", "least", "most"), [(True, 0.29, 0.31), (False, -0.1, 0.2)])
def test_a_move_waits_where_it_blocks(
    tmp_path: Path, blocking: bool, least: float, most: float
) -> None:
    text = f"print(p.move_joint_one(0.3, 0, blocking={blocking}))\n"
    joints, _ = end(tmp_path, OLD, text, READ, "[p.get_current_jaw_position()]")
    assert least < joints[0] < most


def test_a_set_point_without_a_trajectory_is_that_of_servo_jp(tmp_path: Path) -> None:
    text = "p.move_joint_one(0.101, 0, False)\nimport time; time.sleep(0.5)\n"
    joints, _ = end(tmp_path, OLD, text, "p.get_desired_joint_position()", "[0.0]")
    assert joints[0] == pytest.approx(0.101)


def test_every_reading_of_1_x_is_that_of_2_4_without_its_time(tmp_path: Path) -> None:
    lines: list[str] = []
    for call, (part, reading) in {**READINGS, **END_READINGS}.items():
        if part == "gripper":
            continue
        got = f"{part}.{reading}" if part else reading
        new = f"n.{got}()" + ("" if reading == "jacobian" else "[0]")
        lines.append(f"same(p.{call}(), {new}, {call!r})")
    text = """
n = dvrk.psm(__import__("crtk").ral("new"), "PSM1")
def same(a, b, name):
    b = b[0] if isinstance(a, float) else b
    if hasattr(a, "M"):
        assert (a.p - b.p).Norm() < 1e-4, name
    else:
        np.testing.assert_allclose(a, b, atol=0.05, err_msg=name)
"""
    assert play(tmp_path, OLD + HOME + text + "\n".join(lines)).status == 0


def test_a_master_and_a_console_are_made_by_their_names(tmp_path: Path) -> None:
    text = """
import dvrk
m = dvrk.mtm("MTML")
assert isinstance(m.get_current_gripper_position(), float)
assert m.get_joint_number() == 7
m.lock_orientation_as_is()
assert len(dvrk.ecm("ECM").measured_jp()) == 4
assert dvrk.console().teleop_get_scale() >= 0.0
"""
    assert play(tmp_path, text, "full_cart_mtm").status == 0


def test_setup_joints_of_one_arm_are_made_by_its_name(tmp_path: Path) -> None:
    text = """
import dvrk
assert len(dvrk.suj("PSM1").measured_jp()) == 6
assert len(dvrk.suj("ECM").measured_js()[0]) == 4
assert dvrk.suj("PSM2").measured_cp().p[2] < 1.0
assert dvrk.suj("PSM3").local.measured_cp().p[2] > 0.0
"""
    assert play(tmp_path, text, "full_cart").status == 0


def test_an_arm_with_an_expected_interval_has_readings_without_times(tmp_path: Path) -> None:
    text = """
import crtk, dvrk
ral = crtk.ral("both")
old = dvrk.psm(ral=ral, arm_name="PSM1", expected_interval=0.01)
new = dvrk.psm(ral, "PSM2")
ral.check_connections()
assert old.setpoint_jp().shape == (6,)
assert old.jaw.measured_jp().shape == (1,)
assert old.setpoint_cp().p.Norm() > 0.0
assert old.move_joint_one(0.15, 2)
position, time = new.setpoint_jp()
assert len(position) == 6 and time > 0.0
"""
    assert play(tmp_path, text, "two_psm_ecm").status == 0


def test_an_arm_of_2_4_has_no_older_calls(tmp_path: Path) -> None:
    names = sorted({*CALLS, *READINGS, *END_READINGS})
    text = f"assert not [name for name in {names} if hasattr(p, name)]"
    assert play(tmp_path, NEW + text).status == 0


@pytest.mark.parametrize(
    ("text", "hint"),
    [("raw_input()", True), ("import two", True), ("range(xranges)", False)],
)
def test_names_of_python_2_and_imported_files_of_it_give_a_hint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, hint: bool
) -> None:
    (tmp_path / "two.py").write_text('print "two"\n')
    assert play(tmp_path, f"import dvrk\n{text}").status == 1
    assert ("2to3 -w" in capsys.readouterr().err) == hint


def test_utils_take_a_namespace_as_before_2_3(tmp_path: Path) -> None:
    text = """
import crtk
class Device:
    pass
d = Device()
u = crtk.utils(d, "PSM1", 0.01)
u.add_operating_state()
u.add_measured_js()
u.add_measured_cp()
d.home()
assert len(d.measured_jp()) == 6
assert d.measured_cp().p[2] < 0.0
assert [len(part) for part in d.measured_js()] == [6, 6, 6]
"""
    assert play(tmp_path, text).status == 0
