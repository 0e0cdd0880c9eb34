"""Draw the pictures of the lessons, beside their pages or into another folder.

    python docs/tutorial/draw.py [FOLDER]

Needs matplotlib: pip install 'trocar[plot]'. The lessons themselves do without.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_arm
from trocar.geometry import matrix_from_quaternion
from trocar.simulation import World

try:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
except ImportError:
    sys.exit("the pictures need matplotlib, which is not installed: pip install 'trocar[plot]'")

Array = NDArray[np.float64]
Points = Mapping[str, Array]

HERE = Path(__file__).parent
#: Colours that people with any colour vision tell apart. Source: Okabe and Ito, Color Universal
#: Design, 2008.
BLUE, RED, GREEN, ORANGE, GREY = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#707070"
#: What is drawn as one line: bars of the linkage, in the side view.
BARS = (
    ("pitch_back", "pitch_bottom", "pitch_top", "pitch_back"),
    ("pitch_front", "c1"),
    ("pitch_bottom", "c1", "pitch_end"),
    ("pitch_top", "c2"),
    ("pitch_end", "c2 of the end link", "insertion", "pitch_end"),
)


def lesson(name: str) -> ModuleType:
    """Load a lesson; its file's name begins with a digit, so it cannot be imported by name."""
    spec = importlib.util.spec_from_file_location(f"lesson_{name[:2]}", HERE / f"{name}.py")
    if spec is None or spec.loader is None:
        raise FileNotFoundError(name)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def move_an_arm(axes: Any) -> None:
    """Draw the set-point of the yaw, the arm behind it, and the set-point's speed."""
    module = lesson("01_move_an_arm")
    curves = module.move(module.switch_on())
    left, middle, right = axes
    left.plot(curves["time"], curves["setpoint"], color=GREY, lw=4, alpha=0.5, label="set-point")
    left.plot(curves["time"], curves["measured"], color=BLUE, label="measured")
    left.set(xlabel="time [s]", ylabel="yaw [rad]", title="where the yaw is")
    left.legend(loc="lower right")
    middle.plot(curves["time"], curves["velocity"], color=RED)
    middle.set(xlabel="time [s]", ylabel="speed of the set-point [rad/s]",
               title="commanded speed")  # fmt: skip
    lag = 1e3 * (curves["measured"] - curves["setpoint"])
    right.plot(curves["time"], lag, color=BLUE)
    right.set(xlabel="time [s]", ylabel="measured - set-point [mrad]", title="how far it is away")


def remote_centre(axes: Any) -> None:
    """Draw the linkage at three angles of the pitch, and the miss of the simulated shaft."""
    module = lesson("02_remote_centre")
    left, right = axes
    for pitch, colour in zip(module.PITCHES, (BLUE, GREEN, RED), strict=True):
        points = dict(module.hinges(pitch))
        points["c2 of the end link"] = points["c2"]
        draw_linkage(left, points, colour, f"pitch {pitch:+.1f} rad")
    draw_side_view(left, "every shaft passes the same point")
    time, miss = module.under_load()
    right.plot(time, 1e6 * miss, color=BLUE)
    micrometres = "shaft beside the remote centre [\N{MICRO SIGN}m]"
    right.set(xlabel="time [s]", ylabel=micrometres, ylim=(0, None))
    right.set_title("simulated, with 10 N at the tip")


def open_a_loop(axes: Any) -> None:
    """Draw the linkage with and without its pin, and the miss of the shaft over time."""
    module = lesson("03_open_a_loop")
    left, right = axes
    for (name, world), colour in zip(module.worlds().items(), (BLUE, RED), strict=True):
        rows = module.watch(world)
        right.semilogy(rows[:, 0], 1e3 * rows[:, 1], color=colour, label=f"c2 {name}")
    for (name, world), colour in zip(module.worlds().items(), (BLUE, RED), strict=True):
        world.step(200)
        draw_linkage(left, standing(world), colour, f"c2 {name}")
    draw_side_view(left, "after 0.2 s")
    right.axhline(1.0, color=GREY, ls=":", label="1 mm")
    right.set(xlabel="time [s]", ylabel="shaft beside the remote centre [mm]",
              title="nobody told the arm to move")  # fmt: skip
    right.legend(loc="center right")


