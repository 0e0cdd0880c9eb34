"""Import a lab's dVRK configuration as a rig.

Reads system-*.json (console-*.json before dVRK 2.4) and the files it references: arms, base
frames, setup joints, instruments, gains, teleoperation. Writes a rig file for `trocar sim --rig`,
and a description of each arm that differs from the built-in ones. Parts of the configuration that
the rig does not simulate are listed. See docs/your-lab.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, add_overwrite, options
from trocar.cli.output import print_result, table, warn

if TYPE_CHECKING:
    from trocar.robot.dvrk_config import ImportedRig

SUMMARY = "import a lab's dVRK configuration as a rig"
ORDER = 180


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        system SYSTEM.json             system-*.json file of the dVRK
        -o,--output RIG.toml required  rig file to write
        --share DIR ...                also search DIR for referenced files, e.g.
                                       sawIntuitiveResearchKit/share (repeatable)
        --tool PSM=TOOL:tool ...       mount TOOL in place of the configured instrument (repeatable)
        --literal                      read 1.5708 literally, not as pi/2
    """, tool=_tool)  # fmt: skip
    add_overwrite(parser, "existing files")
    add_json(parser)


def _tool(text: str) -> tuple[str, str]:
    name, equals, tool = text.partition("=")
    if not (name and equals and tool):
        raise ArgumentTypeError(
            f"got {text!r}; allowed: PSM=TOOL, e.g. PSM1=PROGRASP_FORCEPS:400093"
        )
    return name, tool


def run(args: Namespace) -> int:
    """Read, write, print."""
    from trocar.robot.dvrk_config import RigImportOptions, import_dvrk

    options = RigImportOptions(
        tuple(Path(folder) for folder in args.share), tuple(args.tool), args.literal, args.overwrite
    )
    found = import_dvrk(args.system, args.output, options)
    for text in (*found.warnings, *(f"unknown key, ignored: {text}" for text in found.unknown)):
        warn(text)
    print_result(args, _document(found), lambda: _text(found))
    return 0


def _text(found: ImportedRig) -> str:
    head = ("arm", "description", "tool", "carrier")
    arms = [
        (arm.name, Path(arm.arm.file).stem, arm.arm.tool or "-", arm.on or "world")
        for arm in found.rig.arms
    ]
    lines = [table(head, arms)]
    for teleop in found.rig.teleops:
        move = "moves" if len(teleop.masters) == 1 else "move"
        masters = " and ".join(teleop.masters)
        lines.append(f"  {masters} {move} {teleop.slave}, scale {teleop.scale:g}")
    lines += [f"  {text}" for text in found.notes]
    if found.idle:
        lines += ["not simulated:", *(f"  {text}" for text in found.idle)]
    gaps = [
        (kind.replace("_", " "), str(gap.count), f"{gap.metres:.1e}", f"{gap.radians:.1e}")
        for kind, gap in found.agreement.items()
        if gap.count
    ]
    lines.append("largest difference from the files:")
    lines.append(table(("compared", "arms", "position [m]", "angle [rad]"), gaps))
    return "\n".join([*lines, "written:", *(f"  {file}" for file in found.files)])


def _document(found: ImportedRig) -> dict[str, object]:
    arms = [
        {
            "name": arm.name,
            "type": arm.arm.type,
            "description": arm.arm.file,
            "tool": arm.arm.tool,
            "on": arm.on or "world",
        }
        for arm in found.rig.arms
    ]
    return {
        "rig": found.files[0],
        "files": found.files,
        "arms": arms,
        "teleops": found.rig.teleops,
        "said": found.notes,
        "warnings": found.warnings,
        "not_simulated": found.idle,
        "unknown": found.unknown,
        "agreement": found.agreement,
    }
