"""Build the PSM from Table 4 as it is printed, and find out what is wrong with it.

One sees: the errata, which are data; where the printed and the mended arm have their remote centre;
and a loop that goes flat inside the range of the pitch, which no real arm could pass.
"""

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.paper import errata, load_printed
from trocar.kinematics import branch_determinants, coordinates, flattenings, poses, remote_centre

Array = NDArray[np.float64]


def arms() -> dict[str, ArmDescription]:
    """Return the PSM as printed and as mended, without a tool."""
    return {"printed": load_printed("table4"), "mended": load_arm("psm", tool="none")}


def pitched(arm: ArmDescription, angles: Array) -> Array:
    """Return joint vectors (k, n) of an arm whose pitch takes the given angles."""
    q = np.zeros((len(angles), len(arm.joints)))
    q[:, arm.mechanism.joint_names.index("pitch")] = angles
    return q


def flatness(arm: ArmDescription, angles: Array) -> Array:
    """Return the branch determinant of each loop over the pitch, (k, loops): 0 where it is flat."""
    return branch_determinants(arm.mechanism, coordinates(arm.mechanism, pitched(arm, angles)))


def main() -> None:
    """Run the lesson."""
    print("Table 4, what is printed wrong and is more than rounding:")
    for wrong in errata("table4"):
        if "rounding" not in wrong.effect:
            said, right = (
                v if isinstance(v, str) else f"{v:.6g}" for v in (wrong.printed, wrong.mended)
            )
            print(f"  {wrong.frame}, {wrong.key}: {said} -> {right}")
    for name, arm in arms().items():
        print(name)
        pitch = arm.mechanism.joints[1]
        shaft = poses(arm.mechanism, pitched(arm, np.linspace(pitch.lower, pitch.upper, 50)),
                      relative_to="base")["insertion"]  # fmt: skip
        centre = remote_centre(shaft[:, :3, 3], shaft[:, :3, 2])
        x, y, z = np.round(centre.point, 4) + 0.0
        print(f"  remote centre at ({x:g}, {y:g}, {z:g}) m of the base")
        for flat in flattenings(arm.mechanism):
            where = "inside" if flat.margin < 0.0 else "outside"
            print(f"  loop {flat.closure} is flat at {flat.below:.3f} and {flat.above:.3f} rad,"
                  f" {abs(flat.margin):.3f} rad {where} the range")  # fmt: skip


if __name__ == "__main__":
    main()
