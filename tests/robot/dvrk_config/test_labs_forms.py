"""Forms of configuration that labs and older versions of the dVRK have.

Shapes, not copies: CUHK's and UCL's consoles of version 1, JHU's custom tools and fixed mounts,
SAW's share/system of 2.3 and 2.4.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robot.dvrk_config import configurations as lab
from trocar.errors import DescriptionError
from trocar.robot.dvrk_config import RigImportOptions, import_dvrk


def version_1(name: str, kind: str, kinematic: str) -> dict[str, Any]:
    return {
        "name": name,
        "type": kind,
        "io": f"sawRobotIO1394-{name}-12345.xml",
        "pid": f"sawControllersPID-{kind}.xml",
        "kinematic": kinematic,
    }


def test_a_console_that_names_kinematics_in_its_arms_is_imported(tmp_path: Path) -> None:
    console = {
        "io": {"footpedals": "sawRobotIO1394-MTMR-foot-pedals.xml"},
        "arms": [
            version_1("ECM", "ECM", "ecm-straight.json"),
            version_1("PSM1", "PSM", "psm-pro-grasp.json"),
            version_1("PSM2", "PSM", "psm-large-needle-driver_probe.json"),
            version_1("MTMR", "MTM", "mtm.json"),
            version_1("MTML", "MTM", "mtm.json"),
        ],
        "psm-teleops": [{"master": "MTMR", "slave": "PSM1", "rotation": np.eye(3).tolist()}],
        "ecm-teleop": {"master-left": "MTML", "master-right": "MTMR", "slave": "ECM"},
    }
    path = lab.write(tmp_path / "in", {"system-lab.json": console})
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert [arm.name for arm in found.rig.arms] == ["PSM1", "PSM2", "MTMR", "MTML", "ECM"]
    assert found.rig.arm("PSM1").arm.tool == "PROGRASP_FORCEPS:400093"
    assert found.rig.arm("PSM2").arm.tool == "LARGE_NEEDLE_DRIVER:400006"
    assert any("PSM2" in note and "not a built-in instrument" in note for note in found.notes)
    assert {Path(found.rig.arm(n).arm.file).stem for n in ("MTML", "MTMR")} == {"mtml", "mtmr"}
    assert [teleop.name for teleop in found.rig.teleops] == ["MTMR_PSM1", "MTML_MTMR_ECM"]
    assert found.unknown == ()
    (idle,) = found.idle
    assert "arms[].pid" in idle and "psm-teleops[].rotation" in idle


def test_an_arm_s_file_lies_in_the_folder_that_its_system_names(tmp_path: Path) -> None:
    """A system beside the robots' folders, and one in a folder inside a robot's."""
    psm = {"name": "PSM1", "type": "PSM", "serial": "12345", "system": "our-robot"}
    files: dict[str, Any] = {
        f"our-robot/{folder}/system-lab.json": {"arms": [psm]} for folder in ("custom", "..")
    }
    files["our-robot/PSM1-12345.json"] = {"kinematic": "kinematic/PSM.json"}
    for name, content in files.items():
        lab.write((tmp_path / name).parent, {Path(name).name: content})
    for folder in ("our-robot/custom", "."):
        target = tmp_path / f"{len(folder)}.toml"
        found = import_dvrk(tmp_path / folder / "system-lab.json", target)
        assert [arm.name for arm in found.rig.arms] == ["PSM1"]
        assert not any("system" in idle for idle in found.idle)


def test_a_kinematic_file_of_version_1_holds_the_arm_and_its_instrument(tmp_path: Path) -> None:
    rows = [*lab.PSM, *lab.TOOL["Classic"]]
    links = [{"convention": "modified", **row} for row in rows]
    for row in links:
        for key in ("qmin", "qmax", "ftmax", "name"):
            row.pop(key, None)
    file = {"DH": {"links": links}, "tooltip-offset": lab.TOOLTIP, "tool-joint-limit": {}}
    console = {"arms": [version_1("PSM1", "PSM", "psm-large-needle-driver.json")]}
    files = {"system-lab.json": console, "psm-large-needle-driver.json": file}
    found = import_dvrk(lab.write(tmp_path / "in", files), tmp_path / "rig.toml")
    assert found.files == (str(tmp_path / "rig.toml"),)  # the arm and the instrument are trocar's
    assert (found.agreement["chains"].count, found.unknown) == (1, ())
    assert found.agreement["chains"].metres < 1e-9


@pytest.mark.parametrize(("kind", "key"), [("SUJ_Fixed", "kinematic"), ("SUJ_fixed", "arm_file")])
@pytest.mark.parametrize("here", [True, False])
def test_fixed_mounts_are_imported_with_and_without_the_dvrk_s_file(
    tmp_path: Path, kind: str, key: str, here: bool
) -> None:
    system = lab.system()
    arms = [arm for arm in system["arms"] if arm["type"] in ("PSM", "ECM")]
    system = {"arms": [{"name": "SUJ", "type": kind, key: "arm/suj-fixed-simulated.json"}, *arms]}
    files = {"system-lab.json": system}
    if here:
        still: list[list[float]] = np.eye(4).tolist()
        mounts = [{"name": n, "measured_cp": still} for n in ("ECM", "PSM1", "PSM2", "PSM3")]
        mounts[1] = {"name": "PSM1", "measured_cp": [*still[:1], [0, 1, 0, 1], *still[2:]]}
        files["arm/suj-fixed-simulated.json"] = {"arms": mounts}
    found = import_dvrk(lab.write(tmp_path / "in", files), tmp_path / "rig.toml")
    assert {arm.name for arm in found.rig.arms} == {"PSM1", "PSM2", "PSM3", "ECM"}
    assert found.agreement["bases"].metres < 1e-9
    apart = found.rig.arm("PSM1").pose[:3, 3] - found.rig.arm("ECM").pose[:3, 3]
    assert apart[1] == pytest.approx(1.0, abs=0.2)  # the rest: where their bases are


def test_setup_joints_without_a_generation_are_the_classic_s(tmp_path: Path) -> None:
    system = lab.system()
    system["arms"][2] = {
        "name": "SUJ",
        "type": "SUJ",
        "kinematic": "arm/suj-simulated.json",
        "base-frame": {"component": "ECM", "interface": "Robot"},
    }
    path = lab.write(tmp_path / "in", {"system-lab.json": system})
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert [a.name for a in found.rig.arms if a.arm.type == "SUJ"][:1] == ["SUJ_PSM1"]


def test_a_snake_like_instrument_is_not_supported_and_says_so(tmp_path: Path) -> None:
    for tool in ("5MM_NEEDLE_DRIVER_400117", "NEEDLE_DRIVER:400117"):
        psm = {"kinematic": "kinematic/PSM.json", "tool-detection": "FIXED", "tool": tool}
        system = {"arms": [{"name": "PSM1", "type": "PSM", "arm": "psm.json"}]}
        files = {"system-lab.json": system, "psm.json": psm}
        snake = {"tool/NEEDLE_DRIVER_400117.json": {"snake-like": True, "jaw": {}}}
        for folder, more in (("with", snake), ("without", {})):
            if tool[0] == "N" and not more:
                continue
            path = lab.write(tmp_path / tool[0] / folder, files | more)
            with pytest.raises(DescriptionError, match=r"snake-like wrist.*--tool PSM1=TOOL"):
                import_dvrk(path, path.parent / "rig.toml")
            other = RigImportOptions(tools=(("PSM1", "PROGRASP_FORCEPS:400093"),))
            found = import_dvrk(path, path.parent / "rig.toml", other)
            assert found.rig.arm("PSM1").arm.tool == "PROGRASP_FORCEPS:400093"


@pytest.mark.parametrize(
    ("arm", "said"),
    [
        (
            {"type": "PSM_GENERIC", "component": "PSM1", "interface": "PSM1"},
            "PSM1: left out: a PSM_GENERIC from ROS is an arm of another program; trocar mirror",
        ),
        (
            {"type": "PSM_SOCKET", "remote-ip": "localhost", "port": 10001},
            "PSM1: left out: a PSM_SOCKET is an arm of another computer; trocar mirror",
        ),
    ],
)
def test_arms_from_ros_or_a_socket_are_named_and_the_rest_goes_on(
    tmp_path: Path, arm: dict[str, Any], said: str
) -> None:
    reader = {"class-name": "dvrk_psm_from_ros", "constructor-arg": {"Name": "PSM1"}}
    system: dict[str, Any] = {
        "component_manager": {"components": [reader]},
        "arms": [{"name": "PSM1", **arm}, lab.master("MTMR", -0.18)],
        "teleop_PSMs": [{"MTM": "MTMR", "PSM": "PSM1"}],
    }
    path = lab.write(tmp_path / "in", {"system-lab.json": system})
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert [arm.name for arm in found.rig.arms] == ["MTMR"]
    assert any(note.startswith(said) for note in found.notes)
    assert found.unknown == ()
    lab.write(tmp_path / "in", {"system-lab.json": {**system, "arms": system["arms"][:1]}})
    with pytest.raises(DescriptionError, match=f"arms: holds no arm .*{said[16:40]}"):
        import_dvrk(path, tmp_path / "other.toml")


def test_a_file_whose_name_differs_in_letter_case_is_taken_with_a_warning(tmp_path: Path) -> None:
    rows = [{**row, "qmax": 0.2} if row["type"] == "prismatic" else row for row in lab.PSM]
    psm = {"kinematic": "lab-dVRK/custom-tool/PSM-Custom.json", "tool_detection": "MANUAL"}
    files = {
        "system-lab.json": {"arms": [{"name": "PSM1", "type": "PSM", "arm": "psm1-7.json"}]},
        "PSM1-7.json": psm,
        "psm-custom.json": {"DH": {"convention": "modified", "joints": rows}},
    }
    folder = tmp_path / "lab-dVRK" / "custom-tool"
    found = import_dvrk(lab.write(folder, files), tmp_path / "rig.toml")
    assert found.rig.arm("PSM1").arm.joint("insertion").upper == 0.2
    assert all("whose name differs in case" in text for text in found.warnings)
    names = [Path(text.split(": ")[0]).name for text in found.warnings]
    assert names == ["psm1-7.json", "PSM-Custom.json"]


def test_setup_joints_are_imported_alone_and_without_simulated_positions(tmp_path: Path) -> None:
    for generation, setups in (("Classic", lab.CLASSIC), ("Si", lab.SI)):
        rows = [{k: v for k, v in setup.items() if k != "simulated_position"} for setup in setups]
        suj = {"name": "SUJ", "type": f"SUJ_{generation}", "arm_file": "suj.json"}
        files = {"system-lab.json": {"arms": [suj]}, "suj.json": {"arms": rows}}
        folder = tmp_path / generation
        found = import_dvrk(lab.write(folder, files), folder / "rig.toml")
        assert [arm.arm.type for arm in found.rig.arms] == ["SUJ"] * 4
        assert found.agreement["setup_joints"].metres < 1e-9


def test_setup_joints_of_another_count_start_at_zero(tmp_path: Path) -> None:
    rows = json.loads(json.dumps(lab.SI[:2]))
    for setup in rows:
        del setup["simulated_position"]
        setup["DH"]["links"].insert(1, {**setup["DH"]["links"][1], "D": 0.1})
    suj = {"name": "SUJ", "type": "SUJ_Si", "arm_file": "suj.json"}
    files = {"system-lab.json": {"arms": [suj]}, "suj.json": {"arms": rows}}
    found = import_dvrk(lab.write(tmp_path, files), tmp_path / "rig.toml")
    assert found.rig.poses["start"]["SUJ_ECM"].tolist() == [0.0] * 5
