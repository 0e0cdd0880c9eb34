"""How an imported arm leans: its mounting pitch, and the setup joints that hold it."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robot.dvrk_config import configurations as lab
from trocar.descriptions import load_arm
from trocar.descriptions.rig_frames import Places
from trocar.errors import DescriptionError
from trocar.geometry.rotations import rotation_x
from trocar.kinematics.forward import pose
from trocar.robot.dvrk_config import import_dvrk
from trocar.robot.dvrk_config.rig import ImportedRig
from trocar.simulation import World

DRIVER = "LARGE_NEEDLE_DRIVER:4{}0006"


def alone(tmp_path: Path, pitch: float | None, generation: str = "Si", **base: Any) -> ImportedRig:
    """Import a system of one PSM and no setup joints."""
    si = generation == "Si"
    arm = {"kinematic": f"kinematic/PSM{'_Si' if si else ''}.json", "generation": generation}
    arm |= {"tool_detection": "FIXED", "tool": DRIVER.format(2 if si else 0)}
    arm |= {} if pitch is None else {"mounting_pitch": pitch}
    entry = {"name": "PSM1", "type": "PSM", "arm_file": "psm.json", **base}
    files = {"system-lab.json": {"arms": [entry]}, "psm.json": arm}
    return import_dvrk(lab.write(tmp_path / "in", files), tmp_path / "rig.toml")


def up_in_the_base(found: ImportedRig, name: str = "PSM1") -> np.ndarray:
    """Return up in the arm's reference frame at the rig's start, (3,)."""
    start = found.rig.poses["start"]
    return Places(found.rig, lambda arm: start[arm]).reference_pose(name)[2, :3]


@pytest.mark.parametrize("generation", ["Classic", "Si"])
@pytest.mark.parametrize("pitch", [0.0, -0.7853981633974483, -0.2618, 1.2])
def test_an_arm_stands_at_its_mounting_pitch(tmp_path: Path, generation: str, pitch: float) -> None:
    """Gravity in the base is 9.81 (0, sin p, cos p), as the dVRK's compensation has it."""
    found = alone(tmp_path, pitch, generation)
    expected = [0.0, math.sin(pitch), math.cos(pitch)]
    np.testing.assert_allclose(up_in_the_base(found), expected, atol=1e-9)


def test_an_si_without_a_mounting_pitch_stands_upright_with_a_note(tmp_path: Path) -> None:
    found = alone(tmp_path, None)
    np.testing.assert_allclose(up_in_the_base(found), [0.0, 0.0, 1.0], atol=1e-12)
    (note,) = [note for note in found.notes if "mounting_pitch" in note]
    assert note.startswith("PSM1: no mounting_pitch") and note.endswith("stands upright")


def test_a_frame_of_the_lab_stands_as_the_mounting_pitch_of_its_arm_says(tmp_path: Path) -> None:
    frame = {"reference_frame": "table", "transform": np.eye(4).tolist()}
    found = alone(tmp_path, -0.7, base_frame=frame)
    up = up_in_the_base(found)
    np.testing.assert_allclose(up, [0.0, math.sin(-0.7), math.cos(-0.7)], atol=1e-9)


def test_arms_that_a_camera_sees_at_an_angle_lean_with_a_note(tmp_path: Path) -> None:
    """Registrations of two arms in one camera, whose z axes are 20 degrees apart."""
    system: dict[str, Any] = {"arms": []}
    for name, turn in (("PSM1", 0.0), ("PSM2", math.radians(20.0))):
        T = np.eye(4)
        T[:3, :3] = rotation_x(turn)
        frame = {"reference_frame": "camera", "transform": T.tolist()}
        system["arms"].append(
            {"name": name, "type": "PSM", "arm_file": "psm.json", "base_frame": frame}
        )
    arm = {"kinematic": "kinematic/PSM.json", "tool_detection": "FIXED", "tool": DRIVER.format(0)}
    path = lab.write(tmp_path / "in", {"system-lab.json": system, "psm.json": arm})
    found = import_dvrk(path, tmp_path / "rig.toml")
    for name, lean in (("PSM1", 10.0), ("PSM2", -10.0)):
        up = up_in_the_base(found, name)
        np.testing.assert_allclose(up[2], math.cos(math.radians(lean)), atol=1e-9)
        assert any(
            note.startswith(f"{name}: leans by 10.0 degrees: camera") for note in found.notes
        )
    assert not any("leans" in note for note in alone(tmp_path / "one", None, "Classic").notes)


