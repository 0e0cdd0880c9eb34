"""Place sensors on an arm in a rig's file, and read them while it presses a table and grips a peg.

One sees: a table that pushes back about as hard as the motor presses, how far a peg is from the
jaw's pad, a grip on both of its sides that adds up to no wrench, and which way is up for an IMU.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

from trocar.simulation import World

RIG = """
schema = 1
name = "touch"
source = "an example"
arm = [{ name = "PSM1", description = "psm", place = "rcm", xyz_m = [0, 0, 0.22] }]
pose = [
  { name = "start", q_rad_m = { PSM1 = [0, 0, 0.12, 0, 0, 0, 0.9] } },
  { name = "around", q_rad_m = { PSM1 = [0, 0, 0.2125, 0, 0, 0, 0.9] } },
  { name = "grip", q_rad_m = { PSM1 = [0, 0, 0.2125, 0, 0, 0, -0.2] } },  # below 0: force
  { name = "press", q_rad_m = { PSM1 = [0.1, 0, 0.24, 0, 0, 0, 0.9] } },
]
prop = [
  { name = "table", shape = [{ kind = "box", center_mm = [0, 0, -20], size_mm = [400, 400, 40] }] },
  { name = "peg", shape = [{ kind = "box", center_mm = [0, 0, 5], size_mm = [2, 2, 10] }] },
]
sensor = [
  { name = "motor", kind = "joint_effort", arm = "PSM1", joint = "insertion" },
  { name = "tip", kind = "tip_wrench", arm = "PSM1" },
  { name = "touch", kind = "contacts", arm = "PSM1" },
  { name = "between", kind = "proximity", arm = "PSM1", xyz_mm = [0, -8, 0], noise_mm = 0.01 },
  { name = "imu", kind = "imu", arm = "PSM1", frame = "tip", noise_m_s2 = 0.01 },
  { name = "speed", kind = "twist", arm = "PSM1", frame = "tip" },
]
"""


def main() -> None:
    """Run the example."""
    with TemporaryDirectory() as folder:
        Path(folder, "touch.toml").write_text(RIG, encoding="utf-8")
        world = World(Path(folder, "touch.toml"))
    for pose in ("press", "start", "around", "grip"):
        world.arm("PSM1").move_to(pose).wait(timeout_s=5.0)
        world.step(300)
        print(f"at the pose {pose!r}:")
        for name in world.sensors:
            print(f"  {world.sensor(name)}")


if __name__ == "__main__":
    main()
