"""The simulation beside recorded answers of the dVRK's own software."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.genuine import __main__ as genuine
from benchmarks.genuine import cart
from benchmarks.genuine.compare import HANG, UNSET, before_parting, compared, outcome, same_fact
from benchmarks.genuine.plans import PLANS
from benchmarks.genuine.purpose import PURPOSE, RULES
from benchmarks.genuine.steps import matrix, quaternion, rotation
from trocar.cli.program import main as trocar
from trocar.robot.dvrk_config import import_dvrk
from trocar.simulation import World

PAGE = genuine.ROOT / "docs" / "as-on-the-robot.md"

#: Steps and facts that are as the robot's, or differ on purpose. A change may raise these.
REACHED = {
    "psm": 366, "mtm": 60, "ecm": 46, "suj": 15, "teleoperation": 30,
    "walk-states": 664, "walk-moves": 156, "walk-poses": 120,
}  # fmt: skip
#: The same for part A alone, the states.
STATES_REACHED = 56


def step(name: str, *events: tuple[str, Any], **setpoints: list[float]) -> dict[str, Any]:
    listed = [[0.0, topic, value] for topic, value in events]
    return {"step": name, "events": listed, **setpoints}


def record(*steps: dict[str, Any], **facts: Any) -> dict[str, Any]:
    return {"steps": list(steps), "facts": facts}


def kept(rows: list[genuine.Row]) -> int:
    return sum(row.verdict in ("same", "purpose") for row in rows)


@pytest.mark.parametrize("plan", PLANS)
def test_each_plan_has_recorded_answers(plan: str) -> None:
    recorded = genuine.read(genuine.RECORDED / f"{plan}.json.gz")
    assert recorded["plan"] == plan
    assert recorded["steps"]


@pytest.mark.parametrize("plan", PURPOSE)
def test_a_difference_on_purpose_names_a_recorded_step(plan: str) -> None:
    recorded = genuine.read(genuine.RECORDED / f"{plan}.json.gz")
    names = {each["step"] for each in recorded["steps"]} | set(recorded["facts"])
    assert set(PURPOSE[plan]) <= names


@pytest.mark.parametrize(
    "reason", sorted({r for p in PURPOSE.values() for r in p.values()} | {*RULES})
)
def test_each_difference_on_purpose_is_a_row_of_the_page(reason: str) -> None:
    subjects = re.findall(r"^\| ([^|]+?) \|", PAGE.read_text(), flags=re.MULTILINE)
    assert any(reason.startswith(f"{subject}:") for subject in subjects)


def test_forward_kinematics_of_the_si_are_as_recorded(capsys: pytest.CaptureFixture[str]) -> None:
    recorded = genuine.read(genuine.RECORDED / "psm-si.json.gz")["facts"]
    names = [name for name in recorded if name.startswith("local/forward")]
    assert len(names) == 5
    for name in names:
        assert trocar(["fk", "psm_si", *name.split()[1:], "--json"]) == 0
        T = np.array(json.loads(capsys.readouterr().out)["pose"])
        robot = recorded[name]["cp"]
        p = [robot["position"][k] for k in "xyz"]
        R = matrix([robot["orientation"][k] for k in "xyzw"])
        np.testing.assert_allclose(T[:3, 3], p, atol=2e-6)  # 1.5708 for pi/2, rounded to 1e-6
        np.testing.assert_allclose(T[:3, :3], R, atol=2e-5)


def matrix_of(recorded: dict[str, Any]) -> np.ndarray:
    """Return a recorded pose, (4, 4)."""
    T, pose = np.eye(4), recorded["pose"]
    T[:3, :3] = matrix([pose["orientation"][k] for k in "xyzw"])
    T[:3, 3] = [pose["position"][k] for k in "xyz"]
    return T


def imported_cart(folder: Path) -> World:
    """Import the robot's own Si patient cart."""
    arms: list[dict[str, Any]] = [
        {"name": "SUJ", "type": "SUJ_Si", "arm_file": "arm/suj-si-simulated.json"}
    ]
    own = {"generation": "Si", "mounting_pitch": 0.0, "kinematic": "kinematic/PSM_Si.json"}
    psm = own | {"tool_detection": "FIXED", "tool": "LARGE_NEEDLE_DRIVER:420006[1]"}
    ecm = own | {"kinematic": "kinematic/ECM_Si.json", "mounting_pitch": -1.22173}
    files = {"psm.json": psm, "ecm.json": ecm | {"endoscope": "Classic_SD_STRAIGHT"}}
    for name in cart.ARMS:
        base = {"component": "SUJ", "interface": name}
        kind = name[:3]
        file = f"{kind.lower()}.json"
        arms.append({"name": name, "type": kind, "arm_file": file, "base_frame": base})
    files["system.json"] = {"$id": "dvrk-system.schema.json", "$version": "1", "arms": arms}
    for file, content in files.items():
        (folder / file).write_text(json.dumps(content))
    return World(import_dvrk(folder / "system.json", folder / "rig.toml").rig)


