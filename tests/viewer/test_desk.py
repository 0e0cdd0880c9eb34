"""A browser's page: what it reports, what it may drive, and what it shows of the scene."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest

from tests.live.fake_world import FakeWorld
from tests.viewer.visitor import Visitor, visiting
from trocar.live import Command, Loop
from trocar.simulation import World
from trocar.viewer.channel import LONGEST, BrowserReport, Channel
from trocar.viewer.drawing import AUTOMATIC, LEVELS, PATIENT, SLOW_HZ, SMOOTH_HZ, Drawing
from trocar.viewer.gallery import Card, Choice, Gallery, gallery_html
from trocar.viewer.help import HINTS, hint
from trocar.viewer.page import DRAWN_S, Page
from trocar.viewer.panel import ArmControls, idle_reason, power_of, read_arm
from trocar.viewer.scoreboard import AGAIN, NEXT, TAKE, SceneControls, SceneScore, score_html
from trocar.viewer.seats import ANSWER_S, Seats
from trocar.viewer.server import LocalServer, run_there, serving


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    with serving("127.0.0.1", 0, "test") as found:
        yield found


@contextmanager
def visited(world: World, scene: SceneControls) -> Iterator[Visitor]:
    """Serve a scene, and visit it with a wide browser."""
    with serving("127.0.0.1", 0, "test") as server:
        run_there(server, lambda: Page(server, world, Loop(world), scene=scene))
        with visiting(server) as visitor:
            visitor.report()
            yield visitor


# ---------------------------------------------------------------------- the channel


def test_a_browser_s_report_is_read_and_nonsense_is_not(server: LocalServer) -> None:
    reports: list[BrowserReport] = []
    pressed: list[str] = []
    channel = Channel(server.gui, reports.append, pressed.append)
    report = {"width": 800, "software": True, "frames": 7.5, "drawn": True}
    channel.receive(json.dumps(report))
    channel.receive(json.dumps({"press": "help/"}))
    nonsense: list[object] = [[], 3, {"width": "x"}, {"width": 1, "frames": []}, {"press": 3}]
    for text in ("", "{", "[" * 900, " " * (LONGEST + 1), *map(json.dumps, nonsense)):
        channel.receive(text)
    assert reports == [BrowserReport(800, software=True, frames_hz=7.5, drawn=True)]
    assert pressed == ["help/"]


# ---------------------------------------------------------------------- drawing


def report(frames_hz: float | None = None, *, software: bool = False) -> BrowserReport:
    return BrowserReport(software=software, frames_hz=frames_hz)


def test_a_browser_without_a_graphics_card_begins_plainly_and_others_fully(
    server: LocalServer,
) -> None:
    for software, name in ((True, "plain"), (False, "full")):
        drawing = Drawing(server.scene)
        drawing.follow(report(software=software))
        assert drawing.level.name == name


def test_the_level_falls_while_frames_are_few_and_never_rises_to_one_that_was_slow(
    server: LocalServer,
) -> None:
    drawing = Drawing(server.scene)
    drawing.follow(report())
    for name in ("no shadows", "plain", "plain"):
        for _ in range(PATIENT):
            drawing.follow(report(SLOW_HZ - 1))
        assert drawing.level.name == name
    for _ in range(5 * PATIENT):
        drawing.follow(report(SMOOTH_HZ + 1))
    assert drawing.level.name == "plain"
    fast = Drawing(server.scene)
    fast.follow(report(software=True))
    for _ in range(5 * PATIENT):
        fast.follow(report(SMOOTH_HZ + 1))
    assert fast.level.name == "full"


def test_one_slow_moment_and_a_scene_at_rest_change_nothing(server: LocalServer) -> None:
    drawing = Drawing(server.scene)
    for frames_hz in (None, 3.0, 30.0, 3.0, 30.0, None, None):
        drawing.follow(report(frames_hz))
    assert drawing.level.name == "full"


def test_a_level_chosen_by_hand_stays(server: LocalServer) -> None:
    drawing = Drawing(server.scene)
    drawing.choose("no shadows")
    for _ in range(5):
        drawing.follow(report(2.0, software=True))
    assert drawing.level.name == "no shadows"
    drawing.choose(AUTOMATIC)
    for _ in range(PATIENT):
        drawing.follow(report(2.0, software=True))
    assert drawing.level.name == "plain"
    assert [level.name for level in LEVELS] == ["full", "no shadows", "plain"]
    assert [level.joined for level in LEVELS] == [False, False, True]


# ---------------------------------------------------------------------- who drives


def test_the_first_drives_and_when_it_leaves_the_next_one_does() -> None:
    seats = Seats()
    for who in (7, 8, 9):
        seats.come(who)
    assert seats.blocked(7) == "" and "browser 1 drives" in seats.blocked(8)
    seats.leave(7)
    assert seats.driver == 8
    seats.leave(8)
    seats.leave(9)
    assert seats.driver is None


def test_control_is_given_by_the_driver_or_when_it_does_not_answer() -> None:
    now = [0.0]
    seats = Seats(lambda: now[0])
    seats.come(1)
    seats.come(2)
    seats.request(2)
    seats.answer(granted=False)
    assert (seats.driver, seats.asking) == (1, None)
    seats.request(2)
    seats.answer(granted=True)
    assert seats.driver == 2
    seats.request(1)
    now[0] = ANSWER_S - 1.0
    seats.follow()
    assert seats.driver == 2
    now[0] = ANSWER_S + 1.0
    seats.follow()
    assert seats.driver == 1


def test_two_browsers_have_panels_of_their_own_and_one_drives(server: LocalServer) -> None:
    world: Any = FakeWorld()
    page = Page(server, world, Loop(world))
    first, second = page.open(server, 0), page.open(server, 1)
    for desk in (first, second):
        desk.build(1920)
        assert desk.panel is not None
    assert first.panel is not None and second.panel is not None
    second.panel.choice.value = "PSM2"
    second.panel.choose()
    assert (first.panel.arm.name, second.panel.arm.name) == ("PSM1", "PSM2")
    assert first.blocked("PSM1") == "" and "browser 1 drives" in second.blocked("PSM2")
    page.leave(0)
    assert second.blocked("PSM2") == ""


# ---------------------------------------------------------------------- controls that cannot act


def test_a_disabled_arm_offers_what_helps_and_says_why_it_does_not_move() -> None:
    now = World("psm").snapshot().arms["PSM1"]
    assert idle_reason(now) == "" and power_of(now) == ("Home", "Disable")
    off = now._replace(state="DISABLED", homed=False)
    assert "Enable" in idle_reason(off) and power_of(off) == ("Enable",)
    assert "FAULT" in idle_reason(now._replace(state="FAULT"))
    assert idle_reason(now._replace(homed=False)) == "not homed: Home"


def test_an_arm_that_stands_still_in_a_scene_has_no_handle_and_is_grey_with_the_reason(
    server: LocalServer,
) -> None:
    world = World("two_psm_ecm", welded=("PSM2",))
    loop = Loop(world)
    still, free = (read_arm(world, name) for name in ("PSM2", "PSM1"))
    with visiting(server) as visitor:
        for info, why in ((still, "stands still in this scene"), (free, "")):
            controls = ArmControls(server.gui, loop, info, loop.latest)
            controls.follow(loop.latest)
            assert why in visitor.text("why") and bool(visitor.text("why")) == bool(why)
            assert all(handle.disabled == bool(why) for handle in controls.sliders.handles)
            controls.remove()


def test_sliders_under_a_policy_are_grey_with_the_reason_and_act_again_afterwards(
    server: LocalServer,
) -> None:
    world = World("psm")
    loop = Loop(world)
    arm = ArmControls(server.gui, loop, read_arm(world, "PSM1"), world.snapshot())
    with visiting(server) as visitor:
        arm.follow(world.snapshot(), "the scripted policy drives PSM1: Take control above")
        assert all(handle.disabled for handle in arm.sliders.handles)
        assert "Take control" in visitor.text("why")
        arm.follow(world.snapshot(), "")
        assert not any(handle.disabled for handle in arm.sliders.handles)
        assert visitor.text("why") == ""


# ---------------------------------------------------------------------- scenes


class Scene:
    """A scene whose controls note what is pressed."""

    def __init__(self) -> None:
        self.calls: list[object] = []
        self.now = SceneScore(1.5, 18.0, 0, 2, 1, done=False, reason="", seed=5)
        self.controls = SceneControls(
            name="touch",
            title="<b>touch</b>",
            limit_s=20.0,
            driver="scripted policy",
            arms=("PSM1",),
            score=lambda: self.now,
            take=lambda: self.calls.append("take"),
            give=lambda: self.calls.append("give"),
            begin=self.calls.append,
            repeat=self.calls.append,
        )


def test_the_policy_has_the_arm_until_a_person_takes_it_or_the_episode_ends(
    server: LocalServer,
) -> None:
    world, scene = World("psm"), Scene()
    page = Page(server, world, Loop(world), scene=scene.controls)
    desk = page.open(server)
    desk.build(1920)
    assert "the scripted policy drives PSM1" in desk.blocked("PSM1")
    scene.now = replace(scene.now, taken=True)
    assert desk.blocked("PSM1") == ""
    scene.now = replace(scene.now, taken=False, done=True)
    assert desk.blocked("PSM1") == ""


def test_again_begins_the_same_seed_and_next_seed_the_next() -> None:
    scene = Scene()
    with visited(World("psm"), scene.controls) as visitor:
        for label, name in (("Episode", AGAIN), ("Episode", NEXT), ("Policy", TAKE)):
            visitor.use(label, name)
    assert scene.calls == [5, 6, "take"]


def test_the_score_shows_seed_end_and_driver_without_markup_of_others() -> None:
    scene = Scene()
    end = replace(scene.now, done=True, reason="<i>x</i>", by_hand=True)
    text = score_html(scene.controls, end)
    assert "&lt;b&gt;touch&lt;/b&gt;" in text and "&lt;i&gt;x&lt;/i&gt;" in text
    assert "<i>" not in text and ">5</b>" in text and "after a person" in text


def test_time_waits_until_a_browser_has_drawn_the_scene(
    server: LocalServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    world: Any = FakeWorld()
    for seen, late in ((True, False), (False, True)):
        loop = Loop(world, speed="max")
        page = Page(server, world, loop)
        page.waits = loop.post(Command("world", "pause"))
        now = [0.0]
        monkeypatch.setattr("trocar.viewer.page.time.monotonic", lambda at=now: at[0])
        desk = page.open(server)
        desk.build(1920)
        page.refresh()
        assert page.waits
        desk.seen, now[0] = seen, DRAWN_S + 1.0 if late else 1.0
        page.refresh()
        assert not page.waits


def test_the_gallery_loads_what_it_shows_and_nothing_else() -> None:
    cards = [Card(Choice("scene", "needle-pick"), "<Pick>", "easy"), Card(Choice("rig", "psm"), "")]
    gallery = Gallery(lambda: cards, "psm")
    assert not gallery.choose("scene/../secret") and gallery.chosen is None
    assert gallery.choose("rig/psm") and gallery.chosen == Choice("rig", "psm")
    text = gallery_html(cards, "note", disabled=False)
    assert 'data-trocar-send="load/scene/needle-pick"' in text and "&lt;Pick&gt;" in text
    assert "data:image/jpeg" in text and " disabled>" not in text
    assert text.count("<button") == gallery_html(cards, "", disabled=True).count(" disabled>")


# ---------------------------------------------------------------------- help


def test_every_label_of_the_panels_has_a_hint() -> None:
    with visited(World("full_cart"), Scene().controls) as visitor:
        labelled = [w for w in visitor.read().widgets.values() if "hint" in w.props]
    assert len(labelled) > 20
    without = [w.props["label"] for w in labelled if not w.props["hint"] and w.props["visible"]]
    assert without == []


def test_hints_name_pages_that_exist() -> None:
    from pathlib import Path

    docs = Path(__file__).parents[2]
    named = {
        word.strip(".,") for text in HINTS.values() for word in text.split() if "docs/" in word
    }
    assert named and all((docs / page).is_file() for page in named)
    assert "N m/rad" in hint("gains", gain="N m/rad")
