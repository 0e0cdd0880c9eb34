"""Move a PSM as on the dVRK: set-points run ahead within limits, the arm follows.

One sees: an arm that is off, is enabled and homed; a move whose set-point arrives first; how far
the arm is behind it; and a move that is refused because the arm is off again.
"""

import logging

import numpy as np
from numpy.typing import NDArray

from trocar.simulation import World

GOAL = [0.5, -0.3, 0.18, 0.0, 0.4, 0.0]  # yaw, pitch, insertion [m], roll, wrist pitch, wrist yaw
Curves = dict[str, NDArray[np.float64]]


def switch_on() -> World:
    """Return a world whose PSM has been enabled and homed."""
    world = World("psm", homed=False)
    arm = world.arm("PSM1")
    print(f"at power-on: {arm.operating_state().state}, homed {arm.operating_state().is_homed}")
    arm.enable()
    arm.home().wait(timeout_s=10.0)
    state = arm.operating_state()
    print(f"after {world.time:.2f} s: {state.state}, homed {state.is_homed}")
    return world


def move(world: World) -> Curves:
    """Move to the goal and on for half a second; return what happened every 5 ms."""
    arm, begin, rows = world.arm("PSM1"), world.time, []
    motion, arrived = arm.move_jp(GOAL), np.nan
    while not world.time > arrived + 0.5:
        told, measured = arm.setpoint_js(), arm.measured_js()
        rows.append([world.time - begin, told.position[0], told.velocity[0], measured.position[0]])
        if motion.done and np.isnan(arrived):
            arrived = world.time
            print(f"set-points arrive after {arrived - begin:.3f} s: {motion.goal_reached}")
            off = 1e3 * (measured.position[0] - told.position[0])
            print(f"  the yaw is {off:.3f} mrad away from its set-point just then")
        world.step(5)
    columns = np.array(rows).T
    return dict(zip(("time", "setpoint", "velocity", "measured"), columns, strict=True))


def main() -> None:
    """Run the lesson."""
    logging.disable(logging.WARNING)  # what is refused is printed below
    world = switch_on()
    arm, curves = world.arm("PSM1"), move(world)
    print(f"  half a second later {1e3 * (curves['measured'][-1] - GOAL[0]):.3f} mrad")
    x, y, z = 1e3 * arm.measured_cp().matrix[:3, 3]
    print(f"the tip: ({x:.2f}, {y:.2f}, {z:.2f}) mm")
    arm.disable()
    print(f"switched off: goal reached {arm.move_jp(GOAL).goal_reached}, {arm.rejections.last}")


if __name__ == "__main__":
    main()
