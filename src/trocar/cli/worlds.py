"""The world that a command simulates, its recording and its cameras, with their options."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import TYPE_CHECKING, Literal

from trocar.cli.arguments import add_calibrations, add_gains, add_rig, number
from trocar.errors import InputError

if TYPE_CHECKING:
    from argparse import _ActionsContainer

    from trocar.interfaces import Loop
    from trocar.interfaces.pictures import Pictures, Renderer
    from trocar.rendering import Look, Series
    from trocar.simulation import World
    from trocar.simulation.records import ShapeRecord

    Shapes = tuple[int, Sequence[ShapeRecord]]


def add_world(parser: ArgumentParser, rig: str | None = "full_cart") -> None:
    """Add the rig, its tools and how it is simulated; None: the command chooses the rig."""
    add_rig(parser, rig)
    parser.add_argument(
        "--tool",
        action="append",
        default=[],
        type=_tool,
        metavar="ARM=TOOL",
        help="mount another tool (trocar list tools, or a TOML file); may be repeated",
    )
    add_calibrations(parser)
    add_gains(parser)
    parser.add_argument(
        "--setup-joints",
        choices=("braked", "locked"),
        default="braked",
        help="setup joints simulated with brakes, or welded (faster)",
    )
    parser.add_argument(
        "--timestep", type=number, default=0.001, metavar="S", help="physics step (default 0.001)"
    )


def _tool(text: str) -> tuple[str, str]:
    arm, _, tool = text.partition("=")
    if not (arm and tool):
        example = "PSM1=LARGE_NEEDLE_DRIVER:400006"
        raise ArgumentTypeError(f"got {text!r}; allowed: ARM=TOOL, as {example}")
    return arm, tool


def make_world(args: Namespace, tip_load_n: float = 0.0) -> World:
    """Build the world of `add_world`'s options.

    Raises:
        InputError: an option that cannot be used
    """
    from trocar.simulation import World

    world = World(
        args.rig,
        timestep_s=args.timestep,
        control=args.control,
        friction=args.friction,
        setup_joints=args.setup_joints,
        tip_load_n=tip_load_n,
        calibration=args.calibration,
    )
    for arm, tool in args.tool:
        world.exchange_tool(arm, tool)
    if args.tool:
        world.reset()
    return world


def add_record(parser: ArgumentParser) -> None:
    """Add the recording of the run."""
    parser.add_argument(
        "--record", metavar="FILE", help="write states, commands and events to a new MCAP file"
    )
    parser.add_argument("--overwrite", action="store_true", help="--record: replace the file")


def recording(world: World, args: Namespace) -> Callable[[], AbstractContextManager[object]]:
    """Return what opens the recording of `add_record`'s options, and closes it again."""
    if args.record is None:
        return nullcontext
    from trocar.recording import record

    return partial(record, world, args.record, overwrite=args.overwrite)


def add_look(group: _ActionsContainer) -> None:
    """Add the look of the cameras' images."""
    group.add_argument(
        "--preset",
        metavar="CAMERA",
        help="camera of the endoscope: built-in (trocar list cameras), a TOML file, or a"
        " calibration file of ROS or OpenCV (LEFT,RIGHT for both eyes)",
    )
    group.add_argument(
        "--distortion", action="store_true", help="lens distortion; needs a calibration"
    )
    group.add_argument(
        "--exposure",
        type=_exposure,
        default="auto",
        metavar="STOPS",
        help="exposure compensation in stops (default: auto)",
    )
    group.add_argument(
        "--vignette", type=number, default=0.0, metavar="0..1", help="darkening of corners"
    )
    group.add_argument(
        "--noise", type=number, default=0.0, metavar="RATIO", help="sensor noise (default: 0)"
    )
    group.add_argument("--no-shadows", action="store_true", help="draw no shadows (faster)")


def add_cameras(group: _ActionsContainer) -> None:
    """Add the cameras of a live simulation."""
    group.add_argument("--no-cameras", action="store_true", help="draw no images")
    group.add_argument("--camera-rate", type=number, metavar="HZ", help="image rate (default: 60)")
    group.add_argument(
        "--image-format",
        choices=("jpeg", "png"),
        default="jpeg",
        help="format of compressed images (default: jpeg)",
    )
    add_look(group)


