"""xacro is expanded as its documentation says, and runs no code."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

pytest.importorskip("lxml", reason="lxml is not installed (extra export)")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")

from trocar.errors import InputError
from trocar.formats.importing import ImportOptions, import_file
from trocar.formats.xacro import expand
from trocar.formats.xml_tree import XmlNode, read_xml

HEAD = '<?xml version="1.0"?><robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'


def expanded(body: str, folder: Path, **arguments: str) -> XmlNode:
    file = folder / "robot.urdf.xacro"
    file.write_text(f"{HEAD}{body}</robot>", encoding="utf-8")
    return expand(read_xml(file), file, (), arguments)


def value(expression: str, folder: Path, before: str = "", **arguments: str) -> str:
    root = expanded(f'{before}<link name="{expression}"/>', folder, **arguments)
    return root.children("link")[0].attribute("name")


A = '<xacro:property name="a" value="2.5"/>'


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("${a * 2}", "5.0"),
        ("x_${a}_y", "x_2.5_y"),
        ("${-a + 1}", "-1.5"),
        ("${a ** 2}", "6.25"),
        ("${7 // 2} ${7 % 2}", "3 1"),
        ("${sin(pi / 6) + 0.5}", "1.0"),
        ("${radians(180) == pi}", "True"),
        ("${'yes' if a > 2 else 'no'}", "yes"),
        ("${str(a).upper() + '_x'}", "2.5_x"),
        ("${a in [1, 2.5] and not a == 3}", "True"),
        ("${dict(zip=1) if False else {'k': [4, 5]}['k'][1]}", "5"),
        ("$${a}", "${a}"),
        ("$$(arg a)", "$(arg a)"),
        ("${max(1, a, 2)}", "2.5"),
        ("$(eval 1 + 1)", "2"),
        ("$(optenv NOWHERE none at all)", "none at all"),
    ],
)
def test_expressions(expression: str, expected: str, tmp_path: Path) -> None:
    assert value(expression, tmp_path, A) == expected


def test_properties_are_numbers_truths_or_texts(tmp_path: Path) -> None:
    for text, expected in (("0112", "113"), ("1e-3", "1.001"), ("true", "2"), ("'7'", "71")):
        own = f'<xacro:property name="p" value="{text}"/>'
        one = "'1'" if text == "'7'" else "1"
        assert value(f"${{p + {one}}}", tmp_path, own) == expected


def test_a_property_uses_others_of_later_lines(tmp_path: Path) -> None:
    own = '<xacro:property name="b" value="${a + 1}"/>'
    assert value("${b}", tmp_path, own + A) == "3.5"


def test_arguments_have_defaults_and_values(tmp_path: Path) -> None:
    own = '<xacro:arg name="tool" default="420006"/>'
    assert value("$(arg tool)", tmp_path, own) == "420006"
    assert value("$(arg tool)", tmp_path, own, tool="400006") == "400006"
    with pytest.raises(InputError, match=r"robot.urdf.xacro:1: .*give --arg gone=VALUE"):
        value("$(arg gone)", tmp_path)


def test_macros_have_parameters_defaults_blocks_and_outer_values(tmp_path: Path) -> None:
    root = expanded(
        '<xacro:property name="side" value="left"/>'
        '<xacro:macro name="leg" params="prefix length:=0.5 xyz:=\'0 0 1\' side:=^|right'
        ' *origin **more"><link name="${prefix}_${side}_${length}"><xacro:insert_block'
        ' name="origin"/><at xyz="${xyz}"/><xacro:insert_block name="more"/></link></xacro:macro>'
        '<xacro:leg prefix="${side}er"><origin rpy="${1 + 1}"/><all><one/><two/></all></xacro:leg>',
        tmp_path,
    )
    (link,) = root.children("link")
    assert link.attribute("name") == "lefter_left_0.5"
    assert [node.tag for node in link.children()] == ["origin", "at", "one", "two"]
    assert link.need("at").attribute("xyz") == "0 0 1"
    assert link.need("origin").attribute("rpy") == "2"


def test_a_macro_s_properties_end_with_it(tmp_path: Path) -> None:
    body = (
        '<xacro:macro name="m" params=""><xacro:property name="a" value="9"/>'
        '<xacro:property name="g" value="3" scope="global"/><link name="in_${a}"/></xacro:macro>'
        '<xacro:m/><link name="out_${a}_${g}"/>'
    )
    names = [link.attribute("name") for link in expanded(A + body, tmp_path).children("link")]
    assert names == ["in_9", "out_2.5_3"]


def test_conditions(tmp_path: Path) -> None:
    body = "".join(
        f'<xacro:{tag} value="{v}"><link name="{tag}_{k}"/></xacro:{tag}>'
        for tag in ("if", "unless")
        for k, v in enumerate(("true", "0", "${a > 2}", "False"))
    )
    names = [link.attribute("name") for link in expanded(A + body, tmp_path).children("link")]
    assert names == ["if_0", "if_2", "unless_1", "unless_3"]
    with pytest.raises(InputError, match="value: got 'maybe'; allowed: true, false or a number"):
        expanded('<xacro:if value="maybe"/>', tmp_path)


def test_files_of_a_package_are_included_and_tables_read(tmp_path: Path) -> None:
    package = tmp_path / "checkout"
    (package / "urdf").mkdir(parents=True)
    manifest = "<package><name>my_robot</name></package>"
    (package / "package.xml").write_text(manifest, encoding="utf-8")
    (package / "urdf" / "tools.yaml").write_text("tools: {'7': {length: 0.4}}", encoding="utf-8")
    (package / "urdf" / "parts.xacro").write_text(
        f"{HEAD}<xacro:property name=\"t\" value=\"${{xacro.load_yaml('tools.yaml')['tools']}}\"/>"
        '<xacro:macro name="part" params="name"><link name="${name}"/></xacro:macro></robot>',
        encoding="utf-8",
    )
    body = (
        '<xacro:include filename="$(find my_robot)/urdf/parts.xacro"/>'
        "<xacro:part name=\"l_${t['7']['length']}\"/>"
    )
    root = expanded(body, package / "urdf")
    assert root.children("link")[0].attribute("name") == "l_0.4"
    with pytest.raises(InputError, match=r"package 'gone' not found; .*--package-path"):
        expanded('<xacro:include filename="$(find gone)/a.xacro"/>', package / "urdf")


def test_a_package_is_found_from_a_relative_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A relative $(find) would be taken from the file's folder, a second time."""
    model = tmp_path / "packages" / "arm" / "model"
    model.mkdir(parents=True)
    (model / "part.xacro").write_text(f'{HEAD}<link name="part"/></robot>')
    main = model / "arm.urdf.xacro"
    main.write_text(f'{HEAD}<xacro:include filename="$(find arm)/model/part.xacro"/></robot>')
    monkeypatch.chdir(tmp_path)
    short = main.relative_to(tmp_path)
    root = expand(read_xml(short), short, (Path("packages"),), {})
    assert [one.attribute("name") for one in root.children("link")] == ["part"]


