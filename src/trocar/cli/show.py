"""Show an arm: joint limits, frames, closed loops, masses, gains, and the source of each number.

With --picture DIR, render the arm instead: front.png, side.png and top.png in orthographic
projection, to scale, and three_quarter.png in perspective. ARM may then also be a rig.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from trocar import outputs
from trocar.cli.arguments import (
    add_arm,
    add_calibration,
    add_json,
    add_overwrite,
    allow,
    allow_overwrite,
    options,
)
from trocar.cli.output import print_result, progress_steps, short, table, warn
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.descriptions import ArmDescription, RigDescription
    from trocar.kinematics.mechanism import Frame

SUMMARY = "show an arm: joints, frames, masses, gains, sources"
ORDER = 150

Document = dict[str, Any]

WIDTH = 110  # of running text
LENGTH = {"revolute": "rad", "prismatic": "m"}
EFFORT = {"revolute": "N m", "prismatic": "N"}


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    add_arm(parser)
    add_calibration(parser)
    add_json(parser)
    options(parser, """
        --picture DIR  render four views into DIR
    """)  # fmt: skip
    add_overwrite(parser, "existing pictures in DIR")


def run(args: Namespace) -> int:
    """Print the arm's description, or render it."""
    allow_overwrite(args, "picture")
    if args.picture is not None:
        from trocar.rendering import write_pictures

        allow(args, "without --picture", "json")
        with progress_steps() as watch:
            watch(f"rendering {args.arm}")
            paths = write_pictures(_rig(args), Path(args.picture), overwrite=args.overwrite)
        for path in paths:
            print(path)
        return 0
    from trocar.descriptions import load_arm
    from trocar.kinematics.loops import NEAR_FLAT_RAD

    found = document(load_arm(args.arm, args.tool, args.calibration))
    for flat in (flat for closure in found["closures"] for flat in closure["flattenings"]):
        if flat["margin"] is not None and flat["margin"] < NEAR_FLAT_RAD:
            warn(
                f"loop {flat['closure']} is singular {short(flat['margin'])} rad from the limits"
                f" of {flat['joint']}; allowed: {NEAR_FLAT_RAD} rad or more"
            )
    print_result(args, found, lambda: report(found))
    return 0


def _rig(args: Namespace) -> RigDescription:
    """Return the named rig, or a rig with the named arm only."""
    from trocar.descriptions import load_arm, load_rig, names
    from trocar.descriptions.rigs import lone_arm_rig

    if args.arm in names("rigs") and args.arm not in names("arms"):
        allow(args, "with an arm", "tool")
        return load_rig(args.arm, args.calibration)
    return lone_arm_rig(load_arm(args.arm, args.tool, args.calibration))


def document(arm: ArmDescription) -> Document:
    """Return a description as a JSON document."""
    from trocar.kinematics.loops import flattenings

    mechanism, overlay, coupling = arm.mechanism, arm.overlay, arm.coupling
    flat = [asdict(entry) for entry in flattenings(mechanism)]
    body_keys = ("frame", "part", "mass", "com", "inertia", "inertia_from", "source")
    return outputs.document(
        {
            "arm": arm.name,
            "type": arm.type,
            "generation": arm.generation,
            "title": arm.title,
            "tool": arm.tool or None,
            "file": arm.file,
            "calibration": overlay
            and {
                "file": overlay.file,
                "closure": overlay.closure,
                "frames": list(overlay.frames),
                "closures": list(overlay.closures),
                "source": dict(overlay.source),
                "warnings": list(overlay.warnings),
            },
            "source": " ".join(arm.source.split()),
            "root": arm.root,
            "relative_to": mechanism.reference,
            "tip": mechanism.tip,
            "inverse_kinematics": arm.inverse_kinematics or None,
            "joints": [{**asdict(j), "drive": dict(j.drive)} for j in arm.joints],
            "frames": _frame_documents(arm),
            "closures": [
                {**asdict(c), "flattenings": [f for f in flat if f["closure"] == c.name]}
                for c in mechanism.closures
            ],
            "bodies": [
                {**{key: getattr(body, key) for key in body_keys}, "shapes": len(body.shapes)}
                for body in arm.bodies
            ],
            "friction": _nested(arm.friction),
            "rotor": arm.rotor,
            "control": _nested(arm.control),
            "coupling": coupling
            and {"joints": coupling.joints, "actuator_to_joint": coupling.actuator_to_joint},
            "poses": arm.poses,
            "sources": arm.block_sources,
            "missing": [asdict(entry) for entry in arm.missing],
        }
    )


