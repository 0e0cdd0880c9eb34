"""Output files are whole or not there, and replace nothing unless that is allowed."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import sys
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trocar.errors import InputError, TrocarError
from trocar.outputs import check_file, document, json_text, locked_stream, whole_file

LINKS = pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write(file: Path, text: str, overwrite: bool = False) -> None:
    with whole_file(file, overwrite) as part:
        part.write_text(text)


def fail_half_way(file: Path, overwrite: bool = False) -> None:
    with whole_file(file, overwrite) as part:
        part.write_text("half")
        raise ZeroDivisionError


def test_a_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    with whole_file(file) as part:
        assert part.suffix == ".csv" and not file.exists()
        part.write_text("whole")
    assert file.read_text() == "whole"
    assert names(tmp_path) == ["run.csv"]
    if sys.platform != "win32":
        mask = os.umask(0)
        os.umask(mask)
        assert file.stat().st_mode & 0o777 == 0o666 & ~mask


def test_a_failure_leaves_nothing_new_and_what_was_there(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    with pytest.raises(ZeroDivisionError):
        fail_half_way(file)
    assert names(tmp_path) == []
    file.write_text("old")
    with pytest.raises(ZeroDivisionError):
        fail_half_way(file, overwrite=True)
    assert (names(tmp_path), file.read_text()) == (["run.csv"], "old")


def test_an_existing_file_is_replaced_only_if_allowed(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    file.write_text("old")
    with pytest.raises(InputError, match=r"run\.csv: exists already; allowed: .*--overwrite"):
        check_file(file)
    with pytest.raises(InputError, match="exists already"):
        write(file, "new")
    with pytest.raises(InputError, match="exists already"):
        locked_stream(file)
    assert file.read_text() == "old"
    write(file, "new", overwrite=True)
    assert file.read_text() == "new"


def test_a_file_that_appears_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"

    def meet() -> None:
        with whole_file(file) as part:
            part.write_text("mine")
            file.write_text("another's")

    with pytest.raises(InputError, match="exists already"):
        meet()
    assert (names(tmp_path), file.read_text()) == (["run.csv"], "another's")


@LINKS
@pytest.mark.parametrize("overwrite", [False, True])
def test_nothing_is_written_through_a_symbolic_link(tmp_path: Path, overwrite: bool) -> None:
    kept, link, dangling = tmp_path / "kept", tmp_path / "link", tmp_path / "dangling"
    kept.write_text("kept")
    link.symlink_to(kept)
    dangling.symlink_to(tmp_path / "none")
    for file in (link, dangling):
        for opened in (check_file, locked_stream):
            with pytest.raises(InputError, match=r"is a symbolic link to .*; allowed: a file"):
                opened(file, overwrite)
        with pytest.raises(InputError, match="symbolic link"):
            write(file, "x", overwrite)
    assert kept.read_text() == "kept"
    assert names(tmp_path) == ["dangling", "kept", "link"]


def test_a_file_that_cannot_be_made_is_said_before_it_is_written(tmp_path: Path) -> None:
    for opened in (check_file, locked_stream):
        with pytest.raises(InputError, match="cannot be written: No such file or directory"):
            opened(tmp_path / "no" / "x.csv")
        with pytest.raises(InputError, match="cannot be written: Is a directory"):
            opened(tmp_path)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no device that is always full")
def test_a_full_disk_is_one_error_that_is_not_bad_input() -> None:
    with pytest.raises(TrocarError, match="/dev/full: cannot be written: No space") as caught:
        write(Path("/dev/full"), "x")
    assert not isinstance(caught.value, InputError)


def hold(file: Path, held: multiprocessing.Event, let_go: multiprocessing.Event) -> None:  # type: ignore[valid-type]
    with locked_stream(file) as stream:
        stream.write(b"theirs")
        held.set()  # type: ignore[attr-defined]
        let_go.wait(30.0)  # type: ignore[attr-defined]


@pytest.mark.skipif(sys.platform == "win32", reason="has no such locks")
def test_a_recording_of_another_program_is_not_replaced_while_it_runs(tmp_path: Path) -> None:
    context, file = multiprocessing.get_context("fork"), tmp_path / "run.mcap"
    held, let_go = context.Event(), context.Event()
    other = context.Process(target=hold, args=(file, held, let_go))
    other.start()
    assert held.wait(30.0)
    with pytest.raises(InputError, match="another program records into it; allowed: another file"):
        locked_stream(file, overwrite=True)
    assert file.read_bytes() == b"theirs"
    let_go.set()
    other.join()
    locked_stream(file, overwrite=True).close()
    assert file.read_bytes() == b""


class Colour(Enum):
    RED = "red"


@dataclass(frozen=True, eq=False)
class Entry:
    file: Path
    values: Any
    colour: Colour


@dataclass(frozen=True)
class Total:
    mass_kg: float

    def document(self) -> dict[str, float]:
        return {"mass_g": 1e3 * self.mass_kg}


def test_a_record_becomes_a_document_of_json_types() -> None:
    record = Entry(Path("a.csv"), {"t_s": np.array([[1.0, np.nan], [-0.0, np.inf]])}, Colour.RED)
    expected = {
        "file": "a.csv",
        "values": {"t_s": [[1.0, None], [0.0, None]]},
        "colour": "red",
    }
    assert document(record) == expected
    assert json.loads(json_text([record]), parse_constant=pytest.fail) == [expected]
    assert math.copysign(1.0, document(record)["values"]["t_s"][1][0]) == 1.0


def test_a_record_with_a_document_of_its_own_is_written_by_it() -> None:
    assert document({"each": (Total(0.5),)}) == {"each": [{"mass_g": 500.0}]}


def test_innermost_lists_stand_on_one_line() -> None:
    assert json_text({"q": np.zeros((2, 2))}) == (
        '{\n  "q": [\n    [0.0, 0.0],\n    [0.0, 0.0]\n  ]\n}'
    )
