"""Build a PSM that differs from the standard one in a single number, and simulate it.

One sees: the built-in file copied with one number changed, a rig of one's own beside it, how far
the changed arm's shaft misses the remote centre, and what a mistake in a file says.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

from trocar.descriptions import load_arm
from trocar.errors import DescriptionError
from trocar.kinematics import pose
from trocar.simulation import World

BEFORE, AFTER = "a_mm = 43.0", "a_mm = 43.5"  # from the last hinge to the instrument's shaft
RIG = """
schema = 1
name = "workshop"
source = "an example"

[[arm]]
name = "PSM1"
description = "bent_psm.toml"   # beside this file
place = "rcm"
xyz_m = [0.0, 0.0, 0.3]

[[pose]]
name = "start"
q_rad_m = { PSM1 = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0, 0.0] }
"""


def main() -> None:
    """Run the example."""
    standard = load_arm("psm")
    text = Path(standard.file).read_text(encoding="utf-8")
    with TemporaryDirectory() as folder:
        arm_file, rig_file = Path(folder, "bent_psm.toml"), Path(folder, "workshop.toml")
        arm_file.write_text(text.replace(BEFORE, AFTER), encoding="utf-8")
        rig_file.write_text(RIG, encoding="utf-8")

        bent, q = load_arm(arm_file), [0.3, 0.5, 0.15, 0.0, 0.0, 0.0, 0.0]
        apart = pose(bent.mechanism, q)[:3, 3] - pose(standard.mechanism, q)[:3, 3]
        print("the tip lies elsewhere by " + ", ".join(f"{1e3 * d:.3f}" for d in apart) + " mm")

        for rig in ("psm", rig_file):
            world = World(rig)
            world.arm("PSM1").move_jp(q[:6]).wait(timeout_s=5.0)
            miss = world.health().rcm_error_m
            print(f"{world.rig.name}: the shaft passes the remote centre at {1e6 * miss:.2f} um")

        arm_file.write_text(text.replace("mass_kg = 0.355", "mass_kg = -0.355"), encoding="utf-8")
        try:
            load_arm(arm_file)
        except DescriptionError as problem:
            print(f"a mistake: {str(problem).removeprefix(folder)}")


if __name__ == "__main__":
    main()
