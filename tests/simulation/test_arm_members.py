"""How many names a class shows, and the names that an arm had before."""

from __future__ import annotations

import ast

import numpy as np
import pytest

from tests.test_architecture import SOURCES
from trocar.simulation import World
from trocar.simulation.arm import MOVED, VERBS
from trocar.simulation.journal import Entry, apply_command

#: Public members that a class may have: methods, properties and attributes. Source: issue 35.
MOST = 40
PSM = World("psm").arm("PSM1")
#: Classes that have more today, and how many: both are to be taken apart (issue 35).
TODAY = {"simulation/world.World": 60, "tasks/task.Task": 43}


def members(node: ast.ClassDef) -> set[str]:
    """Return the public names of a class: methods, properties, fields, `self.x = ...`."""
    found = set[str]()
    for part in ast.walk(node):
        if isinstance(part, ast.FunctionDef | ast.AsyncFunctionDef) and part in node.body:
            found.add(part.name)
        elif (
            isinstance(part, ast.AnnAssign)
            and part in node.body
            and isinstance(part.target, ast.Name)
        ):
            found.add(part.target.id)
        elif isinstance(part, ast.Assign) and part in node.body:
            found |= {t.id for t in part.targets if isinstance(t, ast.Name)}
        elif (
            isinstance(part, ast.Attribute)
            and isinstance(part.ctx, ast.Store)
            and isinstance(part.value, ast.Name)
            and part.value.id == "self"
        ):
            found.add(part.attr)
    return {name for name in found if not name.startswith("_")}


def test_no_class_has_more_than_forty_public_members() -> None:
    counts = {
        f"{room}.{node.name}": len(members(node))
        for room, source in SOURCES.items()
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ClassDef)
    }
    assert {name: n for name, n in counts.items() if n > TODAY.get(name, MOST)} == {}
    assert {name for name in TODAY if counts[name] <= MOST} == set(), "take them out of TODAY"


@pytest.mark.parametrize("name", sorted(MOVED))
def test_a_name_that_moved_answers_with_a_warning(name: str) -> None:
    with pytest.warns(DeprecationWarning, match=rf"^Arm\.{name} is Arm\."):
        getattr(PSM, name)


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
