"""Pack coloured triangles as binary glTF, the format in which the browser takes them.

Source: glTF 2.0 specification, Khronos Group, sections 3 (JSON) and 4 (GLB container).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FLOAT, UNSIGNED_INT = 5126, 5125
"""glTF component types."""


@dataclass(frozen=True)
class Finish:
    """How a surface answers to light.

    Args:
        rgba: colour, sRGB and opacity, each 0..1
        metallic: 0 plastic or paint, 1 bare metal
        roughness: 0 mirror, 1 chalk
    """

    rgba: tuple[float, float, float, float]
    metallic: float
    roughness: float


@dataclass(frozen=True)
class Part:
    """Triangles of one finish.

    Args:
        vertices: (n, 3) [m]
        faces: (m, 3)
        finish: how they answer to light
        normals: the surface's at the vertices, (n, 3); without them each triangle is drawn flat
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    finish: Finish
    normals: NDArray[np.float64] | None = None


def pack(parts: Sequence[Part]) -> bytes:
    """Write the parts as one glTF mesh in a GLB container."""
    blob = b""
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    primitives: list[dict[str, Any]] = []
    for material, part in enumerate(parts):
        first = len(accessors)
        for array, accessor in _accessors(part):
            views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": array.nbytes})
            accessors.append({"bufferView": len(views) - 1, **accessor})
            blob += array.tobytes()
        attributes = {"POSITION": first}
        if part.normals is not None:
            attributes["NORMAL"] = first + 1
        last = len(accessors) - 1
        primitives.append({"attributes": attributes, "indices": last, "material": material})
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": primitives}],
        "materials": [_material(part.finish) for part in parts],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    text = json.dumps(document).encode()
    chunks = _chunk(b"JSON", text + b" " * (-len(text) % 4)) + _chunk(b"BIN\0", blob)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _accessors(part: Part) -> Iterator[tuple[NDArray[Any], dict[str, Any]]]:
    points = part.vertices.astype("<f4")
    indices = part.faces.astype("<u4").ravel()
    bounds = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    yield points, {"componentType": FLOAT, "count": len(points), "type": "VEC3", **bounds}
    if part.normals is not None:
        normals = part.normals.astype("<f4")
        yield normals, {"componentType": FLOAT, "count": len(normals), "type": "VEC3"}
    yield indices, {"componentType": UNSIGNED_INT, "count": indices.size, "type": "SCALAR"}


def _material(finish: Finish) -> dict[str, Any]:
    *rgb, alpha = finish.rgba
    linear = [_linear_from_srgb(value) for value in rgb]
    material: dict[str, Any] = {
        "pbrMetallicRoughness": {
            "baseColorFactor": [*linear, alpha],
            "metallicFactor": finish.metallic,
            "roughnessFactor": finish.roughness,
        }
    }
    if alpha < 1.0:
        material["alphaMode"] = "BLEND"
    return material


def _linear_from_srgb(value: float) -> float:
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack("<I4s", len(data), kind) + data
