"""Force feedback: what the hand gets, when, and that it never gets more energy than it gave."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from benchmarks.bilateral import RIG, HeldMaster, Wall, figures, run
from trocar.cli import main
from trocar.errors import InputError, UnknownNameError
from trocar.live import Loop
from trocar.simulation import World
from trocar.teleoperation import Teleoperation
from trocar.teleoperation.force_feedback import (
    MOST_N,
    Architecture,
    DelayLine,
    FeedbackSettings,
    ForceFeedback,
    ForceSource,
    PassivityController,
)
from trocar.teleoperation.psm import PsmTeleoperation
from trocar.teleoperation.remote_master import RemoteMaster
from trocar.teleoperation.session import Session
from trocar.teleoperation.slave import view_in_world

PERIOD_S = 0.001


def following(settings: FeedbackSettings) -> tuple[World, Loop, PsmTeleoperation, ForceFeedback]:
    """Return a held master that moves an instrument, its orientation locked."""
    world = World(RIG)
    loop = Loop(world, tick_s=PERIOD_S, speed="max")
    engine = Teleoperation(loop, None, {"MTMR": HeldMaster("MTMR")})
    assert engine.set_feedback(settings) == ["MTMR_PSM1"]
    engine.start()
    component = cast(PsmTeleoperation, engine.components["MTMR_PSM1"])
    component.set_align(False)
    component.lock_rotation(True)
    component.command("enable")
    for _ in range(10):
        loop.tick()
    assert component.following
    return world, loop, component, cast(ForceFeedback, component.feedback)


# ------------------------------------------------------------------ the parts


def test_a_channel_delivers_what_was_sent_a_delay_ago() -> None:
    channel: DelayLine[int] = DelayLine(0.003)
    arrived = [channel.send(k * PERIOD_S, k) for k in range(8)]
    assert arrived == [0, 0, 0, 0, 1, 2, 3, 4]
    channel.restart()
    assert channel.send(1.0, 9) == 9


@pytest.mark.parametrize("seed", range(5))
def test_a_port_that_generates_energy_is_made_passive(seed: int) -> None:
    """A spring that pulls late is active: with the controller the hand never gains energy."""
    rng = np.random.default_rng(seed)
    turns, late = rng.uniform(5.0, 40.0, 3), rng.uniform(0.0, 2.0, 3)
    way = rng.uniform(0.001, 0.01, 3)
    controllers = {acting: PassivityController() for acting in (True, False)}
    lowest = dict.fromkeys(controllers, 0.0)
    for acting, controller in controllers.items():
        energy, force, before = 0.0, np.zeros(3), np.zeros(3)
        for k in range(5000):
            begun = 1.0 - np.exp(-((k * PERIOD_S / 0.2) ** 2))  # a handle has mass
            x = begun * way * np.sin(turns * k * PERIOD_S)
            energy -= float(force @ (x - before))  # counted here, beside the observer
            lowest[acting], before = min(lowest[acting], energy), x
            pull = -500.0 * begun * way * np.sin(turns * k * PERIOD_S - late)
            force = controller.corrected(pull, x, PERIOD_S, acting=acting)
            assert controller.energy == pytest.approx(energy, abs=1e-12)
    assert lowest[False] < -0.5
    assert lowest[True] >= -1e-6  # of 0.5 J or more; the way ahead is extrapolated
    assert controllers[True].dissipated > 0.0


def test_a_passive_port_stays_as_it_is() -> None:
    """A spring stores energy and gives it back: the controller takes its reserve at most."""
    controller, changed = PassivityController(), 0.0
    for k in range(5000):
        x = np.array([0.005 * (1.0 - np.cos(10.0 * k * PERIOD_S)), 0.0, 0.0])
        force = controller.corrected(-200.0 * x, x, PERIOD_S)
        if controller.energy > 3e-4:
            changed = max(changed, float(np.abs(force + 200.0 * x).max()))
    assert changed == 0.0
    assert 0.0 <= controller.dissipated < 1e-2


# ------------------------------------------------------------------ at the hand


@pytest.mark.parametrize("delay", [0.0, 0.02])
def test_the_hand_gets_the_scaled_force_after_the_delay(delay: float) -> None:
    settings = FeedbackSettings("position-force", 0.5, delay, passive=False)
    world, loop, _, feedback = following(settings)
    push = np.array([1.0, -2.0, 0.5])
    for _ in range(50):
        loop.tick()
    feedback.contact = lambda: push
    expected = 0.5 * view_in_world(world)[:3, :3].T @ push
    for k in range(round(delay / PERIOD_S) + 1):
        loop.tick()
        late = k < round(delay / PERIOD_S)
        np.testing.assert_allclose(feedback.force, 0.0 if late else expected, atol=1e-12)
    arm = world.arm("MTMR")
    exerted = arm.measured_cp().matrix[:3, :3] @ arm.body.measured_cf().force
    np.testing.assert_allclose(exerted, expected, atol=0.1)  # the gimbal's lock exerts some of it


def test_the_instrument_follows_after_the_delay() -> None:
    tips = {}
    for delay in (0.0, 0.05):
        world, loop, component, _ = following(FeedbackSettings(delay=delay))
        master = cast(HeldMaster, component.masters[0])
        master.hand = np.array([0.0, 2.0, 0.0])
        found = []
        for _ in range(200):
            loop.tick()
            found.append(world.arm("PSM1").local.setpoint_cp().matrix[:3, 3])
        tips[delay] = np.array(found)
    assert np.linalg.norm(tips[0.0][-1] - tips[0.0][0]) > 0.001
    np.testing.assert_allclose(tips[0.05][50:], tips[0.0][:-50], atol=1e-6)


def test_the_force_is_limited() -> None:
    _, loop, _, feedback = following(FeedbackSettings(passive=False))
    feedback.contact = lambda: np.array([100.0, 0.0, 0.0])
    loop.tick()
    assert np.linalg.norm(feedback.force) == pytest.approx(MOST_N)


def test_a_locked_translation_and_a_carried_handle_get_no_force() -> None:
    world, loop, component, feedback = following(FeedbackSettings(passive=False))
    feedback.contact = lambda: np.array([3.0, 0.0, 0.0])
    loop.tick()
    assert np.linalg.norm(world.arm("MTMR").body.measured_cf().force) > 2.0
    component.carried = lambda: True
    component.masters[0].exert(world, np.zeros(6))
    loop.tick()
    assert np.linalg.norm(world.arm("MTMR").body.measured_cf().force) < 0.5
    component.carried = lambda: False
    component.lock_translation(True)
    loop.tick()
    assert np.linalg.norm(world.arm("MTMR").body.measured_cf().force) < 0.5


def test_motors_efforts_show_the_force_of_a_contact() -> None:
    """Against a wall at rest the motors exert the contact's force, but for the joints' friction."""
    settings = FeedbackSettings(source="efforts", passive=False)
    world, loop, component, feedback = following(settings)
    component.carried = lambda: True  # nothing pushes the handle
    up = np.array([0.0, 0.0, 1.0])
    tip = (world.reference_pose("PSM1") @ world.arm("PSM1").local.measured_cp().matrix)[:3, 3]
    wall = Wall("PSM1", 3000.0, tip + 0.001 * up, up)
    world.add("wall", wall)
    for _ in range(400):
        loop.tick()
    assert np.linalg.norm(wall.force) > 1.0
    expected = view_in_world(world)[:3, :3].T @ wall.force
    np.testing.assert_allclose(feedback.force, expected, atol=0.5)


@pytest.mark.parametrize("architecture", ["position-force", "position-position"])
def test_no_energy_is_generated_against_a_hard_wall_with_a_delay(
    architecture: Architecture,
) -> None:
    with_it = run(architecture, 10_000.0, 0.05, 1.3, settle=0.1)
    assert with_it.lowest >= -1e-5
    assert with_it.contact > 0.2
    if architecture == "position-force":
        without = run(architecture, 10_000.0, 0.05, 1.3, passive=False, settle=0.1)
        assert without.lowest < -0.05


def test_without_delay_the_hand_gets_the_force_of_the_wall() -> None:
    one = run("position-force", 1_000.0, 0.0, 1.2, settle=0.1)
    assert one.ratio == pytest.approx(1.0, abs=0.02)
    assert one.lowest >= -1e-5
    energy, *_ = figures("a run", one)
    assert energy.met and energy.text(one.lowest) == "0"


# ------------------------------------------------------------------ switched on and off


def test_feedback_is_off_at_first_and_at_real_masters_unless_it_is_asked_for() -> None:
    world = World(RIG)
    loop = Loop(world, tick_s=PERIOD_S, speed="max")
    plain = Teleoperation(loop)
    (component,) = plain.components.values()
    assert cast(PsmTeleoperation, component).feedback is None
    plain.set_feedback(FeedbackSettings())
    plain.set_feedback(None)
    assert cast(PsmTeleoperation, component).feedback is None
    (description,) = world.rig.teleops
    elsewhere = replace(description, masters=("HAND",))
    engine = Teleoperation(loop, (elsewhere,), {"HAND": RemoteMaster("HAND", lambda: 0.0)})
    with pytest.raises(InputError, match=r"no simulated master .* --feedback-real"):
        engine.set_feedback(FeedbackSettings())
    assert engine.set_feedback(FeedbackSettings(real_masters=True)) == ["MTMR_PSM1"]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"scale": 0.0}, "scale of 0; allowed: above 0 to 10"),
        ({"scale": 11.0}, "scale of 11; allowed"),
        ({"delay": -0.1}, "delay of -0.1 s; allowed: 0 to 2 s"),
        ({"delay": float("nan")}, "delay of nan s"),
    ],
)
def test_settings_out_of_range_are_rejected(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        FeedbackSettings("position-force", **settings)


def test_unknown_settings_are_rejected() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'position-force'"):
        FeedbackSettings(cast(Architecture, "position-forces"))
    with pytest.raises(UnknownNameError, match="known: contact, efforts"):
        FeedbackSettings(source=cast(ForceSource, "felt"))
    with pytest.raises(InputError, match="--feedback: allowed with --device masters only"):
        Session("keyboard", feedback=FeedbackSettings())


def test_the_command_line_switches_it_on(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["teleop", "--rig", str(RIG), "--feedback", "position-force", "--feedback-scale", "0.5"]
    words += ["--delay", "0.02", "--duration", "0.05", "--no-page", "--websocket-port", "0"]
    assert main(words) == 0
    assert main(["teleop", "--delay", "0.02"]) == 2
    assert "--delay: has no effect here; allowed with --feedback only" in capsys.readouterr().err
