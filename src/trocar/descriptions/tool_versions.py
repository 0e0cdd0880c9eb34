"""Versions of instruments: newer ones of a model are geared and have their own description."""

from __future__ import annotations

import re

from trocar.errors import InputError

#: The first geared version of each model that has one.
#: Source: jhu-dvrk/sawIntuitiveResearchKit@9e535e6 share/tool/index.json.
GEARED_FROM = {
    "LARGE_NEEDLE_DRIVER:420006": 12,
    "PROGRASP_FORCEPS:420093": 14,
    "PERMANENT_CAUTERY_HOOK:420183": 11,
    "MEGA_NEEDLE_DRIVER:420194": 12,
    "MEGA_SUTURECUT_NEEDLE_DRIVER:420309": 7,
}
GEARED = "_GEARED"


def tool_of_version(name: str) -> str:
    """Return the tool of a name with versions: NAME:CODE[12..], [..11] or [13], as the dVRK writes.

    A range selects by its first version, or its last where it has no first; without a version the
    tool is the one that is not geared.
    Source: SAW 9e535e6, mtsToolList.cpp:156 (which refuses a geared model without its version).

    Raises:
        InputError: brackets that hold no versions
    """
    model, bracket, rest = name.partition("[")
    if not bracket:
        return name
    found = re.fullmatch(r"(\d*)(?:\.\.(\d*))?\]", rest)
    if found is None or rest == "]":
        raise InputError(f"{name}: its versions are {bracket + rest!r}; allowed: [3], [3..], [..3]")
    version = found[1] or found[2]
    geared = model in GEARED_FROM and bool(version) and int(version) >= GEARED_FROM[model]
    return model + GEARED if geared else model


def full_name(tool: str) -> str:
    """Return a tool's name with its versions, as the dVRK publishes it; "" for none.

    Source: SAW 9e535e6, mtsToolList.cpp:262 and share/tool/index.json.
    """
    model = tool.removesuffix(GEARED)
    first = GEARED_FROM.get(model)
    if not tool or first is None:
        return tool and f"{tool}[..]"
    return f"{model}[{first}..]" if tool.endswith(GEARED) else f"{model}[..{first - 1}]"
