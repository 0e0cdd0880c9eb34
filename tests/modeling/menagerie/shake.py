"""Random control in range, in plain MuJoCo: what any version of it makes of an exported file.

    python tests/modeling/menagerie/shake.py FOLDER/scene.xml ... --seconds 60

needs MuJoCo and numpy, not trocar; so it runs in an environment with an older MuJoCo too.
"""

from __future__ import annotations

import argparse
import sys

import mujoco
import numpy as np

#: For half of the time controls change with each step, as Menagerie's own test has them; then they
#: stay for so many steps.
HELD = 500


def shake(model: mujoco.MjModel, seconds: float, rng: np.random.Generator) -> float:
    """Return how far loops gaped [m].

    Raises:
        RuntimeError: MuJoCo warned, or a position is not finite
    """
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    lower, upper = model.actuator_ctrlrange.T
    steps = round(seconds / model.opt.timestep)
    loops = np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_CONNECT))
    ends = model.eq_obj1id[loops], model.eq_obj2id[loops]
    gap = 0.0
    for step in range(steps):
        if step < steps // 2 or step % HELD == 0:
            data.ctrl[:] = rng.uniform(lower, upper)
        mujoco.mj_step(model, data)
        if step % 10 == 0 and len(loops):
            apart = data.site_xpos[ends[0]] - data.site_xpos[ends[1]]
            gap = max(gap, float(np.linalg.norm(apart, axis=1).max()))
    if np.any(data.warning.number) or not np.isfinite(data.qpos).all():
        raise RuntimeError(f"MuJoCo warned: {np.asarray(data.warning.number)}")
    return gap


def at_rest(model: mujoco.MjModel) -> float:
    """Return the largest acceleration one step after "home" [rad/s^2 or m/s^2]."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data)
    return float(np.abs(data.qacc).max())


def main() -> None:
    """Shake files and tell how their loops held."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+")
    parser.add_argument("--seconds", type=float, default=60.0)
    asked = parser.parse_args()
    for file in asked.files:
        model = mujoco.MjModel.from_xml_path(file)
        rest, gap = at_rest(model), shake(model, asked.seconds, np.random.default_rng(0))
        sys.stdout.write(
            f"{mujoco.__version__} {file}: no warning, home {rest:.1e}, gap {1e6 * gap:.2f} um\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
