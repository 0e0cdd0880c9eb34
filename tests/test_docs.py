"""What the pages show works: their examples run, their links lead somewhere."""

from __future__ import annotations

import re
import runpy
import shlex
import subprocess
from pathlib import Path
from typing import Any

import pytest

from trocar.cli import main
from trocar.cli.program import COMMANDS
from trocar.descriptions import load_arm, load_rig

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(text: str, language: str) -> list[str]:
    """The code blocks of a page that are marked as being in some language ("" for none)."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def commands() -> list[str]:
    """Each trocar command of the README, its remark cut off."""
    lines = "".join(blocks(README, "")).splitlines()
    return [line.split(" #")[0].strip() for line in lines if line.startswith("trocar ")]


def test_links_inside_the_repository_lead_somewhere() -> None:
    missing = [
        f"{page.name}: {link}"
        for page in PAGES
        for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
        if not (page.parent / link).exists()
    ]
    assert not missing


def test_the_readme_shows_every_command_and_no_other() -> None:
    typed = [line.split()[1:] for line in commands()]
    pairs = [("-".join(words[:2]), words[0]) for words in typed]  # "learn train" is learn-train
    shown = {two if two in COMMANDS else one for two, one in pairs} - {"--help"}
    assert set(COMMANDS) - {"calibrate-paper", "rcm", "completion"} <= shown <= set(COMMANDS)


def test_the_readme_calls_no_sample_file_a_recording_of_a_real_robot() -> None:
    lines = [line for line in README.splitlines() if " samples/" in line]
    assert lines
    assert not [line for line in lines if "real one" in line]


#: Longer than a test may take, ended by Ctrl-C alone, or of a robot; each has tests of its own.
LONG = ("trocar bench", "trocar verify", "trocar conform", "trocar learn drive")
#: What a command that serves is given as well: any free ports, and an end.
SERVES = {
    "sim": ("--duration", "0.2", "--port", "0", "--websocket-port", "0"),
    "play": ("--duration", "0.2", "--port", "0", "--websocket-port", "0"),
    "teleop": ("--duration", "0.2", "--port", "0", "--websocket-port", "0"),
    "mirror": ("--duration", "0.2", "--port", "0"),
    "view": ("--duration", "0.2", "--port", "0"),
}


def tour() -> list[list[str]]:
    """The paragraphs of the tour, a list of commands each."""
    (block,) = [b for b in blocks(README, "") if "trocar show psm " in b]
    return [
        [line.split(" #")[0].strip() for line in paragraph.splitlines()]
        for paragraph in block.strip().split("\n\n")
    ]


@pytest.mark.slow
@pytest.mark.parametrize("lines", tour(), ids=lambda lines: lines[0])
def test_the_tour_of_the_readme_works_as_it_is_typed(
    lines: list[str],
    tmp_path: Path,
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    for library in ("mcap", "matplotlib", "lxml", "trimesh", "coacd", "rosbags"):
        pytest.importorskip(library, reason="the extra `all` is not installed")
    if any(" render " in line for line in lines):
        pytest.importorskip("imageio_ffmpeg", reason="the extra `all` is not installed")
        request.getfixturevalue("opengl")
    if any(" learn" in line for line in lines):
        for library in ("torch", "safetensors", "pyarrow"):
            pytest.importorskip(library, reason="the extra `learn` is not installed")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    for line in lines:
        words = shlex.split(line)
        more = () if "--headless" in words else SERVES.get(words[1], ())
        if not line.startswith((*LONG, "pip ")):  # the extra is looked for above
            assert main([*words[1:], *more]) == 0, f"{line}\n{capfd.readouterr().err}"


def test_make_run_installs_what_the_tour_needs_and_says_how_to_type_its_commands() -> None:
    begin = README.split("## What there is")[0]
    assert "\n. .venv/bin/activate " in begin and "\npip install '.[all]'\n" in begin
    said = subprocess.run(
        ["make", "--dry-run", "run"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    hints = re.findall(r'echo "  (trocar|python) ([^"]*?)   +[^"]*"', said)
    assert len(hints) == 5
    assert all(f"\n{program} {words}" in begin for program, words in hints)
    for program, words in hints:
        if program == "python":
            assert (ROOT / words).is_file()
        else:
            assert words.split()[0] in (*COMMANDS, "--help")


def shown() -> list[tuple[str, str]]:
    """Each command whose output a page shows, and what it says that it prints."""
    text = "".join(
        block
        for page in sorted((ROOT / "docs").glob("*.md"))
        for block in blocks(page.read_text(encoding="utf-8"), "console")
    )
    pairs = [block.split("\n", 1) for block in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]]
    return [(command, output) for command, output in pairs]


@pytest.mark.parametrize(("line", "printed"), shown(), ids=[line for line, _ in shown()])
def test_a_command_prints_what_its_page_shows(
    line: str, printed: str, capfd: pytest.CaptureFixture[str]
) -> None:
    main(shlex.split(line)[1:])
    said = capfd.readouterr()
    # "..." stands for whatever is left out.
    wanted = re.escape(printed.strip()).replace(re.escape("..."), "(?s:.*?)")
    assert re.fullmatch(wanted, (said.err + said.out).strip())


def test_the_readme_moves_an_arm_in_python(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = blocks(README, "python")
    exec(compile(example, "README.md", "exec"), {})
    assert capsys.readouterr().out


@pytest.mark.parametrize(
    ("page", "tool"),
    [
        ("command-line.md", "command_line.py"),
        ("descriptions.md", "descriptions.py"),
        ("errata.md", "errata.py"),
        ("learning-scenes.md", "learning_scenes.py"),
        ("scene-list.md", "scenes.py"),
        ("script-calls.md", "calls.py"),
        ("topic-list.md", "topics.py"),
    ],
)
def test_a_generated_page_is_what_the_program_offers(page: str, tool: str) -> None:
    written = runpy.run_path(str(ROOT / "tools" / "docs" / tool))["page"]()
    assert (ROOT / "docs" / page).read_text(encoding="utf-8") == written, "make docs"


def test_the_page_on_the_command_line_solves_in_python_too() -> None:
    page = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    (example,) = blocks(page, "python")
    said: dict[str, Any] = {}
    exec(compile(example, "command-line.md", "exec"), said)
    assert said["solutions"].shape[1] == 6


def test_the_files_shown_to_contributors_load(tmp_path: Path) -> None:
    arm, rig = blocks((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), "toml")
    (tmp_path / "two_link.toml").write_text(arm, encoding="utf-8")
    (tmp_path / "bench.toml").write_text(rig, encoding="utf-8")
    assert load_arm(tmp_path / "two_link.toml").name == "two_link"
    assert load_rig(tmp_path / "bench.toml").name == "bench"
