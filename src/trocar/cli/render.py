"""Render an image or a video from a camera of a rig.

The file extension selects the format: .png or .jpg for an image, .mp4 for a video (extra video).
Rendering needs neither a display nor a GPU. Videos advance in simulated time, independent of the
rendering speed.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trocar.cli.arguments import (
    add_calibrations,
    add_json,
    add_overwrite,
    add_rig,
    allow,
    names_of,
    options,
)
from trocar.cli.output import print_result, progress_bar, progress_steps
from trocar.cli.worlds import add_look, add_pose, eyes_of, look_of, take_pose
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.rendering import Endoscope
    from trocar.simulation import World

SUMMARY = "render an image or a video from a camera of a rig"
ORDER = 20

DURATION_S, RATE_HZ = 10.0, 30.0
#: As in `trocar.rendering.frames`, which is not imported for a list of words.
EYES = ("both", "left", "right", "anaglyph")
SHOWN = ("colour", "depth", "ids", "normals")
MOTIONS = ("instruments", "sine", "still")


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        -o,--out FILE required  output file, .png, .jpg or .mp4
    """)  # fmt: skip
    add_overwrite(parser)
    add_rig(parser)
    add_calibrations(parser)
    add_pose(parser)
    options(parser, """
        --after S:number = 0  simulated time before the first frame
    """)  # fmt: skip
    add_json(parser)
    video = parser.add_argument_group("video")
    options(video, f"""
        --duration S:number                 duration in simulated time (default: {DURATION_S:g})
        --rate HZ:number                    frame rate (default: {RATE_HZ:g})
        --motion {'|'.join(MOTIONS)} = instruments  instruments: small motions of the instruments
                                            (default); sine: all arms along the paper's sine
                                            trajectory; still: none
    """)  # fmt: skip
    picture = parser.add_argument_group("camera")
    options(picture, f"""
        --camera NAME                      camera of the rig (default: the first one)
        --eye {'|'.join(EYES)} = both      image of a stereo camera (default: both, side by side)
        --show {'|'.join(SHOWN)} = colour  image content; ids: segmentation
        --angle DEG:number                 endoscope tip angle: 0, 30 or -30
        --samples N:int = 4                samples per pixel
    """)  # fmt: skip
    add_look(picture)


def run(args: Namespace) -> int:
    """Render and write."""
    from trocar.outputs import check_file
    from trocar.rendering.film import film, kind_of, take_picture

    path = Path(args.out).expanduser()
    kind = kind_of(path)
    if kind == "picture":
        allow(args, "with a video (.mp4)", "duration", "rate", "motion")
    check_file(path, args.overwrite)
    if args.show != "colour":
        allow(args, "with --show colour", *(set(names_of(add_look)) - {"preset", "distortion"}))
    if not 0.0 <= args.after < float("inf"):
        raise InputError(f"--after: got {args.after:g}; allowed: 0 s or more")
    with progress_steps() as announce:
        announce(f"rendering {args.rig}")
        world, scope = _opened(args)
    shown: dict[str, Any] = {"eye": args.eye, "show": args.show, "overwrite": args.overwrite}
    if kind == "picture":
        width, height = take_picture(scope.capture, path, **shown)
        count = 1
    else:
        with progress_bar("frames") as watch:
            width, height, count = film(
                world,
                scope.capture_next,
                path,
                duration_s=DURATION_S if args.duration is None else args.duration,
                rate_hz=RATE_HZ if args.rate is None else args.rate,
                motion=args.motion,
                progress=watch,
                **shown,
            )
    scope.close()
    many = "" if count == 1 else f", {count} frames"
    document = {"file": str(path), "width": width, "height": height, "pictures": count}
    print_result(args, document, lambda: f"{path}: {width} x {height}{many}")
    return 0


def _opened(args: Namespace) -> tuple[World, Endoscope]:
    """Return the world in its initial pose, and its endoscope."""
    from trocar.descriptions.cameras import load_camera
    from trocar.rendering import Endoscope
    from trocar.simulation import World

    world = World(args.rig, calibration=args.calibration)
    names = [camera.name for camera in world.rig.cameras]
    if not names:
        raise InputError(f"rig {world.rig.name} has no camera: add a [[camera]] to its file")
    take_pose(world, args.pose)
    scope = Endoscope(
        world,
        args.camera or names[0],
        calibration=None if args.preset is None else load_camera(eyes_of(args.preset)),
        angle_deg=args.angle,
        look=look_of(args, world.rig, samples=args.samples),
        **{name: name == args.show for name in ("depth", "ids", "normals")},
    )
    if periods := round(args.after / world.timestep):
        world.step(periods)
    return world, scope
