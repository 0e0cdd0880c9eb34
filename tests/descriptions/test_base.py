"""Files that say only how they differ from their base."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trocar.cli.program import main
from trocar.descriptions import load_tool, names
from trocar.errors import DescriptionError

BASE = "LARGE_NEEDLE_DRIVER:400006"
HEAD = f'schema = 1\nbase = "{BASE}"\nname = "MINE:1"\n'


@pytest.fixture
def written(tmp_path: Path):
    """Return the function that writes a file beside the others of the test."""

    def write(text: str, name: str = "mine.toml") -> Path:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_tool_says_only_what_differs_from_its_base(written, capsys) -> None:
    path = written(HEAD + '[[frame]]\nname = "roll"\nd_mm = 426.2\n')
    pose: list[np.ndarray] = []
    for tool in (BASE, str(path)):
        assert main(["fk", "psm", "0", "0", "0.12", "0", "0", "0", "--tool", tool]) == 0
        rows = capsys.readouterr().out.splitlines()[-4:-1]
        pose.append(np.array([[float(word) for word in row.split()[-4:]] for row in rows]))
    moved = pose[1][:, 3] - pose[0][:, 3]
    assert np.linalg.norm(moved) == pytest.approx(0.01, abs=1e-6)
    assert load_tool(path).name == "MINE:1"
    assert load_tool(path).fits == load_tool(BASE).fits


def test_tables_are_merged_by_key_and_rows_by_their_name_or_frame(written) -> None:
    rows = '[[joint]]\nname = "jaw"\neffort_max_nm = 0.5\n[[body]]\nframe = "roll"\nmass_kg = 1\n'
    rows += '[[frame]]\nname = "dot"\nparent = "tip"\n[control.dvrk]\npid = { jaw = [1, 0, 0] }\n'
    tool = load_tool(written(HEAD + rows))
    nominal = load_tool(BASE)
    assert [j.effort_max for j in tool.parts.joints] == [0.33, 0.25, 0.20, 0.5]
    assert [b.mass for b in tool.parts.bodies][1] == 1.0
    assert tool.parts.bodies[1].solid == nominal.parts.bodies[1].solid
    assert [f.name for f in tool.parts.frames] == [*(f.name for f in nominal.parts.frames), "dot"]
    pid = tool.parts.control["dvrk"].pid
    assert (pid["jaw"].p, pid["roll"]) == (1.0, nominal.parts.control["dvrk"].pid["roll"])


def test_what_is_dropped_may_be_said_anew(written) -> None:
    jaw = '[[joint]]\nname = "jaw"\ndrop = ["lower_rad"]\nlower_deg = -10.0\n'
    poses = '[[pose]]\nname = "home"\nq_rad_m = [0, 0, 0, 0]\n'
    tool = load_tool(written(HEAD + 'drop = ["pose"]\n' + jaw + poses))
    assert tool.parts.joints[3].lower == pytest.approx(np.deg2rad(-10.0))
    assert list(tool.parts.poses) == ["home"]


def test_rows_that_share_a_name_replace_the_whole_array(written) -> None:
    row = '[[body]]\nframe = "roll"\nmass_kg = 0.1\nsolid = "tools/shaft_4162"\n'
    assert [b.mass for b in load_tool(written(HEAD + row + row)).parts.bodies] == [0.1, 0.1]


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ('[[frame]]\nname = "roll"\nd_mm = "x"\n', "frame[0].d_mm: got 'x'; allowed: a finite"),
        ('[[body]]\nframe = "tip"\nmass_kg = -1.0\n', "body[0].mass"),
        ('[[joint]]\nname = "jaw"\nlower_rad = 9.0\n', "joint[0].lower"),
        ("[rotor]\nroll = 1.0\n", "rotor.roll: got 1.0; allowed: a table"),
        ('[[joint]]\nname = "jaw"\ncolor = 1\n', "joint[0].color: unknown key"),
        ('[[joint]]\nname = "jaw"\nlower_deg = 1.0\n', "joint[0].lower_deg: contradicts lower_rad"),
        ('[coupling]\ndrop = ["yaw"]\n', "coupling.drop: got 'yaw'; allowed: joints, actuator_to"),
        ("[coupling]\ndrop = 3\n", "coupling.drop: got 3; allowed: a list of texts"),
        ('[[pose]]\nname = "new"\ndrop = ["q"]\nq_rad_m = [0, 0, 0, 0]\n', "pose[0].drop: unknown"),
    ],
)
def test_a_fault_is_named_where_it_stands(text, where, written) -> None:
    path = written(HEAD + text)
    with pytest.raises(DescriptionError) as caught:
        load_tool(path)
    assert str(caught.value).startswith(f"{path}: {where}")


def test_a_fault_in_the_base_is_named_there_from_any_depth(written) -> None:
    below = written(
        f'schema = 1\nbase = "{BASE}"\nname = "A:1"\n[[joint]]\nname = "jaw"\neffort_max_nm = -1\n',
        "below.toml",
    )
    middle = written('schema = 1\nbase = "below.toml"\nname = "B:1"\n', "middle.toml")
    rows = '[[joint]]\nname = "jaw"\nlower_rad = -0.1\n[[frame]]\nname = "roll"\nd_mm = 1\n'
    top = written('schema = 1\nbase = "middle.toml"\nname = "C:1"\n' + rows)
    for path in (middle, top):
        with pytest.raises(DescriptionError) as caught:
            load_tool(path)
        assert str(caught.value).startswith(f"{below}: joint[0].effort_max")


@pytest.mark.parametrize(
    ("head", "where"),
    [
        ('base = "SPOON:1"\nname = "A"', "base: unknown tool 'SPOON:1'"),
        ('base = "none.toml"\nname = "A"', "base: "),
        ('base = "mine.toml"\nname = "A"', "base: got 'mine.toml'; allowed: a file that is not"),
        ('base = "ring.toml"\nname = "A"', "base: got 'mine.toml'; allowed: a file that is not"),
        ("base = 3", "base: got 3; allowed: a text"),
        (f'base = "{BASE}"', "name: is missing"),
        (f'schema = 2\nbase = "{BASE}"\nname = "A"', "schema: got 2; allowed: 1"),
    ],
)
def test_a_wrong_base_ends_a_command_with_2(head, where, written, capsys) -> None:
    ring = written('schema = 1\nname = "B"\nbase = "mine.toml"\n', "ring.toml")
    path = written(head + "\n" if "schema" in head else f"schema = 1\n{head}\n")
    assert main(["fk", "psm", "0", "0", "0.12", "0", "0", "0", "--tool", str(path)]) == 2
    message = capsys.readouterr().err
    assert f"{ring if 'ring' in head else path}: {where}" in message


def test_twins_of_the_si_have_the_chain_of_the_classic_with_a_longer_shaft() -> None:
    """Source: the roll's d of sawIntuitiveResearchKit's share/tool, 400... and 420... ."""
    for name in names("tools"):
        if ":420" in name and not name.endswith("_GEARED"):
            short, long = load_tool(name.replace(":420", ":400")), load_tool(name)
            moved = [
                (a.name, round(1e3 * float(np.linalg.norm(b.before[:3, 3] - a.before[:3, 3])), 6))
                for a, b in zip(short.parts.frames, long.parts.frames, strict=True)
                if not np.array_equal(a.before, b.before)
            ]
            assert moved == [("roll", 50.8)], name