def test_an_imported_si_cart_is_where_the_robot_has_it_and_carries_its_weight(
    tmp_path: Path,
) -> None:
    facts = genuine.read(genuine.RECORDED / "cart-si.json.gz")["facts"]
    world = imported_cart(tmp_path)
    for k in range(cart.POSTURES):
        for name in cart.ARMS:
            q = facts[f"{k} /{name}/setpoint_js"]["position"]
            jaw = [0.0] * (len(world.arms[name].joints.names) - len(q))
            world.set_state(name, np.array([*q, *jaw]))
            setup = facts[f"{k} /SUJ/{name}/measured_js"]["position"]
            world.set_state(f"SUJ_{name}", np.array(setup))
        for name in cart.ARMS:
            arm = world.arm(name)
            for topic, ours in (
                (f"/{name}/setpoint_cp", arm.measured_cp()),
                (f"/{name}/local/setpoint_cp", arm.local.measured_cp()),
                (f"/SUJ/{name}/measured_cp", world.arm(f"SUJ_{name}").measured_cp()),
            ):
                robot = matrix_of(facts[f"{k} {topic}"])  # its files have 1.5708 for pi/2
                np.testing.assert_allclose(ours.matrix[:3, 3], robot[:3, 3], atol=5e-5)
                np.testing.assert_allclose(ours.matrix[:3, :3], robot[:3, :3], atol=5e-5)
            efforts = facts[f"{k} /{name}/gravity_compensation/setpoint_js"]["effort"]
            held = world.servos.holding[world.joints.arms[name].rows][: len(efforts)]
            np.testing.assert_allclose(held, efforts, atol=2e-5)


@pytest.mark.parametrize(("rig", "names"), [("psm_si", cart.ARMS[:3]), ("ecm_si", ("ECM",))])
def test_moves_of_the_si_are_as_fast_as_recorded_where_they_keep_the_limit(
    rig: str, names: tuple[str, ...]
) -> None:
    facts = genuine.read(genuine.RECORDED / "cart-si.json.gz")["facts"]
    world = World(rig)
    arm = world.arm(names[0])
    middle, half = map(np.array, cart.ECM if rig == "ecm_si" else cart.PSM)
    jaw = [0.0] * (len(arm.joints.names) - len(middle))
    for j in range(len(middle)):
        way = half * (np.arange(len(middle)) == j)
        world.set_state(arm.name, np.array([*(middle - way), *jaw]))
        arm.move_jp(middle + way)
        peak = 0.0
        for _ in range(1000):
            world.step(5)
            peak = max(peak, abs(float(arm.setpoint_js().velocity[j])))
        robot = [facts[f"peak {name} joint {j}"] for name in names]
        if (rig, j) == ("psm_si", 1):  # Reflexxes exceeds it: docs/as-on-the-robot.md
            assert peak == pytest.approx(np.pi / 2, rel=1e-3)
            assert min(robot) > 1.05 * peak
        else:
            assert peak == pytest.approx(np.median(robot), rel=0.01)


def test_states_are_as_recorded() -> None:
    rows = genuine.rows("psm", "A")
    assert len(rows) == 56
    assert kept(rows) >= STATES_REACHED


@pytest.mark.slow
@pytest.mark.parametrize("plan", REACHED)
def test_answers_are_as_recorded(plan: str) -> None:
    rows = genuine.rows(plan)
    assert kept(rows) >= REACHED[plan]
    if plan == "psm":
        assert sum(row.verdict == "purpose" for row in rows) <= 15


def test_a_record_is_the_same_as_itself() -> None:
    recorded = genuine.read(genuine.RECORDED / "psm.json.gz")
    assert {row.verdict for row in compared(recorded, recorded, {})} == {"same"}


