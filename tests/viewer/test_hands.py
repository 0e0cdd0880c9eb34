"""Handles and the timeline on the page, without a browser."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.viewer.visitor import Visitor, visiting
from trocar.geometry.se3 import translation
from trocar.live import Command, Loop
from trocar.live.timeline import Timeline
from trocar.live.tip_goals import TipGoals
from trocar.recording import open_recording, record
from trocar.robot.follow.reproduce import repeat
from trocar.simulation import World
from trocar.simulation.journal import WORLD
from trocar.viewer.desk import Folder
from trocar.viewer.handles import CHOSEN, NONE, TipHandles, free_objects
from trocar.viewer.look_back import LookBack
from trocar.viewer.overlays import LONGEST_M, M_PER_N, Overlays
from trocar.viewer.page import Page
from trocar.viewer.panel import read_arm
from trocar.viewer.plots import PERIOD_S, LastMinute, QuantityPlots
from trocar.viewer.server import LocalServer, run_there, serving
from trocar.viewer.timeline import BACK, CONTINUE, NOW, STEP, TimelineFolder


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    with serving("127.0.0.1", 0, "test") as found:
        yield found


@pytest.fixture
def visitor(server: LocalServer) -> Iterator[Visitor]:
    with visiting(server) as found:
        yield found


class Bench:
    """A world that runs, and the two folders of one browser, which may drive."""

    def __init__(self, server: LocalServer, rig: str = "psm") -> None:
        self.world = World(rig)
        self.loop = Loop(self.world, speed="max")
        self.timeline, self.goals = Timeline(self.world, self.loop.tick_s), TipGoals(self.loop)
        self.left: list[str] = []
        self.seat = ""
        self.past = LookBack(self.loop, self.timeline, lambda: self.left.append("policy"))
        panel = SimpleNamespace(arm=SimpleNamespace(name="PSM1"))
        self.desk: Any = SimpleNamespace(browser=server, panel=panel, blocked=self.blocked)
        self.desk.seat = ""
        things = tuple(free_objects(self.world))
        self.hands = TipHandles(self.desk, self.goals, ("PSM1",), things, self.loop)
        self.folder = TimelineFolder(self.desk, self.past)

    def blocked(self, arm: str) -> str:  # noqa: ARG002
        return "a moment of before" if self.past.looked else self.desk.seat

    @contextmanager
    def running(self) -> Iterator[None]:
        stops = [self.loop.watch(self.timeline), self.loop.watch(self.goals)]
        self.loop.start()
        try:
            yield
        finally:
            self.loop.stop()
            for stop in stops:
                stop()
            self.hands.close()

    def now(self) -> float:
        return self.loop.ask(lambda world: world.time).result()

    def until(self, seconds: float) -> None:
        self.wait(lambda: self.loop.latest.time >= seconds and self.now() >= seconds)

    def settled(self, **wanted: object) -> None:
        """Wait until the loop's state is as wanted."""
        state = self.loop
        self.wait(lambda: all(getattr(state.state, key) == value for key, value in wanted.items()))

    def wait(self, met: Callable[[], bool]) -> None:
        end = time.monotonic() + 60.0
        while not met():
            assert time.monotonic() < end, "in vain"

    def refresh(self) -> None:
        self.loop.ask(lambda world: world.time).result()
        for _ in range(2):
            self.show(self.hands)
        self.folder.show(self.past.shown(self.loop.state))

    def show(self, folder: Folder) -> None:
        """Show a folder what the loop answers to its question."""
        folder.show(self.loop.state)
        self.loop.ask(lambda _: None).result()  # answers come in turn
        folder.show(self.loop.state)


def tip(bench: Bench) -> np.ndarray:
    return bench.loop.ask(lambda world: world.arm("PSM1").setpoint_cp("world").matrix).result()


def test_a_tip_follows_its_handle_and_undo_brings_it_back(server: LocalServer) -> None:
    bench = Bench(server)
    with bench.running():
        bench.refresh()
        start = tip(bench)
        goal = translation([0.01, 0.0, -0.02]) @ start
        for phase in ("start", "update", "end"):
            bench.hands.drag("PSM1", goal, phase)
        bench.until(bench.now() + 0.6)
        assert tip(bench) == pytest.approx(goal, abs=1e-6)
        bench.refresh()
        assert np.array(bench.hands.nodes["PSM1"].position) == pytest.approx(goal[:3, 3], abs=1e-4)
        bench.hands.undo()
        bench.until(bench.now() + 0.6)
        assert tip(bench) == pytest.approx(start, abs=1e-6)


def test_who_may_not_drive_moves_nothing(server: LocalServer) -> None:
    bench = Bench(server)
    with bench.running():
        bench.refresh()
        start = tip(bench)
        bench.desk.seat = "browser 1 drives"
        for phase in ("start", "update", "end"):
            bench.hands.drag("PSM1", translation([0.02, 0.0, 0.0]) @ start, phase)
        bench.until(bench.now() + 0.3)
        assert tip(bench).tolist() == start.tolist()
        bench.refresh()
        assert not bench.hands.nodes["PSM1"].visible