def tune_a_joint(axes: Any) -> None:
    """Draw the step responses and what they ask of the motor."""
    module = lesson("04_tune_a_joint")
    left, right = axes
    traces = {name: trace for name, (_, trace) in module.traces().items()}
    size = 1e3 * (traces["tuned"].target - traces["tuned"].position[0])
    for (name, trace), colour in zip(traces.items(), (BLUE, ORANGE, GREEN), strict=True):
        way = 1e3 * (trace.position - trace.position[0])
        left.plot(1e3 * trace.time, way, color=colour, label=name)
        right.plot(1e3 * trace.time, trace.effort, color=colour, label=name)
    left.axhspan(0.98 * size, 1.02 * size, color=GREY, alpha=0.3, lw=0, label="2 % of the step")
    left.set(xlabel="time since the step [ms]", ylabel="insertion [mm]", xlim=(0, 400),
             title="how it answers")  # fmt: skip
    left.legend(loc="lower right")
    limit = load_arm("psm").joint("insertion").effort_max
    right.axhline(limit, color=GREY, ls=":", label="limit of the motor")
    right.set(xlabel="time since the step [ms]", ylabel="effort [N]", xlim=(0, 150),
              title="what it asks of the motor")  # fmt: skip
    right.legend(loc="upper right")


def read_the_errata(axes: Any) -> None:
    """Draw how far the loops are from flat, as printed and as mended."""
    module = lesson("05_read_the_errata")
    angles = np.linspace(-1.4, 1.4, 400)
    for axis, (name, arm) in zip(axes, module.arms().items(), strict=True):
        values = module.flatness(arm, angles)
        pitch = arm.mechanism.joints[1]
        for column, (closure, colour) in enumerate(
            zip(arm.mechanism.closures, (BLUE, RED), strict=True)
        ):
            sign = np.sign(values[len(angles) // 2, column])
            axis.plot(angles, sign * values[:, column], color=colour, label=f"loop {closure.name}")
        axis.axhline(0.0, color="black", lw=0.8)
        axis.axvspan(pitch.lower, pitch.upper, color=GREY, alpha=0.2, lw=0, label="range of pitch")
        axis.set(xlabel="pitch [rad]", ylabel="sine between the bars (0: flat)", ylim=(-0.6, 1.1),
                 title=f"Table 4 as {name}")  # fmt: skip
        axis.legend(loc="lower right")


def standing(world: World) -> Points:
    """Return where the hinges of a simulated PSM are, in the frame of its remote centre [m]."""
    snapshot, arm = world.snapshot(), world.arm("PSM1")
    body = {shape.frame: shape.body for shape in world.shapes() if shape.arm == arm.name}
    origin = world.remote_centres()[arm.name]
    points = {frame: snapshot.positions[index] - origin for frame, index in body.items()}

    def on(frame: str, point: Array) -> Array:
        return points[frame] + matrix_from_quaternion(snapshot.quaternions[body[frame]]) @ point

    tied = {closure.name: closure for closure in arm.description.mechanism.closures}
    points["c1"] = on("pitch_front", tied["c1"].point_a)
    points["c2"] = on("pitch_top", tied["c2"].point_a)
    points["c2 of the end link"] = on("pitch_end", tied["c2"].point_b)
    points["tip"] = points["wrist_yaw"]
    return points


def draw_linkage(axis: Axes, points: Points, colour: str, label: str) -> None:
    """Draw the bars, the hinges and the shaft with its line."""
    for bar in BARS:
        y, z = 1e3 * np.array([points[name][1:3] for name in bar]).T
        axis.plot(y, z, color=colour, lw=2, marker="o", ms=3, alpha=0.8)
    begin, end = points["insertion"][1:3], points["tip"][1:3]
    beyond = end + 0.08 * (end - begin) / np.linalg.norm(end - begin)
    axis.plot(*(1e3 * np.array([begin, end]).T), color=colour, lw=1.2, label=label)
    axis.plot(*(1e3 * np.array([end, beyond]).T), color=colour, lw=0.8, ls=":")


def draw_side_view(axis: Axes, title: str) -> None:
    """Mark the remote centre, and give both axes one scale."""
    axis.plot(0, 0, marker="x", ms=9, mew=2, color="black", ls="", label="remote centre")
    axis.set(xlabel="y [mm]", ylabel="z [mm]", title=title, aspect="equal", xlim=(-720, 320),
             ylim=(-330, 350))  # fmt: skip
    axis.legend(loc="lower left", fontsize=8)


PICTURES: dict[str, Callable[[Any], None]] = {
    "01_move_an_arm": move_an_arm,
    "02_remote_centre": remote_centre,
    "03_open_a_loop": open_a_loop,
    "04_tune_a_joint": tune_a_joint,
    "05_read_the_errata": read_the_errata,
}


def main(folder: Path) -> None:
    """Draw every picture."""
    for name, draw in PICTURES.items():
        columns = 3 if draw is move_an_arm else 2
        figure = Figure(figsize=(9.0, 3.8), layout="constrained")
        axes = figure.subplots(1, columns)
        draw(axes)
        for axis in axes:
            axis.grid(alpha=0.3)
        # Without matplotlib's version in it, the same picture is the same file.
        figure.savefig(folder / f"{name}.png", dpi=100, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