def test_a_set_point_elsewhere_differs_and_the_next_step_follows() -> None:
    robot = record(step("a", setpoint_js=[0.1]), step("b", setpoint_js=[0.2]))
    ours = record(step("a", setpoint_js=[0.11]), step("b", setpoint_js=[0.18]))
    assert [row.verdict for row in compared(ours, robot, {})] == ["differs", "follows"]
    assert [row.verdict for row in compared(ours, robot, {"a": "safer"})] == ["purpose", "follows"]


def test_a_move_by_the_same_from_elsewhere_is_the_same() -> None:
    robot = record(step("a", setpoint_js=[0.1]), step("b", setpoint_js=[0.2]))
    ours = record(step("a", setpoint_js=[0.3]), step("b", setpoint_js=[0.4]))
    assert [row.verdict for row in compared(ours, robot, {})] == ["differs", "same"]


@pytest.mark.parametrize(
    ("robot", "ours", "verdict"),
    [
        ([("warning", "no")], [], "differs"),
        ([], [("warning", "no")], "same"),
        ([("error", "no")], [("error", "other words")], "same"),
        ([("goal_reached", True)], [("goal_reached", False), ("goal_reached", True)], "differs"),
        ([("desired_state", "HOMED")], [("desired_state", "ENABLED")], "differs"),
        ([("operating_state", "FAULT")], [("operating_state", "ENABLED")], "differs"),
    ],
)
def test_a_step_is_compared_by_what_a_client_acts_on(
    robot: list[tuple[str, Any]], ours: list[tuple[str, Any]], verdict: str
) -> None:
    (row,) = compared(record(step("a", *ours)), record(step("a", *robot)), {})
    assert row.verdict == verdict


def test_steps_of_one_name_are_compared_in_their_order() -> None:
    robot = record(step("a", ("goal_reached", True)), step("a", ("goal_reached", False)))
    ours = record(step("a", ("goal_reached", False)), step("a", ("goal_reached", False)))
    assert [row.verdict for row in compared(ours, robot, {})] == ["differs", "same"]


def test_a_missing_step_differs() -> None:
    (row,) = compared(record(), record(step("a")), {})
    assert (row.verdict, row.differences) == ("differs", ("no such step here",))


def test_a_refused_move_where_the_robot_hangs_is_on_purpose_until_the_hang_ends() -> None:
    busy, idle = "ENABLED homed=0 busy=1 sub=-", "ENABLED homed=0 busy=0 sub=-"
    end = ("operating_state", "DISABLED homed=0 busy=0 sub=-")
    robot = record(
        step("0.00 move_jp", ("operating_state", busy)),
        step("0.01 disable", end, ("goal_reached", False)),
        step("0.02 move_jp", ("goal_reached", False)),
    )
    ours = record(
        step("0.00 move_jp", ("operating_state", idle)),
        step("0.01 disable", end),
        step("0.02 move_jp"),
    )
    rows = compared(ours, robot, {})
    assert [row.verdict for row in rows] == ["purpose", "purpose", "differs"]
    assert rows[0].reason == HANG == RULES[0]
    assert before_parting(rows) == {"0": (2, 3)}


def test_a_goal_of_a_hang_is_on_purpose_whenever_the_robot_ends_it() -> None:
    busy, idle = "ENABLED homed=0 busy=1 sub=-", "ENABLED homed=0 busy=0 sub=-"
    both = step("0.01 enable", ("operating_state", idle))
    robot = record(
        step("0.00 move_jp", ("operating_state", busy)),
        both,
        step("0.02 disable", ("goal_reached", False)),
        step("0.03 disable", ("goal_reached", False)),
    )
    ours = record(
        step("0.00 move_jp", ("operating_state", idle)), both, step("0.02 disable"),
        step("0.03 disable"),
    )  # fmt: skip
    verdicts = [row.verdict for row in compared(ours, robot, {})]
    assert verdicts == ["purpose", "same", "purpose", "differs"]


def test_a_pose_that_the_robot_cannot_solve_from_zeroed_joints_is_on_purpose() -> None:
    unhomed = ("operating_state", "ENABLED homed=0 busy=0 sub=-")
    robot = record(step("0.00 move_cp", unhomed, ("error", "no"), ("goal_reached", False)))
    refused = record(step("0.00 move_cp", unhomed, ("warning", "not homed")))
    silent = record(step("0.00 move_cp", unhomed))
    assert [row.verdict for row in compared(refused, robot, {})] == ["purpose"]
    assert [row.verdict for row in compared(silent, robot, {})] == ["differs"]


