"""The arm's verbs as a state machine: what holds after every verb, whatever came before."""

from __future__ import annotations

import logging
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from trocar.errors import InputError
from trocar.simulation import World
from trocar.simulation.controllers import CartesianImpedance, HalfPlaneGains
from trocar.simulation.moves import Motion

#: (from, to) of the operating state. Source: collaborative-robotics documentation, robot operating
#: states; the dVRK's own.
STEPS = {
    ("DISABLED", "ENABLED"), ("ENABLED", "DISABLED"), ("ENABLED", "PAUSED"),
    ("PAUSED", "ENABLED"), ("PAUSED", "DISABLED"), ("ENABLED", "FAULT"), ("PAUSED", "FAULT"),
    ("FAULT", "DISABLED"),
}  # fmt: skip
POWERED = {"ENABLED", "PAUSED"}
TOOLS = ("LARGE_NEEDLE_DRIVER:400006", "PROGRASP_FORCEPS:420093", "none")
#: Joints without power relax by less than this. Source: measured, 4e-11. [rad or m]
STILL = 1e-6
#: Made once: a build takes longer than an example.
WORLD = World("psm")

turns = st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6).map(np.array)
timeouts = st.sampled_from([None, 0.01, 0.1])


class ArmMachine(RuleBasedStateMachine):
    """One PSM, whose verbs come in any order."""

    #: Whether tools are exchanged, which builds a model each time.
    exchanges = False

    @initialize(homed=st.booleans())
    def start(self, homed: bool) -> None:
        self.world, self.arm = WORLD, WORLD.arm("PSM1")
        if self.arm.description.tool != TOOLS[0]:
            self.arm.runtime.set_tool_type(TOOLS[0])
        self.world.reset()
        if not homed:
            self.arm.disable()
            self.arm.state_command("unhome")
        self.seen = self.arm.operating_state()
        self.motion: Motion | None = None
        self.ends = np.inf

    # ------------------------------------------------------------------ states

    @rule(name=st.sampled_from(["enable", "disable", "home", "unhome", "pause", "resume"]))
    def state(self, name: str) -> None:
        before = self.arm.operating_state()
        accepted = self.arm.state_command(name)
        now = self.arm.operating_state()
        if not accepted:
            assert (now.state, now.is_homed) == (before.state, before.is_homed)
            assert now.is_busy == before.is_busy
        elif name in ("disable", "pause"):
            assert not now.is_busy
        if name == "unhome":
            assert not now.is_homed
        if name != "resume" or accepted:
            homed = before.is_homed and before.state == "ENABLED"  # "home" then changes nothing
            goes_on = not accepted or name in ("enable", "unhome") or (homed and name == "home")
            self.ends = self.ends if goes_on else np.inf

    # ------------------------------------------------------------------ motion

    def commanded(self, accepted: bool, ends: float = np.inf, shared: bool = False) -> None:
        """Check that a command was accepted only when the arm was ready; note when it ends.

        Efforts for joints that are in mode "effort" are `shared`: the other joints' move goes on.
        """
        if accepted:
            assert self.ready
            if not shared and self.motion is not None:
                assert self.motion.done, "a command ends the move before"
            self.motion, self.ends = None, ends

    @property
    def shared(self) -> bool:
        """Whether efforts are for joints in mode "effort" alone; asked before the command."""
        names = self.arm.joints.names[: self.arm.description.own_joints]
        return any(self.arm.joints.mode(name) == "effort" for name in names)

    def position(self, turn: np.ndarray) -> np.ndarray:
        """Return joints near the middle of the workspace."""
        return np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0]) + turn * [1, 1, 0.1, 1, 1, 1]

    @rule(turn=turns, speed=st.none() | turns)
    def servo_jp(self, turn: np.ndarray, speed: np.ndarray | None) -> None:
        self.commanded(self.arm.servo_jp(self.position(turn), speed))

    @rule(turn=turns)
    def servo_jr(self, turn: np.ndarray) -> None:
        self.commanded(self.arm.servo_jr(0.01 * turn))

    @rule(turn=turns, timeout=timeouts)
    def servo_jv(self, turn: np.ndarray, timeout: float | None) -> None:
        ends = self.world.time + (timeout or np.inf)
        self.commanded(self.arm.servo_jv(turn, timeout), ends)

    @rule(turn=turns, timeout=timeouts)
    def servo_jf(self, turn: np.ndarray, timeout: float | None) -> None:
        ends, shared = self.world.time + (timeout or np.inf), self.shared
        self.commanded(self.arm.servo_jf(turn, timeout), ends, shared)

    @rule(turn=turns, timeout=timeouts, frame=st.sampled_from(["body", "spatial"]))
    def servo_cf(self, turn: np.ndarray, timeout: float | None, frame: Any) -> None:
        ends, shared = self.world.time + (timeout or np.inf), self.shared
        self.commanded(self.arm.forces.servo_cf(turn, frame, timeout), ends, shared)

    @rule(turn=turns)
    def servo_ci(self, turn: np.ndarray) -> None:
        gains = HalfPlaneGains(p=np.full(3, -50.0), d=np.full(3, -5.0))
        place = self.arm.measured_cp().matrix[:3, 3] + 0.02 * turn[:3]
        spring = CartesianImpedance(place, position_positive=gains, position_negative=gains)
        shared = self.shared
        self.commanded(self.arm.forces.servo_ci(spring), shared=shared)

    @rule(turn=turns, verb=st.sampled_from(["servo_cp", "move_cp"]))
    def tip(self, turn: np.ndarray, verb: str) -> None:
        goal = self.arm.setpoint_cp().matrix
        goal[:3, 3] += 0.02 * turn[:3]
        found = getattr(self.arm, verb)(goal)
        if isinstance(found, Motion):
            self.moved(found)
        else:
            self.commanded(found)

    @rule(turn=turns)
    def move_jp(self, turn: np.ndarray) -> None:
        self.moved(self.arm.move_jp(self.position(turn)))

    @rule(turn=turns)
    def move_jr(self, turn: np.ndarray) -> None:
        self.moved(self.arm.move_jr(0.1 * turn))

    @rule()
    def move_to(self) -> None:
        self.moved(self.arm.move_to("home"))

    def moved(self, motion: Motion) -> None:
        self.commanded(not motion.done)
        self.motion = self.motion if motion.done else motion

    @rule()
    def hold(self) -> None:
        self.arm.hold()
        if self.ready:
            assert not self.arm.operating_state().is_busy
            self.ends = np.inf

    @rule()
    def free(self) -> None:
        shared = self.shared
        self.commanded(self.arm.free(), shared=shared)

    @rule(angle=st.floats(-0.3, 1.2), verb=st.sampled_from(["servo_jp", "move_jp", "servo_jf"]))
    def jaw(self, angle: float, verb: str) -> None:
        if self.arm.jaw is None:
            return
        found = getattr(self.arm.jaw, verb)([0.1 * angle if verb == "servo_jf" else angle])
        assert self.ready or not (found if isinstance(found, bool) else not found.done)
        if found is True and verb == "servo_jp" and self.motion is not None:
            assert self.motion.done, "the jaw and the arm have one controller"

    # ------------------------------------------------------------------ settings

    @rule(mode=st.sampled_from(["position", "effort", "set"]), yaw=st.booleans())
    def mode(self, mode: Any, yaw: bool) -> None:
        changes = self.ready or not self.arm.runtime.motors.powered
        self.arm.joints.set_mode(mode, ["yaw"] if yaw else None)
        if changes:
            self.ends = np.inf
            assert self.arm.joints.mode("yaw") == mode

    @rule(on=st.booleans())
    def gravity(self, on: bool) -> None:
        self.arm.joints.use_gravity_compensation(on)
        assert self.arm.joints.gravity_compensation == on

    @rule(ratio=st.floats(0.002, 1.0), of=st.sampled_from(["both", "velocity", "acceleration"]))
    def ratio(self, ratio: float, of: Any) -> None:
        before, refused = self.arm.joints.trajectory_ratio, ""
        try:
            self.arm.joints.set_trajectory_ratio(ratio, of)
        except InputError as error:
            refused = str(error)
        if refused:  # a running move would take hours to brake
            assert self.motion is not None
            assert "no trajectory" in refused
            assert self.arm.joints.trajectory_ratio == before
        else:
            assert ratio in self.arm.joints.trajectory_ratio

    @rule()
    def brakes(self) -> None:
        with pytest.raises(InputError, match="has no brakes"):
            self.arm.brakes.release()

    @precondition(lambda self: self.exchanges)
    @rule(tool=st.sampled_from(TOOLS))
    def exchange(self, tool: str) -> None:
        if tool == (self.arm.description.tool or "none"):
            return
        before = self.arm.operating_state()
        self.arm.runtime.set_tool_type(tool)
        self.ends = np.inf
        now = self.arm.operating_state()
        assert (self.arm.description.tool or "none") == tool
        assert now.state == before.state
        assert now.is_homed == before.is_homed
        assert not now.is_busy

    # ------------------------------------------------------------------ time

    @rule(steps=st.integers(1, 200))
    def step(self, steps: int) -> None:
        arm, own = self.arm, self.arm.description.own_joints
        was, before, setpoint = (
            arm.operating_state(),
            arm.joints.positions(),
            arm.setpoint_js().position,
        )
        inside = bool(((arm.joints.lower < before) & (before < arm.joints.upper))[:own].all())
        began, acts = self.world.time, self.arm.runtime.active
        self.world.step(steps)
        now = arm.operating_state()
        if was.state not in POWERED and inside:
            np.testing.assert_allclose(arm.joints.positions()[:own], before[:own], atol=STILL)
        ended = -1e-9 < self.ends - began <= self.world.time - began + 1e-9
        if not (was.ready or was.is_busy or acts or ended) and now.state == was.state:
            np.testing.assert_array_equal(arm.setpoint_js().position, setpoint)
        assert now.is_homed == was.is_homed or was.is_busy
        if self.motion is not None and self.motion.done:
            motion, self.motion = self.motion, None
            if motion.goal_reached:
                goal = motion.goal
                np.testing.assert_allclose(arm.joints.setpoints()[: len(goal)], goal, atol=1e-12)

    @rule(steps=st.integers(1, 100))
    def save_and_load(self, steps: int) -> None:
        state = pickle.dumps(self.world.save())
        self.world.step(steps)
        expected, then = self.arm.joints.positions(), self.arm.operating_state()
        self.world.load(pickle.loads(state))
        self.world.step(steps)
        np.testing.assert_array_equal(self.arm.joints.positions(), expected)
        assert self.arm.operating_state() == then
        self.motion = None  # its handle is of the time before

    @rule(seed=st.integers(0, 5))
    def reset(self, seed: int) -> None:
        self.world.reset(seed)
        self.motion, self.ends = None, np.inf
        assert self.arm.operating_state().ready and not self.arm.operating_state().is_busy
        self.seen = self.arm.operating_state()

    # ------------------------------------------------------------------ laws

    @property
    def ready(self) -> bool:
        return self.arm.operating_state().ready

    @invariant()
    def the_state_is_finite(self) -> None:
        data = self.world.mj_data
        assert np.isfinite(data.qpos).all() and np.isfinite(data.ctrl).all()
        assert not self.world.engine_warnings()

    @invariant()
    def operating_states_follow_from_each_other(self) -> None:
        now = self.arm.operating_state()
        assert now.state == self.seen.state or (self.seen.state, now.state) in STEPS
        assert not (now.is_busy and now.state != "ENABLED")
        assert self.arm.runtime.motors.powered == (now.state in POWERED)
        self.seen = now

    @invariant()
    def set_points_are_inside_the_limits(self) -> None:
        setpoint = self.arm.joints.setpoints()
        assert (self.arm.joints.lower <= setpoint).all() and (
            setpoint <= self.arm.joints.upper
        ).all()
        efforts = np.abs(self.arm.runtime.motors.effort)
        assert (efforts <= self.arm.joints.effort_limit + 1e-12).all()

    @invariant()
    def a_set_point_with_a_time_out_ends(self) -> None:
        if self.world.time > self.ends + 1e-9 and self.arm.runtime.motors.powered:
            assert not self.arm.runtime.active or self.arm.operating_state().is_busy
            assert not self.arm.runtime.control.switched & set(
                range(self.arm.description.own_joints)
            )


class ExchangingMachine(ArmMachine):
    """The same with exchanges of tools."""

    exchanges = True


@pytest.fixture(autouse=True)
def quiet():
    log = logging.getLogger("trocar")
    log.setLevel(logging.CRITICAL + 1)
    yield
    log.setLevel(logging.NOTSET)


def run(machine: type[ArmMachine], examples: int, steps: int, **others: Any) -> None:
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=examples, stateful_step_count=steps, deadline=None, **others
        ),
    )


def test_an_arm_keeps_its_laws_whatever_verbs_come():
    run(ArmMachine, 15, 20, derandomize=True)


@pytest.mark.slow
def test_an_arm_keeps_its_laws_in_long_orders_of_verbs():
    run(ExchangingMachine, 400, 50, derandomize=True)
