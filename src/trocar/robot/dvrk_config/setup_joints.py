"""Setup joints of a lab as arms of trocar's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.catalogue import document
from trocar.descriptions.table import toml_text
from trocar.errors import DescriptionError
from trocar.kinematics.forward import pose
from trocar.robot.dvrk_config.arms import (
    STAND_IN,
    Document,
    Files,
    known,
    largest_gap,
    limit,
    link_bodies,
    pose_entries,
    set_row,
    without,
)
from trocar.robot.dvrk_config.system import DhRows, SetupArm

Array = NDArray[np.float64]

#: The cart's reference above the floor [m]. Source: dvrk_env suj.sdf, as in full_cart; of the Si,
#: our own choice, as in full_cart_si.
CART = {"Classic": (0.0, 0.0, 0.167458), "Si": (0.0, 0.0, 0.53)}

#: Range of setup joints without limits in a file [m, rad]. Source: our own choice; cisst takes 2 m
#: and 360 degrees.
REACH = {"prismatic": 0.8, "revolute": np.pi}
#: Holding efforts of their brakes, and gains that follow a set position. Source: our own choice, as
#: the Classic's (suj_psm1.toml).
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
#: Source of the Si's numbers that no file has.
OWN_FILE = "sawIntuitiveResearchKit share/arm/suj-si-simulated.json"
#: Margin of a limit that is moved out past a file's own position [m, rad].
MARGIN = 0.05


def setup_entry(arm: SetupArm, files: Files) -> tuple[str, bool]:
    """Return the description of setup joints, and whether they hold the base or the arm's centre.

    Raises:
        DescriptionError: more or fewer joints than trocar's have
    """
    classic = arm.generation == "Classic"
    own = f"suj_{arm.name.lower()}" if classic else f"suj_si_{arm.name.lower()}"
    if arm.chain is None or _same_setup(arm, known(own)):
        return own, not classic
    if classic or _like(arm.chain, known(own)):
        found = _own_setup(arm, own)
        files.notes.append(f"SUJ {arm.name}: own kinematic parameters; masses and shapes of {own}")
    else:
        found = _serial_setup(arm, files)
        files.stand_ins.append(f"SUJ_{arm.name}")
    found["title"] = f"Setup joints of {arm.name}, as the lab has them"
    found["source"] = Path(arm.file).name or OWN_FILE
    return files.write(f"suj_{arm.name.lower()}", found), True


def _like(chain: DhRows, own: ArmDescription) -> bool:
    """Return whether a chain has the joints of trocar's setup joints, then the fixed wedge."""
    moving = [row.type for row in chain.rows if row.moves]
    wedge = [row.moves for row in chain.rows[len(moving) :]]
    fits = chain.convention == "modified" and wedge == [False, False]
    return fits and moving == [joint.kind for joint in own.joints]


def _same_setup(arm: SetupArm, own: ArmDescription) -> bool:
    if arm.chain is None or arm.chain.moving != len(own.joints):
        return False
    origin = np.eye(4)  # the Si's hold the remote centre, the Classic's the base
    if arm.generation == "Classic":
        held = known("ecm" if arm.name == "ECM" else "psm").mechanism
        origin = pose(held, np.zeros(len(held.joints)), "rcm", held.frames[0].name)
    lower, upper = own.mechanism.lower, own.mechanism.upper
    return all(
        largest_gap(arm.base(q), pose(own.mechanism, q, "mount") @ origin).max() < 1e-9
        for q in np.random.default_rng(0).uniform(lower, upper, (4, len(lower)))
    )


