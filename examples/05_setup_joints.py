"""Move a setup joint of the cart: the arm that hangs on it follows with its remote centre.

One sees: brakes that refuse a move while they are locked, the remote centre before and after, that
the PSM's own joints stand still meanwhile, and that its tip moves in the picture of the endoscope.
"""

import logging

import numpy as np

from trocar.simulation import World


def main() -> None:
    """Run the example."""
    logging.basicConfig(format="  warning: %(message)s")
    world = World("suj_two_psm_ecm")
    setup, psm = world.arm("SUJ_PSM1"), world.arm("PSM1")
    goal = setup.setpoint_js().position
    goal[0] += 0.05  # the slide along the column: 5 cm up

    def look() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return (
            world.remote_centres()["PSM1"],
            psm.measured_js().position,
            psm.measured_cp().matrix[:3, 3],
        )

    before = look()
    print("with its brakes locked:")
    print(f"  arrived: {setup.move_jp(goal).wait(timeout_s=5.0)}")

    print("with the slide's brake released:")
    setup.brakes.release(["suj_1"])
    print(
        "  brakes: "
        + ", ".join(f"{joint} {'locked' if on else 'free'}" for joint, on in setup.brakes.items())
    )
    print(f"  arrived: {setup.move_jp(goal).wait(timeout_s=10.0)} at {world.time:.2f} s")
    world.step(3000)  # its friction makes it creep the last tenths of a millimetre
    setup.brakes.lock()
    after = look()

    x, y, z = np.round(1e3 * (after[0] - before[0]), 2) + 0.0
    print(f"remote centre of PSM1 moved by ({x:.2f}, {y:.2f}, {z:.2f}) mm in the world")
    print(f"its joints moved by at most {1e3 * np.abs(after[1] - before[1]).max():.3f} mrad or mm")
    apart, frame = np.linalg.norm(after[2] - before[2]), psm.measured_cp().frame_id
    print(f"its tip moved by {1e3 * apart:.1f} mm in the frame of the {frame}")

    exact = setup.joints.potentiometers()
    noisy = setup.joints.potentiometers(noise=0.002, rng=world.rng)
    print(f"potentiometer of the slide: {exact[0]:.4f} m, with noise {noisy[0]:.4f} m")
    error = world.health().per_arm["PSM1"].rcm_error_m
    print(f"the shaft passes the remote centre at {1e6 * error:.3f} um")


if __name__ == "__main__":
    main()