def test_a_handle_is_shown_at_the_chosen_arm_or_none(server: LocalServer, visitor: Visitor) -> None:
    bench = Bench(server)
    with bench.running():
        for choice in (CHOSEN, NONE, CHOSEN):
            visitor.use("Tip handles", choice)
            bench.refresh()
            handle = visitor.node("/hands/tip_PSM1")
            assert handle is not None and handle.visible == (choice == CHOSEN)


def test_an_object_is_placed_while_time_stands_still(server: LocalServer, visitor: Visitor) -> None:
    bench = Bench(server, "pegs")
    name = next(iter(free_objects(bench.world)))
    with bench.running():
        bench.until(0.2)
        bench.loop.post(Command(WORLD, "pause"))
        bench.settled(paused=True)
        visitor.use("Object handle", name)
        bench.refresh()
        handles = [node for node in visitor.read().nodes if node.startswith("/hands/object_")]
        assert handles == [f"/hands/object_{name}"]
        before = bench.loop.ask(free_objects).result()[name]
        goal = translation([0.0, 0.0, 0.05]) @ before
        for phase in ("start", "update", "end"):
            bench.hands.place(name, goal, phase)
        assert bench.loop.ask(free_objects).result()[name] == pytest.approx(goal, abs=1e-9)
        bench.hands.undo()
        assert bench.loop.ask(free_objects).result()[name] == pytest.approx(before, abs=1e-9)


def test_looking_back_pauses_shows_the_moment_and_keeps_the_present(
    server: LocalServer, visitor: Visitor
) -> None:
    bench = Bench(server)
    with bench.running():
        bench.loop.post(Command("PSM1", "move_jp", {"q": (0.4, 0.0, 0.12, 0.0, 0.0, 0.0)}))
        bench.until(1.0)
        bench.past.look(0.3)
        bench.settled(paused=True)
        state = bench.loop.state
        shown = bench.past.shown(state).snapshot
        assert shown.time == pytest.approx(0.3, abs=0.02)
        assert shown.arms["PSM1"].q[0] < state.snapshot.arms["PSM1"].q[0]
        bench.folder.show(state)
        visitor.use("Step", BACK)
        assert bench.past.shown(state).snapshot.time == pytest.approx(shown.time - 0.1)
        visitor.use("Moment", NOW)
        assert bench.past.shown(state) is state


def test_a_branch_goes_on_from_the_moment_without_the_policy(
    server: LocalServer, visitor: Visitor
) -> None:
    bench = Bench(server)
    with bench.running():
        bench.until(1.0)
        bench.past.look(0.5)
        bench.settled(paused=True)
        moment = bench.past.looked
        assert moment is not None
        visitor.use("Moment", CONTINUE)
        bench.loop.ask(lambda world: world.time).result()
        assert bench.loop.ask(lambda world: world.time).result() == pytest.approx(moment.time)
        assert bench.left == ["policy"] and bench.past.looked is None
        assert all(kept.time <= moment.time for kept in bench.timeline.moments)


def test_a_branch_closes_the_file_of_a_recorder(
    server: LocalServer, visitor: Visitor, tmp_path: Path
) -> None:
    bench, file = Bench(server), tmp_path / "run.mcap"
    with record(bench.world, file), bench.running():
        bench.until(1.0)
        bench.past.look(0.5)
        bench.settled(paused=True)
        ends = bench.now()
        visitor.use("Moment", CONTINUE)
        assert bench.now() < ends
        bench.loop.post(Command(WORLD, "resume"))
        bench.until(0.7)
    kept = open_recording(file)
    assert kept.start + (kept.rows - 1) * kept.timestep == pytest.approx(ends)
    assert repeat(file).identical


def test_the_message_of_a_branch_stays_until_a_reset() -> None:
    with serving("127.0.0.1", 0, "test") as server:
        bench = Bench(server)
        page = Page(server, bench.world, bench.loop, past=bench.past)
        with page.notices.listening(), bench.running():
            bench.until(1.0)
            bench.past.look(0.5)
            bench.settled(paused=True)
            for act in (bench.past.branch, lambda: bench.loop.post(Command(WORLD, "reset"))):
                run_there(server, page.refresh)
                before = bench.loop.latest.time
                act()
                bench.wait(lambda was=before: bench.loop.latest.time < was)
                run_there(server, page.refresh)
                texts = [notice.text for notice in page.notices.newest_first]
                assert any("this is a branch" in text for text in texts) == (bench.now() > 0.0)


def test_time_that_flows_again_ends_the_look_back(server: LocalServer) -> None:
    bench = Bench(server)
    with bench.running():
        bench.until(0.5)
        bench.past.look(0.2)
        bench.settled(paused=True)
        bench.past.shown(bench.loop.state)
        bench.loop.post(Command(WORLD, "resume"))
        bench.settled(paused=False)
        state = bench.loop.state
        assert bench.past.shown(state) is state and bench.past.looked is None


