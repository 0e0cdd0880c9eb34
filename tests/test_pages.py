"""The pages about the rooms and the code that they describe say the same."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.served import served
from trocar.cli import main
from trocar.descriptions import catalogue, load_arm, load_rig, load_tool, names, table
from trocar.descriptions.cameras import load_camera
from trocar.descriptions.paper import errata, load_printed, printed_tables
from trocar.descriptions.sensors import KINDS
from trocar.descriptions.solids import INDEX
from trocar.simulation import World

DOCS = Path(__file__).parents[1] / "docs"
PAGES = sorted(DOCS.glob("*.md"))


def text(page: str) -> str:
    return (DOCS / page).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(p, id=p.stem, marks=[pytest.mark.slow] if p.stem == "scenes" else [])
        for p in PAGES
        if "\n```python\n" in p.read_text(encoding="utf-8") and p.stem != "sockets"
    ],
)
def test_the_python_of_a_page_runs_from_top_to_bottom(
    page: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    request: pytest.FixtureRequest,
) -> None:
    monkeypatch.chdir(tmp_path)  # some pages write files
    blocks = python(page.name)
    if any("trocar.rendering" in block for block in blocks):
        request.getfixturevalue("opengl")
    names: dict[str, object] = {}
    for number, block in enumerate(blocks):
        exec(compile(block, f"{page.name}, block {number}", "exec"), names)
    capsys.readouterr()


def python(page: str) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", text(page), re.DOTALL | re.MULTILINE)


def test_the_client_on_the_page_about_sockets_talks_to_a_simulator() -> None:
    pytest.importorskip("roslibpy", reason="the extra `clients` is not there")
    with socket.socket() as probe:
        if probe.connect_ex(("127.0.0.1", 9090)) == 0:
            pytest.skip("something else listens on port 9090, which the page names")
    with served(["--no-page", "--rig", "psm"], r"ws://\S+"):
        done = subprocess.run(
            [sys.executable, "-c", "\n".join(python("sockets.md"))],
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert done.returncode == 0, done.stderr


def test_the_index_names_every_page() -> None:
    index = text("README.md")
    assert not [p.name for p in PAGES if p.name != "README.md" and f"]({p.name})" not in index]


def test_the_page_on_security_has_the_port_of_every_server(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        main(["sim", "--help"])
    said = re.findall(r"^ +--(\S*port) N\b.*?default: (\d+)", capsys.readouterr().out, re.M | re.S)
    shown = re.findall(r"TCP (\d+) \(`--(\S*port)`\)", text("security.md"))
    assert len(shown) == 3
    assert dict(said) == {option: port for port, option in shown}


# ------------------------------------------------------------------ descriptions.md: the schema

#: Longest first: q_rad_m is a joint vector, no length.
UNITS = sorted({unit for units in table.UNITS.values() for unit in units}, key=len, reverse=True)
#: Tables whose keys are names that a file chooses; beside these, what is fixed in them.
NAMES_ONLY = (
    r"joint\.drive|frame\.q|control|control\.[^.]+\.pid|friction|calibration\.(axes|betas)"
    r"|pose\.q_rad_m"
)
#: Paths as files have them, and the section that describes them.
SECTIONS = (
    (r"friction\.[^.]+(\.[^.]+)?", "friction"),
    (r"rotor(\.[^.]+)?", "rotor"),
    (r"control\.[^.]+", "control"),
    (r"(body|prop)\.shape", "shape"),
    (r"joint\.spring", "spring"),
    (r"arm\.base_frame", "base_frame"),
    (r"prop\.joint", "joint"),
    (r"band\.point", "point"),
)


def without_unit(key: str) -> str:
    """`lower_rad` and `lower_*` are the same key."""
    for unit in [*UNITS, "*"]:
        if key.endswith(f"_{unit}"):
            return f"{key[: -len(unit) - 1]}_*"
    return key


def documented() -> dict[tuple[str, str], set[str]]:
    """{(chapter, section): keys} of the page."""
    found: dict[tuple[str, str], set[str]] = {}
    chapter, section = "", ""
    for line in text("descriptions.md").splitlines():
        if line.startswith("## "):
            chapter, section = line[3:].lower(), ""
        elif line.startswith("### "):
            name = re.search(r"[a-z_]+", line[4:].replace("The file", ""))
            section = name[0] if name else "file"
        elif line.startswith("| `") and section:
            keys = re.findall(r"`([^`]+)`", line.split("|")[1])
            found.setdefault((chapter, section), set()).update(map(without_unit, keys))
    return found


def mesh_tool(folder: Path) -> Path:
    """A tool whose left finger is also a mesh; no built-in file has one."""
    (folder / "tools").mkdir()
    (folder / "tools" / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    built_in = Path(load_tool(names("tools")[0]).file).read_text(encoding="utf-8")
    start = built_in.index("shape = [", built_in.index('[[body]]\nframe = "finger_left"'))
    mesh = '\n    { kind = "mesh", file = "a.obj" },'
    at = start + len("shape = [")
    path = folder / "tools" / "mesh.toml"
    path.write_text(built_in[:at] + mesh + built_in[at:], encoding="utf-8")
    return path


def rig_of_the_page_on_sensors(folder: Path) -> Path:
    """Write a PSM's rig with every sensor that the page shows."""
    (shown,) = re.findall(r"^```toml\n(.*?)^```$", text("sensors.md"), re.DOTALL | re.MULTILINE)
    path = folder / "rigs" / "sensors.toml"
    path.parent.mkdir()
    path.write_text(f"{Path(load_rig('psm').file).read_text(encoding='utf-8')}\n{shown}")
    return path


