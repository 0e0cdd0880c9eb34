"""What trocar exports, trocar imports: the same poses, masses and loops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("lxml", reason="lxml is not installed (extra export)")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")

from trocar.apps.exports import export
from trocar.apps.foreign import bring_in
from trocar.descriptions import load_arm
from trocar.descriptions.lone_arm import lone_arm_rig
from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import poses

#: One file a format.
FILES = {"urdf": "*.urdf", "sdf": "model.sdf", "mjcf": "*.xml"}


@pytest.mark.parametrize("format", FILES)
@pytest.mark.parametrize("name", ["psm", "ecm", "mtml"])
def test_an_exported_arm_comes_back(format: str, name: str, tmp_path: Path, rng) -> None:
    arm = load_arm(name)
    rig = lone_arm_rig(arm)
    made = export(rig, format, tmp_path / "out")
    files = [f for f in made.files if (tmp_path / "out" / f).match(FILES[format])]
    print(files)
    found = bring_in(tmp_path / "out" / files[0], tmp_path / "back")
    back = load_arm(found.file)
    place = rig.arms[0].name
    print(found)
    assert len(back.joints) == len(arm.joints)
    assert sum(b.mass for b in back.bodies) == pytest.approx(
        sum(b.mass for b in arm.bodies), abs=1e-3
    )
    for _ in range(10):
        q = rng.uniform(arm.mechanism.lower, arm.mechanism.upper)
        weights = np.array([j.drive[0][1] for j in arm.joints])
        ours = poses(arm.mechanism, q, arm.root)
        theirs = poses(back.mechanism, q / weights, back.root)
        root = inverse(theirs[f"{place}_{arm.root}"])
        for frame, expected in ours.items():
            if f"{place}_{frame}" in theirs:
                assert np.abs(root @ theirs[f"{place}_{frame}"] - expected).max() < 1e-6, frame
