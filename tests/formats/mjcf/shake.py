"""Random control in range, in plain MuJoCo: what any version of it makes of an exported file.

    python tests/formats/mjcf/shake.py FOLDER/scene.xml ... --seconds 60
    python tests/formats/mjcf/shake.py FOLDER/psm.xml --twice

needs MuJoCo and numpy, not trocar; so it runs in an environment with an older MuJoCo too.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

import mujoco
import numpy as np

#: For half of the time controls change with each step, as Menagerie's own test has them; then they
#: stay for so many steps.
HELD = 500
#: What the README of an export asks a scene to copy.
COPIED = ("timestep", "integrator", "solver", "jacobian", "cone", "impratio")
#: Hinges of the scene that robots are attached to.
PENDULUMS = 61


def shake(model: mujoco.MjModel, seconds: float, rng: np.random.Generator) -> float:
    """Return the largest loop error [m].

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


def busy_scene(child: mujoco.MjSpec | None) -> mujoco.MjSpec:
    """Return a scene of pendulums with a child's option block, or with MuJoCo's own for None."""
    scene = mujoco.MjSpec()
    for k in range(PENDULUMS):
        body = scene.worldbody.add_body(name=f"pendulum_{k}", pos=[2.0 + 0.1 * k, 0.0, 1.0])
        body.add_joint(name=f"pendulum_{k}", damping=[0.01, 0.0, 0.0])
        body.add_geom(size=[0.02] * 3, pos=[0.0, 0.0, -0.1])
    if child is not None:
        for name in COPIED:
            setattr(scene.option, name, getattr(child.option, name))
    return scene


def twice(child: Callable[[], mujoco.MjSpec], scene: mujoco.MjSpec) -> mujoco.MjModel:
    """Attach a robot on two sides of a scene."""
    for side, y in (("left_", 0.6), ("right_", -0.6)):
        frame = scene.worldbody.add_frame(pos=[0.0, y, 0.0])
        scene.attach(child(), prefix=side, frame=frame)
    return scene.compile()


def main() -> None:
    """Shake files and tell how their loops held."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--twice", action="store_true", help="two of them in a large scene")
    options = parser.parse_args()
    for file in options.files:
        model = mujoco.MjModel.from_xml_path(file)
        if options.twice:
            scene = busy_scene(mujoco.MjSpec.from_file(file))
            model = twice(lambda file=file: mujoco.MjSpec.from_file(file), scene)
        rest, gap = at_rest(model), shake(model, options.seconds, np.random.default_rng(0))
        sys.stdout.write(
            f"{mujoco.__version__} {file}: no warning, home {rest:.1e}, gap {1e6 * gap:.2f} um\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
