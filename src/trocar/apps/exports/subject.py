"""What is exported: an arm alone, or a rig."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from trocar.descriptions import RigDescription, load_arm, load_rig, names, rig_with_tool
from trocar.descriptions.calibrated import calibrated_rig
from trocar.descriptions.lone_arm import lone_arm_rig
from trocar.errors import InputError, UnknownNameError


def find_rig(
    name: str | Path, tools: Sequence[str] = (), calibrations: Sequence[str] = ()
) -> RigDescription:
    """Return the rig that a name stands for: an arm alone and without props, or a rig.

    Args:
        name: a built-in arm or rig, or the path of a TOML file; a name of both is the arm
        tools: "TOOL" of a lone arm, or "ARM=TOOL" of an arm in a rig
        calibrations: overlays as for `load_rig`: "FILE", or "ARM=FILE"

    Raises:
        UnknownNameError: no such arm, rig or tool
        InputError, DescriptionError: a file is broken, or fits none of the arms
    """
    rig = _alone(name) if _is_arm(name) else load_rig(name)
    lone = rig.arms[0].name if len(rig.arms) == 1 else ""
    for wanted in tools:
        arm, given, tool = wanted.rpartition("=")
        if not tool or (given and not arm) or not (arm or lone):
            allowed = f"ARM=TOOL, ARM one of {', '.join(a.name for a in rig.arms)}"
            raise InputError(f"--tool: got {wanted!r}; allowed: {allowed}")
        rig = rig_with_tool(rig, arm or lone, tool)
    return calibrated_rig(rig, list(calibrations) or None)


def _alone(name: str | Path) -> RigDescription:
    arm = load_arm(name)
    return replace(lone_arm_rig(arm), name=arm.name)


def _is_arm(name: str | Path) -> bool:
    text = str(name)
    if not text.endswith(".toml"):
        if text not in (*names("arms"), *names("rigs")):
            known = sorted({*names("arms"), *names("rigs")})
            raise UnknownNameError("arm or rig", text, known)
        return text in names("arms")
    try:
        with Path(name).expanduser().open("rb") as file:
            return "arm" not in tomllib.load(file)
    except (OSError, ValueError):
        return True  # load_arm says what is wrong with it
