"""An arm's description as one document, in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import TYPE_CHECKING, Any

from trocar.cli.output import plain
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.descriptions import ArmDescription
    from trocar.kinematics.mechanism import Frame

Document = dict[str, Any]


def document(arm: ArmDescription) -> Document:
    """Return what a description says, as JSON has it."""
    mechanism = arm.mechanism
    return plain(
        {
            "arm": arm.name,
            "type": arm.type,
            "generation": arm.generation,
            "title": arm.title,
            "tool": arm.tool or None,
            "file": arm.file,
            "calibration": _calibration(arm),
            "source": " ".join(arm.source.split()),
            "root": arm.root,
            "relative_to": mechanism.reference,
            "tip": mechanism.tip,
            "inverse_kinematics": arm.inverse_kinematics or None,
            "joints": [{**asdict(j), "drive": dict(j.drive)} for j in arm.joints],
            "frames": _frames(arm),
            "closures": _closures(arm),
            "bodies": _bodies(arm),
            "friction": _nested(arm.friction),
            "rotor": arm.rotor,
            "control": _nested(arm.control),
            "coupling": _coupling(arm),
            "poses": arm.poses,
            "sources": arm.block_sources,
            "missing": [asdict(entry) for entry in arm.missing],
        }
    )


def _calibration(arm: ArmDescription) -> Document | None:
    """Return where the arm's own geometry comes from, None of a nominal arm."""
    overlay = arm.overlay
    if overlay is None:
        return None
    return {
        "file": overlay.file,
        "closure": overlay.closure,
        "frames": list(overlay.frames),
        "closures": list(overlay.closures),
        "source": dict(overlay.source),
        "warnings": list(overlay.warnings),
    }


def _frames(arm: ArmDescription) -> list[Document]:
    import numpy as np

    # Only a standard row has a part that comes after its motion; some rows are of both kinds.
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
    """Return the DH row that places a frame at q = 0, None when it is not placed by one."""
    from trocar.geometry import modified_dh_parameters, standard_dh_parameters

    read = standard_dh_parameters if convention == "standard" else modified_dh_parameters
    try:
        a, alpha, d, theta = read(frame.before @ frame.after)
        if convention == "standard":
            standard_dh_parameters(frame.before)  # the motion is about its z axis
    except InputError:
        return None
    return {"convention": convention, "a": a, "alpha": alpha, "d": d, "theta": theta}


def _closures(arm: ArmDescription) -> list[Document]:
    from trocar.kinematics.loops import flattenings

    flat = [asdict(f) for f in flattenings(arm.mechanism)]
    return [
        {**asdict(c), "flattenings": [f for f in flat if f["closure"] == c.name]}
        for c in arm.mechanism.closures
    ]


def _bodies(arm: ArmDescription) -> list[Document]:
    keys = ("frame", "part", "mass", "com", "inertia", "inertia_from", "source")
    return [
        {**{key: getattr(body, key) for key in keys}, "shapes": len(body.shapes)}
        for body in arm.bodies
    ]


def _nested(models: Mapping[str, Any]) -> Document:
    """Return named records, and records of records, as dictionaries."""
    return {
        name: asdict(entry) if is_dataclass(entry) else _nested(entry)  # type: ignore[arg-type]
        for name, entry in models.items()
    }


def _coupling(arm: ArmDescription) -> dict[str, Any] | None:
    if arm.coupling is None:
        return None
    return {"joints": arm.coupling.joints, "actuator_to_joint": arm.coupling.actuator_to_joint}