def test_a_step_moves_time_by_one_physics_step(server: LocalServer, visitor: Visitor) -> None:
    bench = Bench(server)
    with bench.running():
        bench.until(0.1)
        bench.loop.post(Command(WORLD, "pause"))
        bench.settled(paused=True)
        before = bench.loop.ask(lambda world: world.periods).result()
        bench.folder.show(bench.loop.state)
        visitor.use("Step", STEP)
        assert bench.loop.ask(lambda world: world.periods).result() == before + 1


def test_the_last_minute_is_that_of_the_arms_and_its_table_has_all_of_it(
    server: LocalServer,
) -> None:
    bench, last = Bench(server), LastMinute()
    plots = QuantityPlots(bench.desk, {"PSM1": read_arm(bench.world, "PSM1")}, last)
    bench.loop.post(Command("PSM1", "move_jp", {"q": (0.4, 0.0, 0.12, 0.0, 0.0, 0.0)}))
    measured: list[float] = []
    for _ in range(700):
        bench.loop.run(PERIOD_S)
        last.add(bench.loop.state)
        measured.append(float(bench.world.arm("PSM1").measured_js().position[0]))
    assert last.times[-1] - last.times[0] == pytest.approx(60.0)
    assert last.values("PSM1", 0, "measured") == pytest.approx(measured[-601:], abs=1e-9)
    error = last.values("PSM1", 0, "measured") - last.values("PSM1", 0, "commanded")
    assert last.values("PSM1", 0, "error") == pytest.approx(error, abs=1e-12)
    rows = plots.table().splitlines()
    assert rows[0].split(",")[:2] == ["time s", "PSM1 yaw measured rad"]
    assert len(rows) == 602 and float(rows[-1].split(",")[1]) == pytest.approx(measured[-1])
    plots.show(bench.loop.state)


def test_a_list_of_quantities_is_made_when_the_one_before_has_its_choice() -> None:
    with serving("127.0.0.1", 0, "test") as server, visiting(server) as visitor:
        bench = Bench(server)
        arms = {"PSM1": read_arm(bench.world, "PSM1")}
        run_there(server, lambda: QuantityPlots(bench.desk, arms, LastMinute()))
        for number in range(1, 5):
            assert not visitor.all(f"Plot {number + 1}")
            for quantity in ("measured", "velocity"):
                visitor.use(f"Plot {number}", f"PSM1 yaw {quantity}")
        widgets = visitor.read().widgets.values()
        assert sum(w.props.get("label", "").startswith("Plot ") for w in widgets) == 4
        assert sum(w.kind == "GuiUplotMessage" for w in widgets) == 4


def test_a_tool_that_is_taken_off_leaves_gaps_in_the_last_minute(
    server: LocalServer, visitor: Visitor
) -> None:
    bench, last = Bench(server), LastMinute()
    plots = QuantityPlots(bench.desk, {"PSM1": read_arm(bench.world, "PSM1")}, last)
    visitor.use("Plot 1", "PSM1 jaw measured")
    bench.world.exchange_tool("PSM1", "none")
    for _ in range(3):
        bench.loop.run(PERIOD_S)
        last.add(bench.loop.state)
    plots.show(bench.loop.state)
    assert np.isnan(last.values("PSM1", 6, "measured")).all()
    assert plots.table().splitlines()[-1].endswith(",nan")


def test_an_arrow_stands_at_each_contact_as_long_as_its_force(
    server: LocalServer, visitor: Visitor
) -> None:
    bench = Bench(server)
    see = Overlays(bench.desk, bench.loop)
    for box in ("Contact forces", "Tip paths"):
        visitor.use(box, True)
    with bench.running():
        bench.goals.set("PSM1", translation([0.1, 0.0, -0.3]) @ tip(bench))  # into the table
        bench.until(6.0)
        bench.loop.post(Command(WORLD, "pause"))
        bench.settled(paused=True)
        bench.show(see)
        found = bench.loop.ask(lambda world: [c.force for c in world.contacts().contacts]).result()
        assert see.shown[0] == len(found) > 0 and set(see.shown[1]) == {"PSM1"}
        arrows = visitor.node("/see/forces")
        assert arrows is not None
        points = arrows.props["points"].reshape(-1, 2, 3)
        lengths = np.linalg.norm(points[:, 1] - points[:, 0], axis=1)
        newtons = np.sort(np.linalg.norm(found, axis=1))[::-1]
        assert lengths == pytest.approx(np.minimum(M_PER_N * newtons, LONGEST_M), rel=1e-4)
        see.close()
        assert see.shown == (0, {}) and visitor.node("/see/forces") is None


def test_the_speed_of_the_page_is_that_of_the_loop(server: LocalServer, visitor: Visitor) -> None:
    bench = Bench(server)
    with bench.running():
        bench.refresh()
        assert visitor.widget("Speed").value == "max"  # as the loop was made
        visitor.use("Speed", "0.5 x")
        bench.loop.ask(lambda world: world.time).result()
        bench.refresh()
        assert (bench.loop.speed, visitor.widget("Speed").value) == (0.5, "0.5 x")
        bench.desk.seat = "browser 1 drives"
        visitor.use("Speed", "2 x")
        bench.loop.ask(lambda world: world.time).result()
        assert bench.loop.speed == 0.5
