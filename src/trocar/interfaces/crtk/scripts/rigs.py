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
ARM = re.compile(r"PSM[123]|ECM|MTM[LR]|SUJ")


def rig_for(source: bytes, arguments: Sequence[str]) -> str:
    """Return the first rig that has all arms that a script names.

    Args:
        source: of the script; texts in it count, remarks and docstrings do not
        arguments: of the script; where one names an arm, the script's texts do not count
    """
    given = {name for word in arguments for name in ARM.findall(word)}
    named = given or {name for text in _texts(source) for name in ARM.findall(text)}
    if not named:
        return EVERY
    for rig in RIGS:
        arms = {arm.name for arm in load_rig(rig).arms}
        arms |= {"SUJ"} if any(name.startswith("SUJ_") for name in arms) else set()
        if named <= arms:
            return rig
    return RIGS[-1]


def _texts(source: bytes) -> Iterator[str]:
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError) as problem:
        raise InputError(f"the script cannot be read: {problem}") from problem
    remarks = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) not in remarks:
                yield node.value
        elif isinstance(node, ast.Attribute) and node.attr == "suj":
            yield "SUJ"
