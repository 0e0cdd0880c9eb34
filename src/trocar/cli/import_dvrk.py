"""Import a lab's dVRK configuration as a rig.

Reads system-*.json (console-*.json before dVRK 2.4) and the files it references: arms, base
frames, setup joints, instruments, gains, teleoperation. Writes a rig file for `trocar sim --rig`,
and a description of each arm that differs from the built-in ones. Parts of the configuration that
the rig does not simulate are listed. See docs/your-lab.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, add_overwrite, options
from trocar.cli.output import print_json, table, warn

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
    if args.json:
        print_json(_document(found))
        return 0
    rows = [
        (arm.name, Path(arm.arm.file).stem, arm.arm.tool or "-", arm.on or "world")
        for arm in found.rig.arms
    ]
    print(table(("arm", "description", "tool", "carrier"), rows))
    for teleop in found.rig.teleops:
        move = "moves" if len(teleop.masters) == 1 else "move"
        print(f"  {' and '.join(teleop.masters)} {move} {teleop.slave}, scale {teleop.scale:g}")
    for text in found.notes:
        print(f"  {text}")
    if found.idle:
        print("not simulated:", *found.idle, sep="\n  ")
    print("largest difference from the files:")
    rows = [
        (kind.replace("_", " "), str(gap.count), f"{gap.metres:.1e}", f"{gap.radians:.1e}")
        for kind, gap in found.agreement.items()
        if gap.count
    ]
    print(table(("compared", "arms", "position [m]", "angle [rad]"), rows))
    print("written:", *found.files, sep="\n  ")
    return 0


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
        "teleops": [asdict(teleop) for teleop in found.rig.teleops],
        "said": found.notes,
        "warnings": found.warnings,
        "not_simulated": found.idle,
        "unknown": found.unknown,
        "agreement": {kind: asdict(gap) for kind, gap in found.agreement.items()},
    }
