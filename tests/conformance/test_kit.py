"""The kit has no complaint of our arms, and finds each seeded fault of a stand-in."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import pytest

from tests.conformance.stand_in import (
    MOVING,
    READING,
    Fault,
    FaultyClient,
    Runaway,
    ServedClient,
)
from trocar.conformance import (
    ConformanceReport,
    ConformanceSettings,
    arms_of,
    conform,
    page,
)
from trocar.errors import InputError, UnknownNameError
from trocar.outputs import document


def run(client: ServedClient, arm: str = "PSM1", **settings: Any) -> ConformanceReport:
    how = ConformanceSettings(seconds=1.0, **settings)
    with closing(client):
        client.start()
        return conform(client, arm, how)


def failed(report: ConformanceReport) -> set[str]:
    return {result.name for result in report.having("fail")}


@pytest.mark.parametrize(("rig", "arm"), [("psm", "PSM1"), ("ecm", "ECM"), ("mtm", "MTMR")])
def test_our_arms_conform_by_reading(rig: str, arm: str) -> None:
    report = run(ServedClient(rig), arm)
    assert failed(report) == set()
    assert len(report.having("pass")) > 30


def test_our_psm_conforms_in_moves_and_is_back_afterwards() -> None:
    client = ServedClient()
    before = client.served.world.arm("PSM1").setpoint_js().position.copy()
    report = run(client, move=True, nan=True)
    assert failed(report) == set()
    assert not [r for r in report.having("skip") if r.group == "Moves"]
    after = client.served.world.arm("PSM1")
    assert abs(after.setpoint_js().position - before).max() < 1e-4
    assert after.joints.trajectory_ratio == (1.0, 1.0)


@pytest.mark.parametrize("kind", READING, ids=lambda kind: kind.__name__)
def test_a_fault_is_found_by_reading(kind: type[FaultyClient]) -> None:
    found = failed(run(kind()))
    assert set(kind.found_by) <= found
    assert len(found) <= len(kind.found_by) + 3  # one fault is no shower of alarms


@pytest.mark.slow
@pytest.mark.parametrize("kind", MOVING, ids=lambda kind: kind.__name__)
def test_a_fault_is_found_by_moving(kind: type[FaultyClient]) -> None:
    assert failed(run(kind(), move=True)) == set(kind.found_by)


def test_a_fault_state_stops_the_moves() -> None:
    client = Fault()
    report = run(client, move=True)
    (stop,) = [r for r in report.having("fail") if r.name.startswith("nothing happens")]
    assert "PSM1 is FAULT (" in stop.found
    assert not [r for r in report.results if r.name.startswith("servo_jp")]


def test_a_joint_that_leaves_by_itself_stops_the_moves() -> None:
    client = Runaway()
    report = run(client, move=True)
    (stop,) = [r for r in report.having("fail") if r.name.startswith("nothing happens")]
    assert "pitch is at" in stop.found
    assert "allowed: 0.07 from there" in stop.found
    assert client.served.world.arm("PSM1").joints.trajectory_ratio == (1.0, 1.0)


def test_an_arm_that_is_not_homed_is_not_moved() -> None:
    client = ServedClient()
    client.publish("PSM1/state_command", "crtk_msgs/StringStamped", {"string": "disable"})
    with pytest.raises(InputError, match=r"PSM1 is DISABLED.*allowed: ENABLED and homed"):
        run(client, move=True)


def test_an_unknown_arm_is_named_with_those_that_are_there() -> None:
    with pytest.raises(UnknownNameError, match="PSM1"):
        run(ServedClient(), "PSM9")
    client = ServedClient("full_cart")
    assert arms_of(client.graph()) == ["ECM", "PSM1", "PSM2", "PSM3"]
    client.close()


def test_settings_have_bounds() -> None:
    with pytest.raises(InputError, match="rate: got 0; allowed: above 0"):
        run(ServedClient(), rate_hz=0.0)


def test_the_report_has_every_result_with_its_source() -> None:
    report = run(ServedClient())
    written = document(report)
    assert written["pass"] + written["fail"] + written["skip"] == len(report.results)
    assert written["conforms"] is not report.having("fail")
    shown = page(report)
    for result in report.results:
        assert result.source
        assert result.name.replace("'", "&#x27;").replace("<", "&lt;") in shown
