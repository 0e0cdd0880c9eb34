"""Bytes that are filled in from one table of numbers are those that the encoders write."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trocar.descriptions import names
from trocar.interfaces.commands import Verb
from trocar.interfaces.crtk.arm_messages import MAKERS
from trocar.interfaces.crtk.figures import RigFigures
from trocar.interfaces.crtk.messages.forms import CDR_PACKING, FIRST, ROS1_PACKING, form, marks
from trocar.interfaces.crtk.plan import Plan
from trocar.interfaces.crtk.sample import Sample, take
from trocar.interfaces.crtk.scene import look
from trocar.interfaces.crtk.scene_messages import makers
from trocar.interfaces.crtk.sheet import JOINTS, TIPS, Page, Sheet
from trocar.interfaces.crtk.transports.websocket.parcel import PACKING
from trocar.interfaces.crtk.transports.websocket.transport import WebSocketTransport

from .served import Served

STAMP = (1_800_000_000, 42)
PACKINGS = {"ros1": ROS1_PACKING, "cdr": CDR_PACKING, "json": PACKING}


def sampled(served: Served) -> Sample:
    seen = (), look(served.world, frozenset())
    return take(served.world, STAMP, 0.0, seen, lambda _: False)


def told(rig: RigFigures, topic) -> dict | None:
    if topic.arm:
        return MAKERS[topic.key](rig.arm(topic.arm), STAMP)
    return makers(rig.sample.rig)[topic.name](rig, STAMP)


def check(served: Served, sample: Sample, packing: str) -> int:
    plan = Plan(sample.rig)
    sheet = Sheet(plan, served.core.topics.values())
    wanted = frozenset(served.core.topics)
    page, rig = Page(sheet, PACKINGS[packing], wanted), RigFigures(sample, plan)
    filled = page.filled(rig, STAMP)
    for topic, data in filled:
        message = told(rig, topic)
        assert message is not None, topic.name
        assert data == PACKINGS[packing].encode(topic.type, message), topic.name
    assert page.rest == wanted - {topic.name for topic, _ in filled}
    left = {n for n in page.rest if served.core.topics[n].key in {*JOINTS, *TIPS}}
    assert all(told(rig, served.core.topics[n]) is None for n in left if "_js" in n)
    return len(filled)


@pytest.mark.parametrize("rig", names("rigs"))
@pytest.mark.parametrize("packing", PACKINGS)
def test_what_is_filled_in_is_what_the_encoder_writes(
    rig: str, packing: str, rng: np.random.Generator
) -> None:
    served = Served(rig, world={"collisions": False})
    for _ in range(2):
        for name, arm in served.world.arms.items():
            q = rng.uniform(arm.lower, arm.upper)
            served.world.set_state(name, q, 0.1 * rng.standard_normal(len(q)))
        served.run()
        assert check(served, sampled(served), packing) >= 2


@pytest.mark.parametrize("packing", PACKINGS)
def test_frames_may_change_and_numbers_may_be_none(packing: str) -> None:
    served = Served("psm")
    frame = "100 %b of a \N{GREEK SMALL LETTER LAMDA}-frame"
    served.loop.post(Verb("PSM1", "set_base_frame", {"T": np.eye(4), "frame_id": frame}))
    served.run()
    sample = sampled(served)
    check(served, sample, packing)
    arm = sample.arms["PSM1"]
    assert arm.base is not None and arm.base[1] == frame
    effort = np.array([np.nan, np.inf, -np.inf, -0.0, 5e-324, 1e300, 1.0])
    broken = replace(arm, effort=effort[: len(arm.effort)])
    check(served, replace(sample, arms={"PSM1": broken}), packing)


def test_a_page_follows_a_frame_that_is_renamed() -> None:
    served = Served("psm")
    before = sampled(served)
    plan = Plan(before.rig)
    sheet = Sheet(plan, served.core.topics.values())
    page = Page(sheet, ROS1_PACKING, frozenset({"PSM1/measured_cp"}))
    assert b"PSM1_base" in page.filled(RigFigures(before, plan), STAMP)[0][1]
    served.world.arm("PSM1").set_base_frame(np.eye(4), "table")
    after = page.filled(RigFigures(sampled(served), plan), STAMP)[0][1]
    assert b"table" in after and b"PSM1_base" not in after


def test_two_transports_get_each_their_own_bytes_and_the_others_messages() -> None:
    served = Served("full_cart")
    publishing = served.core._publishing
    both = frozenset({"PSM1/measured_js", "ECM/measured_cp", "PSM1/measured_cv"})
    wanted = [(ROS1_PACKING, both), (None, both), (CDR_PACKING, frozenset({"PSM2/measured_js"}))]
    sample = sampled(served)
    ros1, plain, cdr = ({t.name: m for t, m in out} for out in publishing.states(sample, wanted))
    assert ros1.keys() == plain.keys() == both
    assert isinstance(ros1["PSM1/measured_cv"], dict)
    for name in ("PSM1/measured_js", "ECM/measured_cp"):
        kind = served.core.topics[name].type
        assert ros1[name] == ROS1_PACKING.encode(kind, plain[name])
    assert cdr["PSM2/measured_js"][:2] == b"\0\1"
    assert publishing.states(sample, [(ROS1_PACKING, frozenset())]) == [[]]


def test_a_form_is_refused_where_a_mark_is_missing() -> None:
    message = {"x": 0.0, "y": 0.0, "z": 0.0}
    with pytest.raises(ValueError, match="mark"):
        form(ROS1_PACKING, "geometry_msgs/Vector3", message, (0, 1, 2))
    assert len(set(marks(1000))) == 1000
    assert WebSocketTransport.packing is PACKING


@pytest.mark.parametrize("packing", PACKINGS)
def test_a_frame_may_be_called_like_a_mark(packing: str) -> None:
    served = Served("psm")
    arm = served.world.arm("PSM1")
    arm.set_base_frame(np.eye(4), f"{FIRST:.1f}")
    served.run()
    assert check(served, sampled(served), packing) >= 2


def test_of_frames_that_change_only_the_newest_forms_are_kept() -> None:
    served = Served("psm")
    sheet = Sheet(Plan(served.world.rig), served.core.topics.values())
    row = sheet.rows["PSM1/measured_cp"]
    forms = [sheet.form(PACKING, row, {"PSM1": frame}) for frame in ("a", "b", "b")]
    assert forms[0] is not forms[1] and forms[1] is forms[2]
    assert len(sheet._forms) == 1


def test_a_message_that_cannot_be_filled_in_ends_nobody_elses() -> None:
    served = Served("psm", wanted=[])
    served.world.arm("PSM1").set_base_frame(np.eye(4), "\ud800")
    served.run()
    sample, topics = sampled(served), frozenset({"PSM1/measured_cp", "PSM1/measured_js"})
    (out,) = served.core._publishing.states(sample, [(PACKING, topics)])
    assert {topic.name for topic, _ in out} == topics
