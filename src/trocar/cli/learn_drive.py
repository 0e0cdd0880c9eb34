"""Drive a robot, or a scene that another program serves, by a policy, over its topics.

Subscribes to joints, jaws and objects' poses, and publishes set-points of joints at 100 Hz; goals
are those of the seed. The arms must be enabled and homed. Ctrl-C stops; the arms then hold. Try it
with `trocar play SCENE --policy none` in another terminal. See docs/learning-policies.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from contextlib import closing
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, allow, options
from trocar.cli.output import fixed, print_result
from trocar.cli.worlds import script_of
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.ros.client import RosClient

SUMMARY = "drive a robot or a served scene by a policy"
ORDER = 19


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        scene SCENE                      built-in scene (see trocar list scenes) or TOML file
        --policy FILE|scripted required  policy file (see trocar play), or the scene's own policy
        --trust                          allow an archive of Stable-Baselines3, which can run any
                                         code
        --seed N:int = 0                 seed of the episode, which determines its goals
        --duration S:duration            stop after S seconds
    """)  # fmt: skip
    options(parser.add_mutually_exclusive_group(required=True), """
        --ros1           robot on ROS 1 (rospy)
        --ros2           robot on ROS 2 (extra ros2)
        --websocket URL  robot or scene behind rosbridge, e.g. ws://127.0.0.1:9090
    """)  # fmt: skip
    add_json(parser)


def run(args: Namespace) -> int:
    """Drive, and print the result."""
    if not args.policy.endswith(".zip"):
        allow(args, "with --policy FILE.zip", "trust")
    if args.seed < 0:
        raise InputError(f"--seed: got {args.seed}; allowed: 0 or more")
    from trocar.learning.policy_node import PolicyNode
    from trocar.tasks import make_task

    task = make_task(args.scene)
    script, _ = script_of(args.policy, task.scene, args.trust)
    duration_s = float("inf") if args.duration is None else args.duration
    with closing(_client(args)) as client:
        client.start()
        found = PolicyNode(client, task, script, args.seed).run(duration_s)
    print_result(
        args,
        found,
        lambda: (
            f"{found.scene}: {'success' if found.success else 'no success'} ({found.reason}) after"
            f" {fixed(found.time_s, 2)} s, {found.met} of {found.goals} goals"
        ),
    )
    return 0


def _client(args: Namespace) -> RosClient:
    if args.websocket:
        from trocar.ros.transports.websocket.client import WebSocketClient

        return WebSocketClient(args.websocket)
    if args.ros1:
        from trocar.ros.transports.ros1 import Ros1Client

        return Ros1Client("trocar_policy")
    from trocar.ros.transports.ros2 import Ros2Client

    return Ros2Client()
