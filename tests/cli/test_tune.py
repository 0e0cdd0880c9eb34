"""`trocar tune`: its document, its table, its refusals."""

from __future__ import annotations

import tomllib

import pytest

from trocar.robot.dvrk_config.arms import SERIAL

TRIED = [
    "p", "i", "d", "rise_time_s", "overshoot", "settling_time_s", "steady_error",
    "peak_effort_share",
]  # fmt: skip


def test_tune_prints_one_document_and_its_progress_beside_it(trocar):
    answer = trocar("tune", "ecm", "--joint", "roll", "--json")
    assert answer.status == 0
    assert answer.err == "trocar: tuning roll (1 of 1) ...\n"
    document = answer.document
    assert list(document) == ["arm", "tool", "control", "friction", "joints", "toml"]
    assert (document["arm"], document["tool"], document["control"]) == ("ecm", None, "dvrk")
    (roll,) = document["joints"]
    assert list(roll) == ["joint", "kind", "step", "present", "tuned", "tried"]
    assert list(roll["present"]) == TRIED
    assert roll["tuned"]["settling_time_s"] <= roll["present"]["settling_time_s"]
    pid = tomllib.loads(document["toml"]["ecm"])["control"]["dvrk"]["pid"]
    assert pid["roll"] == [roll["tuned"][key] for key in "pid"]


def test_tune_tells_people_before_and_after_and_what_to_paste(trocar):
    answer = trocar("tune", "ecm", "--joint", "roll", "--control", "paper")
    assert answer.status == 0
    for text in ("rise [ms]", "overshoot [%]", "settling [ms]", "present", "tuned", "# ecm"):
        assert text in answer.out
    for text in ("gains 'paper'", "[control.paper]\npid = { yaw = [700.0, 1.0, 90.0], "):
        assert text in answer.out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["pms"], "unknown arm 'pms' (did you mean 'psm'?)"),
        (["psm", "--joint", "rol"], "psm: unknown joint 'rol' (did you mean 'roll'?)"),
        (["psm", "--tool", "SCALPEL"], "unknown tool 'SCALPEL'"),
        (["psm", "--control", "hand"], "invalid choice: 'hand'"),
        ([str(SERIAL["PSM"])], "serial_psm: cannot be simulated, no mass for yaw, pitch"),
        ([], "the following arguments are required: ARM"),
    ],
)
def test_bad_input_is_one_line(words, said, trocar):
    answer = trocar("tune", *words)
    assert answer.status == 2
    assert said in answer.complaint