def _frame_documents(arm: ArmDescription) -> list[Document]:
    import numpy as np

    # Only a standard row has a transform after its motion; some rows fit both conventions.
    standard = any((frame.after != np.eye(4)).any() for frame in arm.mechanism.frames)
    return [
        {
            "name": frame.name,
            "parent": frame.parent,
            "motion": frame.motion,
            "couplings": dict(frame.couplings),
            "dh": _dh_row(frame, "standard" if standard else "modified"),
            "pose": frame.before @ frame.after,
            "source": arm.row_sources.get(frame.name, ""),
        }
        for frame in arm.mechanism.frames
    ]


def _dh_row(frame: Frame, convention: str) -> Document | None:
    """Return the DH row of a frame at q = 0; None: its pose is no DH row."""
    from trocar.geometry import modified_dh_parameters, standard_dh_parameters

    read = standard_dh_parameters if convention == "standard" else modified_dh_parameters
    try:
        a, alpha, d, theta = read(frame.before @ frame.after)
        if convention == "standard":
            standard_dh_parameters(frame.before)  # the motion is about its z axis
    except InputError:
        return None
    return {"convention": convention, "a": a, "alpha": alpha, "d": d, "theta": theta}


def _nested(models: Mapping[str, Any]) -> Document:
    """Convert named (nested) records to dictionaries."""
    return {
        name: asdict(entry) if is_dataclass(entry) else _nested(entry)  # type: ignore[arg-type]
        for name, entry in models.items()
    }


def report(arm: Document) -> str:
    """Lay out a document, section by section."""
    return "\n\n".join(_sections(arm))


def _sections(arm: Document) -> Iterator[str]:
    head = {
        "type": f"{arm['type']}, {arm['generation'] or 'no generation'}",
        "tool": arm["tool"] or "none",
        "root": f"{arm['root']} (mounting frame)",
        "poses": f"of {arm['tip']} in {arm['relative_to']}",
        "inverse": arm["inverse_kinematics"] or "no closed form",
        "file": arm["file"],
    }
    if (overlay := arm["calibration"]) is not None:
        head["overlay"] = f"{overlay['file']} ({overlay['closure']})"
    lines = (f"  {key:<8} {text}" for key, text in head.items())
    yield "\n".join([f"{arm['arm']}: {arm['title']}", *lines])
    yield "Joints\n" + table(
        ["joint", "lower", "upper", "max effort", "max speed", "max acceleration", "hinge"],
        (
            [
                j["name"],
                _amount(j["lower"], LENGTH[j["kind"]]),
                _amount(j["upper"], LENGTH[j["kind"]]),
                _amount(j["effort_max"], EFFORT[j["kind"]]),
                _amount(j["velocity_max"], f"{LENGTH[j['kind']]}/s"),
                _amount(j["acceleration_max"], f"{LENGTH[j['kind']]}/s^2"),
                _sum(j["drive"]),
            ]
            for j in arm["joints"]
        ),
    )
    yield "Frames: pose in the parent at q = 0\n" + table(
        ["frame", "parent", "motion", "pose"],
        ([f["name"], f["parent"] or "-", _motion(f), _place(f)] for f in arm["frames"]),
    )
    if arm["closures"]:
        yield "Loops: points of the hinges, and singular joint positions\n" + table(
            ["hinge", "on [m]", "and on [m]", "joint", "singular below", "above", "margin [rad]"],
            (
                [
                    c["name"],
                    *(f"{c[f'frame_{side}']} {_vector(c[f'point_{side}'])}" for side in "ab"),
                    f["joint"],
                    *(short(f[key]) for key in ("below", "above", "margin")),
                ]
                for c in arm["closures"]
                for f in c["flattenings"]
            ),
        )
    if arm["bodies"]:
        total = sum(body["mass"] for body in arm["bodies"])
        yield f"Bodies: {short(total)} kg in total\n" + table(
            [
                "frame",
                "part",
                "mass [kg]",
                "com x",
                "y",
                "z [m]",
                "ixx",
                "iyy",
                "izz [kg m^2]",
                "inertia from",
            ],
            (
                [
                    b["frame"],
                    b["part"],
                    short(b["mass"]),
                    *(f"{v + 0.0:.5f}" for v in b["com"]),
                    *(f"{b['inertia'][i][i]:.4g}" for i in range(3)),
                    b["inertia_from"],
                ]
                for b in arm["bodies"]
            ),
        )
    if arm["friction"]:
        yield "Friction\n" + table(
            ["model", "at", "Coulomb [N m, N]", "viscous [N m s/rad, N s/m]"],
            (
                [model, name, short(entry["coulomb"]), short(entry["viscous"])]
                for model, entries in arm["friction"].items()
                for name, entry in entries.items()
            ),
        )
    if arm["rotor"]:
        rows = [[name, short(value)] for name, value in arm["rotor"].items()]
        yield "Rotor inertia, reflected to the frame\n" + table(["frame", "[kg m^2, kg]"], rows)
    for control in arm["control"].values():
        switches = {
            "gravity compensation": "gravity_compensation",
            "effort limits": "effort_limits",
        }
        on = [f"{name} {'on' if control[key] else 'off'}" for name, key in switches.items()]
        rows = [
            [j["name"], *(short(pid[key]) for key in "pid"), EFFORT[j["kind"]]]
            for j in arm["joints"]
            if (pid := control["pid"].get(j["name"]))
        ]
        gains = table(["joint", "P", "I", "D", "effort"], rows)
        yield f"Gains {control['name']!r}: {', '.join(on)}\n{gains}"
        observers, caps = dict(control["observer"]), control["pid_output_max"]
        for k, disc in enumerate(control["disc_observer"]):
            observers[f"disc {k + 1}"] = disc
        if observers or caps:
            head = ["motor", "nominal mass [kg m^2, kg]", "cut-off [rad/s]", "cap [N m, N]"]
            none = {"mass": None, "cutoff": None}
            rows = [
                [name, *map(short, observers.get(name, none).values()), short(caps.get(name))]
                for name in dict.fromkeys((*observers, *caps))
            ]
            yield "Disturbance observers, and caps of PID and observer\n" + table(head, rows)
    if (coupling := arm["coupling"]) is not None:
        joints, matrix = coupling["joints"], coupling["actuator_to_joint"]
        yield "Coupling: joints from actuators [rad]\n" + table(
            ["", "", *(f"actuator {i + 1}" for i in range(len(joints)))],
            ([name, "=", *map(short, row)] for name, row in zip(joints, matrix, strict=True)),
        )
    if arm["poses"]:
        rows = [[name, *map(short, q)] for name, q in arm["poses"].items()]
        names = (j["name"] for j in arm["joints"])
        yield "Named poses [rad, m if prismatic]\n" + table(["pose", *names], rows)
    if arm["missing"]:
        rows = [[entry["what"], entry["why"]] for entry in arm["missing"]]
        yield "Missing values\n" + table(["value", "reason"], rows)
    yield "Sources\n" + "\n".join(_sources(arm))


