"""Whatever is done to a world, each recording is repeated to the last bit, or says why not."""

from __future__ import annotations

import contextlib
import itertools
import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trocar.errors import DivergedError, LogError, TrocarError
from trocar.recording import record, recorder_of
from trocar.robot.follow import repeat
from trocar.simulation import State, World
from trocar.simulation.arm import STATE_COMMANDS, Arm
from trocar.simulation.controllers import Action, CartesianImpedance, HalfPlaneGains, TipState
from trocar.tasks import make_task
from trocar.tasks.task import Task

pytest.importorskip("mcap")
GOAL = [0.3, 0.2, 0.15, 0.4, 0.2, -0.3]
#: Tools for both generations of arms, and none.
TOOLS = ("LARGE_NEEDLE_DRIVER:420006", "PROGRASP_FORCEPS:420093", "none")
#: Numbers of steps; forces are renewed each 20, and blocks of a recording end each 100.
STEPS = (1, 7, 20, 100, 133)
#: How often each action is drawn.
WEIGHTS = {
    "start": 5, "stop": 3, "step": 8, "save": 4, "load": 6, "reset": 2, "restart": 2, "exchange": 1,
    "move": 4, "servo": 3, "jaw": 3, "state": 1, "change": 2, "put": 1, "put_object": 2, "sense": 1,
}  # fmt: skip


@contextlib.contextmanager
def maybe_rejected(*reasons: str) -> Iterator[None]:
    """Let one of these reasons for a rejection pass."""
    try:
        yield
    except TrocarError as problem:
        if not any(reason in str(problem) for reason in reasons):
            raise


