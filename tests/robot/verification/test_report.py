"""What is verified together, what is refused, and the page about it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.overlay import write_overlay
from trocar.descriptions.overlay_records import ClosurePatch, Overlay
from trocar.errors import InputError, UnknownNameError
from trocar.robot.verification import Verification, check_report, verify, write_report
from trocar.robot.verification.figures import Figure, ReportPart


@pytest.fixture(scope="module")
def found() -> Verification:
    return verify(["psm"], parts=("rcm", "axes", "tracking", "formats"))


def overlay(folder: Path, name: str = "mine.toml") -> Path:
    """A PSM's overlay that lengthens a side of the second loop by 1 mm."""
    (c2,) = (c for c in load_arm("psm").mechanism.closures if c.name == "c2")
    patch = ClosurePatch(c2.point_a + np.array([1e-3, 0.0, 0.0]), c2.point_b)
    write_overlay(folder / name, Overlay("psm", "general", closures={"c2": patch}))
    return folder / name


def test_a_figure_knows_whether_it_is_met() -> None:
    assert Figure("a", 1.0, "m").met is None
    assert Figure("a", 1.0, "m", upper=1.0).met
    assert not Figure("a", 1.1, "m", upper=1.0).met
    assert Figure("a", 1.1, "m", lower=1.0).met
    assert not Figure("a", 0.9, "m", lower=1.0, upper=2.0).met
    assert not Figure("a", float("nan"), "m", upper=1.0).met


@pytest.mark.parametrize(
    ("value", "shown", "told"),
    [
        (0.51611, "mm", "516.11"),
        (-1.49e-3, "mm", "-1.49"),
        (1.2345e-7, "mm", "0.00012"),
        (-1e-12, "mm", "0"),
        (2.663e-8, "um", "0.0266"),
        (123.456, "", "123.46"),
        (20.5134, "", "20.51"),
        (3.1e-12, "", "3.1e-12"),
        (float("nan"), "", "-"),
        (None, "mm", ""),
    ],
)
def test_people_are_told_as_many_digits_as_mean_something(value, shown, told) -> None:
    assert Figure("a", 0.0, "m", shown=shown).text(value) == told


def test_a_figure_is_converted_to_the_unit_in_which_it_is_displayed() -> None:
    assert Figure("a", 0.00948, "N m", shown="mN m").text(0.00948) == "9.48"
    with pytest.raises(ValueError, match="a: shown in furlong; known: "):
        Figure("a", 1.0, "m", shown="furlong")  # when it is made, not after hours of measuring


def test_tolerances_are_told() -> None:
    assert (
        Figure("a", 0.0, "m", shown="mm", lower=0.14739, upper=0.15001).allowed == "148.7 +- 1.31"
    )
    assert Figure("a", 0.0, "m", shown="um", upper=1e-7).allowed == "<= 0.1"
    assert Figure("a", 0.0, "", lower=0.51).allowed == ">= 0.51"
    assert Figure("a", 0.0, "").allowed == ""


def test_parts_come_in_one_order_and_say_how_to_repeat_them(found: Verification) -> None:
    assert [part.name for part in found.parts] == ["rcm", "axes", "tracking", "formats"]
    assert found.parts[0].command == "trocar verify --only rcm --arm psm"
    assert found.missed == ()
    assert found.judged == sum(f.met is not None for p in found.parts for f in p.figures) > 0
    assert all(f.source for part in found.parts for f in part.figures)


def test_a_calibrated_robot_is_verified_without_naming_its_arm(tmp_path: Path) -> None:
    file = overlay(tmp_path)
    found = verify(calibrations=[file], parts=("rcm", "axes"))
    assert {part.arm for part in found.parts} == {"psm"}
    assert found.parts[0].command.endswith(f"--arm psm --calibration {file}")
    assert found.missed == ()
    assert any("another robot" in note for part in found.parts for note in part.notes)


def test_the_summary_counts_figures_without_a_tolerance_apart() -> None:
    stated, met = Figure("speed", 0.37, "", paper_simulation=0.47), Figure("gap", 0.1, "m", 0.5)

    def verified(*figures: Figure) -> Verification:
        return Verification(
            (ReportPart("closure", "psm", "Closure: loops", figures, "trocar verify"),)
        )

    assert verified(met, stated).summary == (
        "1 of 1 figures with a tolerance are within it; 1 more have none."
    )
    assert verified(met).summary == "1 of 1 figures with a tolerance are within it."
    assert verified(stated).summary == "No figure has a tolerance; 1 are stated without."
    assert [verified(*f).met for f in ((met, stated), (stated,))] == [True, None]


def test_bad_input_is_refused(tmp_path: Path) -> None:
    file = overlay(tmp_path)
    with pytest.raises(InputError, match="part: got 'speed'; allowed: closure, rcm"):
        verify(parts=["speed"])
    with pytest.raises(UnknownNameError, match="unknown arm 'pms'"):
        verify(["pms"], parts=["axes"])
    with pytest.raises(InputError, match="got an overlay of 'psm'; allowed: one of ecm"):
        verify(["ecm"], [file], ["axes"])
    with pytest.raises(InputError, match="got a second overlay of psm; allowed: one"):
        verify([], [file, overlay(tmp_path, "again.toml")], ["axes"])
    with pytest.raises(InputError, match="nothing of tracking applies to ecm"):
        verify(["ecm"], parts=["tracking"])


def test_the_report_is_one_page_that_asks_nobody_for_anything(
    found: Verification, tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib")
    file = Path(write_report(tmp_path / "new" / "report", found))
    assert [p.name for p in file.parent.iterdir()] == ["index.html"]
    page = file.read_text(encoding="utf-8")
    assert page.count("<svg") == 4  # Figure 9, Table 6, and Figure 10 twice
    fetched = re.findall(r"(?:src|href|url\()\s*=?\s*[\"'(]?(?!#)[^\"')]*https?://[^\"')]*", page)
    assert not [f for f in fetched if "w3.org" not in f]
    assert "<script" not in page and "@import" not in page
    for part in found.parts:
        assert part.command in page
    for text in ("-516.11", "-518.60", "148.7", "mrad", found.summary):
        assert text in page


def test_a_figure_out_of_tolerance_stands_at_the_head_of_the_page(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    wrong = Figure("loop gap <here>", 1.0, "m", upper=0.5, source="a test")
    part = ReportPart("closure", "psm", "Closure: loops", (wrong,), "trocar verify")
    file = write_report(tmp_path, Verification((part,)))
    page = Path(file).read_text(encoding="utf-8")
    assert "Out of tolerance:</p><ul><li>loop gap &lt;here&gt;</li>" in page
    assert "0 of 1 figures with a tolerance are within it." in page


def test_a_report_goes_into_a_folder_only(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    found = Verification((ReportPart("formats", "psm", "Formats", (), "trocar verify"),))
    taken = tmp_path / "taken"
    taken.write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="is not a folder; allowed"):
        check_report(taken)
    with pytest.raises(InputError, match="is not a folder; allowed"):
        write_report(taken, found)
    assert taken.read_text(encoding="utf-8") == "mine"
    with pytest.raises(InputError, match="cannot be written"):
        write_report(taken / "below", found)
