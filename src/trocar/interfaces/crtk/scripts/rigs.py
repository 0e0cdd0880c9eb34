"""Which rig a script needs, by the arms that it names."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence

from trocar.descriptions import load_rig
from trocar.errors import InputError

#: Built-in rigs that have arms of different kinds, the fastest first.
RIGS = ("psm", "ecm", "mtm", "three_psm", "two_psm_ecm", "full_cart", "full_cart_mtm")
#: Has every arm of a patient's cart; taken where a script names none.
EVERY = "full_cart"
#: Classes of dvrk that need more than one arm; teleoperation is served where masters are.
PARTS = {
    "suj": ("SUJ",),
    "console": ("MTML", "MTMR", "PSM1"),
    "teleop_psm": ("MTML", "MTMR", "PSM1"),
}
ARM = re.compile(r"PSM[123]|ECM|MTM[LR]|SUJ")


def rig_for(source: bytes, arguments: Sequence[str]) -> str:
    """Return the first rig that has all arms that a script names.

    Args:
        source: of the script; texts in it count, remarks and docstrings do not
        arguments: of the script; where one names an arm, the script's texts do not count
    """
    tree = _tree(source)
    named = {name for word in arguments for name in ARM.findall(word)}
    named = named or {name for text in _texts(tree) for name in ARM.findall(text)}
    named |= set(_parts(tree))
    if not named:
        return EVERY
    for rig in RIGS:
        arms = {arm.name for arm in load_rig(rig).arms}
        arms |= {"SUJ"} if any(name.startswith("SUJ_") for name in arms) else set()
        if named <= arms:
            return rig
    return RIGS[-1]


def _tree(source: bytes) -> ast.AST:
    try:
        return ast.parse(source)
    except (SyntaxError, ValueError) as problem:
        raise InputError(f"the script cannot be read: {problem}") from problem


def _texts(tree: ast.AST) -> Iterator[str]:
    remarks = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        text = node.value if isinstance(node, ast.Constant) else None
        if isinstance(text, str) and id(node) not in remarks:
            yield text


def _parts(tree: ast.AST) -> Iterator[str]:
    """Yield the arms without which the classes that a script takes from dvrk have no topics."""
    modules, names = _imported(tree)
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id in modules
        ):
            names.append(node.attr)
    for name in names:
        yield from PARTS.get(name, ())


def _imported(tree: ast.AST) -> tuple[set[str], list[str]]:
    """Return what a script calls dvrk, and the names that it imports from it."""
    modules: set[str] = set()
    names: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for name in node.names:
                package, *below = name.name.split(".")
                if package == "dvrk":
                    modules.add(name.asname or package)
                    names += below
        elif isinstance(node, ast.ImportFrom):
            package, *below = (node.module or "").split(".")
            if package == "dvrk":
                names += [*below, *(name.name for name in node.names)]
    return modules, names
