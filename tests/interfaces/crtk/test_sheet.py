"""Bytes that are filled in from one table of numbers are those that the encoders write."""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from trocar.descriptions import names
from trocar.interfaces.commands import Verb
from trocar.interfaces.crtk.arm_messages import MAKERS
from trocar.interfaces.crtk.messages.forms import CDR_PACKING, FIRST, ROS1_PACKING, form, marks
from trocar.interfaces.crtk.sample import RigFigures, Sample, take
from trocar.interfaces.crtk.scene import look
from trocar.interfaces.crtk.scene_messages import makers
from trocar.interfaces.crtk.sheet import JOINTS, TIPS, Page, Sheet
from trocar.interfaces.crtk.transports.websocket.parcel import PACKING
from trocar.interfaces.crtk.transports.websocket.transport import WebSocketTransport
from trocar.simulation.readout import Reader

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
    reader = Reader(sample.world.model)
    sheet = Sheet(reader, served.core.topics.values())
    wanted = frozenset(served.core.topics)
    page, rig = (
        Page(sheet, PACKINGS[packing], wanted),
        RigFigures(sample, reader.read(sample.world)),
    )
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
    world = replace(sample.world, arms={"PSM1": broken})
    check(served, replace(sample, world=world), packing)


def test_a_page_follows_a_frame_that_is_renamed() -> None:
    served = Served("psm")
    before = sampled(served)
    reader = Reader(before.world.model)
    sheet = Sheet(reader, served.core.topics.values())
    page = Page(sheet, ROS1_PACKING, frozenset({"PSM1/measured_cp"}))
    assert b"PSM1_base" in page.filled(RigFigures(before, reader.read(before.world)), STAMP)[0][1]
    served.world.arm("PSM1").set_base_frame(np.eye(4), "table")
    renamed = sampled(served)
    after = page.filled(RigFigures(renamed, reader.read(renamed.world)), STAMP)[0][1]
    assert b"table" in after and b"PSM1_base" not in after


def test_two_transports_get_each_their_own_bytes_and_the_others_messages() -> None:
    served = Served("full_cart")
    publishing = served.core._publishing
    both = frozenset({"PSM1/measured_js", "ECM/measured_cp", "joint_states"})
    wanted = [(ROS1_PACKING, both), (None, both), (CDR_PACKING, frozenset({"PSM2/measured_js"}))]
    sample = sampled(served)
    ros1, plain, cdr = ({t.name: m for t, m in out} for out in publishing.states(sample, wanted))
    assert ros1.keys() == plain.keys() == both
    assert isinstance(ros1["joint_states"], dict)
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
    sheet = Sheet(Reader(served.world.model), served.core.topics.values())
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


def calls(served: Served, packing: str, *topics: str) -> Counter[str]:
    """Return how often each function is called, by its name, to publish one sample."""
    served.transport.packing = PACKINGS.get(packing)
    served.transport.want(*topics)
    served.run()
    served.loop.tick()
    found: Counter[str] = Counter()

    def count(frame, event: str, argument) -> None:
        if event in ("call", "c_call"):
            found[frame.f_code.co_name if event == "call" else argument.__name__] += 1

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        assert served.core.publish_waiting() == 1
    finally:
        sys.setprofile(before)
    return found


@pytest.mark.parametrize("packing", ["json", "as messages"])
def test_frames_and_jacobians_are_computed_once_for_all_topics(packing: str) -> None:
    served = Served("full_cart", rate_hz=1000.0)
    made = calls(served, packing, *served.core.topics)
    assert (made["mj_jac"], made["mj_kinematics"]) == (4, 2)  # an arm; measured and at set-points
    assert not made["jacobian_body"] and not made["jacobian_spatial"]


def test_a_calibrated_arm_computes_its_jacobian_once_for_all_topics(skew_overlay, rng) -> None:
    served = Served("psm", world={"calibration": skew_overlay("psm", rng)}, rate_hz=1000.0)
    assert calls(served, "json", *served.core.topics)["jacobian_spatial"] == 1


@pytest.mark.parametrize("packing", ["json", "as messages"])
@pytest.mark.parametrize(
    ("topic", "computed"),
    [
        ("PSM1/measured_js", (0, 0)),
        ("PSM1/measured_cp", (0, 1)),
        ("PSM1/setpoint_cp", (0, 2)),  # the frames that poses are told in are the measured ones
        ("PSM1/body/jacobian", (4, 1)),
    ],
)
def test_what_nobody_wants_is_not_computed(
    topic: str, computed: tuple[int, int], packing: str
) -> None:
    made = calls(Served("full_cart", rate_hz=1000.0), packing, topic)
    assert (made["mj_jac"], made["mj_kinematics"]) == computed


def test_every_state_of_an_arm_is_filled_in() -> None:
    served = Served("full_cart")
    sheet = Sheet(Reader(served.world.model), served.core.topics.values())
    states = {t.name for t in served.core.topics.values() if t.rate == "state" and t.arm}
    assert len(states) == 74 and states <= sheet.rows.keys()
