"""Play a trajectory on two PSMs and an ECM at once, as fast as it goes.

One sees: how well each joint follows with and without commanded velocities, how the loops and the
remote centres hold on the way with 10 N at every tip, and that the same run gives the same motion.
"""

import numpy as np

from trocar.kinematics import gaps
from trocar.simulation import World

ROW_S = 0.005  # a row every 5 ms, which is five physics periods
TIME = ROW_S * np.arange(800)[:, None]
OUT_AND_BACK = 0.5 * (1.0 - np.cos(np.pi * TIME))  # starts and ends at rest, 2 s long
SLOPE = 0.5 * np.pi * np.sin(np.pi * TIME)
SWING = {
    "PSM1": [0.2, 0.2, 0.04, 0.5, 0.3, 0.3, 0.5],  # rad, m; the jaw last
    "PSM2": [-0.2, 0.2, 0.04, 0.5, 0.3, 0.3, 0.5],
    "ECM": [0.1, 0.1, 0.03, 0.2],
}


def main() -> None:
    """Run the example."""
    world = World("two_psm_ecm")
    start = {name: world.arm(name).joints.poses["start"] for name in SWING}
    positions = {name: start[name] + OUT_AND_BACK * swing for name, swing in SWING.items()}
    velocities = {name: SLOPE * swing for name, swing in SWING.items()}

    without = world.play(positions, every=5)
    world.reset()
    played = world.play(positions, velocities, every=5)
    print("RMS of measured - commanded [mrad, mm], and without commanded velocities")
    for name, joints in ((name, world.arm(name).joints.names) for name in SWING):
        good, poor = (
            1e3 * np.sqrt(np.mean((run.positions[name] - positions[name]) ** 2, axis=0))
            for run in (played, without)
        )
        for joint, one, other in zip(joints, good, poor, strict=True):
            print(f"  {name:5} {joint:12} {one:6.2f} {other:6.2f}")

    loaded = World("two_psm_ecm", tip_load_n=10.0)
    run = loaded.play(positions, velocities, every=5)
    for name, coordinates in run.coordinates.items():
        gap = gaps(loaded.arm(name).description.mechanism, coordinates).max()
        print(f"{name} with 10 N at its tip: the loops gape by {1e6 * gap:.3f} um at most")
    health = loaded.health()
    print(f"remote centres at the end: {1e6 * health.rcm_error_m:.3f} um off at most")
    print(f"branches right: {health.branch_ok}")

    world.reset()
    again = world.play(positions, velocities, every=5)
    same = all(np.array_equal(q, played.positions[name]) for name, q in again.positions.items())
    print(f"the same motion a second time, to the last bit: {same}")


if __name__ == "__main__":
    main()