def add_record_images(group: _ActionsContainer) -> None:
    """Add images to recordings."""
    group.add_argument(
        "--record-images", action="store_true", help="record compressed images at the camera rate"
    )


def _exposure(text: str) -> float | Literal["auto"]:
    if text == "auto":
        return "auto"
    try:
        return number(text)
    except ArgumentTypeError:
        allowed = 'allowed: a number of stops, or "auto"'
        raise ArgumentTypeError(f"got {text.strip()!r}; {allowed}") from None


def eyes_of(preset: str) -> str | list[str]:
    """Return a preset's name or file, or the files of both eyes."""
    return preset.split(",") if "," in preset else preset


def look_of(args: Namespace, samples: int = 0) -> Look:
    """Return the look of `add_look`'s options, with so many samples per pixel.

    Raises:
        InputError: a value that is not allowed
    """
    from trocar.rendering import Look

    return Look(
        shadows=not args.no_shadows,
        exposure=args.exposure,
        vignette=args.vignette,
        noise=args.noise,
        distortion=args.distortion,
        samples=samples,
    )


def open_pictures(loop: Loop, args: Namespace) -> Pictures | None:
    """Return the images of a loop's cameras, None without cameras.

    Raises:
        UnknownNameError: no such preset; the known ones are listed
        InputError: an option that is not allowed
    """
    rig = loop.world.rig
    scopes = [camera.name for camera in rig.cameras if camera.kind == "endoscope"]
    if args.preset is not None and (args.no_cameras or not scopes):
        raise InputError(f"--preset: {rig.name} has no endoscope whose images are drawn")
    if args.no_cameras or not rig.cameras:
        return None
    from trocar.descriptions.cameras import load_camera
    from trocar.interfaces.pictures import RATE_HZ, Pictures

    eyes = {} if args.preset is None else {scopes[0]: load_camera(eyes_of(args.preset))}
    rate = RATE_HZ if args.camera_rate is None else args.camera_rate
    look = look_of(args)

    def renderer() -> Renderer:
        return _series(look, lambda ask: loop.ask(ask).result())

    return Pictures(loop, renderer, rate, args.image_format, eyes)


def _series(look: Look, ask: Callable[[Callable[[World], Shapes]], Shapes]) -> Series:
    """Return a renderer of the shapes that a world answers with."""
    from trocar.rendering import Renderer, Series

    return Series(
        Renderer(lambda: ask(lambda w: (w.snapshot(arms=False).build, w.shapes())), None, look)
    )


def record_images(world: World, pictures: Pictures | None, args: Namespace) -> None:
    """Add images to the recording of a live run, with --record-images.

    Raises:
        InputError: nothing is recorded, or no camera draws
    """
    if not args.record_images:
        return
    if args.record is None and args.foxglove_record is None:
        raise InputError("--record-images: got no recording; add --record or --foxglove-record")
    if pictures is None:
        raise InputError(f"--record-images: {world.rig.name} has no camera that is drawn")
    if args.record is not None:
        from trocar.interfaces.crtk.images import RecordedImages

        pictures.add(RecordedImages(world))


def images_of_headless(world: World, args: Namespace) -> AbstractContextManager[None]:
    """Return what adds images to the recording of a headless run, with --record-images.

    Raises:
        InputError: nothing is recorded, or the rig has no camera
        TrocarError: nothing can be drawn
    """
    if not args.record_images:
        return nullcontext()
    if args.record is None:
        raise InputError("--record-images: got no recording; add --record FILE")
    if not world.rig.cameras:
        raise InputError(f"--record-images: {world.rig.name} has no camera")
    from trocar.interfaces.crtk.images import images_recorded
    from trocar.interfaces.pictures import RATE_HZ

    look, rate = look_of(args), RATE_HZ if args.camera_rate is None else args.camera_rate
    return images_recorded(
        world, lambda: _series(look, lambda ask: ask(world)), rate, args.image_format
    )
