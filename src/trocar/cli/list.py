"""List the built-in arms, tools, rigs, cameras and scenes."""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from typing import Any, cast

from trocar.cli.arguments import add_json
from trocar.cli.output import print_result, table

SUMMARY = "list built-in arms, tools, rigs, cameras and scenes"
ORDER = 140

SHELVES = ("arms", "tools", "rigs", "cameras", "scenes")


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument(
        "shelf",
        metavar="|".join(SHELVES),
        nargs="?",
        choices=SHELVES,
        help="kind to list (default: all)",
    )
    add_json(parser)


def run(args: Namespace) -> int:
    """Print the catalogue."""
    readers = {
        "arms": _arms,
        "tools": _tools,
        "rigs": _rigs,
        "cameras": _cameras,
        "scenes": _scenes,
    }
    found = {shelf: readers[shelf]() for shelf in ([args.shelf] if args.shelf else SHELVES)}
    print_result(args, found, lambda: "\n\n".join(_report(*shelf) for shelf in found.items()))
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


def _scenes() -> list[dict[str, Any]]:
    from trocar.descriptions import names
    from trocar.descriptions.catalogue import load_scene

    return [
        {"name": s.name, "arms": list(s.arms), "time_limit_s": s.time_limit, "title": s.title}
        for s in map(load_scene, names("scenes"))
    ]


def _report(shelf: str, rows: list[dict[str, Any]]) -> str:
    head = [shelf[:-1], *(key for key in rows[0] if key != "name")]
    cells = [
        [
            " ".join(map(str, cast("list[object]", v)))
            if isinstance(v, list)
            else str("-" if v is None else v)
            for v in row
        ]
        for row in (row.values() for row in rows)
    ]
    return table(head, cells, indent="")
