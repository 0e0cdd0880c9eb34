"""Output files and folders, whole or not at all, and JSON documents of records.

A file is built beside its place and moved there when it is whole. A recording, which grows where it
is, is locked against other programs. Existing files are replaced only if allowed, and no output is
written through a symbolic link.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
from io import FileIO
from pathlib import Path
from typing import Any

from trocar.errors import InputError, TrocarError

if sys.platform != "win32":
    import fcntl


def check_file(path: str | Path, overwrite: bool = False) -> Path:
    """Return the path of an output file, with ~ expanded; call it before a long computation.

    Args:
        path: a new file; with `overwrite` also an existing one. Devices such as /dev/null are
            always allowed
        overwrite: an existing file may be replaced

    Raises:
        InputError: the file exists, is a folder or a symbolic link, or its folder does not exist
    """
    target = Path(path).expanduser()
    if target.is_symlink():
        raise InputError(
            f"{target}: is a symbolic link to {os.readlink(target)}; allowed: a file's own path"
        )
    if target.is_dir():
        raise InputError(f"{target}: cannot be written: Is a directory; allowed: a file")
    if target.is_file() and not overwrite:
        raise _exists(target)
    if not target.absolute().parent.is_dir():
        raise InputError(f"{target}: cannot be written: No such file or directory")
    return target


@contextmanager
def whole_file(path: str | Path, overwrite: bool = False) -> Generator[Path]:
    """Yield the path of an empty file, which becomes the output file when the block ends.

    After an error in the block there is no new file, and an existing one is unchanged.

    Args:
        path, overwrite: as for `check_file`

    Raises:
        InputError: as for `check_file`, or no file can be made in that folder
        TrocarError: the file could not be written to its end, as on a full disk
    """
    target = check_file(path, overwrite)
    if target.exists() and not target.is_file():
        with _writing(target):
            yield target
        return
    try:
        handle, name = tempfile.mkstemp(target.suffix, f".{target.stem}.", target.absolute().parent)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from error
    os.close(handle)
    part = Path(name)
    try:
        with _writing(target):
            part.chmod(0o666 & ~_umask())
            yield part
            with part.open("rb+") as file:
                os.fsync(file.fileno())
            if not overwrite:
                try:
                    os.close(os.open(target, os.O_CREAT | os.O_EXCL))
                except FileExistsError:
                    raise _exists(target) from None
            part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def locked_stream(path: str | Path, overwrite: bool = False) -> FileIO:
    """Open an output file that is written while a program runs; no other trocar can replace it.

    Args:
        path, overwrite: as for `check_file`

    Returns:
        an empty, unbuffered binary file; the lock ends when it is closed

    Raises:
        InputError: as for `check_file`, or the file is being recorded, or cannot be opened
    """
    target = check_file(path, overwrite)
    device = target.exists() and not target.is_file()
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    if device:
        flags = os.O_WRONLY
    elif not overwrite:
        flags |= os.O_EXCL
    try:
        stream = FileIO(os.open(target, flags, 0o666), "wb")
    except FileExistsError:
        raise _exists(target) from None
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from error
    if not device:
        if not _locked(stream):
            stream.close()
            raise InputError(f"{target}: another program records into it; allowed: another file")
        stream.truncate(0)
    return stream


@contextmanager
def whole_folder(folder: str | Path, overwrite: bool = False) -> Generator[Path]:
    """Yield an empty folder, whose content moves to `folder` when the block ends.

    After an error in the block nothing of it stays. With `overwrite`, existing entries of the same
    names are replaced, and the others stay.

    Args:
        folder: a new or an empty folder; folders above it are made
        overwrite: it may hold something

    Raises:
        InputError: as for `check_folder`, or it cannot be written
    """
    target = Path(folder).expanduser().resolve()
    check_folder(target, overwrite)
    existing = next(place for place in (target, *target.parents) if place.exists())
    try:
        with tempfile.TemporaryDirectory(prefix=f".{target.name}.", dir=existing) as beside:
            built = Path(beside) / "new"
            built.mkdir()
            yield built
            if target.exists():
                _move_into(target, built, Path(beside) / "old")
            else:
                target.parent.mkdir(parents=True, exist_ok=True)
                built.rename(target)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from error


def check_folder(folder: str | Path, overwrite: bool = False) -> Path:
    """Return the path of an output folder, with ~ expanded; call it before a long computation.

    Raises:
        InputError: it is a file, or holds something without `overwrite`
    """
    target = Path(folder).expanduser()
    if target.exists() and not target.is_dir():
        raise InputError(f"{target}: is not a folder; allowed: a new or an empty folder")
    if target.is_dir() and not overwrite:
        held = sorted(entry.name for entry in target.iterdir())
        if held:
            more = f" and {len(held) - 1} more" if len(held) > 1 else ""
            raise InputError(
                f"{target}: is not empty (got {held[0]}{more}); allowed: a new or an empty folder,"
                " or --overwrite to replace existing files"
            )
    return target


def _exists(target: Path) -> InputError:
    return InputError(
        f"{target}: exists already; allowed: a new file, or --overwrite to replace it"
    )


@contextmanager
def _writing(target: Path) -> Generator[None]:
    try:
        yield
    except OSError as error:
        raise TrocarError(f"{target}: cannot be written: {error.strerror or error}") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _locked(stream: FileIO) -> bool:
    """Lock a file; False where another program holds it. Some file systems have no locks."""
    if sys.platform == "win32":  # has no such locks
        return True
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _move_into(folder: Path, built: Path, old: Path) -> None:
    """Replace entries of a folder by new ones; if one cannot be replaced, all stay as before."""
    old.mkdir()
    moved: list[str] = []
    try:
        for entry in sorted(built.iterdir()):
            if (folder / entry.name).exists():
                (folder / entry.name).rename(old / entry.name)
            moved.append(entry.name)
            entry.rename(folder / entry.name)
    except OSError:
        for name in moved:
            _remove(folder / name)
            if (old / name).exists():
                (old / name).rename(folder / name)
        raise


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def write_text(path: str | Path, text: str, overwrite: bool = False) -> None:
    """Write a text file, whole or not at all.

    Args:
        path, overwrite: as for `check_file`
        text: what to write, as UTF-8

    Raises:
        InputError, TrocarError: as for `whole_file`
    """
    with whole_file(path, overwrite) as part:
        part.write_text(text, encoding="utf-8", newline="\n")


def document(record: Any) -> Any:
    """Convert a record to JSON types.

    Args:
        record: a dataclass, by its fields or by its method `document` where it has one; mappings,
            sequences, arrays, enumerations and paths, nested at will

    Returns:
        dictionaries, lists, texts, numbers, booleans and None; NaN and infinity are None
    """
    value: Any = record
    if isinstance(record, Mapping):
        return {str(key): document(item) for key, item in value.items()}
    if is_dataclass(record) and not isinstance(record, type):
        if hasattr(record, "document"):
            return document(value.document())
        return {field.name: document(getattr(value, field.name)) for field in fields(record)}
    if hasattr(record, "tolist"):  # an array or a number of numpy, which is not imported here
        return document(value.tolist())
    if isinstance(record, list | tuple):
        return [document(item) for item in value]
    if isinstance(record, float):
        return record + 0.0 if math.isfinite(record) else None
    if isinstance(record, Enum):
        return document(record.value)
    return str(record) if isinstance(record, Path) else record


def json_text(record: Any) -> str:
    """Write a record as an indented JSON document, innermost lists on one line.

    Args:
        record: as for `document`
    """
    text = json.dumps(document(record), indent=2, allow_nan=False)
    return re.sub(r"\[\n[^][{}]*\]", lambda m: f"[{' '.join(m[0][1:-1].split())}]", text)