def test_a_resume_that_the_robot_ignores_is_on_purpose_until_it_is_disabled() -> None:
    paused, enabled = ("PAUSED homed=1 busy=0 sub=-", "ENABLED homed=1 busy=0 sub=-")
    end = ("operating_state", "DISABLED homed=1 busy=0 sub=-")
    robot = record(
        step("0.00 resume", ("operating_state", paused)),
        step("0.01 servo_jp", ("warning", "arm not ready")),
        step("0.02 disable", end),
        step("0.03 servo_jp", ("warning", "arm not ready")),
    )
    ours = record(
        step("0.00 resume", ("operating_state", enabled)),
        step("0.01 servo_jp"),
        step("0.02 disable", end),
        step("0.03 servo_jp"),
    )
    rows = compared(ours, robot, {})
    assert [row.verdict for row in rows] == ["purpose", "purpose", "same", "differs"]


def walk_of_unset(events: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a walk in which move_jr leaves jaws apart, after a number of busy=1."""
    busy, idle = "ENABLED homed=1 busy=1 sub=-", "ENABLED homed=1 busy=0 sub=-"
    states = [("operating_state", word) for word in (busy, idle) * events]
    name = "0.00 move_jp move_jr"
    found = []
    for jaw in (0.41, 0.4):
        found.append(record(
            step("0.fix", setpoint_js=[0.0], **{"jaw/setpoint_js": [0.2]}),
            step(name, *states, setpoint_js=[0.1], **{"jaw/setpoint_js": [jaw]}),
            step("0.02 move_jr", setpoint_js=[0.1], **{"jaw/setpoint_js": [2.0 * jaw]}),
            step("0.03 move_jp", setpoint_js=[0.1 + jaw], **{"jaw/setpoint_js": [0.0]}),
            step("0.04 move_jr", setpoint_js=[0.0], **{"jaw/setpoint_js": [jaw]}),
        ))  # fmt: skip
    return found[0], found[1]


def test_a_number_that_the_robot_never_sets_excuses_the_jaw_until_it_is_set_anew() -> None:
    robot, ours = walk_of_unset(1)
    rows = compared(ours, robot, {})
    assert [row.verdict for row in rows] == ["same", "purpose", "purpose", "follows", "follows"]
    assert rows[1].reason == UNSET


def test_a_move_jr_after_the_move_before_has_ended_is_not_excused() -> None:
    robot, ours = walk_of_unset(2)
    assert [row.verdict for row in compared(ours, robot, {})][1] == "differs"


def test_facts_are_compared_as_numbers_and_rotations() -> None:
    q = {"x": 0.5, "y": 0.5, "z": 0.5, "w": -0.5}
    assert same_fact(q, {name: -value for name, value in q.items()})
    assert same_fact({"jp": [1.0], "message": "a"}, {"jp": [1.0001], "message": "b"})
    assert not same_fact({"jp": [1.0]}, {"jp": []})
    assert not same_fact(True, 1.0)


def test_the_outcome_has_the_last_state() -> None:
    seen = outcome(step("a", ("operating_state", "DISABLED"), ("operating_state", "ENABLED")))
    assert seen["state"] == ["ENABLED"]


def test_quaternions_of_plans_are_those_of_their_matrices() -> None:
    for axis, angle in (([1, 0, 0], np.pi), ([1, 2, 3], 0.7), ([0, 1, -1], -3.0), ([0, 0, 1], 0.0)):
        R = rotation(axis, angle)
        np.testing.assert_allclose(matrix(quaternion(R)), R, atol=1e-9)


def test_the_command_counts_and_exits_with_1_where_steps_differ(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    robot = genuine.read(genuine.RECORDED / "psm.json.gz")
    monkeypatch.setattr(genuine, "answers", lambda *_, **__: robot)
    assert main(["genuine", "--plan", "psm", "--keep", str(tmp_path)]) == 0
    assert genuine.read(tmp_path / "psm.json.gz") == robot
    kept_steps = [each for each in robot["steps"] if each["step"] != "P3 system/home"]
    robot = {**robot, "steps": kept_steps}
    capsys.readouterr()
    assert main(["genuine", "--plan", "psm", "--json"]) == 1
    assert [
        row["step"] for row in json.loads(capsys.readouterr().out)["psm"] if row["differences"]
    ] == ["P3 system/home"]
    assert main(["genuine", "--plan", "psm", "-v"]) == 1
    assert "psm ! P3 system/home | no such step here" in capsys.readouterr().out


def test_an_unknown_part_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["genuine", "--plan", "psm", "--only", "Z"]) == 2
    assert "got Z; allowed: A, B, C" in capsys.readouterr().err
