"""The document of an arm as tables for people."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from textwrap import fill
from typing import Any

from trocar.cli.output import short, table

Document = dict[str, Any]

LENGTH = {"revolute": "rad", "prismatic": "m"}
WIDTH = 110  # of what is running text
EFFORT = {"revolute": "N m", "prismatic": "N"}


def report(arm: Document) -> str:
    """Lay out everything, section by section."""
    return "\n\n".join(_sections(arm))


def _sections(arm: Document) -> Iterator[str]:
    yield _head(arm)
    yield "Joints\n" + _joints(arm["joints"])
    yield "Frames: where each stands in its parent at q = 0\n" + _frames(arm["frames"])
    if arm["closures"]:
        yield "Loops: where their hinges are, and where they would flatten\n" + _loops(arm)
    if arm["bodies"]:
        total = sum(body["mass"] for body in arm["bodies"])
        yield f"Bodies: {short(total)} kg in all\n{_bodies(arm['bodies'])}"
    if arm["friction"]:
        yield "Friction\n" + _friction(arm["friction"])
    if arm["rotor"]:
        rows = [[name, short(value)] for name, value in arm["rotor"].items()]
        yield "Rotors, as the frame feels them\n" + table(["frame", "[kg m^2, kg]"], rows)
    for control in arm["control"].values():
        yield f"{_preset(control)}\n{_control(control, arm['joints'])}"
    if arm["coupling"]:
        yield "Coupling: joints from actuators [rad]\n" + _coupling(arm["coupling"])
    if arm["poses"]:
        yield "Named poses [rad, slides m]\n" + _poses(arm)
    if arm["missing"]:
        rows = [[entry["what"], entry["why"]] for entry in arm["missing"]]
        yield "Not known\n" + table(["what", "why"], rows)
    yield "Sources\n" + "\n".join(_sources(arm))


def _head(arm: Document) -> str:
    rows = [
        ("type", f"{arm['type']}, {arm['generation'] or 'no generation'}"),
        ("tool", arm["tool"] or "none"),
        ("root", f"{arm['root']} (the frame that is mounted)"),
        ("poses", f"of the tip {arm['tip']} in {arm['relative_to']}"),
        ("inverse", arm["inverse_kinematics"] or "no closed form"),
        ("file", arm["file"]),
    ]
    if arm["calibration"] is not None:
        rows.append(("overlay", f"{arm['calibration']['file']} ({arm['calibration']['closure']})"))
    return "\n".join(
        [f"{arm['arm']}: {arm['title']}", *(f"  {key:<8} {text}" for key, text in rows)]
    )


def _joints(joints: list[Document]) -> str:
    rows = [
        [
            j["name"],
            _amount(j["lower"], LENGTH[j["kind"]]),
            _amount(j["upper"], LENGTH[j["kind"]]),
            _amount(j["effort_max"], EFFORT[j["kind"]]),
            _amount(j["velocity_max"], f"{LENGTH[j['kind']]}/s"),
            _amount(j["acceleration_max"], f"{LENGTH[j['kind']]}/s^2"),
            _sum(j["drive"]),
        ]
        for j in joints
    ]
    head = ["joint", "lower", "upper", "effort at most", "speed", "acceleration", "hinge"]
    return table(head, rows)


def _frames(frames: list[Document]) -> str:
    rows = [[f["name"], f["parent"] or "-", _motion(f), _place(f)] for f in frames]
    return table(["frame", "parent", "moves", "placed"], rows)


def _motion(frame: Document) -> str:
    verb = {"fixed": "fixed", "revolute": "turns by ", "prismatic": "slides by "}[frame["motion"]]
    if frame["motion"] != "fixed" and not frame["couplings"]:
        return "slides as its loop has it"
    return verb + _sum(frame["couplings"]) if frame["couplings"] else verb


def _place(frame: Document) -> str:
    """Write a frame's place: its DH row, or position and angles; what is 0 is left out."""
    if frame["parent"] is None:
        return "-"
    units = {"a": "m", "alpha": "rad", "d": "m", "theta": "rad"}
    if frame["dh"] is not None:
        row = [f"{k} {_amount(frame['dh'][k], u)}" for k, u in units.items() if frame["dh"][k]]
        return f"{frame['dh']['convention']} DH: {', '.join(row)}" if row else "on its parent"
    import numpy as np

    from trocar.geometry import rpy_from_matrix

    pose = np.array(frame["pose"])
    parts = []
    if pose[:3, 3].any():
        parts.append(f"xyz {_vector(pose[:3, 3])} m")
    if (pose[:3, :3] != np.eye(3)).any():
        parts.append(f"rpy {_vector(rpy_from_matrix(pose[:3, :3]))} rad")
    return ", ".join(parts) or "on its parent"


