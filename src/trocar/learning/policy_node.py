"""A node that drives a robot, or a served scene, by a policy: it subscribes and commands."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, TrocarError
from trocar.messages import blank
from trocar.ros.client import RosClient, Take
from trocar.ros.message_fields import RefusedError, joints, pose
from trocar.ros.topic import JOINTS, POSE, STATE, STRING
from trocar.tasks import Episode, Task
from trocar.tasks.controller import EVERY, PERIOD_S, Row
from trocar.tasks.play import EARLY_S, Script

Array = NDArray[np.float64]

#: Longest time until the first messages. Source: our own choice. [s]
FIRST_S = 3.0
#: Longest age of joint positions; the robot then holds. Source: our own choice, as the mirror's.
#: [s]
SILENCE_S = 0.5


class PolicyNode:
    """Reads the topics of a scene's arms and objects, and commands the arms' servos by a script.

    A copy of the scene is put where the robot and its objects are, every 20 ms: the policy reads
    the copy, and limits, inverse kinematics and the count of goals are those of the simulation.
    Goals are those of a seed. The object in a jaw is the published one; a real robot has no such
    topic, and contacts of the copy, which is moved every 20 ms, do not replace it.

    Args:
        client: of the topics, started
        task: of the scene; its world is the copy
        script: returns the actions of an episode
        seed: of the episode

    Raises:
        InputError: the scene has objects that no pose describes
    """

    def __init__(self, client: RosClient, task: Task, script: Script, seed: int = 0) -> None:
        self._client, self._task, self._script, self._seed = client, task, script, seed
        rig = task.world.rig
        for prop in rig.props:
            if any(of is not None for of in (prop.joint, prop.thread, prop.tissue)):
                raise InputError(
                    f"{task.scene.name}: {prop.name} is on a joint, a thread or tissue, whose state"
                    " no pose has; allowed: scenes of free, rigid objects"
                )
        self._objects = [prop.name for prop in rig.objects]
        self._lock = threading.Lock()  # the client's thread and ours
        self._q: dict[str, Array] = {}
        self._jaws: dict[str, Array] = {}
        self._states: dict[str, str] = {}
        self._poses: dict[str, Array] = {}
        self._held: dict[str, str] = {}
        self._arrived: dict[str, float] = {}
        self._wrong = ""
        self._commanded: dict[str, Array] = {}

    def run(
        self,
        duration_s: float = float("inf"),
        watch: Callable[[float], None] = lambda _: None,
    ) -> Episode:
        """Drive until the episode ends, and return its result; the arms then hold.

        Args:
            duration_s: time after which it is stopped [s]
            watch: called with the time of the episode after each action [s]

        Raises:
            TrocarError: no messages, ones that cannot be used, an arm that is not enabled, or of
                the script
        """
        task, client = self._task, self._client
        task.reset(self._seed)
        self._commanded.clear()
        with ExitStack() as stack:
            self._subscribe(stack)
            self._wait()
            self._mirror()
            task.begin()
            self._commanded = {n: task.world.arms[n].joints.setpoints() for n in task.arms}
            actions = self._script(task)
            due = client.now()
            while not task.done and task.time < duration_s - EARLY_S:
                action = next(actions, None)
                for row in task.controller.setpoints(task.stay() if action is None else action):
                    task.controller.drive(row)
                    self._command(row)
                    task.world.step(EVERY)
                    due += EVERY * task.world.timestep
                    if (left := due - client.now()) > 0.0:
                        client.sleep(left)
                self._mirror()
                task.look()
                watch(task.time)
        return task.result(self._seed)

    # ------------------------------------------------------------------ topics

    def _subscribe(self, stack: ExitStack) -> None:
        """Subscribe to all topics, until the stack is closed."""

        def add(topic: str, kind: str, take: Take) -> None:
            stack.callback(self._client.subscribe(topic, kind, partial(self._take, topic, take), 1))

        for name in self._task.arms:
            arm = self._task.world.arms[name].description
            known = arm.mechanism.joint_names
            own = known[: arm.own_joints]
            add(f"{name}/measured_js", JOINTS, partial(self._take_joints, self._q, name, own))
            if jaw := known[arm.own_joints :]:
                take = partial(self._take_joints, self._jaws, name, jaw)
                add(f"{name}/jaw/measured_js", JOINTS, take)
                add(f"{name}/grasp/object", STRING, partial(self._take_text, self._held, name))
            add(f"{name}/operating_state", STATE, partial(self._take_state, name))
        for name in self._objects:
            add(f"scene/{name}/measured_cp", POSE, partial(self._take_pose, name))

    def _take(self, topic: str, take: Take, message: Mapping[str, Any]) -> None:
        """Take a message, in the client's thread; what is wrong with one is raised by ours."""
        with self._lock:
            try:
                take(message)
            except RefusedError as problem:
                self._wrong = f"{self._client.name}: /{topic}: {problem}"
            self._arrived[topic] = self._client.now()

    def _take_joints(
        self, to: dict[str, Array], name: str, known: tuple[str, ...], message: Mapping[str, Any]
    ) -> None:
        to[name] = joints(message, "position", known)

    def _take_text(self, to: dict[str, str], name: str, message: Mapping[str, Any]) -> None:
        to[name] = str(message["data"])

    def _take_state(self, name: str, message: Mapping[str, Any]) -> None:
        self._states[name] = str(message["state"])

    def _take_pose(self, name: str, message: Mapping[str, Any]) -> None:
        self._poses[name] = pose(message, "pose")

    def _wait(self) -> None:
        """Wait for the first messages of joints and objects."""
        jawed = {name for name in self._task.arms if self._task.world.arms[name].jaw is not None}
        needed = {f"{name}/measured_js" for name in self._task.arms}
        needed |= {f"{name}/jaw/measured_js" for name in jawed}
        needed |= {f"scene/{name}/measured_cp" for name in self._objects}
        end = self._client.now() + FIRST_S
        while missing := needed - set(self._arrived):
            if self._client.now() >= end:
                names = ", ".join(f"/{topic}" for topic in sorted(missing))
                raise TrocarError(
                    f"{self._client.name}: no message within {FIRST_S:g} s on {names}; allowed: the"
                    f" arms and objects of {self._task.scene.name}"
                )
            self._client.sleep(PERIOD_S)

    def _command(self, row: Row) -> None:
        """Publish set-points of `TipController`; arms and jaws that rest are absent."""
        for name, (q, v) in row.items():
            self._commanded[name] = np.append(q, self._commanded[name][len(q) :])
            own = self._task.world.arms[name].description.own_joints
            parts = {"servo_jp": slice(own), "jaw/servo_jp": slice(own, len(q))}
            for verb, part in parts.items():
                if len(q[part]):
                    fields = {**blank(JOINTS), "position": q[part], "velocity": v[part]}
                    self._client.publish(f"{name}/{verb}", JOINTS, fields)

    # ------------------------------------------------------------------ the copy

    def _mirror(self) -> None:
        """Put the copy where arms and objects are, with its set-points as commanded."""
        world, client = self._task.world, self._client
        with self._lock:
            if self._wrong:
                raise TrocarError(self._wrong)
            for name in self._task.arms:
                age = client.now() - self._arrived[f"{name}/measured_js"]
                if age > SILENCE_S:
                    raise TrocarError(
                        f"{client.name}: /{name}/measured_js: no message for {age:.1f} s; allowed:"
                        f" {SILENCE_S:g} s; {name} holds"
                    )
                if (state := self._states.get(name, "ENABLED")) != "ENABLED":
                    raise TrocarError(
                        f"{client.name}: {name} is {state}; allowed: ENABLED (home it first)"
                    )
            arms = {name: np.append(q, self._jaws.get(name, ())) for name, q in self._q.items()}
            poses = dict(self._poses)
            self._task.referee.reported = dict(self._held)
        for name, q in arms.items():
            limits = world.arms[name].joints
            world.set_state(name, np.clip(q, limits.lower, limits.upper))
        for name, T in poses.items():
            world.objects[name].set_cp(T)
        self._task.controller.drive(
            {name: (q.tolist(), [0.0] * len(q)) for name, q in self._commanded.items()}
        )
