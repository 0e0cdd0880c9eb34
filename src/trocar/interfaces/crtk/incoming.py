"""What a message that somebody published makes the simulator do.

message -> is it newer than the last? -> what does it ask for? -> command -> the loop's inbox
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from trocar.errors import InputError
from trocar.interfaces.commands import Command, SetReferenceArm
from trocar.interfaces.crtk import console
from trocar.interfaces.crtk.arm_commands import READERS, state_verb, wish
from trocar.interfaces.crtk.asked import Asked, Call, Turns
from trocar.interfaces.crtk.fields import Message, RefusedError, shown, stamp, text
from trocar.interfaces.crtk.setup_joints import SetupJoints
from trocar.interfaces.crtk.tools import Tools

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.topics import Topic
    from trocar.interfaces.state import Elapsed
    from trocar.simulation import World

#: A stream of messages that was silent for this long may begin anew with older stamps, as a bag
#: does that is played again. Source: our own choice. [s]
SILENCE_S = 5.0
#: How many streams are remembered. Source: our own choice: many times what a lab has.
STREAMS = 1024
#: Ticks until a look at what waits, where nothing does. Source: our own choice.
PATIENT = 1000

Handler = Callable[["Topic", Message], None]


class Incoming:
    """Checks messages and posts the commands that they are.

    Args:
        core: whose topics they come by

    Attributes:
        handlers: {topic: what takes its messages}, for topics that are no arm's; raises InputError
    """

    def __init__(self, core: Core) -> None:
        self._core = core
        self._lock = threading.Lock()
        self._newest: OrderedDict[tuple[str, str], tuple[tuple[int, int], float]] = OrderedDict()
        self._tools = Tools(core.emit)
        self._setup = SetupJoints()
        self._turns = Turns(self._warn, self._before, core.tell_state, lambda: core.loop.now)
        #: Held by the one question that the loop is asked at a time, so that many take no tick.
        self.asking = threading.Lock()
        self.handlers: dict[str, Handler] = {
            **dict.fromkeys(console.EVERY_ARM, self._every_arm),
            **dict.fromkeys(console.DEEDS, self._console),
            "SUJ/set_reference_arm": self._reference_arm,
        }

    def begin(self) -> Callable[[], None]:
        """Look on at ticks and say how the console stands; call the result to stop."""
        console.begin(self._core.emit)
        for name, arm in self._core.loop.world.arms.items():
            if arm.type == "PSM":
                self._tools.show_adapter(name)
        return self._core.loop.watch(self)

    def take(self, topic: Topic, message: Message, peer: str = "") -> None:
        """Check a message and post the command that it is; from any thread.

        Raises:
            InputError: what is wrong with it; nothing changes
        """
        sent = stamp(message) if topic.stamped else None
        if sent is not None:
            self._check_new((topic.name, peer), sent)
        handler = self.handlers.get(topic.name)
        if handler is not None:
            handler(topic, message)
        elif topic.arm and topic.key in READERS:
            arm = self._core.loop.world.arm(topic.arm)
            self.post(self._asked(topic, *wish(topic.key, message, arm.description)))
        else:
            raise InputError("is not obeyed")
        if sent is not None:
            self._remember((topic.name, peer), sent)

    def post(self, command: Command) -> None:
        """Post a command to the loop.

        Raises:
            RefusedError: too many wait
        """
        if not self._core.loop.post(command):
            raise RefusedError("full", "too many commands wait already")

    def obey(
        self, ask: Callable[[Topic, Message], Command], topic: Topic, message: Message
    ) -> None:
        """Post the command that a message is.

        Raises:
            InputError: it is none
        """
        self.post(ask(topic, message))

    def waits(self, arm: str) -> bool:
        """Tell whether commands wait until an arm is home; in the loop's thread."""
        return self._turns.waits(arm)

    # ------------------------------------------------------------------ in the loop's thread

    def ticked(self, elapsed: Elapsed) -> None:  # noqa: ARG002  as every watcher
        """Obey what has waited long enough."""
        self._turns.tick(self._core.loop.world)
        self._setup.tick(self._core.loop.world)

    def patience(self) -> int:
        """Return 1 while something waits for its turn, or brakes for an arm to arrive."""
        return 1 if self._turns.restless or self._setup.restless else PATIENT

    def refused(self, command: Command, reason: str) -> None:
        """Do nothing: the core tells of it."""

    def _before(self, world: World, asked: Asked) -> None:
        self._setup.before(world.arm(asked.arm), asked.name)

    def _warn(self, arm: str, topic: str, reason: str) -> None:
        row = self._core.topics.get(topic)
        self._core.refuse(row, topic or arm, reason)

    # ------------------------------------------------------------------ what is asked

    def _asked(self, topic: Topic, verb: str, values: Mapping[str, Any]) -> Asked:
        arm, said = topic.arm, self._core.emit
        acts: dict[str, Callable[[World], None]] = {
            "set_tool_type": lambda world: self._tools.mount(world, arm, values["name"]),
            "emulate_tool_present": lambda world: self._tools.put_on(world, arm, values["on"]),
            "emulate_adapter_present": lambda world: self._tools.adapt(world, arm, values["on"]),
            "set_endoscope_type": lambda _: said(f"{arm}/endoscope_type", {"data": values["name"]}),
        }
        if verb in acts:
            return Call(arm, verb, values, topic.name, self._turns, acts[verb])
        if verb == "lock_brakes":
            verb, values = ("lock_brakes" if values["locked"] else "release_brakes"), {}
        return Asked(arm, verb, values, topic.name, self._turns)

    def _every_arm(self, topic: Topic, message: Message) -> None:  # noqa: ARG002  it is empty
        verb, values = state_verb(console.EVERY_ARM[topic.name])
        for arm in self._core.loop.world.arms:
            self.post(Asked(arm, verb, values, topic.name, self._turns))

    def _console(self, topic: Topic, message: Message) -> None:
        console.DEEDS[topic.name](message, self._core.emit)

    def _reference_arm(self, topic: Topic, message: Message) -> None:  # noqa: ARG002
        """Refuse an arm that no setup joints are made for, as the dVRK does, and post others."""
        name, known = text(message, "data"), self._core.loop.world.rig.setup_joints
        if name not in known:
            raise RefusedError("arm", f"got {name!r}; allowed: {', '.join(known)}")
        self.post(SetReferenceArm(name))

    # ------------------------------------------------------------------ stamps

    def _check_new(self, stream: tuple[str, str], sent: tuple[int, int]) -> None:
        with self._lock:
            newest, when = self._newest.get(stream, ((0, 0), 0.0))
        if sent < newest and self._core.loop.now - when < SILENCE_S:
            raise RefusedError(
                "stamp",
                f"got the stamp {shown(sent)}, older than {shown(newest)} before; allowed: "
                "stamps that do not go back, or none",
            )

    def _remember(self, stream: tuple[str, str], sent: tuple[int, int]) -> None:
        with self._lock:
            self._newest[stream] = sent, self._core.loop.now
            self._newest.move_to_end(stream)
            if len(self._newest) > STREAMS:
                self._newest.popitem(last=False)
