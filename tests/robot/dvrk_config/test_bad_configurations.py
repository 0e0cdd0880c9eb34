"""A configuration that cannot be used is refused: file, key, what was got, what is allowed."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.robot.dvrk_config import configurations as lab
from trocar.errors import DescriptionError, InputError, UnknownNameError
from trocar.robot.dvrk_config import RigImportOptions, import_dvrk

System = dict[str, Any]
Change = Callable[[System], object]
NO_TURN = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]


def frame(system: System, at: int) -> dict[str, Any]:
    return system["arms"][at]["base_frame"]


WRONG: list[tuple[str, Change, str]] = [
    (
        "kind",
        lambda s: s["arms"][0].update(type="ROBOT"),
        r"arms\[0\].type: got 'ROBOT'; .*MTM, PSM",
    ),
    (
        "twice",
        lambda s: s["arms"][1].update(name="MTML"),
        r"arms\[1\].name: got 'MTML' a second time",
    ),
    ("no name", lambda s: s["arms"][1].pop("name"), r"arms\[1\].name: is missing"),
    ("odd name", lambda s: s["arms"][1].update(name="a b"), r"name: got 'a b'; allowed: letters"),
    ("no arms", lambda s: s.pop("arms"), r"arms: is missing; allowed: a list"),
    (
        "missing file",
        lambda s: s["arms"][3].update(arm_file="arm/mine.json"),
        r"arms\[3\].arm_file: got 'arm/mine.json', not found in .*--share",
    ),
    (
        "missing serial",
        lambda s: s["arms"][3].update(arm_file=None, serial="7"),
        r"arms\[3\]\.\w+: got 'PSM1-7.json', not found in",
    ),
    ("no file", lambda s: s["arms"][3].pop("arm_file"), r"arm_file: is missing; .* or its serial"),
    (
        "mirrored",
        lambda s: frame(s, 0).update(transform=NO_TURN),
        r"arms\[0\].base_frame.transform: got .* determinant is -1; allowed: a rotation",
    ),
    (
        "last row",
        lambda s: frame(s, 0)["transform"].__setitem__(3, [0, 0, 0, 2]),
        r"got \[0.0, 0.0, 0.0, 2.0\] as the last row; allowed: \[0, 0, 0, 1\]",
    ),
    (
        "three rows",
        lambda s: frame(s, 0)["transform"].pop(),
        r"base_frame.transform: got .*; allowed: 4 rows of 4 numbers",
    ),
    (
        "two bases",
        lambda s: frame(s, 0).update(component="SUJ", interface="PSM1"),
        r"arms\[0\].base_frame: got transform, reference_frame, component, interface; allowed",
    ),
    (
        "on what",
        lambda s: frame(s, 3).update(component="CART"),
        r"arms\[3\].base_frame.component: got 'CART'; allowed: SUJ",
    ),
    (
        "on whom",
        lambda s: frame(s, 3).update(interface="PSM7"),
        r"interface: got 'PSM7'; allowed: ECM, PSM1, PSM2, PSM3",
    ),
    (
        "two on one",
        lambda s: frame(s, 4).update(interface="PSM1"),
        r"arms\[4\].base_frame.interface: got 'PSM1', which holds PSM1; allowed: ECM, PSM2, PSM3",
    ),
    (
        "teleop of nobody",
        lambda s: s["consoles"][0]["teleop_PSMs"][1].update(PSM="PSM9"),
        r"consoles\[0\].teleop_PSMs\[1\].PSM: got 'PSM9'; allowed: PSM1, PSM2, PSM3",
    ),
    (
        "scale",
        lambda s: s["consoles"][0]["teleop_PSMs"][0]["configure_parameter"].update(scale=3),
        r"configure_parameter.scale: got 3; allowed: above 0 to 1",
    ),
    (
        "flag",
        lambda s: s["consoles"][0]["teleop_PSMs"][0]["configure_parameter"].update(align_MTM="yes"),
        r"align_MTM: got 'yes'; allowed: true, false",
    ),
]


@pytest.mark.parametrize(("change", "said"), [w[1:] for w in WRONG], ids=[w[0] for w in WRONG])
def test_a_system_that_cannot_be_is_refused(tmp_path: Path, change: Change, said: str) -> None:
    system = lab.system()
    change(system)
    path = lab.lab(tmp_path / "in", files={"system-lab.json": system})
    with pytest.raises(DescriptionError, match=said) as problem:
        import_dvrk(path, tmp_path / "out" / "rig.toml")
    assert str(path) in str(problem.value)
    assert not (tmp_path / "out" / "rig.toml").exists()


def setups(change: Callable[[list[dict[str, Any]]], object]) -> dict[str, Any]:
    arms = json.loads(json.dumps(lab.CLASSIC))
    change(arms)
    return {"arm/suj.json": {"arms": arms}}


def rows(joints: list[dict[str, Any]], convention: str = "modified") -> dict[str, Any]:
    return {"kinematic/PSM.json": {"DH": {"joints": joints, "convention": convention}}}


PSM = "PSM1-7.json"
OTHERS: list[tuple[str, dict[str, Any], str]] = [
    ("who", setups(lambda a: a[0].update(name="PSM4")), r"\[0\].name: got 'PSM4'; allowed: PSM1"),
    (
        "half a calibration",
        setups(lambda a: a[0].pop("world_origin_to_SUJ")),
        r"arms\[0\].DH: is incomplete",
    ),
    (
        "positions",
        setups(lambda a: a[1].update(simulated_position=[0.0, 1.0])),
        r"arms\[1\].simulated_position: got \[0.0, 1.0\]; allowed: 6 numbers",
    ),
    (
        "reference arm",
        {"arm/suj.json": {"reference_arm": "PSM4", "arms": lab.CLASSIC}},
        r"suj.json: reference_arm: got 'PSM4'; allowed: ECM, PSM1, PSM2, PSM3",
    ),
    (
        "column",
        setups(lambda a: a[1]["world_origin_to_SUJ"].update(Translation=[1.0])),
        r"world_origin_to_SUJ.Translation: got \[1.0\]; allowed: 3 numbers",
    ),
    (
        "row",
        setups(lambda a: a[1]["DH"]["links"][2].update(type="ball")),
        r"links\[2\].type: got 'ball'; allowed: revolute, hinge, prismatic",
    ),
    (
        "number",
        setups(lambda a: a[1]["DH"]["links"][2].update(A="long")),
        r"links\[2\].A: got 'long'; allowed: a finite number",
    ),
    (
        "other joints",
        setups(lambda a: a[1]["DH"]["links"][0].update(type="revolute", A=0.1)),
        r"DH row 1: got revolute; allowed: prismatic",
    ),
    (
        "limits",
        rows([{**lab.PSM[0], "qmin": 2.0}]),
        r"joints\[0\].qmin: got 2; allowed: less than qmax, 1.588",
    ),
    (
        "convention",
        rows(lab.PSM, "mine"),
        r"DH.convention: got 'mine'; allowed: modified, standard",
    ),
    (
        "chain",
        rows(lab.PSM[:2]),
        r"kinematic: unsupported kinematic chain for psm \(got revolute, revolute\)",
    ),
    (
        "gains",
        {"pid/sawControllersPID-ECM.json": {"pid": [{"index": 0, "p_gain": 1, "d_gain": 1}]}},
        r"pid: has 1 entries; allowed: 4 for a ECM",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("files", "said"), [o[1:] for o in OTHERS], ids=[o[0] for o in OTHERS])
def test_a_file_that_the_system_names_is_refused(
    tmp_path: Path, files: dict[str, Any], said: str
) -> None:
    path = lab.lab(tmp_path / "in", files=files)
    with pytest.raises(DescriptionError, match=said):
        import_dvrk(path, tmp_path / "rig.toml")


@pytest.mark.parametrize(
    ("arm", "said"),
    [
        ({}, "kinematic: is missing"),
        (
            {"kinematic": "kinematic/mine.json"},
            r"kinematic: got 'kinematic/mine.json', not found in",
        ),
        (
            {"kinematic": "kinematic/PSM_Si.json", "generation": "Classic"},
            "generation: got 'Classic'; allowed: Si, for kinematic is 'kinematic/PSM_Si.json'",
        ),
        ({"kinematic": "kinematic/PSM.json", "generation": "X"}, "got 'X'; allowed: Classic, Si"),
        (
            {"kinematic": "kinematic/PSM.json", "tool-detection": "FIXED"},
            "tool: is missing; allowed: a string",
        ),
        (
            {"kinematic": "kinematic/PSM.json", "tool_detection": "FIXED", "tool": "SPOON:1[2]"},
            r"tool: got 'SPOON:1', file .*allowed: .*LARGE_NEEDLE_DRIVER:400006.*--tool",
        ),
        ({"kinematic": "kinematic/PSM.json", "tool_detection": "X"}, "allowed: AUTOMATIC, MANUAL"),
    ],
)
def test_an_arm_s_file_is_refused(tmp_path: Path, arm: dict[str, Any], said: str) -> None:
    system = {"arms": [{"name": "PSM1", "type": "PSM", "serial": "7"}]}
    path = lab.write(tmp_path / "in", {"system-lab.json": system, PSM: arm})
    with pytest.raises(DescriptionError, match=said) as problem:
        import_dvrk(path, tmp_path / "rig.toml")
    assert PSM in str(problem.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", r"is not JSON: .* \(line 1 column 2\)"),
        ('{\n// hm\n"arms": [,]}', r"is not JSON: .*line 3"),
        ("[1]", "is not a JSON object"),
        ('{"arms": [], "Arms": []}', r"Arms: is given twice \(first as 'arms'\)"),
        ('{"arms": {}}', "arms: got {}; allowed: a list of objects"),
    ],
)
def test_what_is_no_configuration_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = lab.write(tmp_path / "in", {"system-lab.json": text})
    with pytest.raises(DescriptionError, match=said):
        import_dvrk(path, tmp_path / "rig.toml")


def test_devices_of_a_lab_are_left_out_and_named(tmp_path: Path) -> None:
    system = lab.system()
    system["arms"][0] = {
        "name": "MTML",
        "type": "MTM_GENERIC",
        "component": "Falcon",
        "interface": "x",
    }
    path = lab.lab(tmp_path / "in", files={"system-lab.json": system})
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert "MTML" not in [arm.name for arm in found.rig.arms]
    said = "\n".join(found.notes)
    assert re.search("MTML: left out: a MTM_GENERIC", said)
    assert re.search(r"teleop_ECMs\[0\]: MTML must be real masters", said)
    names = [teleop.name for teleop in found.rig.teleops]
    assert names == ["MTMR_PSM1", "MTML_PSM2", "MTML_MTMR_ECM"]


def test_nothing_is_written_over_unless_asked_for(tmp_path: Path) -> None:
    path = lab.lab(tmp_path / "in")
    import_dvrk(path, tmp_path / "rig.toml")
    with pytest.raises(InputError, match="exists already; allowed: a new file, or --overwrite"):
        import_dvrk(path, tmp_path / "rig.toml")
    import_dvrk(path, tmp_path / "rig.toml", RigImportOptions(overwrite=True))
    with pytest.raises(InputError, match=r"a rig file with extension .toml"):
        import_dvrk(path, tmp_path / "rig.json")
    with pytest.raises(InputError, match="no such file"):
        import_dvrk(tmp_path / "no.json", tmp_path / "other.toml")
    with pytest.raises(UnknownNameError, match="unknown PSM 'PSM9'"):
        import_dvrk(path, tmp_path / "o.toml", RigImportOptions(tools=(("PSM9", "none"),)))
    assert [p.name for p in tmp_path.glob(".import*")] == []
