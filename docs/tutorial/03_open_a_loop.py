"""Take the pin out of one hinge of a PSM, and see what becomes of the remote centre.

One sees: two arms that differ in one line, `open = true`; a shaft that leaves the remote centre at
once; and that the encoders, on which everything else relies, hardly notice until a motor gives up.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_arm
from trocar.simulation import World

SECONDS, EVERY = 0.6, 10  # how long to watch, and how often: each so many periods of 1 ms
RIG = """
schema = 1
name = "workshop"
source = "lesson 3"
arm = [{ name = "PSM1", description = "opened.toml", place = "rcm", xyz_m = [0.0, 0.0, 0.3] }]
pose = [{ name = "start", q_rad_m = { PSM1 = [0.0, 0.3, 0.12, 0.0, 0.0, 0.0, 0.0] } }]
"""


def worlds() -> dict[str, World]:
    """Return a world with a sound PSM, and one whose upper long link has come off its pin."""
    text = Path(load_arm("psm").file).read_text(encoding="utf-8")
    found = {}
    for name, pin in (("closed", ""), ("open", "open = true")):
        with TemporaryDirectory() as folder:
            changed = text.replace('name = "c2"', f'name = "c2"\n{pin}')
            Path(folder, "opened.toml").write_text(changed, encoding="utf-8")
            Path(folder, "workshop.toml").write_text(RIG, encoding="utf-8")
            found[name] = World(Path(folder, "workshop.toml"))
    return found


def watch(world: World) -> NDArray[np.float64]:
    """Hold still; return (time [s], miss of the remote centre [m], encoders' largest error)."""
    arm, rows = world.arm("PSM1"), []
    for _ in range(round(SECONDS / world.timestep / EVERY)):
        world.step(EVERY)
        error = np.abs(arm.measured_js().position - arm.setpoint_js().position).max()
        rows.append((world.time, world.health().rcm_error_m, error))
    return np.array(rows)


def main() -> None:
    """Run the lesson."""
    for name, world in worlds().items():
        print(f"hinge c2 {name}; the arm holds its pose")
        for time, miss, error in watch(world)[9::10]:
            print(f"  {time:.1f} s: shaft beside the remote centre {1e3 * miss:10.6f} mm,", end=" ")
            print(f"encoders off by {1e3 * error:7.3f} mrad or mm")
        print(f"  the arm reports {world.arm('PSM1').operating_state().state}")


if __name__ == "__main__":
    main()
