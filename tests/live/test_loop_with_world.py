"""The loop and its commands on real rigs: what they do, and that watching changes nothing."""

from __future__ import annotations

import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from trocar.live import Command, Loop
from trocar.simulation import World


@pytest.fixture
def loop() -> Loop:
    return Loop(World("psm", dynamics="cad"), speed="max")


def after(loop: Loop, duration_s: float, *commands: Command):
    for command in commands:
        assert loop.post(command)
    loop.run(duration_s)
    assert loop.state.refused == 0
    return loop.latest.arms


def test_moves_and_set_points_arrive(loop: Loop) -> None:
    goal = (0.3, -0.2, 0.15, 0.5, 0.1, -0.1)
    arm = after(
        loop,
        3.0,
        Command("PSM1", "move_jp", {"q": goal}),
        Command("PSM1", "jaw.move_jp", {"q": [0.6]}),
    )["PSM1"]
    assert arm.q == pytest.approx([*goal, 0.6], abs=2e-3)
    nearby = tuple(value + 0.01 for value in goal)
    arm = after(
        loop,
        1.0,
        Command("PSM1", "servo_jp", {"q": nearby}),
        Command("PSM1", "jaw.servo_jp", {"q": [0.5]}),
    )["PSM1"]
    assert arm.setpoint == pytest.approx([*nearby, 0.5])
    arm = after(loop, 5.0, Command("PSM1", "move_to", {"name": "home"}))["PSM1"]
    home = after(loop, 0.1, Command("PSM1", "hold"))["PSM1"].setpoint
    assert arm.setpoint == pytest.approx(home) and not arm.busy


def test_modes_efforts_gains_and_gravity_are_set(loop: Loop) -> None:
    start = loop.latest.arms["PSM1"].q[0]
    arm = after(
        loop, 0.1, Command("PSM1", "set_mode", {"mode": "effort", "joints": ("yaw", "jaw")})
    )["PSM1"]
    assert arm.modes == ("effort", *["position"] * 5, "effort")
    efforts = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    arm = after(
        loop,
        0.5,
        Command("PSM1", "servo_jf", {"effort": efforts}),
        Command("PSM1", "jaw.servo_jf", {"effort": [0.05]}),
    )["PSM1"]
    assert arm.q[0] > start + 0.02
    after(
        loop,
        0.1,
        Command("PSM1", "set_gains", {"joint": "pitch", "p": 77.0}),
        Command("PSM1", "use_gravity_compensation", {"on": False}),
    )
    answer = loop.ask(
        lambda world: (
            world.arm("PSM1").joints.gains("pitch")[0],
            world.arm("PSM1").joints.gravity_compensation,
        )
    )
    loop.tick()
    assert answer.result(0) == (77.0, False)


def test_a_setup_arm_moves_only_when_its_brakes_are_released() -> None:
    loop = Loop(World("full_cart"), speed="max")
    before = loop.latest.arms["SUJ_PSM1"].q
    goal = tuple(before + np.array([0.02, 0.05, 0, 0, 0, 0]))
    loop.post(Command("SUJ_PSM1", "move_jp", {"q": goal}))
    arm = after(loop, 0.5)["SUJ_PSM1"]
    assert arm.q == pytest.approx(before, abs=1e-3) and all(arm.locked)
    assert arm.warnings == 1 and "brakes" in arm.last_warning
    released = Command("SUJ_PSM1", "release_brakes")
    arm = after(loop, 3.0, released, Command("SUJ_PSM1", "move_jp", {"q": goal}))["SUJ_PSM1"]
    assert arm.q == pytest.approx(goal, abs=5e-3) and not any(arm.locked)
    arm = after(loop, 0.5, Command("SUJ_PSM1", "lock_brakes"))["SUJ_PSM1"]
    assert all(arm.locked)


def test_a_reset_starts_over_exactly(loop: Loop) -> None:
    first = after(loop, 1.0, Command("PSM1", "move_to", {"name": "home"}))["PSM1"].q
    second = after(
        loop, 1.0, Command("world", "reset"), Command("PSM1", "move_to", {"name": "home"})
    )["PSM1"].q
    assert loop.latest.time == pytest.approx(1.0)
    assert np.array_equal(first, second)


