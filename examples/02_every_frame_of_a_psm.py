"""Ask where every link of a PSM is, the closed linkage included; no physics is needed.

One sees: the pose of each frame and closing hinge, that both sides of the linkage meet at the
hinges over the whole range of the pitch, how far the loops stay from flattening, and that the
shaft always passes the remote centre.
"""

import numpy as np

from trocar.descriptions import load_arm
from trocar.kinematics import coordinates, flattenings, gaps, poses, remote_centre


def main() -> None:
    """Run the example."""
    psm = load_arm("psm")
    mechanism = psm.mechanism
    q = [0.0, 0.5, 0.12, 0.0, 0.3, 0.0, 0.4]  # yaw, pitch, insertion, roll, wrist, jaw

    print(f"frames of {psm.title} with {psm.tool}, in {mechanism.reference} [mm]")
    for name, T in poses(mechanism, q).items():
        x, y, z = np.round(1e3 * T[:3, 3], 2) + 0.0  # no "-0.00"
        print(f"  {name:18} {x:9.2f} {y:9.2f} {z:9.2f}")

    # Everything takes joint vectors with any leading axes: a thousand configurations at once.
    rng = np.random.default_rng(1)
    many = rng.uniform(mechanism.lower, mechanism.upper, (1000, len(mechanism.joints)))
    worst = gaps(mechanism, coordinates(mechanism, many)).max(axis=0)
    for closure, gap in zip(mechanism.closures, worst, strict=True):
        print(
            f"loop {closure.name}: {closure.frame_a} meets {closure.frame_b}"
            f" to {gap:.0e} m in {len(many)} random configurations"
        )
    for flat in flattenings(mechanism):
        print(
            f"loop {flat.closure} flattens at {flat.joint} {flat.below:.3f} and"
            f" {flat.above:.3f} rad, {flat.margin:.3f} rad outside its range"
        )

    shaft = poses(mechanism, many, relative_to="base")["insertion"]
    centre = remote_centre(shaft[:, :3, 3], shaft[:, :3, 2])
    x, y, z = np.round(1e3 * centre.point, 1) + 0.0
    print(f"all shafts pass ({x:.1f}, {y:.1f}, {z:.1f}) mm of the base")
    print(f"at most {centre.distances.max():.0e} m beside it")


if __name__ == "__main__":
    main()