class History:
    """Two worlds, or two scenes, to which random things are done; each is recorded now and then.

    Args:
        seed: of the random numbers
        folder: for the recordings
        worlds: of one rig with one set of options
        tasks: of scenes, whose worlds these are
    """

    def __init__(
        self, seed: int, folder: Path, worlds: list[World], tasks: list[Task] | None = None
    ) -> None:
        self.rng = np.random.default_rng(seed)
        self.folder, self.worlds, self.tasks = folder, worlds, tasks or []
        self.states: list[State] = []
        self.files: list[Path] = []
        self.refused: list[str] = []
        self.done: list[str] = []

    def run(self, count: int) -> None:
        """Do so many things, then end and repeat the recordings."""
        names, weights = list(WEIGHTS), np.array(list(WEIGHTS.values()))
        for _ in range(count):
            self.turn = int(self.rng.integers(2))
            self.world = self.worlds[self.turn]
            name = names[self.rng.choice(len(names), p=weights / weights.sum())]
            self.done.append(f"{name} {self.turn}")
            getattr(self, name)()
        for world in self.worlds:
            self.world = world
            self.stop()

    def pick(self, values: Any) -> Any:
        """Draw one of some values."""
        return list(values)[int(self.rng.integers(len(list(values))))]

    # ------------------------------------------------------------------ recordings and time

    def start(self) -> None:
        """Begin a recording."""
        if recorder_of(self.world) is None:
            self.files.append(self.folder / f"{len(self.files)}.mcap")
            record(self.world, self.files[-1])

    def stop(self) -> None:
        """End a recording and repeat it."""
        recorder = recorder_of(self.world)
        if recorder is None:
            return
        recorder.stop()
        rig = self.world.first_rig if not self.world.rig_source else None
        try:
            report = repeat(recorder.file, rig)
        except LogError as problem:
            self.refused.append(str(problem))
        else:
            assert report.identical, (report.difference, self.done)

    def step(self) -> None:
        """Let time pass."""
        self.world.step(self.pick(STEPS))

    # ------------------------------------------------------------------ from one state to another

    def save(self) -> None:
        """Keep a state."""
        state = self.world.save()
        self.states.append(self.pick([state, pickle.loads(pickle.dumps(state))]))

    def load(self) -> None:
        """Go on from a state, also one of the other world; one of other tools is rejected."""
        if self.states:
            with maybe_rejected("load: got a state of"):
                self.world.load(self.pick(self.states))

    def reset(self) -> None:
        """Begin at time 0."""
        self.world.reset(self.pick([None, 1, 2]), self.pick(sorted(self.world.rig.poses)))

    def restart(self) -> None:
        """Begin an episode, and drive by the scene's policy."""
        if self.tasks:
            task, count = self.tasks[self.turn], self.pick([1, 5, 20])
            with maybe_rejected("is its tool mounted", "the episode is over"):
                task.reset(int(self.rng.integers(3)))
                for action in itertools.islice(task.policy(), count):
                    task.command(action)

    def exchange(self) -> None:
        """Mount another tool; some arms take none, and no arm where there is tissue."""
        with maybe_rejected("takes no tool", "has tissue", "sensor"):
            self.world.exchange_tool(self.pick(sorted(self.world.arms)), self.pick(TOOLS))

    # ------------------------------------------------------------------ commands

    @property
    def arm(self) -> Arm:
        """Any arm that moves."""
        arms = self.world.arms.values()
        return self.pick([arm for arm in arms if not arm.runtime.motors.welded])

    def move(self) -> None:
        """Send an arm somewhere near its start."""
        arm, verb = self.arm, self.pick(["servo_jp", "move_jp"])
        start = self.world.rig.poses["start"][arm.name][: arm.description.own_joints]
        getattr(arm, verb)(start + self.rng.uniform(-0.1, 0.1, len(start)))

    def servo(self) -> None:
        """Drive an arm by velocities, small turns, forces or springs."""
        arm, verb = self.arm, self.pick(["servo_jv", "servo_jr", "forces.servo_cf", "servo_ci"])
        if verb == "servo_ci":
            gains = HalfPlaneGains(p=np.full(3, -50.0), d=np.full(3, -5.0))
            arm.forces.servo_ci(
                CartesianImpedance(arm.measured_cp().matrix[:3, 3], position_positive=gains)
            )
        else:
            size = 6 if verb == "forces.servo_cf" else arm.description.own_joints
            attrgetter(verb)(arm)(self.rng.uniform(-0.03, 0.03, size))

    def jaw(self) -> None:
        """Open or close a jaw."""
        jaw = self.arm.jaw
        if jaw is not None:
            getattr(jaw, self.pick(["servo_jp", "move_jp"]))([self.rng.uniform(-0.3, 1.0)])

    def state(self) -> None:
        """Change an operating state."""
        self.arm.state_command(self.pick(STATE_COMMANDS))

    def change(self) -> None:
        """Change gains, compensation, modes, ratios and frames."""
        arm, on = self.arm, self.pick([True, False])
        arm.joints.set_gains(arm.joints.names[0], p=self.rng.uniform(10.0, 60.0))
        arm.joints.use_gravity_compensation(on)
        arm.joints.use_computed_torque(on)
        arm.joints.set_mode("effort" if on else "position", [arm.joints.names[0]])
        arm.joints.set_trajectory_ratio(self.rng.uniform(0.1, 1.0))
        arm.joints.use_strict_limits(on)
        if on:
            arm.forces.lock_orientation()  # which masters can

    def put(self) -> None:
        """Put an arm somewhere."""
        arm = self.arm
        start = self.world.rig.poses["start"][arm.name]
        self.world.set_state(arm.name, start + self.rng.uniform(-0.01, 0.01, len(start)))

    def put_object(self) -> None:
        """Put a free object somewhere."""
        free = [found for found in self.world.objects.values() if found.description.joint is None]
        if free:
            found = self.pick(free)
            T = found.measured_cp().matrix.copy()
            T[:3, 3] += self.rng.uniform([-0.005, -0.005, 0.0], [0.005, 0.005, 0.01])
            found.set_cp(T)

    def sense(self) -> None:
        """Read the sensors, which draws random numbers."""
        for name in self.world.sensors:
            self.world.sensor(name)


CASES: dict[str, Callable[[], list[World]]] = {
    "a PSM": lambda: [World("psm", tip_load_n=1.0), World("psm", tip_load_n=1.0, seed=3)],
    "a PSM that is not homed": lambda: [World("psm", homed=False) for _ in "ab"],
    "a PSM with errors": lambda: [World("psm", errors="lab", seed=seed) for seed in (1, 2)],
    "a cart": lambda: [World("full_cart"), World("full_cart")],
    "objects": lambda: [World("pegs"), World("pegs")],
    "masters": lambda: [World("mtm"), World("mtm")],
}
#: Each seed is another order of the same verbs.
SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", SEEDS)
def test_every_recording_is_repeated_whatever_is_done(case: str, seed: int, tmp_path: Path) -> None:
    history = History(seed, tmp_path, CASES[case]())
    history.run(80)
    assert len(history.files) > 1
    assert history.refused == []