def test_a_robot_of_macros_is_imported_with_its_arguments(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf.xacro").write_text(
        f'{HEAD}<xacro:arg name="reach" default="0.3"/><link name="base"/>'
        '<xacro:macro name="bar" params="name on axis"><link name="${name}"><inertial>'
        '<mass value="0.2"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link><joint name="${name}_joint" type="revolute"><parent link="${on}"/>'
        '<child link="${name}"/><origin xyz="0 0 $(arg reach)"/><axis xyz="${axis}"/>'
        '<limit lower="${-pi / 2}" upper="${pi / 2}" effort="5" velocity="2"/></joint>'
        '</xacro:macro><xacro:bar name="one" on="base" axis="0 1 0"/>'
        '<xacro:bar name="two" on="one" axis="1 0 0"/></robot>',
        encoding="utf-8",
    )
    options = ImportOptions(arguments=(("reach", "0.45"),))
    found = import_file(tmp_path / "arm.urdf.xacro", tmp_path / "out", options)
    assert found.joints == ("one_joint", "two_joint")
    text = Path(found.file).read_text(encoding="utf-8")
    assert "0.45" in text
    assert f"{math.pi / 2!r}" in text


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        ('<link name="${open(1)}"/>', "function 'open' is not supported"),
        ("<link name=\"${__import__('os')}\"/>", "is not supported"),
        ("<link name=\"${''.__class__.__mro__}\"/>", "cannot be evaluated"),
        ("<link name=\"${str.__subclasses__()}\"/>", "is not supported|cannot be evaluated"),
        ('<link name="${[i for i in [1]]}"/>', "is not supported"),
        ('<link name="${9 ** 9 ** 9}"/>', "allowed: up to 64"),
        ("<link name=\"${'a' * 1000000}\"/>", "where a number is needed"),
        ('<link name="$(env HOME)"/>', r"got \$\(env HOME\); allowed: find, arg"),
        ('<link name="${nobody}"/>', "property 'nobody', which does not exist"),
        ('<xacro:wheel/>', "xacro:wheel is neither a macro nor supported"),
        ('<xacro:insert_block name="b"/>', "block 'b', which does not exist"),
        ('<xacro:macro name="m" params=""><xacro:m/></xacro:macro><xacro:m/>', "nested more than"),
        ('<xacro:macro name="m" params="a"/><xacro:m/>', "lacks the parameter 'a'"),
        ('<xacro:macro name="m" params="a"/><xacro:m a="1" b="2"/>', "no parameter 'b'; all"),
        ('<xacro:property name="p" value="${p}"/><link name="${p}"/>', "refers to itself"),
        ("<link name=\"${'%99999999d' % 1}\"/>", "where a number is needed"),
        ('<link name="${1 / 0}"/>', "cannot be evaluated: division by zero"),
    ],
)  # fmt: skip
def test_what_cannot_be_expanded_is_named(body: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"robot\.urdf\.xacro:1: .*({problem})"):
        expanded(body, tmp_path)


def test_a_file_of_macros_alone_is_called_so(tmp_path: Path) -> None:
    body = '<xacro:macro name="m" params=""><link name="l"/></xacro:macro>'
    (tmp_path / "base.xacro").write_text(f"{HEAD}{body}</robot>", encoding="utf-8")
    with pytest.raises(InputError, match=r"has no links; .*macros alone"):
        import_file(tmp_path / "base.xacro", tmp_path / "out")