def _motion(frame: Document) -> str:
    verb = {"fixed": "fixed", "revolute": "turns by ", "prismatic": "slides by "}[frame["motion"]]
    if frame["motion"] != "fixed" and not frame["couplings"]:
        return "slides by its loop"
    return verb + _sum(frame["couplings"]) if frame["couplings"] else verb


def _place(frame: Document) -> str:
    """Format a frame's pose: DH row, or position and angles; omit zeros."""
    if frame["parent"] is None:
        return "-"
    units = {"a": "m", "alpha": "rad", "d": "m", "theta": "rad"}
    if frame["dh"] is not None:
        row = [f"{k} {_amount(frame['dh'][k], u)}" for k, u in units.items() if frame["dh"][k]]
        return f"{frame['dh']['convention']} DH: {', '.join(row)}" if row else "on its parent"
    import numpy as np

    from trocar.geometry import rpy_from_matrix

    pose = np.array(frame["pose"])
    parts: list[str] = []
    if pose[:3, 3].any():
        parts.append(f"xyz {_vector(pose[:3, 3])} m")
    if (pose[:3, :3] != np.eye(3)).any():
        parts.append(f"rpy {_vector(rpy_from_matrix(pose[:3, :3]))} rad")
    return ", ".join(parts) or "on its parent"


def _sources(arm: Document) -> Iterator[str]:
    """Format the sources, each once with all blocks it applies to."""
    blocks_of: dict[str, list[str]] = {arm["source"]: ["default"]}
    for kind, rows, key in (
        ("joint", arm["joints"], "name"),
        ("frame", arm["frames"], "name"),
        ("body", arm["bodies"], "frame"),
    ):
        for row in rows:
            part = f"{row['part']} " if row.get("part", arm["arm"]) != arm["arm"] else ""
            blocks_of.setdefault(row["source"], []).append(f"{part}{kind} {row[key]}")
    for block, source in arm["sources"].items():
        blocks_of.setdefault(source, []).append(block)
    blocks_of.pop("", None)
    for source, blocks in blocks_of.items():
        yield _paragraph(", ".join(blocks) + ":", "  ") + "\n" + _paragraph(source, " " * 6)


def _paragraph(text: str, indent: str) -> str:
    return fill(
        " ".join(text.split()),
        WIDTH,
        initial_indent=indent,
        subsequent_indent=indent,
        break_on_hyphens=False,
        break_long_words=False,
    )


def _amount(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{short(value)} {unit}"


def _vector(values: Iterable[float]) -> str:
    return f"({', '.join(short(value) for value in values)})"


def _sum(terms: Mapping[str, float]) -> str:
    """Format a weighted sum: `yaw - 0.5 jaw`."""
    factors = {1.0: "", -1.0: "-"}
    parts = [factors.get(ratio, f"{short(ratio)} ") + name for name, ratio in terms.items()]
    return " + ".join(parts).replace("+ -", "- ")