def _own_setup(arm: SetupArm, own: str) -> Document:
    """Return trocar's setup joints with the numbers of a file."""
    found, chain = document("arms", own), arm.chain
    if chain is None or chain.moving != len(found["joint"]):
        raise DescriptionError(arm.file, "DH", f"allowed: {len(found['joint'])} joints")
    frames = {frame["name"]: frame for frame in found["frame"]}
    wedge = ("lean", "upright") if arm.generation == "Si" else ()
    for k, row in enumerate(chain.rows):
        fixed = k - chain.moving
        name = wedge[fixed] if 0 <= fixed < len(wedge) else f"suj_{k + 1}"
        kind = "prismatic" if k == 0 else "revolute"
        if name not in frames or row.type != kind or chain.convention != "modified":
            raise DescriptionError(
                arm.file, f"DH row {k + 1}", f"got {row.type}; allowed: {kind}, modified"
            )
        set_row(frames[name], row)
    _place(frames["column"], arm.column)
    _place(frames["mount"], arm.tool_origin)
    if arm.generation == "Classic":  # the Si's tip is its mount
        _place(frames["tip"], arm.tool_origin)
    found["name"] = f"{own}_lab"
    if arm.q is not None:
        for joint, q in zip(found["joint"], arm.q.tolist(), strict=True):
            _widen(joint, q)
    return found


def _place(frame: Document, T: Array) -> None:
    for name in ("xyz", "rpy", "rotation"):
        without(frame, name)
    frame |= pose_entries(T)
    frame["source"] = "the lab's file"


def _widen(joint: Document, q: float) -> None:
    """Move a limit out where the file's own position lies beyond it."""
    for name, outside in (("lower", min), ("upper", max)):
        own = limit(joint, name)
        if outside(own, q) != own:
            without(joint, name)
            unit = "rad" if joint["kind"] == "revolute" else "m"
            joint[f"{name}_{unit}"] = q + (-MARGIN if name == "lower" else MARGIN)


def _serial_setup(arm: SetupArm, files: Files) -> Document:
    """Return setup joints of which only the chain is known."""
    chain = arm.chain
    if chain is None:
        raise DescriptionError(arm.file, "DH", "is missing; allowed: the rows of the setup joints")
    rows = chain.rows
    joints: list[Document] = []
    frames: list[Document] = [
        {"name": "cart", "source": "the file's world origin"},
        {"name": "column", "parent": "cart", **pose_entries(arm.column)},
    ]
    for k, row in enumerate(rows):
        name = f"suj_{k + 1}"
        frame: Document = {"name": name, "parent": frames[-1]["name"], "dh": "modified"}
        set_row(frame, row)
        if row.moves:
            frame |= {"motion": row.type, "q": {name: 1.0}}
            at = 0.0 if arm.q is None else float(arm.q[len(joints)])
            joints.append(_setup_joint(name, row.type, at))
        frames.append(frame)
    last = frames[-1]["name"]
    frames.append({"name": "mount", "parent": last, **pose_entries(arm.tool_origin)})
    frames.append({"name": "tip", "parent": "mount"})
    found: Document = {
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
    mechanism = _loaded(found, files).mechanism
    found["body"] = link_bodies(mechanism, [*moving, "mount"])
    found["control"] = {
        "dvrk": {"source": STAND_IN, "pid": {j["name"]: GAINS[j["kind"]] for j in joints}}
    }
    found["friction"] = {
        "identified": {"source": STAND_IN, **{j["name"]: FRICTION[j["kind"]] for j in joints}}
    }
    return found


def _setup_joint(name: str, kind: str, at: float) -> Document:
    reach, unit = REACH[kind], "rad" if kind == "revolute" else "m"
    joint: Document = {"name": name, "kind": kind}
    joint |= {f"lower_{unit}": -reach, f"upper_{unit}": reach, **MOTORS[kind]}
    _widen(joint, at)
    return {**joint, "drive": {name: 1.0}, "source": "range, effort and rates: our own choice"}


def _loaded(found: Document, files: Files) -> ArmDescription:
    """Return an arm without bodies, read from a file as every arm is."""
    path = files.folder / "chain.toml"
    path.write_text(toml_text(found), encoding="utf-8")
    try:
        return load_arm(path)
    finally:
        path.unlink()
