"""World, policy, recording and cameras of a command, with their options."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from trocar.cli.arguments import (
    add_calibrations,
    add_gains,
    add_rig,
    allow,
    names_of,
    number,
    options,
)
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.cli.arguments import Arguments
    from trocar.descriptions.records import RigDescription
    from trocar.descriptions.scenes import Scene
    from trocar.live import Loop
    from trocar.live.images import ImageRenderer, Pictures
    from trocar.rendering import Look, Series
    from trocar.simulation import World
    from trocar.simulation.records import ShapeRecord
    from trocar.tasks.play import Script

    Shapes = tuple[int, Sequence[ShapeRecord]]


#: Initial pose with the tools in view, if the rig defines it.
WORK = "work"


def add_world(parser: ArgumentParser, rig: str | None = "full_cart", chosen: str = "") -> Arguments:
    """Add the rig, its tools and the physics options; return their group.

    Args:
        parser: parser of the command
        rig: default rig; None: the command chooses one
        chosen: help text for the default, if `rig` is None
    """
    group = parser.add_argument_group("rig and physics")
    add_rig(group, rig, chosen)
    options(group, """
        --tool ARM=TOOL:tool ...  mount TOOL on ARM: built-in (see trocar list tools) or TOML file
                                  (repeatable)
    """, tool=_tool)  # fmt: skip
    add_calibrations(group)
    add_gains(group)
    options(group, """
        --computed-torque ARM ...           add the model's inverse dynamics to ARM's servos
                                            (repeatable)
        --errors NAME                       errors of encoders, cables and registrations: perfect,
                                            lab or wide (default: the rig's)
        --seed N:int = 0                    random seed of errors and sensors, another robot each
        --setup-joints braked|locked = braked  simulate setup joints with brakes, or weld them,
                                            which is faster
        --belts rigid|stretch = rigid       whether belts of an Si stretch (a placeholder's
                                            stiffness)
        --strict                            reject targets beyond joint limits, which are clipped
                                            with a warning else
        --timestep S:number = 0.001         physics step
    """)  # fmt: skip
    return group


def _tool(text: str) -> tuple[str, str]:
    arm, _, tool = text.partition("=")
    if not (arm and tool):
        example = "PSM1=LARGE_NEEDLE_DRIVER:400006"
        raise ArgumentTypeError(f"got {text!r}; allowed: ARM=TOOL, e.g. {example}")
    return arm, tool


def make_world(args: Namespace, tip_load_n: float = 0.0) -> World:
    """Build the world from the options of `add_world`.

    Raises:
        InputError: an option is not usable
    """
    from trocar.simulation import World

    world = World(
        args.rig,
        timestep_s=args.timestep,
        control=args.control,
        friction=args.friction,
        setup_joints=args.setup_joints,
        belts=args.belts,
        tip_load_n=tip_load_n,
        calibration=args.calibration,
        errors=args.errors,
        seed=args.seed,
        strict_limits=args.strict,
    )
    for arm, tool in args.tool:
        world.exchange_tool(arm, tool)
    if args.tool:
        world.reset()
    for arm in args.computed_torque:
        world.arm(arm).joints.use_computed_torque(True)
    return world


def add_pose(group: Arguments) -> None:
    """Add the initial pose."""
    options(group, f"""
        --pose NAME  initial pose of the rig (default: {WORK}, tools in view, if the rig has it)
    """)  # fmt: skip


def take_pose(world: World, pose: str | None) -> None:
    """Put the arms at a pose of `add_pose`, as the world begins there.

    Raises:
        UnknownNameError: no such pose; the known ones are listed
    """
    pose = pose or (WORK if WORK in world.rig.poses else "start")
    if pose != "start":
        world.reset(pose=pose)


def add_record(parser: ArgumentParser) -> None:
    """Add the recording of the run."""
    group = parser.add_argument_group("recording")
    options(group, """
        --record FILE  record states, commands and events to a new MCAP file
        --overwrite    overwrite the file of --record if it exists
    """)  # fmt: skip


def recording(world: World, args: Namespace) -> Callable[[], AbstractContextManager[object]]:
    """Return a factory of the context manager that records according to `add_record`'s options."""
    if args.record is None:
        return nullcontext
    from trocar.recording import record

    return partial(record, world, args.record, overwrite=args.overwrite)


def add_look(group: Arguments) -> None:
    """Add the image options of cameras."""
    options(group, """
        --preset CAMERA                   endoscope camera: built-in (see trocar list cameras), TOML
                                          file, or ROS or OpenCV calibration (LEFT,RIGHT for both
                                          eyes)
        --distortion                      apply lens distortion; requires a calibrated camera
        --exposure STOPS:exposure = auto  exposure compensation in stops
        --vignette 0..1:number            darkening of the image corners (default: 0.6 in a cavity,
                                          else 0)
        --noise RATIO:number = 0          sensor noise
        --no-shadows                      render no shadows (faster)
        --look plain|surgical             surgical: tissue with structure and moisture, mirroring
                                          metal, soft shadows; slower (default: surgical where the
                                          rig has tissue, else plain)
        --smoke 0..1:number = 0           smoke, in the surgical look
        --blood 0..1:number = 0           ratio of tissue under blood, in the surgical look
        --bleeding ML_MIN:number = 0      blood that spreads from the middle of the tissue, in the
                                          surgical look
        --jpeg QUALITY:int = 0            compress images as a video does, 1 to 95 (0 = not at all)
    """, exposure=_exposure)  # fmt: skip


def add_cameras(group: Arguments) -> None:
    """Add the camera options of a live simulation."""
    options(group, """
        --no-cameras                    render no images
        --camera-rate HZ:number         image rate (default: 60)
        --image-format jpeg|png = jpeg  format of compressed images
    """)  # fmt: skip
    add_look(group)


def add_record_images(group: Arguments) -> None:
    """Add the recording of images."""
    options(group, """
        --record-images  record compressed images at the camera rate
    """)  # fmt: skip


def _exposure(text: str) -> float | Literal["auto"]:
    if text == "auto":
        return "auto"
    try:
        return number(text)
    except ArgumentTypeError:
        allowed = 'allowed: a number of stops, or "auto"'
        raise ArgumentTypeError(f"got {text.strip()!r}; {allowed}") from None


def eyes_of(preset: str) -> str | list[str]:
    """Return the name or file of a preset, or the files of both eyes."""
    return preset.split(",") if "," in preset else preset


def look_of(args: Namespace, rig: RigDescription, samples: int = 0) -> Look:
    """Return the Look from the options of `add_look`.

    Args:
        args: parsed options
        rig: whose pictures are drawn; it has a style of its own
        samples: samples per pixel

    Raises:
        InputError: a value is out of range
    """
    from trocar.rendering.look import bleeding_place, style_of, vignette_of

    found = _look(args, args.look or style_of(rig), vignette_of(rig), samples)
    return replace(found, bleeding_at=bleeding_place(rig)) if args.bleeding else found


def _look(
    args: Namespace, style: Literal["plain", "surgical"], vignette: float, samples: int = 0
) -> Look:
    from trocar.rendering import Look

    for name in ("smoke", "blood", "bleeding"):
        if getattr(args, name) and style != "surgical":
            raise InputError(
                f"--{name}: got {getattr(args, name):g} in the plain style; allowed: with --look"
                " surgical"
            )
    return Look(
        style=style,
        smoke=args.smoke,
        blood=args.blood,
        bleeding=args.bleeding,
        jpeg=args.jpeg,
        shadows=not args.no_shadows,
        exposure=args.exposure,
        vignette=vignette if args.vignette is None else args.vignette,
        noise=args.noise,
        distortion=args.distortion,
        samples=samples,
    )


def changed_look(args: Namespace) -> dict[str, object]:
    """Return the settings that the options of `add_look` change, by name.

    A task that looks at images has a style of its own, which is left where none is chosen.
    """
    look = _look(args, args.look or "surgical", 0.0)
    changed = {
        f.name: getattr(look, f.name) for f in fields(look) if getattr(look, f.name) != f.default
    }
    changed.pop("style", None)
    if args.vignette is not None:
        changed["vignette"] = args.vignette  # 0, too: a cavity has another
    return {**changed, "style": look.style} if args.look else changed


def open_pictures(loop: Loop, args: Namespace, *, stepped: bool = False) -> Pictures | None:
    """Return the image source of a loop's cameras; None: no cameras.

    Args:
        loop: of the world
        args: with the options of `add_cameras`
        stepped: the loop is stepped by its script, and waits for each image

    Raises:
        UnknownNameError: unknown preset
        InputError: an option is out of range
    """
    rig = loop.world.rig
    scopes = [camera.name for camera in rig.cameras if camera.kind == "endoscope"]
    if args.preset is not None and (args.no_cameras or not scopes):
        raise InputError(f"--preset: rig {rig.name} has no rendered endoscope")
    if args.no_cameras or not rig.cameras:
        allow(args, "with cameras", *(set(names_of(add_cameras)) - {"no_cameras"}))
        return None
    from trocar.descriptions.cameras import load_camera
    from trocar.live.images import RATE_HZ, Pictures
    from trocar.rendering.latest_only import InTurn, LatestOnly

    eyes = {} if args.preset is None else {scopes[0]: load_camera(eyes_of(args.preset))}
    rate = RATE_HZ if args.camera_rate is None else args.camera_rate
    look = look_of(args, rig)

    def renderer() -> ImageRenderer:
        return _series(look, lambda ask: ask(loop.world) if stepped else loop.ask(ask).result())

    worker = InTurn if stepped else LatestOnly
    return Pictures(loop, renderer, rate, args.image_format, eyes, worker)


def _series(look: Look, ask: Callable[[Callable[[World], Shapes]], Shapes]) -> Series:
    """Return a renderer of the world's shapes."""
    from trocar.rendering import Renderer, Series

    return Series(
        Renderer(lambda: ask(lambda w: (w.snapshot(arms=False).build, w.shapes())), None, look)
    )


def record_images(world: World, pictures: Pictures | None, args: Namespace) -> None:
    """Add images to the recording of a live run, if --record-images is given.

    Raises:
        InputError: nothing is recorded, or no camera is rendered
    """
    if not args.record_images:
        return
    if args.record is None and args.foxglove_record is None:
        raise InputError("--record-images: requires --record FILE or --foxglove-record FILE")
    if pictures is None:
        raise InputError(f"--record-images: rig {world.rig.name} has no rendered camera")
    if args.record is not None:
        from trocar.ros.images import RecordedImages

        pictures.add(RecordedImages(world))


def images_of_headless(world: World, args: Namespace) -> AbstractContextManager[None]:
    """Return a context manager that adds images to a headless recording, with --record-images.

    Raises:
        InputError: nothing is recorded, or the rig has no camera
        TrocarError: rendering is not possible
    """
    if not args.record_images:
        return nullcontext()
    if args.record is None:
        raise InputError("--record-images: requires --record FILE")
    if not world.rig.cameras:
        raise InputError(f"--record-images: rig {world.rig.name} has no camera")
    from trocar.live.images import RATE_HZ
    from trocar.ros.images import images_recorded

    look, rate = look_of(args, world.rig), RATE_HZ if args.camera_rate is None else args.camera_rate
    return images_recorded(
        world, lambda: _series(look, lambda ask: ask(world)), rate, args.image_format
    )


def script_of(policy: str, scene: Scene, trust: bool, other: str = "") -> tuple[Script, str]:
    """Return the script of --policy, and its name.

    Args:
        policy: "scripted", or a file
        scene: that it plays
        trust: whether files whose reading runs code are read
        other: further values that the command allows, for the error

    Raises:
        InputError: neither, a file that is no policy, or one of another scene
    """
    from trocar.tasks.play import scripted

    if policy == "scripted":
        return scripted, policy
    from trocar.learning.policies import ALLOWED, PolicyFile

    if not Path(policy).suffix:
        raise InputError(
            f"--policy: got {policy!r}; allowed: scripted,{other} or a file: {ALLOWED}"
        )
    file = PolicyFile(policy, trust)
    file.check(scene)
    return file.script, file.name
