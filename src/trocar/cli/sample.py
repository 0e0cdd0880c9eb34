"""Write small sample files for the commands that read files.

The files are a PSM log, a rosbag, motion-capture tracks, touches of a block, a URDF robot and a
dVRK configuration. None is recorded on a robot: log, bag, tracks and touches are simulated. The
files are identical on every machine. Requires the extra bags.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from trocar.cli.arguments import add_json, add_overwrite, options
from trocar.cli.output import print_result, progress_steps, table

SUMMARY = "write small sample files for the other commands"
ORDER = 210

#: Options of `trocar mocap`. Source: our own choice: link lengths perturbed by some millimetres,
#: noise of a common system.
SEED, SWEEP_S, RATE_HZ, NOISE_M, NOISE_RAD = 7, 12.0, 60.0, 1e-4, 1e-3


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        folder DIR  output folder, new or empty
    """)  # fmt: skip
    add_overwrite(parser, "existing files in DIR")
    add_json(parser)


def run(args: Namespace) -> int:
    """Write the files, and print the content of each."""
    import numpy as np

    from trocar.descriptions import load_arm
    from trocar.outputs import whole_folder
    from trocar.robot.mocap import (
        MarkerNoise,
        MocapSettings,
        perturbed,
        simulate_tracks,
        write_tracks,
    )
    from trocar.robot.mocap.touches import TouchSettings, write_touches
    from trocar.robot.samples import write_samples

    folder = Path(args.folder)
    with whole_folder(folder, args.overwrite) as built, progress_steps() as watch:
        watch("writing logs, robot and configuration")
        files = write_samples(built)
        watch("writing tracks.csv")
        arm = perturbed(load_arm("psm"), np.random.default_rng(SEED))
        noise = MarkerNoise(NOISE_M, NOISE_RAD)
        settings = MocapSettings(
            motion="kinematic", duration_s=SWEEP_S, rate_hz=RATE_HZ, noise=noise, seed=SEED
        )
        robot = f"perturbed with seed {SEED}"
        write_tracks(built / "tracks.csv", simulate_tracks(arm, settings, robot=robot), "tidy")
        files["tracks.csv"] = "simulated motion capture of a PSM with perturbed link lengths"
        watch("writing touches.toml")
        psm = ("psm", load_arm("psm"))
        write_touches(built / "touches.toml", {"PSM1": psm, "PSM2": psm}, TouchSettings(seed=SEED))
        files["touches.toml"] = "simulated joint readings of two PSMs that touch a block"
    document = {"folder": str(folder), "files": files}
    print_result(
        args,
        document,
        lambda: table(("file", "content"), ((str(folder / n), w) for n, w in files.items()), ""),
    )
    return 0
