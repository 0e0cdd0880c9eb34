"""The system, the surgeon's console, and what a person beside the arms does, as far as emulated."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from trocar.descriptions.records import RigDescription
from trocar.descriptions.teleops import TeleopDescription
from trocar.descriptions.tool_versions import full_name
from trocar.errors import InputError
from trocar.live.inbox import Command
from trocar.live.loop import Loop
from trocar.live.state import PATIENT, Elapsed
from trocar.ros import message_builders as build
from trocar.ros.arm_topics import Act
from trocar.ros.message_fields import RefusedError, button, number, text, vector
from trocar.ros.period_statistics import CONTROL, FRAMES, PUBLISHING
from trocar.ros.topic import (
    BOOL,
    COMMAND,
    EMPTY,
    FLOAT,
    FORCE,
    JOY,
    MATRIX,
    PLACE,
    POSE,
    SPEED,
    STRING,
    TWIST,
    WRENCH,
    Emit,
    Read,
    Topic,
    command,
    latched,
    prefix,
    state,
)
from trocar.simulation.journal import WORLD, verb_of

if TYPE_CHECKING:
    from trocar.ros.clock import Stamp
    from trocar.ros.sample import SampleReadings
    from trocar.simulation import World
    from trocar.simulation.arm import Arm

_log = logging.getLogger("trocar")
Message = Mapping[str, Any]

NO_TOOL = "none"
#: Brakes of setup joints hold again when the joints are this near to their set-points and this
#: slow, or this long after the last command or the end of the move. Source: our own choice.
#: [rad or m, per s, s]
NEAR, SLOW, PATIENCE_S = 1e-3, 1e-3, 1.0

PEDALS = ("clutch", "camera", "cam_minus", "cam_plus", "bicoag", "coag", "mono")
#: {topic that emulates a button: topics of the button}. Source: dvrk_python, console.py, for those
#: of the console; a pedal is published under both names. The pedals' own are ours.
BUTTONS = {
    "console/emulate_operator_present": ("console/operator_present",),
    "console/emulate_clutch": ("console/clutch", "footpedals/clutch"),
    "console/emulate_camera": ("console/camera", "footpedals/camera"),
    "footpedals/emulate_clutch": ("console/clutch", "footpedals/clutch"),
    "footpedals/emulate_camera": ("console/camera", "footpedals/camera"),
    **{f"footpedals/emulate_{pedal}": (f"footpedals/{pedal}",) for pedal in PEDALS[2:]},
}
#: Names of a beep's numbers, and the largest of each. Source: SAW system component; the bounds are
#: our own choice, the frequency's is that of dvrk_python's own example. [s, Hz, 0 to 1]
BEEP = (("duration", 60.0), ("frequency", 50_000.0), ("volume", 1.0))
#: Volume at the start. Source: SAW system_configuration, audio_volume.
VOLUME = 0.5


class Bedside:
    """Instruments and sterile adapters put on as if by hand, and brakes of setup joints.

    A tool that is taken off is remembered, so that the same one comes back. Real setup joints have
    no motors; the dVRK's own simulation moves them by servo_jp and move_jp, and so do these, by the
    servos that hold them while their brakes are released for the command. In the loop's thread.

    Args:
        emit: publishes an event
    """

    def __init__(self, emit: Emit) -> None:
        self.emit = emit
        self._without_adapter: set[str] = set()
        self._last_tool: dict[str, str] = {}
        #: {setup arm: its joints whose brakes a command released, and since when it rests}.
        self._loose: dict[str, tuple[tuple[str, ...], float]] = {}
        self._world: World

    def acts(self, arm_type: str) -> Mapping[str, Act]:
        """Return {verb: what does it in place of the arm}, for a type of arm."""
        if arm_type == "SUJ":
            verbs = ("servo_jp", "move_jp", "lock_brakes", "release_brakes")
            return {verb: partial(self._move_setup, verb) for verb in verbs}
        return {
            "set_tool_type": lambda arm, values, world: self._mount(world, arm, values["name"]),
            "reject_type": self._reject_type,
            "emulate_tool_present": lambda arm, values, world: self._put(world, arm, values["on"]),
            "emulate_adapter_present": self._adapt,
            "set_endoscope_type": lambda arm, values, world: self.emit(  # noqa: ARG005
                f"{arm}/endoscope_type", {"data": values["name"]}
            ),
        }

    def show_adapter(self, arm: str) -> None:
        """Publish whether an arm has a sterile adapter."""
        self.emit(f"{arm}/IO/adapter", build.joy(int(arm not in self._without_adapter)))

    def _mount(self, world: World, name: str, tool: str) -> None:
        arm = world.arm(name)
        if (arm.description.tool or NO_TOOL) == tool:
            self.emit(f"{name}/tool_type", {"data": full_name(arm.description.tool)})
            return
        if tool != NO_TOOL:
            self._check_adapter(name)
        arm.runtime.set_tool_type(tool)

    def _reject_type(self, name: str, values: Mapping[str, Any], world: World) -> None:  # noqa: ARG002
        """Report an unknown tool or endoscope. Source: SAW 9e535e6, PSM.cpp:1733, ECM.cpp:457."""
        kind, allowed = values["kind"], ", ".join(values["known"])
        text = f"{kind} type {values['name']!r} is not supported; allowed: {allowed}"
        _log.warning("%s: %s", name, text)
        self.emit(f"{name}/error", {"data": text})
        self.emit(f"{name}/{kind}_type", {"data": "ERROR"})

    def _put(self, world: World, name: str, on: bool) -> None:
        """Put the last tool on again, or take the tool off."""
        arm = world.arm(name)
        if on and not arm.description.tool:
            self._check_adapter(name)
            if name not in self._last_tool:
                self.emit(f"{name}/tool_type_request", {})
                return
            self._mount(world, name, self._last_tool[name])
        elif not on and arm.description.tool:
            self._last_tool[name] = arm.description.tool
            self._mount(world, name, NO_TOOL)

    def _adapt(self, name: str, values: Mapping[str, Any], world: World) -> None:
        """Put a sterile adapter on, or take it off with the tool that it holds."""
        on = values["on"]
        if not on:
            self._put(world, name, False)
        if on == (name in self._without_adapter):
            (self._without_adapter.discard if on else self._without_adapter.add)(name)
            self.show_adapter(name)

    def _check_adapter(self, name: str) -> None:
        if name in self._without_adapter:
            raise InputError(
                f"{name}: no sterile adapter is mounted; mount one first (emulate_adapter_present)"
            )

    # ------------------------------------------------------------------ setup joints

    def _move_setup(self, verb: str, name: str, values: Mapping[str, Any], world: World) -> None:
        arm = world.arm(name)
        state = arm.operating_state()
        if verb == "lock_brakes":
            self._loose.pop(name, None)
        elif verb != "release_brakes" and state.ready:
            locked = tuple(joint for joint, on in arm.brakes.items() if on)
            if name in self._loose:
                self._loose[name] = self._loose[name][0], state.time
            elif locked:
                arm.brakes.release(locked)
                self._loose[name] = locked, state.time
        verb_of(arm, name, verb)(**values)

    def begin(self, loop: Loop) -> Callable[[], None]:
        """Publish which arms have adapters, and watch ticks; call the result to stop."""
        self._world = loop.world
        for name, arm in loop.world.arms.items():
            if arm.description.type == "PSM":
                self.show_adapter(name)
        return loop.watch(self)

    def patience(self) -> int:
        """Return 1 while brakes wait for setup joints to arrive."""
        return 1 if self._loose else PATIENT

    def refused(self, command: Command, reason: str) -> None:
        """Do nothing: the core reports it."""

    def ticked(self, elapsed: Elapsed) -> None:  # noqa: ARG002  as every watcher
        """Lock the brakes of setup joints that have arrived."""
        world = self._world
        for name, (joints, since) in tuple(self._loose.items()):
            arm = world.arm(name)
            if arm.operating_state().is_busy:
                self._loose[name] = joints, world.time
            elif world.time < since:  # a reset came between, which locks every brake
                del self._loose[name]
            elif at_rest(arm) or world.time - since > PATIENCE_S:
                arm.brakes.lock(joints)
                del self._loose[name]


def at_rest(arm: Arm) -> bool:
    """Return whether an arm is at its set-points."""
    measured, setpoint = arm.measured_js(), arm.setpoint_js()
    near = np.abs(measured.position - setpoint.position) < NEAR
    return bool(near.all() and (np.abs(measured.velocity) < SLOW).all())


def begin(emit: Emit) -> None:
    """Publish the state of the console when the simulator starts."""
    emit("system/volume", {"data": VOLUME})
    pedals = (f"footpedals/{pedal}" for pedal in PEDALS)
    for name in (*(shown for topics in BUTTONS.values() for shown in topics), *pedals):
        emit(name, build.joy(0))


# ---------------------------------------------------------------------- commands


def _volume(message: Message) -> list[tuple[str, Message]]:
    volume = number(message, "data")
    if not 0.0 <= volume <= 1.0:
        raise RefusedError("volume", f"got a volume of {volume:g}; allowed: 0 to 1")
    return [("system/volume", {"data": volume})]


def _beep(message: Message) -> list[tuple[str, Message]]:
    values = vector(message, "data")
    if not 1 <= len(values) <= len(BEEP):
        raise RefusedError(
            "shape", f"got {len(values)} numbers in data; allowed: [duration, frequency, volume]"
        )
    parts: list[str] = []
    for value, (name, most) in zip(values, BEEP, strict=False):
        if not 0.0 <= value <= most:
            raise RefusedError("beep", f"got a {name} of {value:g}; allowed: 0 to {most:g}")
        parts.append(f"{name} {value:g}")
    return [("system/status", {"data": f"beep: {', '.join(parts)}"})]


def _speech(message: Message) -> list[tuple[str, Message]]:
    words = text(message, "data")
    _log.info("text to speech: %r", words)
    return [("system/status", {"data": f"said: {words}"})]


def _emulated(topic: str) -> Callable[[Message], list[tuple[str, Message]]]:
    return lambda message: [(name, build.joy(button(message))) for name in BUTTONS[topic]]


def console_topics(rig: RigDescription, emit: Emit) -> list[Topic]:
    """Return the rows of the system and of the console of a rig."""

    def shows(topic: str, events: Callable[[Message], list[tuple[str, Message]]]) -> Read:
        """Read a message whose effect is to publish others."""

        def read(message: Message, _: object) -> Command:
            found = events(message)
            return Command(
                WORLD, topic, topic=topic, act=lambda _: [emit(*shown) for shown in found]
            )

        return read

    def every_arm(topic: str, verb: str) -> Read:
        """Read a switch of the whole system. Before version 2.4 it lay under console/."""
        return lambda message, _: [  # noqa: ARG005
            Command(arm.name, verb, {}, topic) for arm in rig.arms
        ]

    def reference_arm(message: Message, _: object) -> Command:
        """Reject an arm without setup joints, as the dVRK does."""
        name, known = text(message, "data"), rig.setup_joints
        if name not in known:
            raise RefusedError("arm", f"got {name!r}; allowed: {', '.join(known)}")
        return Command(WORLD, "set_reference_arm", {"name": name}, "SUJ/set_reference_arm")

    switches = (
        ("power_on", "enable", "power every arm on"),
        ("power_off", "disable", "power every arm off"),
        ("home", "home", "home every arm"),
    )
    pressed = "0 released, 1 pressed, 2 quick tap"
    sound, words = ("system/set_volume", "system/beep"), "system/string_to_speech"
    rows = [
        *(
            command(f"system/{name}", EMPTY, "", says, every_arm(f"system/{name}", verb))
            for name, verb, says in switches
        ),
        command(sound[0], FLOAT, "0 to 1", "of beeps and speech", shows(sound[0], _volume)),
        latched("system/volume", FLOAT, "of beeps and speech", "0 to 1"),
        command(sound[1], MATRIX, "s, Hz, 0 to 1", "duration, frequency, volume",
                shows(sound[1], _beep)),
        command(words, STRING, "", "text for the log", shows(words, _speech)),
        latched("system/error", STRING, "errors that concern no single arm"),
        latched("system/warning", STRING, "rejections that concern no single arm"),
        latched("system/status", STRING, "other events"),
        *(
            command(
                f"console/{name}",
                EMPTY,
                "",
                f"as system/{name}; the name before version 2.4",
                every_arm(f"console/{name}", verb),
            )
            for name, verb, _ in switches
        ),
        *(
            latched(f"console/{name}", JOY, pressed)
            for name in ("operator_present", "clutch", "camera")
        ),
        *(latched(f"footpedals/{name}", JOY, pressed) for name in PEDALS),
        *(
            command(
                topic, JOY, "", "press or release the pedal", shows(topic, _emulated(topic))
            )
            for topic in BUTTONS
        ),
    ]  # fmt: skip
    if any(arm.arm.type == "SUJ" for arm in rig.arms):
        says = "arm in whose tip frame the poses of the others on setup joints are: ECM, PSM1, ..."
        rows.append(command("SUJ/set_reference_arm", STRING, "", says, reference_arm))
    return rows


# ---------------------------------------------------------------------- statistics

STATISTICS = "cisst_msgs/IntervalStatistics"
CONTROL_HELP = "wall time of a control period, means between samples; no compute times"
AS_PUBLISHERS = "as publishers"


def _statistics(name: str, of: str, says: str) -> Topic:
    def make(readings: SampleReadings, stamp: Stamp) -> dict[str, Any]:
        return readings.statistics[of].message(stamp)

    return state(f"{name}/period_statistics", STATISTICS, "s", says, make, "statistics")


def statistics_topics(rig: RigDescription) -> Iterator[Topic]:
    """Return the rows of the periods of arms and of what publishes.

    Source of names: cisst-ros 73aca61, mts_ros_crtk_bridge_provided.cpp.
    """
    says = "periods of samples; times to make their messages"
    yield _statistics("publishers", PUBLISHING, says)
    for name in ("stats/subscribers", "stats/events"):
        yield _statistics(name, PUBLISHING, AS_PUBLISHERS)
    for arm in rig.arms:
        place = prefix(arm.name, arm.arm)
        yield _statistics(place, CONTROL, CONTROL_HELP)
        name = place.lower().replace("/", "_") + ("" if arm.arm.type == "SUJ" else "_arm")
        yield _statistics(f"stats/publishers_{name}", PUBLISHING, AS_PUBLISHERS)
        yield _statistics(f"stats/tf_{name}", FRAMES, "periods of tf")


# ---------------------------------------------------------------------- teleoperation

TELEOP_CONSOLE = (
    command("console/teleop/enable", BOOL, "", "switch teleoperation"),
    latched("console/teleop/enabled", BOOL, "whether it is on"),
    command("console/teleop/select", STRING, "", "a component to use"),
    command("console/teleop/unselect", STRING, "", "a component not to use"),
    latched("console/teleop/selected", STRING, "a component that was selected"),
    latched("console/teleop/unselected", STRING, "a component that was unselected"),
    command("console/teleop/set_scale", FLOAT, "", "motion of instruments per masters'"),
    latched("console/teleop/scale", FLOAT, "motion of instruments per masters'"),
)

#: Of a component that moves an instrument or the endoscope by masters.
TELEOP = (
    command("state_command", COMMAND, "", "enable, disable; of an instrument's: align_MTM"),
    latched("current_state", STRING, "state of the component"),
    latched("desired_state", STRING, "the last commanded state"),
    latched("following", BOOL, "whether the instrument follows"),
    latched("scale", FLOAT, "motion of the instrument per master's"),
    command("set_scale", FLOAT, "", "motion of the instrument per master's"),
    latched("error", STRING, "why the component is DISABLED"),
    latched("warning", STRING, "what keeps it from following"),
    latched("status", STRING, "other events"),
)

#: Of one that moves an instrument.
TELEOP_TOOL = (
    command("lock_rotation", BOOL, "", "keep the instrument's orientation"),
    command("lock_translation", BOOL, "", "keep the instrument's position"),
    command("set_align_MTM", BOOL, "", "whether the master is aligned first"),
    latched("rotation_locked", JOY, "whether the orientation is kept"),
    latched("translation_locked", JOY, "whether the position is kept"),
    latched("align_mtm", BOOL, "whether the master is aligned first"),
    state("alignment_offset", "geometry_msgs/QuaternionStamped", "xyzw", "master to tip"),
    state("MTM/measured_cp", POSE, PLACE, "the master's handle"),
    state("MTM/measured_cv", TWIST, SPEED, "its velocity, of a master that is an arm of the rig"),
    state("PSM/setpoint_cp", POSE, PLACE, "the commanded tip of the instrument"),
    command("following/mtm/body/servo_cf", WRENCH, FORCE,
            "wrench on the hand while the instrument follows, in axes of the handle",
            newest=True),
)  # fmt: skip

#: Of one that moves the endoscope; masters are MTML and MTMR, whatever their names.
TELEOP_SCOPE = (
    state("MTML/measured_cp", POSE, PLACE, "the left handle"),
    state("MTMR/measured_cp", POSE, PLACE, "the right handle"),
    state("ECM/measured_cp", POSE, PLACE, "the endoscope's tip at its set-points"),
)


def teleop_topics(teleops: Sequence[TeleopDescription]) -> list[Topic]:
    """Return the rows of teleoperation components, and of the console that switches them.

    Nothing serves them until a `Component` does.
    """
    rows = [*TELEOP_CONSOLE]
    for teleop in teleops:
        own = TELEOP_TOOL if teleop.kind == "psm" else TELEOP_SCOPE
        rows += [row.under(teleop.name) for row in (*TELEOP, *own)]
        publisher = f"stats/publishers_{teleop.name.lower()}_setting"
        rows.append(_statistics(teleop.name, CONTROL, CONTROL_HELP))
        rows.append(_statistics(publisher, PUBLISHING, AS_PUBLISHERS))
    return rows
