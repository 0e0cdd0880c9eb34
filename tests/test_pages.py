"""The pages about the rooms and the code that they describe say the same."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.served import served
from trocar.cli import main
from trocar.descriptions import load_rig
from trocar.descriptions.sensors import KINDS
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


# ------------------------------------------------------------------ sensors.md


def rig_of_the_page_on_sensors(folder: Path) -> Path:
    """Write a PSM's rig with every sensor that the page shows."""
    (shown,) = re.findall(r"^```toml\n(.*?)^```$", text("sensors.md"), re.DOTALL | re.MULTILINE)
    path = folder / "rigs" / "sensors.toml"
    path.parent.mkdir()
    path.write_text(f"{Path(load_rig('psm').file).read_text(encoding='utf-8')}\n{shown}")
    return path


def test_the_sensors_that_their_page_shows_can_be_read(tmp_path: Path) -> None:
    world = World(rig_of_the_page_on_sensors(tmp_path))
    kinds = {world.sensor(name).kind for name in world.sensors}
    assert kinds == set(KINDS) - {"tension"}  # of a band, which the rig of that page has not
    assert not [kind for kind in KINDS if f"| `{kind}` |" not in text("sensors.md")]
