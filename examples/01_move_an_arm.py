"""Move a PSM and its jaw, and read where they are.

One sees: a move that arrives, the pose of the tip, the jaw opening and closing with grip, and two
commands that cannot be carried out as they are: one is clipped, the other refused.
"""

import logging

import numpy as np

from trocar.simulation import World


def main() -> None:
    """Run the example."""
    logging.basicConfig(format="  warning: %(message)s")
    world = World("psm")
    arm = world.arm("PSM1")
    if arm.jaw is None:
        raise SystemExit("this arm has no jaw")

    move = arm.move_jp([0.3, -0.2, 0.15, 0.0, 0.4, 0.0])  # rad, the insertion in m
    arrived = move.wait(timeout_s=5.0)
    world.step(200)  # a move ends when its set-point arrives; give the arm 0.2 s to follow
    print(f"arrived: {arrived}, at {world.time:.3f} s of simulated time")

    measured, wanted = arm.measured_js(), arm.setpoint_js()
    for name, q, goal, effort in zip(
        measured.name, measured.position, wanted.position, measured.effort, strict=True
    ):
        print(
            f"  {name:12} {q:9.5f}  off by {1e3 * (q - goal):7.4f} mrad or mm, effort {effort:.4f}"
        )

    tip = arm.measured_cp()
    x, y, z = 1e3 * tip.matrix[:3, 3]
    print(f"tip at ({x:.2f}, {y:.2f}, {z:.2f}) mm in {tip.frame_id}")

    arm.jaw.open().wait(timeout_s=5.0)
    print(f"jaw open:   {np.rad2deg(arm.jaw.measured_js().position[0]):6.2f} deg")
    arm.jaw.close().wait(timeout_s=5.0)
    world.step(200)
    grip = arm.jaw.measured_js()
    print(
        f"jaw closed: {np.rad2deg(grip.position[0]):6.2f} deg, grips with {-grip.effort[0]:.2f} N m"
    )

    print("yaw to 2 rad, which is beyond its limit:")
    arm.move_jp([2.0, 0.0, 0.12, 0.0, 0.0, 0.0]).wait(timeout_s=5.0)
    print(f"  set-point of the yaw: {arm.setpoint_js().position[0]:.3f} rad")
    print("yaw to NaN:")
    accepted = arm.servo_jp([float("nan"), 0.0, 0.12, 0.0, 0.0, 0.0])
    print(f"  accepted: {accepted}")


if __name__ == "__main__":
    main()
