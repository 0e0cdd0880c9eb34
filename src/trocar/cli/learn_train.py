"""Train a policy on a scene, and write it with its curve, log and a video into a folder.

bc clones scripted episodes, or those of a dataset, into plans of set-points; sac-her and ppo are
those of Stable-Baselines3. The policy plays without PyTorch: trocar play SCENE --policy
DIR/policy.toml. The same seed trains the same policy on one machine. Needs the extra learn.
"""

from __future__ import annotations

import shlex
import sys
import time
from argparse import ArgumentParser, Namespace
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trocar.cli.arguments import add_json, add_overwrite, allow, options
from trocar.cli.output import fixed, print_result, progress_bar
from trocar.descriptions.catalogue import load_scene
from trocar.errors import InputError, MissingExtraError

if TYPE_CHECKING:
    from trocar.descriptions.scenes import Scene
    from trocar.learning.policies import TrainedPolicy
    from trocar.learning.run_folder import RunFolder

SUMMARY = "train a policy on a scene (extra learn)"
ORDER = 17

#: First of the seeds whose episode is filmed. Source: our own choice; no training uses it.
FILMED = 30_000


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        scene SCENE                       built-in scene (see trocar list scenes) or TOML file
        --method bc|sac-her|ppo required  bc: behaviour cloning; sac-her, ppo: reinforcement
                                          learning by Stable-Baselines3
        -o,--out DIR required             folder for policy.toml, policy.safetensors, curve.csv,
                                          curve.png, training.json and episode.mp4
        --device cpu|cuda = cpu           of the networks; of ppo's worlds, too (extra gpu)
        --seed N:int = 0                  of initial weights, order and exploration
        --steps N:int                     gradient steps of bc (default: 8000), or steps of the
                                          environment (default: sac-her 5000, ppo 40000)
        --episodes N:int                  bc: scripted episodes, with the seeds 0, 1, ... (default:
                                          250)
        --epochs N:int                    bc: passes through all periods, in place of --steps
        --copies N:int                    bc: copies of each period with displaced tips (default:
                                          1)
        --shift MM:number                 bc: displacement of these, with 1.4 deg for each mm
                                          (default: 1)
        --data DIR                        bc: a dataset of trocar learn collect, in place of
                                          scripted episodes
        --archive                         sac-her, ppo: also write what Stable-Baselines3 saves,
                                          archive.zip
        --no-video                        write no video
    """)  # fmt: skip
    add_drawn(parser)
    add_overwrite(parser, "the files of an earlier training")
    add_json(parser)


def add_drawn(parser: ArgumentParser) -> None:
    """Add the randomisation of worlds."""
    options(parser, """
        --randomise PRESET          draw each episode's world anew: none, lab, wide, or a TOML file
                                    of spreads
        --tips robot|camera = robot  with --randomise: tips as the robot reports them, or corrected
                                    by images
    """)  # fmt: skip


def drawn(args: Namespace, scene: Scene) -> Scene:
    """Return a scene as the options of `add_drawn` have it."""
    if args.randomise is None:
        allow(args, "with --randomise", "tips")
        return scene
    return scene.randomised(args.randomise, args.tips)


def run(args: Namespace) -> int:
    """Train and write."""
    for name in ("steps", "episodes", "epochs"):
        value = getattr(args, name)
        if value is not None and value < 1:
            raise InputError(f"--{name}: got {value}; allowed: 1 or more")
    for name in ("seed", "copies"):
        value = getattr(args, name)
        if value is not None and value < 0:
            raise InputError(f"--{name}: got {value}; allowed: 0 or more")
    if args.shift is not None and not 0.0 < args.shift < float("inf"):
        raise InputError(f"--shift: got {args.shift:g}; allowed: above 0 mm")
    cloning = args.method == "bc"
    if cloning:
        allow(args, "with --method sac-her or ppo", "archive")
        if args.data is not None:
            allow(args, "without --data", "episodes")
        if args.epochs is not None:
            allow(args, "without --epochs", "steps")
    else:
        allow(args, "with --method bc", "episodes", "epochs", "copies", "shift", "data")
    from trocar.learning.cloning import torch_on
    from trocar.learning.lerobot import open_dataset
    from trocar.learning.run_folder import RunFolder

    torch_on(args.device)
    scene = drawn(args, load_scene(args.scene))
    if args.data is not None:
        open_dataset(args.data)
    folder = RunFolder(args.out, args.overwrite)
    begin, wall = time.process_time(), time.monotonic()
    policy, log = _clone(args, scene, folder) if cloning else _actor(args, scene, folder)
    log |= {
        "command": _command(args),
        "cpu_s": round(time.process_time() - begin, 1),
        "wall_s": round(time.monotonic() - wall, 1),
    }
    kept = {name: value for name, value in log.items() if name != "wall_s" and value is not None}
    policy = replace(policy, training=kept)
    files = folder.write(policy, log)
    filmed = None if args.no_video else _film(scene, folder)
    if filmed is not None:
        files.append(folder.path / "episode.mp4")
    document = {"files": [str(file) for file in files], **log, "filmed": filmed}
    print_result(args, document, lambda: _report(document))
    return 0


def _clone(
    args: Namespace, scene: Scene, folder: RunFolder
) -> tuple[TrainedPolicy, dict[str, Any]]:
    from trocar.learning.cloning import (
        CloneSettings,
        clone,
        demonstrate,
        ensemble,
        read_demonstrations,
    )
    from trocar.learning.features import SceneFeatures
    from trocar.learning.policies import TrainedPolicy
    from trocar.tasks import make_task

    task, count = make_task(scene), args.episodes or 250
    settings = replace(CloneSettings(), seed=args.seed)
    if args.copies is not None:
        settings = replace(settings, copies=args.copies)
    if args.shift is not None:
        ratio = 1e-3 * args.shift / settings.shift_m
        turn_rad = ratio * settings.turn_rad
        settings = replace(settings, shift_m=1e-3 * args.shift, turn_rad=turn_rad)
    if args.data is None:
        with progress_bar("episodes") as draw:
            shown = demonstrate(task, range(count), settings, watch=lambda n: draw(n, count))
    else:
        shown = read_demonstrations(args.data, task, settings)
    rows = len(shown.inputs)
    if args.epochs is not None:
        settings = replace(settings, steps=args.epochs * max(1, rows // settings.batch))
    elif args.steps is not None:
        settings = replace(settings, steps=args.steps)
    with progress_bar("gradient steps") as draw:

        def watch(step: int, steps: int, loss: float) -> None:
            folder.add(step=step, loss=loss)
            draw(step, steps)

        network = clone(shown, settings, args.device, watch)
    log = {
        "scene": task.scene.name,
        "method": args.method,
        "settings": asdict(settings),
        "data": args.data,
        "seeds": None if args.data else [0, count - 1],
        "episodes": shown.episodes,
        "failures": shown.failures,
        "periods": rows // (1 + settings.copies),
    }
    names = SceneFeatures(task).names
    policy = TrainedPolicy(
        "clone", task.scene.name, network, features=names, ensemble=ensemble(settings)
    )
    return policy, log


def _actor(
    args: Namespace, scene: Scene, folder: RunFolder
) -> tuple[TrainedPolicy, dict[str, Any]]:
    from trocar.learning.baselines import settings_of, train_actor

    settings = replace(settings_of(args.method), seed=args.seed)
    if args.steps is not None:
        settings = replace(settings, steps=args.steps)
    archive = folder.path / "archive.zip" if args.archive else None
    with progress_bar("steps") as draw:

        def watch(step: int, success: float) -> None:
            folder.add(step=step, success=success)
            draw(step, settings.steps)

        policy = train_actor(scene, args.method, settings, args.device, archive, watch)
    log = {"scene": policy.scene, "method": args.method, "settings": asdict(settings)}
    return policy, log


def _film(scene: Scene, folder: RunFolder) -> dict[str, Any] | None:
    """Film an episode of the policy, where what is needed is installed."""
    from trocar.learning.policies import PolicyFile
    from trocar.learning.run_folder import POLICY, VIDEO, film_episode
    from trocar.tasks import make_task

    task = make_task(scene)
    script = PolicyFile(folder.path / POLICY).script
    try:
        episode = film_episode(task, script, FILMED, folder.path / VIDEO)
    except (MissingExtraError, InputError) as problem:
        print(f"trocar: warning: no video: {problem}", file=sys.stderr)
        return None
    return {"seed": FILMED, "success": episode.success, "time_s": episode.time_s}


def _command(args: Namespace) -> str:
    """Return the command line that makes the policy again."""
    words = ["trocar", "learn", "train", args.scene, "--method", args.method]
    numbers = ("seed", "steps", "episodes", "epochs", "copies", "shift")
    for name in ("device", *numbers, "data", "randomise", "tips"):
        if name in args.given:
            words += [f"--{name}", str(getattr(args, name))]
    return shlex.join([*words, "-o", str(Path(args.out).name)])


def _report(document: dict[str, Any]) -> str:
    filmed, lines = document["filmed"], list(document["files"])
    lines.append(
        f"trained in {fixed(document['cpu_s'], 1)} s of processor time,"
        f" {fixed(document['wall_s'], 1)} s"
    )
    if filmed is not None:
        end = "succeeds" if filmed["success"] else "does not succeed"
        lines.append(f"seed {filmed['seed']} {end}, {fixed(filmed['time_s'], 2)} s")
    return "\n".join(lines)
