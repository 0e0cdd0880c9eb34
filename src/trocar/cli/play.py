"""Play a training scene: by a policy and scored, or by a person or a client.

The scene is served like trocar sim; score, time and drops are in the web viewer and on the topic
task/state. With --headless episodes run as fast as possible, and success, score, time, distances,
forces and drops of each are printed. See docs/scenes.md, and docs/learning-policies.md for files
of policies.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, allow, allow_overwrite, names_of, options
from trocar.cli.output import fixed, print_result, progress_bar, table
from trocar.cli.serving import add_serving, allow_headless, serve, serve_chosen
from trocar.cli.worlds import (
    add_look,
    add_record,
    changed_look,
    eyes_of,
    images_of_headless,
    look_of,
    recording,
    script_of,
)
from trocar.descriptions.catalogue import load_scene
from trocar.errors import DescriptionError, InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from trocar.descriptions.scenes import Scene
    from trocar.rendering import Endoscope
    from trocar.tasks import Episode, Task
    from trocar.tasks.play import Script

SUMMARY = "play a training scene, scripted or by hand"
ORDER = 15

#: Frames of a video a second. Source: our own choice.
VIDEO_HZ = 25.0


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        scene SCENE             built-in scene (see trocar list scenes) or TOML file
        --seed N:int = 0        seed of the first episode
        --policy scripted|none|FILE
                                scripted: the scene's own policy (default where it has one); none: a
                                person or a client drives; FILE: a policy of one's own (.py), a
                                trained one (.toml), or an archive of Stable-Baselines3 (.zip)
        --trust                 of --policy FILE.zip: unpickle it, which can run any code
        --headless              run without web viewer and clients
        --episodes N:int = 1    episodes, with the seeds that follow
        --workers N:int = 1     processes that episodes run on; results do not depend on it
        --cluster ADDRESS       run the episodes on the Ray cluster at HOST:PORT, or on a local one
                                of --workers processes: local (extra cluster)
        --video FILE            write an MP4 video of the endoscope (extra video)
        --duration S:duration   stop serving, or with --headless each episode, after S simulated
                                seconds
        --speed SPEED:speed     of serving: realtime (default); max, as fast as possible; or a
                                factor of real time: 0.2 is slow motion
        --start viewer|now      of serving: begin when a browser shows the scene (default where a
                                policy drives, without --duration), or at once
        --set KEY=VALUE ... as settings
                                value of a key of the scene's file by its dotted path, as
                                time_limit_s=90 or pad.stitches=4; for several keys more than once
        --place table|cavity    surroundings of a scene with tissue (default: as the scene has them,
                                table): cavity is the inside of a body, drawn only
        --generation classic|si  of the arms (default: as the scene has them, Classic): si has the
                                same ports, tips and tools
        --plan FILE             of suturing: write the plan of the first episode's stitches, as TOML
                                or as a picture (.png, extra plot), before it is played
        --register points|image  of suturing: find the wound by noisy points of it (default), or in
                                the endoscope's stereo image (extras scope, vision)
    """)  # fmt: skip
    add_json(parser)
    add_record(parser)
    add_serving(parser)


def run(args: Namespace) -> int:
    """Play."""
    for name, value, least in (
        ("seed", args.seed, 0),
        ("episodes", args.episodes, 1),
        ("workers", args.workers, 1),
    ):
        if value < least:
            raise InputError(f"--{name}: got {value}; allowed: {least} or more")
    _allow(args)
    args.scene = _scene(args)
    own = args.policy in (None, "scripted", "none")
    named = "scripted" if own else args.policy
    script, policy = script_of(named, _loaded(args.scene), args.trust, " none,")
    policy = "" if own else policy
    if args.plan:
        _write_plan(args)
    if not args.headless:
        return _serve(args, script, policy)
    if args.policy == "none":
        raise InputError("--policy none: got --headless, where nobody drives; allowed: without it")
    kept = bool(args.record or args.video or args.record_images)
    if kept and args.episodes > 1:
        raise InputError("--record, --video: allowed with one episode only")
    watched = kept or args.register == "image"
    if watched and (args.workers > 1 or args.cluster):
        raise InputError("--record, --video, --register image: allowed with one worker only")
    from trocar.tasks import play

    found: list[Episode] = []
    duration_s = float("inf") if args.duration is None else args.duration
    scene = _loaded(args.scene)
    longest_s = min(duration_s, scene.time_limit)
    with progress_bar("s simulated") as draw:

        def watch(time_s: float) -> None:
            draw(round(len(found) * longest_s + time_s), round(args.episodes * longest_s))

        if watched:
            episodes = _watched(args, script, duration_s, watch)
        else:
            seeds, cluster = range(args.seed, args.seed + args.episodes), args.cluster or ""
            episodes = play(
                args.scene,
                seeds,
                args.workers,
                cluster,
                script=script,
                duration_s=duration_s,
                watch=watch,
            )
        for episode in episodes:
            found.append(episode)
            watch(0.0)
    document = {
        "scene": found[0].scene,
        "policy": policy or "scripted",
        "grasp": found[0].grasp,
        "dynamics": found[0].dynamics,
        "successes": sum(one.success for one in found),
        "episodes": found,
    }
    print_result(args, document, lambda: _report(found))
    return 0


