"""Setup joints of a lab as arms of trocar's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.apps.labs import documents
from trocar.apps.labs.arm_files import Files
from trocar.apps.labs.numbers import chain_tip
from trocar.apps.labs.records import SetupArm
from trocar.apps.labs.stand_ins import SOURCE, link_bodies
from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.table import toml_text
from trocar.errors import DescriptionError
from trocar.geometry.se3 import pose_difference
from trocar.kinematics.forward import pose

Array = NDArray[np.float64]

#: Setup joints without limits of their own: how far they go [m, rad]. Source: our own choice; cisst
#: takes 2 m and 360 degrees.
REACH = {"prismatic": 0.8, "revolute": np.pi}
#: What their brakes carry, and gains that follow a set position. Source: our own choice, as of the
#: Classic's (suj_psm1.toml).
MOTORS = {
    "prismatic": {
        "effort_max_n": 1000.0,
        "velocity_max_m_s": 0.1,
        "acceleration_max_m_s2": 0.2,
    },
    "revolute": {
        "effort_max_nm": 200.0,
        "velocity_max_deg_s": 30.0,
        "acceleration_max_deg_s2": 60.0,
    },
}
GAINS = {"prismatic": [20000.0, 0.0, 4000.0], "revolute": [2000.0, 0.0, 200.0]}
FRICTION = {
    "prismatic": {"coulomb_n": 20.0, "viscous_ns_per_m": 200.0},
    "revolute": {"coulomb_nm": 2.0, "viscous_nms": 10.0},
}
#: Where the Si's numbers are from when no file has them.
OWN_FILE = "sawIntuitiveResearchKit share/arm/suj-si-simulated.json"
#: Past a file's own position that lies beyond a limit, the limit moves out by this much [m, rad].
MARGIN = 0.05


def setup_entry(arm: SetupArm, files: Files) -> tuple[str, bool]:
    """Return the description of setup joints, and whether they hold the base or the arm's centre.

    Raises:
        DescriptionError: more or fewer joints than trocar's have
    """
    own = f"suj_{arm.name.lower()}"
    if arm.generation == "Classic":
        if arm.chain is None or _same_setup(arm, documents.known(own)):
            return own, False
        document = _classic_setup(arm, own)
        files.said.append(f"SUJ {arm.name}: numbers of its own; masses and shapes are {own}'s")
    else:
        document = _serial_setup(arm, files)
        files.stand_ins.append(f"SUJ_{arm.name}")
    document["title"] = f"Setup joints of {arm.name}, as the lab has them"
    document["source"] = Path(arm.file).name or OWN_FILE
    return files.write(own, document), True


def setup_base(arm: SetupArm, q: Array) -> Array:
    """Return T_cart_base of what setup joints hold, by the file's numbers, (4, 4)."""
    if arm.fixed is not None:
        return arm.fixed
    if arm.chain is None:
        raise ValueError(f"{arm.name}: has no chain")
    return arm.column @ chain_tip(arm.chain, q) @ arm.tool_origin


def _same_setup(arm: SetupArm, known: ArmDescription) -> bool:
    if arm.chain is None or sum(row.moves for row in arm.chain.rows) != len(known.joints):
        return False
    held = documents.known("ecm" if arm.name == "ECM" else "psm").mechanism
    still = np.zeros(len(held.joints))
    origin = pose(held, still, "rcm", held.frames[0].name)
    rng = np.random.default_rng(0)
    lower, upper = known.mechanism.lower, known.mechanism.upper
    return all(
        max(
            float(np.max(d))
            for d in pose_difference(setup_base(arm, q), pose(known.mechanism, q, "mount") @ origin)
        )
        < 1e-9
        for q in rng.uniform(lower, upper, (4, len(lower)))
    )


