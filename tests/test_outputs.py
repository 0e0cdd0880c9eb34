"""Output files are whole or not there, and replace nothing unless that is allowed."""

from __future__ import annotations

import multiprocessing
import os
import sys
from pathlib import Path

import pytest

from trocar.errors import InputError, TrocarError
from trocar.outputs import check_file, locked_stream, whole_file

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
