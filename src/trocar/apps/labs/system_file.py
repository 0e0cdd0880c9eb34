"""The system's file: arms, where they stand, who moves whom."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, cast

from trocar.apps.labs import published
from trocar.apps.labs.finder import Finder
from trocar.apps.labs.json_file import Node, read_json
from trocar.apps.labs.numbers import read_chain, read_transform
from trocar.apps.labs.pid_file import read_gains
from trocar.apps.labs.records import Base, Gains, Generation, Instrument, Lab, LabArm, SetupArm
from trocar.apps.labs.setup_file import own_setup_arms, read_reference_arm, read_setup_file
from trocar.apps.labs.teleop_entries import read_consoles
from trocar.apps.labs.tool_file import read_tool_file
from trocar.descriptions.records import REFERENCE_ARM

#: Kinds of arms. Source: schema dvrk-system-arm.
KINDS = (
    *(f"{arm}{more}" for more in ("", "_DERIVED", "_GENERIC") for arm in ("MTM", "PSM", "ECM")),
    "SUJ_Classic",
    "SUJ_Si",
    "SUJ_Fixed",
    "FOCUS_CONTROLLER",
)
#: Endoscopes. Source: schema dvrk-ecm; the first are those of older files.
ENDOSCOPES = (
    *("STRAIGHT", "UP", "DOWN", "HD_STRAIGHT", "HD_UP", "HD_DOWN", "NONE"),
    *(
        f"{head}_{bend}"
        for head in ("Classic_SD", "Classic_HD", "Si_HD", "Custom")
        for bend in ("STRAIGHT", "UP", "DOWN")
    ),
)
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


class Reader:
    """Reads a system and the files that it names; keeps what they say that is of no use here."""

    def __init__(self, path: Path, share: tuple[Path, ...], literal: bool) -> None:
        self.root = read_json(path)
        self.literal = literal
        self.finder = Finder(path, share)
        self.nodes = [self.root]
        self.said: list[str] = []
        self._absent: list[str] = []
        self._taken: dict[str, str] = {}
        self._setup_names: dict[str, list[SetupArm]] = {}
        self._reference_arm = REFERENCE_ARM
        self._files: dict[Path, Node] = {}
        self._gains: dict[Path, Mapping[str, Gains]] = {}

    def read(self) -> Lab:
        """Return the system.

        Raises:
            DescriptionError: naming file, key, what was got and what is allowed
        """
        root = self.root
        root.without_use("IOs", "io", "ISI_focus_controller", "component_manager", "chatty")
        if "settings" in root:
            settings = root.node("settings")
            settings.without_use("chatty", "audio_volume")
            if "path" in settings:
                self.finder.add(str(p) for p in cast(list[Any], settings.raw("path")))
        entries = root.nodes("arms")
        if not entries:
            raise root.fail("arms", "is missing; a list of arms is needed")
        names: dict[str, str] = {}
        for entry in entries:
            name = entry.text("name")
            if not NAME.fullmatch(name):
                raise entry.fail("name", f"got {name!r}; allowed: letters, digits and _")
            if name in names:
                raise entry.fail("name", f"got {name!r} a second time; allowed: each arm once")
            names[name] = entry.text("type", allowed=KINDS)
        for entry in entries:  # setup joints first, for the others stand on them
            if names[entry.text("name")].startswith("SUJ"):
                self._setup_names[entry.text("name")] = self._setup(entry)
        arms = [self._arm(entry) for entry in entries if self._wanted(entry)]
        teleops = read_consoles(root, names, self.said)
        setup = [arm for arms in self._setup_names.values() for arm in arms]
        if self._absent:
            absent = ", ".join(dict.fromkeys(self._absent))
            self.said.append(f"not here, so taken as the dVRK has published them: {absent}")
        return Lab(
            root.file,
            tuple(arms),
            tuple(setup),
            self._reference_arm,
            tuple(teleops),
            tuple(dict.fromkeys(self.said)),
            tuple(_without_use(node) for node in self.nodes if node.all_idle()),
            tuple(f"{node.file}: {key}" for node in self.nodes for key in node.unknown()),
        )

    def _open(self, path: Path) -> Node:
        if path not in self._files:
            self._files[path] = read_json(path)
            self.nodes.append(self._files[path])
        return self._files[path]

    def _wanted(self, entry: Node) -> bool:
        """Tell whether an entry is an arm that a simulation has; say why not."""
        name, kind = entry.text("name"), entry.text("type")
        if kind.startswith("SUJ"):
            return False
        if kind == "FOCUS_CONTROLLER" or kind.endswith("_GENERIC"):
            self.said.append(f"{name}: left out: a {kind} is a device that only the lab knows")
            entry.without_use("component", "interface", "base_frame", "serial", "IO", "arm_file")
            entry.without_use("simulation", "skip_ROS_bridge")
            return False
        if kind.endswith("_DERIVED"):
            self.said.append(f"{name}: {kind} is simulated as the {kind[:3]} that it derives from")
            entry.without_use("component", "interface")
        return True

    # ------------------------------------------------------------------ setup joints

    def _setup(self, entry: Node) -> list[SetupArm]:
        _idle(entry)
        kind, wanted = entry.text("type"), entry.text("arm_file", entry.text("arm", ""))
        entry.without_use("serial")
        if not wanted:
            raise entry.fail("arm_file", "is missing; setup joints need their file")
        path = self.finder.find(wanted)
        if path is not None:
            file = self._open(path)
            arms = read_setup_file(file, kind, self.literal)
            self._reference_arm = read_reference_arm(file, kind, arms, self.said)
            return arms
        own = published.SETUP_FILES.get(wanted)
        if own is None:
            raise self.finder.missing(entry.file, entry.place("arm_file"), wanted)
        if kind != f"SUJ_{own}":
            raise entry.fail("type", f"got {kind!r}; allowed: SUJ_{own}, as {wanted} has it")
        self._not_found(wanted)
        return own_setup_arms(own)

    def _not_found(self, name: str) -> None:
        self._absent.append(name)

    # ------------------------------------------------------------------ arms

    def _arm(self, entry: Node) -> LabArm:
        _idle(entry)
        name = entry.text("name")
        kind = cast(Literal["PSM", "ECM", "MTM"], entry.text("type")[:3])
        node = self._arm_node(entry, name)
        node.without_use("kinematic_gc", "gravity_compensation", "gravity_tilt", "mounting_pitch")
        node.without_use("re_home", "homing_zero_position", "platform_gain", "kinematic_type")
        node.without_use("custom_tool_index", "always_home", "homing_goes_to_zero")
        kinematic = node.text("kinematic")
        chain, said = self._chain(node, kinematic)
        generation = self._generation(node, kinematic, said)
        tool = self._tool(node, name) if kind == "PSM" else ""
        return LabArm(
            name,
            kind,
            generation,
            entry.path,
            node.file,
            chain,
            tool,
            node.text("endoscope", "", allowed=ENDOSCOPES) if kind == "ECM" else "",
            self._gains_of(entry, kind, generation),
            self._base(entry),
            self._instrument(tool),
        )

    def _instrument(self, tool: str) -> Instrument | None:
        """Return what the tool's own file says, None where it is not here."""
        path = self.finder.find(f"tool/{tool.replace(':', '_')}.json") if tool else None
        return None if path is None else read_tool_file(self._open(path), self.literal)

    def _arm_node(self, entry: Node, name: str) -> Node:
        """Return an arm's own file, found as the dVRK finds it."""
        on_io, serial = entry.text("name_on_IO", name), entry.text("serial", "")
        given = entry.text("arm", f"{on_io}-{serial}.json" if serial else "")
        wanted = entry.text("arm_file", given)
        if not wanted:
            raise entry.fail("arm_file", "is missing; an arm needs arm_file, or its serial")
        path = self.finder.find(wanted)
        if path is not None:
            return self._open(path)
        own = published.own_arm_file(wanted)
        if own is None:
            raise self.finder.missing(entry.file, entry.place(_named_by(entry)), wanted)
        self._not_found(wanted)
        return Node(own, wanted)

    def _chain(self, node: Node, kinematic: str) -> tuple[Any, str]:
        """Return the chain, None where it is the dVRK's own and not here."""
        path = self.finder.find(kinematic)
        if path is not None:
            root = self._open(path)
            root.without_use("coupling", "tooltip_offset", "homing_zero_position")
            return read_chain(root, self.literal), published.own_arm(kinematic)
        own = published.own_arm(kinematic)
        if not own:
            raise self.finder.missing(node.file, node.place("kinematic"), kinematic)
        self._not_found(kinematic)
        return None, own

    def _generation(self, node: Node, kinematic: str, own: str) -> Generation:
        told = node.text("generation", "", allowed=("Classic", "Si"))
        meant = published.generation_of(kinematic)
        if told and own and told != meant:
            raise node.fail(
                "generation", f"got {told!r}; allowed: {meant}, for kinematic is {kinematic!r}"
            )
        return cast(Generation, told) if told else meant

    def _tool(self, node: Node, name: str) -> str:
        how = node.text("tool_detection", "AUTOMATIC", allowed=("AUTOMATIC", "MANUAL", "FIXED"))
        if how == "FIXED":
            return re.sub(r"\[.*\]$", "", node.text("tool"))
        node.without_use("tool")
        self.said.append(
            f"{name}: tool_detection is {how}, so the file leaves the instrument open;"
            f" --tool {name}=NAME chooses one"
        )
        return ""

    def _gains_of(
        self, entry: Node, kind: str, generation: Generation
    ) -> Mapping[str, Gains] | None:
        """Return the gains of an arm, None where no file has them."""
        si = "-Si" if generation == "Si" and kind != "MTM" else ""
        default = f"pid/sawControllersPID-{kind}{si}.json"
        wanted = entry.text("PID_file", default)
        path = self.finder.find(wanted)
        if path is None:
            if "PID_file" in entry:
                raise self.finder.missing(entry.file, entry.place("PID_file"), wanted)
            return None
        if path.suffix != ".json":
            self.said.append(f"{path}: only JSON is read; gains stay those of trocar's arm")
            return None
        if path not in self._gains:
            self._gains[path] = read_gains(self._open(path), kind)
        return self._gains[path]

    def _base(self, entry: Node) -> Base:
        if "base_frame" not in entry:
            return Base("nothing")
        node = entry.node("base_frame")
        has = [k for k in ("transform", "reference_frame", "component", "interface") if k in node]
        if has == ["transform", "reference_frame"]:
            return Base("frame", node.text("reference_frame"), read_transform(node, "transform"))
        if has != ["component", "interface"]:
            raise entry.fail(
                "base_frame",
                f"got {', '.join(has) or 'nothing'}; allowed: transform and reference_frame, or"
                " component and interface",
            )
        component, interface = node.text("component"), node.text("interface")
        if component not in self._setup_names:
            known = ", ".join(self._setup_names) or "none, for the system has no setup joints"
            raise node.fail("component", f"got {component!r}; allowed: {known}")
        held = [arm.name for arm in self._setup_names[component]]
        if interface not in held:
            raise node.fail("interface", f"got {interface!r}; allowed: {', '.join(held)}")
        if interface in self._taken:
            free = ", ".join(name for name in held if name not in self._taken) or "none"
            raise node.fail(
                "interface",
                f"got {interface!r}, which holds {self._taken[interface]}; allowed: {free}",
            )
        self._taken[interface] = entry.text("name")
        return Base("setup", interface)


def _named_by(entry: Node) -> str:
    """Return which entry names the arm's file; older systems call it "arm"."""
    return next((key for key in ("arm_file", "arm") if key in entry), "serial")


def _without_use(node: Node) -> str:
    """Return the entries of a file that have no counterpart, each once for all list items."""
    keys = dict.fromkeys(re.sub(r"\[\d+\]", "[]", key) for key in node.all_idle())
    return f"{node.file}: {', '.join(keys)}"


def _idle(entry: Node) -> None:
    """Say which entries of an arm have no counterpart in a simulation."""
    entry.without_use("IO", "IO_file", "IO_gripper_file", "PID_period", "period", "simulation")
    entry.without_use("skip_ROS_bridge", "socket", "system")
