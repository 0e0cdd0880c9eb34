"""How many names a class shows, and the names of commands in a journal."""

from __future__ import annotations

import ast

import numpy as np

from tests.test_architecture import SOURCES
from trocar.simulation import World
from trocar.simulation.arm import VERBS
from trocar.simulation.journal import Entry, apply_command

#: Public methods and properties that a class may have. Source: our own choice.
MOST = 40
#: Classes whose names are those of ROS: rclpy's Node.
FOREIGN = ("scripts/ros2.RclNode",)


def members(node: ast.ClassDef) -> set[str]:
    """Return the public methods and properties of a class."""
    found = {n.name for n in node.body if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)}
    return {name for name in found if not name.startswith("_")}


def test_no_class_has_more_than_forty_public_methods_and_properties() -> None:
    counts = {
        f"{room}.{node.name}": len(members(node))
        for room, source in SOURCES.items()
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ClassDef)
    }
    assert {name for name, n in counts.items() if n > MOST} - {*FOREIGN} == set()


def test_every_verb_is_recorded_under_the_name_that_it_had() -> None:
    world = World("psm")
    entries: list[Entry] = []
    world.listen(entries.append)
    arm = world.arm("PSM1")
    arm.joints.set_gains("yaw", p=90.0)
    arm.body.servo_cf([0.0] * 6)
    arm.local.set_base_frame(np.eye(4))
    arm.state_command("pause")
    assert [e.name for e in entries if e.kind == "command"] == [
        "set_gains",
        "servo_cf",
        "set_base_frame",
        "state_command",
    ]
    twin = World("psm")
    for verb, path in VERBS.items():
        assert path.count(".") >= 1, verb
    for entry in entries:
        if entry.kind == "command":
            apply_command(twin, entry)
    assert twin.arm("PSM1").joints.gains("yaw")[0] == 90.0