def _allow(args: Namespace) -> None:
    """Reject options that do nothing in the mode, or with the scene."""
    allow_overwrite(args, "record", "video", "plan", "foxglove_record")
    scene = load_scene(args.scene)
    if Path(args.policy or "").suffix.lower() != ".zip":
        allow(args, "with --policy FILE.zip", "trust")
    if args.register == "points" and scene.task != "suturing":
        allow(args, "with the scene suturing", "register")
    if not args.headless:
        names = ("json", "video", "episodes", "workers", "cluster")
        allow(args, "with --headless", *names)
        if args.no_page and args.start == "viewer":
            raise InputError("--start: got viewer with --no-page; allowed: without --no-page")
        return
    allow(args, "without --headless", "start")
    allow_headless(args)
    if args.speed not in (None, "max"):
        raise InputError(f"--speed: got {args.speed} with --headless; allowed: max")
    if args.cluster not in (None, "local"):
        allow(args, "without --cluster HOST:PORT", "workers")
    if args.record_images or args.video or args.register == "image":
        return
    from trocar.tasks.registry import task_class

    where = "without --headless, or with --record-images, --video or --register image"
    allow(args, where, "preset")
    if not task_class(scene).sees:
        allow(args, where, *names_of(add_look))


def _scene(args: Namespace) -> Scene | str:
    """Return the scene, by its name where nothing of it is changed."""
    look, scene = changed_look(args), args.scene
    settings = [*args.settings, *(["generation=Si"] if args.generation == "si" else [])]
    settings += [f"surroundings={args.place}"] if args.place else []
    if settings:
        scene = _with_settings(scene, settings)
    return replace(_loaded(scene), look=look) if look else scene


def _with_settings(name: str, texts: list[str]) -> Scene:
    """Return a scene with values of --set."""
    from trocar.descriptions.settings import read_settings
    from trocar.tasks import scene_with

    try:
        return scene_with(name, read_settings(texts))
    except (DescriptionError, InputError) as problem:
        raise InputError(f"--set: {problem}") from None


def _loaded(scene: Scene | str) -> Scene:
    return load_scene(scene) if isinstance(scene, str) else scene


def _write_plan(args: Namespace) -> None:
    """Write the plan of the first episode's stitches."""
    from trocar.tasks import make_task
    from trocar.tasks.scenes.suturing import Suturing

    path = Path(args.plan).expanduser()
    if path.suffix not in (".toml", ".png"):
        raise InputError(f"--plan: got {args.plan}; allowed: a file that ends in .toml or .png")
    task = make_task(args.scene)
    if not isinstance(task, Suturing):
        raise InputError(f"--plan: got the scene {task.scene.name}; allowed: suturing")
    with ExitStack() as stack:
        if args.register == "image":
            _register(task, args, stack)
        task.reset(args.seed)
        task.make_plan().save(path, overwrite=args.overwrite)


def _serve(args: Namespace, script: Script, policy: str) -> int:
    """Serve the scene; a policy, or a person or a client drives."""
    if args.register == "image":
        raise InputError("--register image: allowed with --headless only")
    from trocar.tasks import Task, make_task
    from trocar.tasks.served import ServedTask

    scene = _loaded(args.scene)
    if args.policy == "none":  # a person or a client may drive every arm
        scene = replace(scene, welded=())
    print(f"trocar: {scene.name}: starting ...", file=sys.stderr, flush=True)
    task = make_task(scene)
    if args.policy == "none" or (args.policy is None and type(task).policy is Task.policy):
        served = ServedTask(task, args.seed, script=None)
    else:
        driver = f"policy {policy}" if policy else "scripted policy"
        served = ServedTask(task, args.seed, script=script, driver=driver)
    waits = bool(served.driver) and not args.no_page and args.duration is None
    start = args.start or ("viewer" if waits else "now")
    if start == "viewer":
        print(
            "trocar: the policy begins when a browser shows the scene (--start now: at once)",
            file=sys.stderr,
            flush=True,
        )
    chosen = serve(task.world, args, task=served, loads=True, start=start)
    print(_report([task.result(served.state()["seed"])]))
    serve_chosen(chosen, args)
    return 0