def teleoperated_rig(folder: Path) -> Path:
    """A console with an arm that tells its poses in a frame of its own; no built-in rig has one."""
    path = folder / "rigs" / "teleoperated.toml"
    built_in = Path(load_rig("full_cart_mtm").file).read_text(encoding="utf-8")
    own = built_in.replace('name = "PSM1"\n', 'name = "PSM1"\nbase_frame = { name = "ECM" }\n', 1)
    path.write_text(own, encoding="utf-8")
    return path


def test_the_sensors_that_their_page_shows_can_be_read(tmp_path: Path) -> None:
    world = World(rig_of_the_page_on_sensors(tmp_path))
    kinds = {world.sensor(name).kind for name in world.sensors}
    assert kinds == set(KINDS) - {"tension"}  # of a band, which the rig of that page has not
    assert not [kind for kind in KINDS if f"| `{kind}` |" not in text("sensors.md")]


#: A prop of the shapes that no built-in rig has.
ROUND_SHAPES = """
[[prop]]
name = "round"
xyz_mm = [0, 200, 0]
shape = [
    { kind = "ring", radius_mm = 8, wire_radius_mm = 1, sides = 8 },
    { kind = "cup", radius_mm = 8, wall_mm = 1, height_mm = 10, floor_mm = 1 },
]
"""


def asked_for(monkeypatch: pytest.MonkeyPatch, folder: Path) -> dict[tuple[str, str], set[str]]:
    """{(chapter, section): keys} that the reader asks for while it reads every built-in file."""
    found: dict[tuple[str, str], set[str]] = {}
    raw, keys = table.Table.raw, table.Table._keys
    contains = table.Table.__contains__

    def note(self: table.Table, key: str) -> None:
        if Path(self.file).name == INDEX:  # written by make cad, not by people
            return
        path = re.sub(r"\[\d+\]", "", self.path)
        if re.fullmatch(NAMES_ONLY, path):
            return
        if re.fullmatch(r"friction\.[^.]+|rotor", path) and key != "source":
            return
        section = path or "file"
        for pattern, name in SECTIONS:
            section = name if re.fullmatch(pattern, path) else section
        folder = Path(self.file).parent.name
        if (folder, path, key) == ("rigs", "", "task"):  # tells scenes, which are no rigs
            return
        chapter = folder if folder in ("rigs", "cameras") else "arms"
        if section == "coupling" or (folder == "tools" and section == "file"):
            chapter = "tools"
        if section == "shape":
            chapter = "arms"
        found.setdefault((chapter, section), set()).add(without_unit(key))

    def noted_raw(self: table.Table, key: str, default: object = None) -> object:
        note(self, key)
        return raw(self, key, default)

    def noted_keys(self: table.Table, name: str, dimensions: tuple[str, ...]) -> object:
        note(self, f"{name}_*")
        return keys(self, name, dimensions)

    def noted_contains(self: table.Table, key: str) -> bool:
        note(self, key)
        return contains(self, key)

    catalogue._shipped_arm.cache_clear()  # another test may have read them
    monkeypatch.setattr(table.Table, "raw", noted_raw)
    monkeypatch.setattr(table.Table, "__contains__", noted_contains)
    monkeypatch.setattr(table.Table, "_keys", noted_keys)
    for arm in names("arms"):
        load_arm(arm)
    for rig in names("rigs"):
        load_rig(rig)
    load_rig(rig_of_the_page_on_sensors(folder))
    for camera in names("cameras"):
        load_camera(camera)
    load_rig(teleoperated_rig(folder))
    for file in (Path(__file__).parents[1] / "examples" / "props").iterdir():
        shutil.copy(file, folder / "rigs")
    with (folder / "rigs" / "play.toml").open("a", encoding="utf-8") as file:
        file.write(ROUND_SHAPES)
    load_rig(folder / "rigs" / "play.toml")
    for printed in printed_tables():
        load_printed(printed)
        errata(printed)
    load_tool(mesh_tool(folder))
    blocks = {section for _, section in found} - {"file", "shape"}
    return {
        place: wanted - blocks if place[1] == "file" else wanted for place, wanted in found.items()
    }


def test_the_page_on_descriptions_has_every_key_and_no_other(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    wanted, shown = asked_for(monkeypatch, tmp_path), documented()
    assert set(wanted) == set(shown)
    for place, keys in wanted.items():
        assert shown[place] <= keys, place
        assert keys - shown[place] <= {"source"}, place  # of every block, as the page says once
