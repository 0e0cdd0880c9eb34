"""The metadata of a recording: its format, the versions, the world's arguments, and its rig."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np

from trocar import __version__
from trocar.descriptions.calibrated import rig_overlays
from trocar.descriptions.overlay import overlay_text
from trocar.descriptions.records import RigDescription
from trocar.recording.entries import plain
from trocar.simulation import World

#: Version of the trocar channels and metadata; the reader rejects every other one.
FORMAT = 3

#: Keys that every recording has.
ABOUT = {
    *("trocar", "mujoco", "numpy", "machine", "rig", "rig_source", "rig_fingerprint"),
    *("arguments", "timestep_s", "start_s", "start_period", "repeatable"),
}

#: Fields that were added to the records later: left out of the fingerprint where they are empty or
#: as they are by default.
YOUNGER = {
    *("movable", "friction", "density", "stiffness", "joint", "bands", "prop", "grasp"),
    "errors",
}
#: Fields that name Python files, whose content counts; left out likewise.
SCRIPTS = {"script", "extension"}
#: Records that were renamed: the names in the fingerprints of older recordings.
FIRST_NAMES = {"TwistSensor": "Twist"}
#: Fields that motion does not depend on: origins, titles, cameras. Dynamics are in the bodies, and
#: in overlays, which are kept whole.
REMARKS = {"file", "source", "title", "calibration", "overlay", "cameras", "dynamics"}


def world_metadata(world: World) -> dict[str, str]:
    """Return the metadata by which a replay builds the same world and compares versions."""
    overlays = rig_overlays(world.first_rig)
    texts = {arm: [overlay.file, overlay_text(overlay)] for arm, overlay in overlays.items()}
    return {
        "format": str(FORMAT),
        **versions(),
        "rig": world.first_rig.name,
        "rig_source": world.rig_source,
        "rig_fingerprint": rig_fingerprint(world.first_rig),
        "arguments": json.dumps({k: plain(v) for k, v in world.arguments.items()}),
        # Overlays are kept whole, since their files may change or go.
        **({"calibration": json.dumps(texts)} if texts else {}),
        "timestep_s": repr(world.timestep),
        "start_s": repr(world.time),
        "start_period": str(world.periods),
        "repeatable": world.past.incomplete or "yes",
    }


def versions() -> dict[str, str]:
    """Return the versions that the last bits of a motion may depend on."""
    return {
        "trocar": __version__,
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "machine": platform.machine(),
    }


def rig_fingerprint(rig: RigDescription) -> str:
    """Return a fingerprint of everything in a rig that motion depends on.

    Rigs that were read from different files have the same one if they are equal to the last digit.
    """
    digest = hashlib.sha256()
    for piece in _pieces(rig):
        digest.update(piece)
    return digest.hexdigest()


def _pieces(value: object) -> list[bytes]:
    """Return the parts of a value as bytes, in an order that does not depend on the run."""
    if dataclasses.is_dataclass(value):
        fields = [f.name for f in dataclasses.fields(value) if f.name not in REMARKS]
        name = type(value).__name__
        found = [FIRST_NAMES.get(name, name).encode()]
        for name in fields:
            part = getattr(value, name)
            if name in YOUNGER | SCRIPTS and part in (None, (), "", "friction+stick"):
                continue
            if name in SCRIPTS:
                part = Path(part).read_text(encoding="utf-8")
            found += [name.encode(), *_pieces(part)]
        return found
    if isinstance(value, np.ndarray):
        array = cast("np.ndarray[Any, Any]", value)
        return [str(array.shape).encode(), array.tobytes()]
    if isinstance(value, Mapping):
        items = cast(Mapping[object, object], value).items()
        ordered = sorted(((str(k), v) for k, v in items), key=lambda pair: pair[0])
        return [p for key, item in ordered for p in (key.encode(), b":", *_pieces(item))]
    if isinstance(value, list | tuple):
        return [b"[", *(p for v in cast(list[object], value) for p in _pieces(v)), b"]"]
    return [repr(value).encode(), b";"]