def _loops(arm: Document) -> str:
    rows = [
        [
            c["name"],
            f"{c['frame_a']} {_vector(c['point_a'])}",
            f"{c['frame_b']} {_vector(c['point_b'])}",
            f["joint"],
            short(f["below"]),
            short(f["above"]),
            short(f["margin"]),
        ]
        for c in arm["closures"]
        for f in c["flattenings"]
    ]
    head = ["hinge", "on [m]", "and on [m]", "flat at", "below", "above", "from the limits [rad]"]
    return table(head, rows)


def _bodies(bodies: list[Document]) -> str:
    rows = [
        [
            b["frame"],
            b["part"],
            short(b["mass"]),
            *(f"{v + 0.0:.5f}" for v in b["com"]),
            *(f"{b['inertia'][i][i]:.4g}" for i in range(3)),
            b["inertia_from"],
        ]
        for b in bodies
    ]
    head = ["frame", "of", "mass [kg]", "com x", "y", "z [m]", "ixx", "iyy", "izz [kg m^2]", "from"]
    return table(head, rows)


def _friction(models: Document) -> str:
    rows = [
        [model, name, short(entry["coulomb"]), short(entry["viscous"])]
        for model, entries in models.items()
        for name, entry in entries.items()
    ]
    return table(["model", "at", "dry [N m, N]", "viscous [N m s/rad, N s/m]"], rows)


def _control(control: Document, joints: list[Document]) -> str:
    rows = [
        [j["name"], *(short(control["pid"][j["name"]][key]) for key in "pid"), EFFORT[j["kind"]]]
        for j in joints
        if j["name"] in control["pid"]
    ]
    return table(["joint", "P", "I", "D", "of"], rows)


def _preset(control: Document) -> str:
    switches = {"gravity compensation": "gravity_compensation", "effort limits": "effort_limits"}
    told = [f"{name} {'on' if control[key] else 'off'}" for name, key in switches.items()]
    return f"Gains {control['name']!r}: {', '.join(told)}"


def _coupling(coupling: Document) -> str:
    joints, matrix = coupling["joints"], coupling["actuator_to_joint"]
    rows = [[name, "=", *(short(v) for v in row)] for name, row in zip(joints, matrix, strict=True)]
    return table(["", "", *(f"actuator {i + 1}" for i in range(len(joints)))], rows)


def _poses(arm: Document) -> str:
    rows = [[name, *(short(v) for v in q)] for name, q in arm["poses"].items()]
    return table(["pose", *(j["name"] for j in arm["joints"])], rows)


def _sources(arm: Document) -> Iterator[str]:
    """Say where each block is from; a source that stands for several is said once."""
    told: dict[str, list[str]] = {arm["source"]: ["all that names no other source"]}
    for kind, rows, key in (
        ("joint", arm["joints"], "name"),
        ("frame", arm["frames"], "name"),
        ("body", arm["bodies"], "frame"),
    ):
        for row in rows:
            part = f"{row['part']} " if row.get("part", arm["arm"]) != arm["arm"] else ""
            told.setdefault(row["source"], []).append(f"{part}{kind} {row[key]}")
    for block, source in arm["sources"].items():
        told.setdefault(source, []).append(block)
    told.pop("", None)
    for source, blocks in told.items():
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
    """Write a weighted sum: `yaw - 0.5 jaw`."""
    factors = {1.0: "", -1.0: "-"}
    parts = [factors.get(ratio, f"{short(ratio)} ") + name for name, ratio in terms.items()]
    return " + ".join(parts).replace("+ -", "- ")