def test_somebody_elses_thread_can_wait_for_a_move() -> None:
    world = World("psm")
    loop = Loop(world, speed="max")
    motion = world.arm("PSM1").move_jp([0.2, 0.1, 0.12, 0.0, 0.0, 0.0])
    loop.start()
    try:
        assert motion.wait(timeout_s=20.0)
        assert motion.done
    finally:
        loop.stop()
    assert world.waiter is None


def test_readers_and_the_wall_clock_leave_the_motion_bit_identical() -> None:
    def run(speed, readers: int):
        loop = Loop(World("psm"), speed=speed)
        for command in (
            Command("PSM1", "move_jp", {"q": (0.4, 0.2, 0.15, 1.0, 0.3, 0.2)}),
            Command("PSM1", "jaw.move_jp", {"q": [0.9]}),
        ):
            loop.post(command)
        over = threading.Event()

        def read() -> None:
            while not over.wait(0.001):
                assert loop.state.snapshot.time >= 0

        threads = [threading.Thread(target=read) for _ in range(readers)]
        for thread in threads:
            thread.start()
        loop.start(duration_s=1.0)
        assert loop.wait(60.0)
        over.set()
        for thread in threads:
            thread.join()
        return loop.latest

    alone, watched = run("max", 0), run("realtime", 3)
    assert np.array_equal(alone.positions, watched.positions)
    assert np.array_equal(alone.quaternions, watched.quaternions)
    assert np.array_equal(alone.arms["PSM1"].effort, watched.arms["PSM1"].effort)


def test_ticks_that_are_due_together_make_the_motion_of_single_ones():
    reached = []
    for dues in ([1] * 300, [7, 5, 3] * 20):
        world = World("psm")
        loop = Loop(world, tick_s=0.001)
        loop.post(Command("PSM1", "move_jp", {"q": (0.2, -0.1, 0.1, 0.0, 0.0, 0.0)}))
        for due in (1, *dues):
            loop.tick(due)
        reached.append(world.arm("PSM1").measured_js().position)
    assert np.array_equal(*reached)
    assert reached[0][0] > 0.05


def test_every_arms_health_is_looked_at_in_turn():
    world = World("two_psm_ecm")
    loop = Loop(world, speed="max")
    loop.start()
    looked: set[str] = set()
    for name, arm in world.arms.items():
        arm.joints.health = lambda name=name, look=arm.joints.health: (looked.add(name), look())[1]  # pyright: ignore
    end = time.monotonic() + 20.0
    while looked != set(world.arms) and time.monotonic() < end:
        _ = loop.state
        time.sleep(0.01)
    health = loop.state.health
    loop.close()
    assert looked == set(world.arms)
    assert health.loop_gap_m == max(h.loop_gap_m for h in health.per_arm.values())


def test_speed_changes_while_it_runs_and_motion_does_not() -> None:
    ends: list[list[float]] = []
    for changes in ((), (0.5, "max", 3.0)):
        world = World("psm")
        loop = Loop(world, speed="max")
        loop.post(Command("PSM1", "move_jp", {"q": (0.4, -0.2, 0.15, 0.5, 0.2, 0.1)}))
        loop.run(0.1)
        for speed in changes:
            loop.post(Command("world", "set_speed", {"speed": speed}))
            loop.run(0.1)
            assert loop.speed == (None if speed == "max" else speed)
        loop.run(0.4 - world.time)
        ends.append(world.arm("PSM1").measured_js().position.tolist())
    assert ends[0] == ends[1]


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), "fast"])
def test_a_speed_that_is_none_is_rejected_and_nothing_changes(speed: float | str) -> None:
    loop = Loop(World("psm"), speed="max")
    loop.post(Command("world", "set_speed", {"speed": speed}))
    loop.run(0.01)
    assert loop.speed is None and loop.state.refused == 1


def test_a_program_may_end_while_a_loop_steps() -> None:
    """Python ends threads that run; one that is within MuJoCo then takes the process down."""
    program = (
        "import time\n"
        "from trocar import World\n"
        "from trocar.live import Loop\n"
        "loop = Loop(World('full_cart'), speed='max')\n"
        "loop.start()\n"
        "time.sleep(0.2)\n"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