def _watched(
    args: Namespace, script: Script, duration_s: float, watch: Callable[[float], None]
) -> Iterator[Episode]:
    """Yield episodes that are recorded or filmed, or whose policy sees the wound in images."""
    from trocar.tasks import make_task, run_episode

    task = make_task(args.scene)
    with ExitStack() as stack:
        stack.enter_context(images_of_headless(task.world, args))
        stack.enter_context(recording(task.world, args)())
        if args.register == "image":
            _register(task, args, stack)
        if args.video:
            _film(task, args, stack)
        for seed in range(args.seed, args.seed + args.episodes):
            yield run_episode(task, seed, script=script, duration_s=duration_s, watch=watch)


def _register(task: Task, args: Namespace, stack: ExitStack) -> None:
    """Let a task of suturing find its wound in images of the endoscope, its height in points."""
    from trocar.cameras import StereoCalibration
    from trocar.tasks.scenes.suturing import Suturing
    from trocar.tasks.vision import find_wound

    if not isinstance(task, Suturing):
        raise InputError(f"--register: got the scene {task.scene.name}; allowed: suturing")
    scope = _scope(task, args, "--register image")
    stack.callback(scope.close)

    def seen(guess: NDArray[np.float64]) -> NDArray[np.float64]:
        frame = scope.capture()
        if frame.right is None or not isinstance(frame.calibration, StereoCalibration):
            raise InputError("--register image: got a camera with one eye; allowed: with two")
        pose, images = frame.T_world_camera[0], (frame.left, frame.right)
        wound = find_wound(frame.calibration, *images, guess, T_world_left=pose)
        # depth from a wet surface with little texture is off by up to 1 mm: only lines of sight
        rays = wound.middle.points - pose[:3, 3]
        below = guess[:, 2].mean() - pose[2, 3]
        return pose[:3, 3] + rays * (below / rays[:, 2:])

    task.find_wound = seen


def _scope(task: Task, args: Namespace, option: str) -> Endoscope:
    """Return the endoscope of a task's world."""
    from trocar.descriptions.cameras import load_camera
    from trocar.rendering import Endoscope

    scopes = [camera.name for camera in task.world.rig.cameras if camera.kind == "endoscope"]
    if not scopes:
        raise InputError(f"{option}: the rig of {task.scene.name} has no endoscope")
    eyes = None if args.preset is None else load_camera(eyes_of(args.preset))
    return Endoscope(task.world, scopes[0], calibration=eyes, look=look_of(args, task.world.rig))


def _film(task: Task, args: Namespace, stack: ExitStack) -> None:
    """Add the left eye's picture of every 1/25 s to a video."""
    from trocar.outputs import check_file
    from trocar.rendering.film import video
    from trocar.rendering.frames import picture

    path, world = Path(args.video).expanduser(), task.world
    if path.suffix != ".mp4":
        raise InputError(f"--video: got {args.video}; allowed: a file that ends in .mp4")
    check_file(path, args.overwrite)
    scope = _scope(task, args, "--video")
    stack.callback(scope.close)
    task.reset(args.seed)

    def capture() -> NDArray[np.uint8]:
        return picture(scope.capture(), "left", "colour")

    first = task.picture(capture)
    add = stack.enter_context(
        video(path, (first.shape[1], first.shape[0]), VIDEO_HZ, overwrite=args.overwrite)
    )
    every = round(1.0 / (VIDEO_HZ * world.timestep))

    def look() -> None:
        if world.periods % every == 0:
            add(task.picture(capture))

    stack.callback(world.observe(look, every=every))


def _report(found: list[Episode]) -> str:
    rows = [
        [
            str(one.seed),
            "yes" if one.success else "no",
            fixed(one.time_s, 2),
            fixed(one.score, 1),
            f"{one.met}/{one.goals}",
            str(one.drops),
            fixed(1e3 * sum(one.distance_m.values()), 0),
            fixed(max(one.force_n.values()), 2),
            one.reason,  # last, as it may be long
        ]
        for one in found
    ]
    head = ["seed", "success", "time [s]", "score", "goals", "drops", "path [mm]", "force [N]"]
    successes = sum(one.success for one in found)
    ended = sum(one.reason != "running" for one in found)
    stopped = "" if ended == len(found) else f", {len(found) - ended} stopped before its end"
    measured = [  # -1: not measured
        [str(o.seed), *("-" if v == -1.0 else fixed(v, 2) for v in o.figures.values())]
        for o in found
    ]
    return (
        f"{found[0].scene}: {successes} of {ended} successful{stopped}, grasp: {found[0].grasp},"
        f" dynamics: {found[0].dynamics}\n\n"
        + table([*head, "end"], rows)
        + (f"\n\n{table(['seed', *found[0].figures], measured)}" if found[0].figures else "")
    )
