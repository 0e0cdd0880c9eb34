"""Draw a circle with the tip of a PSM.

One sees: all joint positions that reach one pose, the solutions that follow a circle without a
jump, how near the simulated tip stays to it, and what a pose out of reach says.
"""

import numpy as np

from trocar.descriptions import load_arm
from trocar.errors import UnreachableError
from trocar.geometry import translation
from trocar.kinematics import inverse_kinematics, pose
from trocar.simulation import World

RADIUS_M = 0.02
PERIOD_S = 4.0
ROW_S = 0.005  # a set-point every 5 ms


def main() -> None:
    """Run the example."""
    psm = load_arm("psm")
    middle = pose(psm.mechanism, [0.2, -0.3, 0.15, 0.0, 0.2, 0.1, 0.0])

    found = inverse_kinematics(psm.mechanism, psm.inverse_kinematics, middle)
    print(f"{len(found)} solution(s) inside the limits:")
    for q in found:
        print("  " + " ".join(f"{value:8.4f}" for value in q))

    angle = np.arange(0.0, 2.0 * np.pi, 2.0 * np.pi * ROW_S / PERIOD_S)
    points = RADIUS_M * np.stack([np.cos(angle) - 1.0, np.sin(angle), 0.0 * angle], axis=-1)
    targets = [translation(point) @ middle for point in points]
    path = [found[0]]
    for target in targets[1:]:
        nearest = inverse_kinematics(psm.mechanism, psm.inverse_kinematics, target, path[-1])[0]
        path.append(nearest)
    print(f"largest step of a joint along the circle: {np.abs(np.diff(path, axis=0)).max():.4f}")

    table = np.column_stack([path, np.zeros(len(path))])  # the jaw stays shut
    speed = np.gradient(table, ROW_S, axis=0)
    world = World("psm")
    world.set_state("PSM1", table[0], speed[0])
    played = world.play({"PSM1": table}, {"PSM1": speed}, every=5)
    tips = pose(psm.mechanism, played.positions["PSM1"])[:, :3, 3]
    off = np.linalg.norm(tips - np.array([T[:3, 3] for T in targets]), axis=-1)
    print(f"simulated tip: {1e3 * np.sqrt(np.mean(off**2)):.2f} mm RMS beside the circle")

    try:
        inverse_kinematics(psm.mechanism, psm.inverse_kinematics, translation([0, 0, -0.3]))
    except UnreachableError as problem:
        print(f"0.3 m below the remote centre: {problem}")


if __name__ == "__main__":
    main()