@pytest.mark.parametrize("scene", ["dynamic-band", "needle-pick", "thread-knot", "suturing"])
@pytest.mark.parametrize("seed", SEEDS[:2])
def test_every_recording_of_a_scene_is_repeated_whatever_is_done(
    scene: str, seed: int, tmp_path: Path
) -> None:
    tasks = [make_task(scene), make_task(scene)]
    history = History(seed, tmp_path, [task.world for task in tasks], tasks)
    history.run(50)
    assert len(history.files) > 1
    assert history.refused == []


def bad(state: State) -> State:
    """Return a state that diverges at the next step."""
    row = state.row.copy()
    row[12:20] = 1e200
    return replace(state, row=row)


def test_a_recording_goes_on_over_a_divergence_and_is_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log of its own where it runs
    world, file = World("psm"), tmp_path / "run.mcap"
    world.step(13)
    with record(world, file):
        world.step(30)
        world.load(bad(world.save()))
        with pytest.raises(DivergedError):
            world.step(40)
        world.reset(pose="home")
        world.arm("PSM1").move_jp(GOAL)
        world.step(200)
    assert repeat(file).identical


@pytest.mark.parametrize("again", ["reset", "load"])
def test_a_recording_that_begins_after_a_divergence_is_repeated(
    again: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    world, file = World("psm"), tmp_path / "run.mcap"
    world.step(13)
    state = world.save()
    world.load(bad(state))
    with pytest.raises(DivergedError):
        world.step(40)
    world.reset() if again == "reset" else world.load(state)
    with record(world, file):
        world.arm("PSM1").move_jp(GOAL)
        world.step(100)
    assert repeat(file).identical


MISTAKES: dict[str, Callable[[World], object]] = {
    "an argument is missing": lambda world: world.arm("PSM1").servo_jp(),  # type: ignore[call-arg]
    "too many": lambda world: world.reset(1, "home", 5),  # type: ignore[call-arg]
    "one twice": lambda world: world.reset(1, seed=2),  # type: ignore[misc]
    "not by name": lambda world: world.play({"PSM1": np.zeros((9, 7))}, None, None, 5),  # type: ignore[misc]
    "another name": lambda world: world.arm("PSM1").move_jp(goal=GOAL),  # type: ignore[call-arg]
    "another type": lambda world: world.reset(pose=["home"]),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_call_that_python_rejects_is_rejected_again(mistake: str, tmp_path: Path) -> None:
    world, file = World("psm"), tmp_path / "run.mcap"
    with record(world, file):
        world.arm("PSM1").move_jp(GOAL)
        world.step(30)
        with pytest.raises(TypeError):
            MISTAKES[mistake](world)
        world.step(20)
    assert repeat(file).identical


def test_reset_and_load_let_a_long_past_be_repeated_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trocar.simulation.journal.MOST_COMMANDS", 5)
    world = World("psm")
    world.exchange_tool("PSM1", "PROGRASP_FORCEPS:420093")
    world.exchange_tool("PSM1", "LARGE_NEEDLE_DRIVER:420006")
    for again in ("reset", "load"):
        for _ in range(9):
            world.arm("PSM1").servo_jp(GOAL)
            world.step()
        assert "it began after more than 5 commands" in world.past.incomplete
        world.reset() if again == "reset" else world.load(world.save())
        world.step(3)
        with record(world, tmp_path / f"{again}.mcap"):
            world.arm("PSM1").move_jp(GOAL)
            world.step(100)
        assert repeat(tmp_path / f"{again}.mcap").identical


def test_the_past_keeps_no_more_than_the_last_state() -> None:
    world = World("psm")
    states = [world.save() for _ in range(3)]
    for _ in range(2000):
        world.load(states[0])
        world.arm("PSM1").servo_jp(GOAL)
        world.step()
        world.load(states[1])
    assert [(entry.name, entry.values) for entry in world.past.entries] == [
        ("load", {"state": states[1]})
    ]


class Spiral:
    """A controller of another package."""

    def act(self, now: TipState) -> Action:
        """Return no efforts."""
        return Action(np.zeros(len(now.q)))


def test_a_state_with_a_controller_of_another_package_cannot_be_repeated_which_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trocar.simulation.forces.load_registered", lambda *_: Spiral)
    world, file = World("psm"), tmp_path / "run.mcap"
    world.arm("PSM1").forces.use_controller("spiral")
    world.step(5)
    state = world.save()
    with record(world, file):
        world.load(state)
        world.step(5)
    with pytest.raises(
        LogError, match=r"cannot be repeated: .* world load at 0\.005 s has .*Spiral"
    ):
        repeat(file)
