"""The walk through docs/calibration.md, as it is written there."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

from trocar.cli import main
from trocar.descriptions.overlay import read_overlay

PAGE = Path(__file__).parents[1] / "docs" / "calibration.md"


@pytest.mark.slow
def test_the_walk_leads_from_tracks_to_a_verified_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    walk = PAGE.read_text(encoding="utf-8").split("## A walk\n")[1].split("\n## ")[0]
    (block,) = re.findall(r"^```bash\n(.*?)^```$", walk, re.DOTALL | re.MULTILINE)
    printed: dict[str, str] = {}
    for line in block.splitlines():
        words = shlex.split(line, comments=True)
        assert main(words[1:]) == 0, line
        printed[words[1]] = capsys.readouterr().out
    assert list(printed) == ["mocap", "calibrate", "show", "sim", "verify"]
    truth = json.loads(Path("tracks.csv.truth.json").read_text(encoding="utf-8"))
    overlay = read_overlay("mine.toml")
    for label, wanted in truth["axis_distances_m"].items():
        told = overlay.measured["axis_distances_m"][label]
        # four standard deviations: once in a thousand walks of eight distances
        assert abs(told["value"] - wanted) < 4.0 * told["sigma"], label
    assert re.search(r"assembly branch +correct", printed["sim"])
    assert "MISSED" not in printed["verify"]
    for page in ("measured", "verified"):
        text = Path(page, "index.html").read_text(encoding="utf-8")
        assert "3-6" in text
        assert text.count("<svg") >= 2
        assert not re.search(r'(src|href)="(?!#|data:)', text)  # self-contained
