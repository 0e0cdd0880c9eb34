"""The arms, tools, rigs and cameras that come with trocar."""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from typing import Any

from trocar.cli.arguments import add_json
from trocar.cli.output import print_json, table

SHELVES = ("arms", "tools", "rigs", "cameras")


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument(
        "shelf", metavar="|".join(SHELVES), nargs="?", choices=SHELVES, help="default: all of them"
    )
    add_json(parser)


def run(args: Namespace) -> int:
    """Print what there is."""
    wanted = [args.shelf] if args.shelf else SHELVES
    found = {shelf: _SHELVES[shelf]() for shelf in wanted}
    if args.json:
        print_json(found)
    else:
        print("\n\n".join(_report(shelf, rows) for shelf, rows in found.items()))
    return 0


def _arms() -> list[dict[str, Any]]:
    from trocar.descriptions import load_arm, names

    return [
        {
            "name": arm.name,
            "type": arm.type,
            "generation": arm.generation,
            "tool": arm.tool or None,
            "joints": arm.own_joints,
            "title": arm.title,
        }
        for arm in map(load_arm, names("arms"))
    ]


def _tools() -> list[dict[str, Any]]:
    from trocar.descriptions import load_tool, names

    return [
        {"name": t.name, "fits": list(t.fits), "title": t.title}
        for t in map(load_tool, names("tools"))
    ]


def _rigs() -> list[dict[str, Any]]:
    from trocar.descriptions import load_rig, names

    return [
        {"name": rig.name, "arms": [arm.name for arm in rig.arms], "title": rig.title}
        for rig in map(load_rig, names("rigs"))
    ]


def _cameras() -> list[dict[str, Any]]:
    from trocar.descriptions.cameras import load_camera, presets

    return [
        {
            "name": name,
            "size": list(camera.eyes[0].size),
            "fov_deg": [round(math.degrees(angle), 1) for angle in camera.eyes[0].fov],
            "baseline_mm": 1e3 * camera.baseline if camera.baseline else None,
            "title": camera.title,
        }
        for name, camera in ((name, load_camera(name)) for name in presets())
    ]


_SHELVES = {"arms": _arms, "tools": _tools, "rigs": _rigs, "cameras": _cameras}


def _report(shelf: str, rows: list[dict[str, Any]]) -> str:
    head = [shelf[:-1], *(key for key in rows[0] if key != "name")]
    return table(head, [[_cell(value) for value in row.values()] for row in rows], indent="")


def _cell(value: Any) -> str:
    return (
        " ".join(map(str, value))
        if isinstance(value, list)
        else str(value if value is not None else "-")
    )
