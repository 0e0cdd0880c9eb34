"""Round trips by export and import: the same poses, masses and loops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("lxml", reason="lxml is not installed (extra export)")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")

from trocar.descriptions import load_arm
from trocar.descriptions.rigs import lone_arm_rig
from trocar.formats.export import export
from trocar.formats.importing import ImportOptions, import_file
from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import poses

#: The robot's file of each format; SDF has words for what follows a joint from 1.11 on.
FILES = {"urdf": "lone_{name}.urdf", "sdf": "model.sdf", "mjcf": "lone_{name}.xml"}

#: SDF does not say where the motors are.
PASSIVE = ("MTML_elbow_bar_joint", "MTML_elbow_rod_joint")


@pytest.mark.slow
@pytest.mark.parametrize("language", FILES)
@pytest.mark.parametrize("name", ["psm", "ecm", "mtml"])
def test_an_exported_arm_comes_back(language: str, name: str, tmp_path: Path, rng) -> None:
    arm = load_arm(name)
    rig = lone_arm_rig(arm)
    options = {"sdf_version": "1.11"} if language == "sdf" else {}
    export(rig, language, tmp_path / "out", options)
    (file,) = (tmp_path / "out").glob(FILES[language].format(name=name))
    order = ImportOptions(passive=PASSIVE) if (name, language) == ("mtml", "sdf") else None
    found = import_file(file, tmp_path / "back", order)
    back = load_arm(found.file)
    place = rig.arms[0].name
    assert len(back.joints) == len(arm.joints)
    assert sum(b.mass for b in back.bodies) == pytest.approx(
        sum(b.mass for b in arm.bodies), abs=1e-3
    )
    for _ in range(10):
        q = rng.uniform(arm.mechanism.lower, arm.mechanism.upper)
        weights = np.array([j.drive[0][1] for j in arm.joints])
        ours = poses(arm.mechanism, q, arm.root)
        theirs = poses(back.mechanism, q / weights, back.root)
        names = {frame: f"{place}_{frame}" for frame in ours}
        if language == "mjcf":  # a lone arm's bodies have no prefix
            names = {frame: frame for frame in ours}
        root = inverse(theirs[names[arm.root]])
        for frame, expected in ours.items():
            if names[frame] in theirs:
                assert np.abs(root @ theirs[names[frame]] - expected).max() < 1e-6, frame