@pytest.mark.parametrize("pitch", [-45.0, 1.6])
def test_a_mounting_pitch_that_no_arm_has_is_an_error(tmp_path: Path, pitch: float) -> None:
    with pytest.raises(DescriptionError, match=rf"psm\.json: mounting_pitch: got {pitch:g}; allow"):
        alone(tmp_path, pitch)
    assert not (tmp_path / "rig.toml").exists()


def test_a_mounting_pitch_that_its_setup_joints_do_not_have_is_noted(tmp_path: Path) -> None:
    found = import_dvrk(lab.lab(tmp_path / "in", "Si", held_at(-0.5)), tmp_path / "rig.toml")
    (note,) = [n for n in found.notes if "mounting_pitch" in n and "psm1.json" in n]
    assert "is -28.6 degrees" in note and "lean by -45.0" in note
    (tmp_path / "right").mkdir()
    right = lab.lab(tmp_path / "right" / "in", "Si", held_at(-0.785398))
    found = import_dvrk(right, tmp_path / "right" / "rig.toml")
    assert not [n for n in found.notes if "psm1.json" in n and "mounting_pitch" in n]


def test_compensation_follows_the_mounting_pitch_of_the_file(tmp_path: Path) -> None:
    found = import_dvrk(lab.lab(tmp_path / "in", "Si", held_at(0.0)), tmp_path / "rig.toml")
    world = World(found.rig)
    world.set_state("PSM1", np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0, 0.0]))
    held = world.servos.holding[world.joints.arms["PSM1"].rows][:3]
    # published by the robot's own software: tests/simulation/test_si_controller.py
    np.testing.assert_allclose(held, [-0.799593, 3.982526, -6.24897], atol=2e-5)


def held_at(pitch: float) -> dict[str, Any]:
    """Return files in which PSM1, on setup joints, has a mounting pitch."""
    system = lab.system("Si")
    system["arms"][3]["arm_file"] = "psm1.json"
    arm = {"kinematic": "kinematic/PSM_Si.json", "generation": "Si", "mounting_pitch": pitch}
    arm |= {"tool_detection": "FIXED", "tool": DRIVER.format(2)}
    return {"system-lab.json": system, "psm1.json": arm}


def test_si_arms_on_classic_setup_joints_are_an_error(tmp_path: Path) -> None:
    system = lab.system("Classic")
    system["arms"][3]["arm_file"] = lab.system("Si")["arms"][3]["arm_file"]
    files = {"system-lab.json": system, "kinematic/PSM_Si.json": si_kinematics()}
    message = r"arms\[3\]\.base_frame\.component: got setup joints of generation Classic for an arm"
    with pytest.raises(DescriptionError, match=message):
        import_dvrk(lab.lab(tmp_path / "in", files=files), tmp_path / "rig.toml")


def si_kinematics() -> dict[str, Any]:
    return {"DH": {"convention": "modified", "joints": lab.PSM_SI}}


def test_setup_joints_of_another_length_keep_the_masses_and_shapes_of_an_si(tmp_path: Path) -> None:
    setups = copy.deepcopy(lab.SI)
    setups[1]["DH"]["links"][2]["A"] += 0.01
    files = {"arm/suj.json": {"arms": setups}}
    found = import_dvrk(lab.lab(tmp_path / "in", "Si", files), tmp_path / "rig.toml")
    own, changed = load_arm("suj_si_psm1"), found.rig.arm("SUJ_PSM1").arm
    assert [b.mass for b in changed.bodies] == [b.mass for b in own.bodies]
    assert [len(b.shapes) for b in changed.bodies] == [len(b.shapes) for b in own.bodies]
    q = np.array(setups[1]["simulated_position"])
    moved = pose(changed.mechanism, q, "mount")
    np.testing.assert_allclose(moved, lab.base(setups[1], q), atol=1e-9)
    assert found.agreement["bases"].metres < 1e-9
