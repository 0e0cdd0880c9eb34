"""Foreign robots and objects as files of ours: TOML, and meshes beside it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.foreign.bodies import ForeignBody
from trocar.apps.foreign.layout import Layout
from trocar.apps.foreign.records import ForeignShape
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.table import toml_text
from trocar.geometry.rotations import rpy_from_matrix
from trocar.kinematics.mechanism import Frame

Array = NDArray[np.float64]
Gains = Mapping[str, tuple[float, float, float]]

MESHES = "meshes"


class MeshStore:
    """The meshes of one import, each once, by the file that it will have."""

    def __init__(self) -> None:
        self.files: dict[str, Mesh] = {}

    def file(self, name: str, mesh: Mesh) -> str:
        """Return the file of a mesh, relative to the TOML."""
        path = f"{MESHES}/{name}.obj"
        self.files[path] = mesh
        return path


def obj_text(mesh: Mesh) -> str:
    """Return a mesh as OBJ in millimetres; numbers come back to the last bit or nearly."""
    corners = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in (1e3 * mesh.vertices).tolist())
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist())
    return f"# millimetres\n{corners}{faces}"


def arm_text(
    layout: Layout, bodies: Iterable[ForeignBody], head: Mapping[str, Any], store: MeshStore,
    gains: Gains | None = None,
) -> str:  # fmt: skip
    """Return an arm's file.

    Args:
        layout: its mechanism
        bodies: masses and shapes, in its frames
        head: name, title, source
        store: takes the meshes
        gains: {joint: (P, I, D)} [SI]
    """
    mechanism = layout.mechanism
    joints: list[dict[str, Any]] = []
    for joint in mechanism.joints:
        unit = "rad" if joint.kind == "revolute" else "m"
        found = layout.sources[joint.name]
        row: dict[str, Any] = {"name": joint.name, "kind": joint.kind}
        row |= {f"lower_{unit}": joint.lower, f"upper_{unit}": joint.upper}
        if np.isfinite(found.effort):
            row["effort_max_nm" if unit == "rad" else "effort_max_n"] = found.effort
        if np.isfinite(found.velocity):
            row[f"velocity_max_{unit}_s"] = found.velocity
        joints.append({**row, "drive": dict(joint.drive)})
    closures = [
        {
            "name": closure.name,
            "frame_a": closure.frame_a,
            "point_a_m": closure.point_a,
            "frame_b": closure.frame_b,
            "point_b_m": closure.point_b,
            "passive": list(closure.passive),
        }
        for closure in mechanism.closures
    ]
    control = {
        "source": "our own choice: what closes each joint's loop in a tenth of a second;"
        " trocar tune makes better ones",
        "gravity_compensation": True,
        "pid": {name: list(values) for name, values in (gains or {}).items()},
    }
    friction = _friction(layout)
    still = np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)
    return toml_text(
        {
            "schema": 1,
            **head,
            "type": "OTHER",
            "root": mechanism.reference,
            "relative_to": mechanism.reference,
            "tip": mechanism.tip,
            "joint": joints,
            "frame": [_frame_row(frame) for frame in mechanism.frames],
            "closure": closures or None,
            "body": [_body_row(body, store) for body in bodies],
            "friction": {"identified": {"source": "the file", **friction}} if friction else None,
            "control": {"dvrk": control} if gains else None,
            "pose": [{"name": "home", "q_rad_m": still}],
        }
    )


def prop_text(bodies: Iterable[ForeignBody], head: Mapping[str, Any], store: MeshStore) -> str:
    """Return a prop's file: bodies in one frame."""
    return toml_text({"schema": 1, **head, "body": [_body_row(body, store) for body in bodies]})


def _frame_row(frame: Frame) -> dict[str, Any]:
    row: dict[str, Any] = {"name": frame.name}
    if frame.parent is not None:
        row["parent"] = frame.parent
    row |= _pose_row("xyz_m", frame.before)
    if frame.motion != "fixed":
        row |= {"motion": frame.motion, "q": dict(frame.couplings)}
    return row


def _pose_row(key: str, pose: Array) -> dict[str, Any]:
    row: dict[str, Any] = {}
    if pose[:3, 3].any():
        row[key] = pose[:3, 3]
    if not np.array_equal(pose[:3, :3], np.eye(3)):
        row["rotation"] = pose[:3, :3]
    return row


def _body_row(body: ForeignBody, store: MeshStore) -> dict[str, Any]:
    i = body.inertia
    shapes = [_shape_row(shape, f"{body.link}_{k}", store) for k, shape in enumerate(body.shapes)]
    return {
        "frame": body.frame,
        "mass_kg": body.mass,
        "com_m": body.com,
        "inertia_kgm2": [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]],
        "source": body.source,
        "shape": shapes or None,
    }


def _shape_row(shape: ForeignShape, name: str, store: MeshStore) -> dict[str, Any]:
    own = shape.shape
    row: dict[str, Any] = {"kind": own.kind}
    turn, at = own.pose[:3, :3], own.pose[:3, 3]
    if own.mesh is not None:
        row |= {"file": store.file(name, own.mesh), "center_m": at, **_turn(turn)}
    elif own.kind == "box":
        row |= {"center_m": at, "size_m": 2.0 * own.size, **_turn(turn)}
    elif own.kind == "sphere":
        row |= {"center_m": at, "radius_m": float(own.size[0])}
    else:
        along = float(own.size[1]) * turn[:, 2]
        row |= {"from_m": at - along, "to_m": at + along, "radius_m": float(own.size[0])}
    row |= {"material": own.material, "collide": shape.collide}
    return row if shape.visible else {**row, "visible": False}


def _turn(turn: Array) -> dict[str, Any]:
    return {} if np.array_equal(turn, np.eye(3)) else {"rpy_rad": rpy_from_matrix(turn)}


def _friction(layout: Layout) -> dict[str, Any]:
    """Return {joint: its friction} of the joints that have some."""
    rows: dict[str, Any] = {}
    for name, joint in layout.sources.items():
        turns = joint.kind == "revolute"
        row: dict[str, Any] = {}
        if joint.friction:
            row["coulomb_nm" if turns else "coulomb_n"] = joint.friction
        if joint.damping:
            row["viscous_nms" if turns else "viscous_ns_per_m"] = joint.damping
        if row:
            rows[name] = row
    return rows
