"""Files that ask for too much are refused at once, with one error."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from trocar.cameras import read_calibration
from trocar.cli import main
from trocar.descriptions import load_arm
from trocar.errors import InputError
from trocar.formats.importing import import_file
from trocar.robot.dvrk_config import import_dvrk
from trocar.robot.identification.logs import read_motion
from trocar.robot.recordings import recorded_joints

DIGITS, DEPTH = 5_000, 20_000


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        (f"schema = {'9' * DIGITS}", "is not TOML: Exceeds the limit"),
        (f"schema = 0x{'f' * DIGITS}", "has an integer of more than 64 bits"),
        (f"schema = {2**63}", "has an integer of more than 64 bits"),
        (f"schema = {'[' * DEPTH}{']' * DEPTH}", "nested too deeply"),
        (f"schema = {'{a = ' * DEPTH}1{'}' * DEPTH}", "nested too deeply"),
        (f"schema = {'[' * 70}{']' * 70}", "nested too deeply; allowed: 64 levels"),
        (f"schema{'.a' * 400_000} = 1", "nested too deeply; allowed: 64 levels"),
        (f"""[{'"a" . ' * 100_000}"a"]""", "nested too deeply; allowed: 64 levels"),
        (f'schema = "{"x" * 50_000_000}"', "is larger than 1 MB; allowed: up to that size"),
    ],
    ids=["digits", "hex", "65 bits", "lists", "tables", "70 lists", "dots", "quotes", "string"],
)
def test_toml_that_asks_for_too_much_is_refused(tmp_path: Path, line: str, complaint: str) -> None:
    file = tmp_path / "arm.toml"
    file.write_text(f"{line}\n")
    with pytest.raises(InputError, match=complaint) as caught:
        load_arm(file)
    assert str(caught.value).startswith(f"{file}: ")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (f'{{"arms": {"9" * DIGITS}}}', "is not JSON: Exceeds the limit"),
        (f'{{"arms": {2**64}}}', "has an integer of more than 64 bits"),
        (f'{{"arms": {"[" * DEPTH}{"]" * DEPTH}}}', "is not JSON: nested too deeply"),
        (f'{{"arms": {"[" * 70}{"]" * 70}}}', "nested too deeply; allowed: 64 levels"),
        (json.dumps({"arms": "x" * 3_000_000}), "is larger than 2 MB"),
    ],
    ids=["digits", "65 bits", "lists", "70 lists", "string"],
)
def test_a_configuration_that_asks_for_too_much_is_refused(
    tmp_path: Path, text: str, complaint: str
) -> None:
    file = tmp_path / "system-lab.json"
    file.write_text(text)
    with pytest.raises(InputError, match=complaint):
        import_dvrk(file, tmp_path / "rig.toml")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (f"image_width: {'9' * DIGITS}", "is not YAML: Exceeds the limit"),
        (f"image_width: {'[' * DEPTH}{']' * DEPTH}", "nested too deeply"),
        ("a: &a [1, 1]\nb: &b [*a, *a]\n", r"line 2: is not YAML: has an alias \(\*name\)"),
        ("a: " + "x" * 300_000, "is larger than 0.2 MB"),
    ],
    ids=["digits", "lists", "aliases", "string"],
)
def test_a_calibration_that_asks_for_too_much_is_refused(
    tmp_path: Path, text: str, complaint: str
) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=complaint):
        read_calibration([file])


BODY = '<body><joint type="hinge"/><geom size="1"/></body>'


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ('<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
         r"<hfield> nrow x ncol: got 1e\+10; allowed: up to 1000000"),
        (f'<worldbody><replicate count="1000000">{BODY}</replicate></worldbody>',
         r"<replicate> count: got 1e\+06; allowed: up to 1000"),
        (f'<worldbody><replicate count="900"><replicate count="900">{BODY}</replicate>'
         "</replicate></worldbody>", "<replicate> count: got 810000; allowed: up to 1000"),
        ('<asset><texture name="t" type="2d" builtin="flat" width="99999" height="99999"/></asset>',
         "<texture> width x height: got"),
        ('<size nkey="1000000000"/>', "<size> nkey: got 1000000000; allowed: up to 10000"),
        ('<include file="more.xml"/>', "more.xml.*<hfield> nrow x ncol"),
        ("<body>" * DEPTH + "</body>" * DEPTH, "is not XML"),
    ],
)  # fmt: skip
def test_mjcf_that_asks_for_too_much_is_refused(
    tmp_path: Path, content: str, complaint: str
) -> None:
    pytest.importorskip("lxml")
    file = tmp_path / "robot.xml"
    file.write_text(f"<mujoco>{content}</mujoco>")
    (tmp_path / "more.xml").write_text(
        '<mujoco><asset><hfield name="h" nrow="9999" ncol="9999" size="1 1 1 1"/></asset></mujoco>'
    )
    with pytest.raises(InputError, match=complaint):
        import_file(file, tmp_path / "out")


def test_an_error_that_quotes_a_long_text_is_cut(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "arm.toml"
    file.write_text(f'schema = "{"x" * 900_000}"\n')
    assert main(["show", str(file)]) == 2
    line = capsys.readouterr().err
    assert len(line) < 4_100 and line.count("\n") == 1
    assert line.startswith(f"trocar: error: {file}: schema: got 'xxx")
    assert line.endswith("x'; allowed: 1\n")


def test_a_log_with_bytes_that_are_no_text_is_refused_by_its_row(tmp_path: Path) -> None:
    joints = recorded_joints(load_arm("psm"))
    head = ["time", *(f"{j}_{what}" for j in joints for what in ("position", "effort"))]
    file = tmp_path / "motion.csv"
    file.write_bytes(",".join(head).encode() + b"\n0.0,\xff" + b",0.0" * 13 + b"\n")
    with pytest.raises(InputError, match=r"row 2: yaw_position: got '.'; allowed: a number"):
        read_motion(file, load_arm("psm"))


@pytest.mark.parametrize("version", ["1e-320", "", "9" * 5000, "1"])
def test_an_sdf_of_an_unreadable_version_is_refused(tmp_path: Path, version: str) -> None:
    file = tmp_path / "arm.sdf"
    file.write_text(f'<sdf version="{version}"><model name="m"><link name="a"/></model></sdf>')
    with pytest.raises(InputError, match=r"<sdf> version: got .*; allowed: two numbers"):
        import_file(file, tmp_path / "out")