def _classic_setup(arm: SetupArm, own: str) -> documents.Document:
    """Return trocar's setup joints with the numbers of a file."""
    document, chain = documents.own_arm(own), arm.chain
    if chain is None or sum(row.moves for row in chain.rows) != len(document["joint"]):
        raise DescriptionError(arm.file, "DH", f"allowed: {len(document['joint'])} joints")
    frames = {frame["name"]: frame for frame in document["frame"]}
    for k, row in enumerate(chain.rows):
        name = f"suj_{k + 1}"
        wanted = "prismatic" if k == 0 else "revolute"
        if name not in frames or row.kind != wanted or chain.convention != "modified":
            raise DescriptionError(
                arm.file, f"DH row {k + 1}", f"got {row.kind}; allowed: {wanted}, modified"
            )
        documents.set_row(frames[name], row)
    _place(frames["column"], arm.column)
    for name in ("mount", "tip"):
        _place(frames[name], arm.tool_origin)
    document["name"] = f"{own}_lab"
    if arm.q is not None:
        for joint, q in zip(document["joint"], arm.q.tolist(), strict=True):
            _widen(joint, q)
    return document


def _place(frame: documents.Document, T: Array) -> None:
    for name in ("xyz", "rpy", "rotation"):
        documents.without(frame, name)
    frame |= documents.pose_entries(T)
    frame["source"] = "the lab's file"


def _widen(joint: documents.Document, q: float) -> None:
    """Move a limit out where the file's own position lies beyond it."""
    for name, outside in (("lower", min), ("upper", max)):
        limit = documents.limit(joint, name)
        if outside(limit, q) != limit:
            documents.without(joint, name)
            unit = "rad" if joint["kind"] == "revolute" else "m"
            joint[f"{name}_{unit}"] = q + (-MARGIN if name == "lower" else MARGIN)


def _serial_setup(arm: SetupArm, files: Files) -> documents.Document:
    """Return setup joints of which only the chain is known."""
    chain = arm.chain
    if chain is None:
        raise DescriptionError(arm.file, "DH", "is missing; the rows of the setup joints")
    rows = chain.rows
    joints: list[documents.Document] = []
    frames: list[documents.Document] = [
        {"name": "cart", "source": "the file's world origin"},
        {"name": "column", "parent": "cart", **documents.pose_entries(arm.column)},
    ]
    for k, row in enumerate(rows):
        name = f"suj_{k + 1}"
        frame: documents.Document = {"name": name, "parent": frames[-1]["name"], "dh": "modified"}
        documents.set_row(frame, row)
        if row.moves:
            frame |= {"motion": row.kind, "q": {name: 1.0}}
            at = 0.0 if arm.q is None else float(arm.q[len(joints)])
            joints.append(_setup_joint(name, row.kind, at))
        frames.append(frame)
    last = frames[-1]["name"]
    frames.append({"name": "mount", "parent": last, **documents.pose_entries(arm.tool_origin)})
    frames.append({"name": "tip", "parent": "mount"})
    document: documents.Document = {
        "schema": 1,
        "name": f"suj_{arm.name.lower()}_{arm.generation.lower()}",
        "type": "SUJ",
        "generation": arm.generation,
        "title": "Setup joints",
        "source": "the lab's file",
        "root": "cart",
        "relative_to": "cart",
        "tip": "tip",
        "joint": joints,
        "frame": frames,
    }
    moving = [joint["name"] for joint in joints]
    mechanism = _loaded(document, files).mechanism
    document["body"] = link_bodies(mechanism, [*moving, "mount"])
    document["control"] = {
        "dvrk": {"source": SOURCE, "pid": {j["name"]: GAINS[j["kind"]] for j in joints}}
    }
    document["friction"] = {
        "identified": {"source": SOURCE, **{j["name"]: FRICTION[j["kind"]] for j in joints}}
    }
    return document


def _setup_joint(name: str, kind: str, at: float) -> documents.Document:
    reach, unit = REACH[kind], "rad" if kind == "revolute" else "m"
    joint: documents.Document = {"name": name, "kind": kind}
    joint |= {f"lower_{unit}": -reach, f"upper_{unit}": reach, **MOTORS[kind]}
    _widen(joint, at)
    return {**joint, "drive": {name: 1.0}, "source": "range, effort and rates: our own choice"}


def _loaded(document: documents.Document, files: Files) -> ArmDescription:
    """Return an arm without bodies, read from a file as every arm is."""
    path = files.folder / "chain.toml"
    path.write_text(toml_text(document), encoding="utf-8")
    try:
        return load_arm(path)
    finally:
        path.unlink()
