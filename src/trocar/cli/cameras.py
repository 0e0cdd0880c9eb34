"""The options of cameras, and what draws for them."""

from __future__ import annotations

from argparse import ArgumentTypeError, Namespace
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Literal

from trocar.cli.arguments import number
from trocar.errors import InputError

if TYPE_CHECKING:
    from argparse import _ArgumentGroup
    from collections.abc import Sequence

    from trocar.interfaces import Loop
    from trocar.interfaces.pictures import Pictures
    from trocar.interfaces.shots import Renderer
    from trocar.rendering import Look, Series
    from trocar.simulation import World
    from trocar.simulation.records import ShapeRecord


def add_look(group: _ArgumentGroup) -> None:
    """Add what the pictures are to look like."""
    group.add_argument(
        "--preset",
        metavar="CAMERA",
        help="other eyes for the endoscope: a built-in camera, a TOML file, or its calibration of"
        " ROS or OpenCV",
    )
    group.add_argument(
        "--distortion", action="store_true", help="what the lens distorts; needs a calibration"
    )
    group.add_argument(
        "--exposure",
        type=_exposure,
        default="auto",
        metavar="STOPS",
        help="brighter by so much; default: auto, as a scope's video processor chooses it",
    )
    group.add_argument(
        "--vignette", type=number, default=0.0, metavar="0..1", help="darker corners; default: 0"
    )
    group.add_argument(
        "--noise", type=number, default=0.0, metavar="SHARE", help="of the sensor; default: 0"
    )
    group.add_argument("--no-shadows", action="store_true", help="faster")


def add_cameras(group: _ArgumentGroup) -> None:
    """Add the options of a simulator that serves pictures."""
    group.add_argument("--no-cameras", action="store_true", help="draw nothing")
    group.add_argument("--camera-rate", type=number, metavar="HZ", help="of images; default: 60")
    group.add_argument(
        "--image-format", choices=("jpeg", "png"), default="jpeg", help="of compressed images"
    )
    group.add_argument(
        "--record-images",
        action="store_true",
        help="recordings carry compressed images, at the camera rate",
    )
    add_look(group)


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
    """Return what the options ask pictures to look like, with so many samples per pixel.

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


def record_images(world: World, pictures: Pictures | None, args: Namespace) -> None:
    """Let the recording of a live run carry images, where the options ask for them.

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
        from trocar.interfaces.crtk.recorded import RecordedImages

        pictures.add(RecordedImages(world))


def images_of_headless(world: World, args: Namespace) -> AbstractContextManager[None]:
    """Return what lets the recording of a headless run carry images, where they are asked for.

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
    from trocar.interfaces.crtk.recorded import images_recorded
    from trocar.interfaces.pictures import RATE_HZ
    from trocar.rendering import Renderer, Series

    look, rate = look_of(args), RATE_HZ if args.camera_rate is None else args.camera_rate

    def shapes() -> tuple[int, Sequence[ShapeRecord]]:
        return world.snapshot(arms=False).build, world.shapes()

    def draws() -> Series:
        return Series(Renderer(shapes, None, look))

    return images_recorded(world, draws, rate, args.image_format)


def open_pictures(loop: Loop, args: Namespace) -> Pictures | None:
    """Return what draws for a loop's cameras, None where there are none to draw for.

    Raises:
        UnknownNameError: no such preset; the known ones are listed
        InputError: an option that is not allowed
    """
    if args.no_cameras or not loop.world.rig.cameras:
        if args.preset is not None:
            raise InputError(f"--preset: no camera to use it: {loop.world.rig.name} has none drawn")
        return None
    from trocar.descriptions.cameras import load_camera
    from trocar.interfaces.pictures import RATE_HZ, Pictures

    eyes = {}
    if args.preset is not None:
        scopes = [c.name for c in loop.world.rig.cameras if c.kind == "endoscope"]
        if not scopes:
            raise InputError(f"--preset: {loop.world.rig.name} has no endoscope")
        eyes = {scopes[0]: load_camera(eyes_of(args.preset))}
    rate = RATE_HZ if args.camera_rate is None else args.camera_rate
    look = look_of(args)

    def renderer() -> Renderer:
        from trocar.rendering import Renderer, Series

        def shapes() -> tuple[int, Sequence[ShapeRecord]]:
            return loop.ask(lambda w: (w.snapshot(arms=False).build, w.shapes())).result()

        return Series(Renderer(shapes, None, look))

    return Pictures(loop, renderer, rate, args.image_format, eyes)
