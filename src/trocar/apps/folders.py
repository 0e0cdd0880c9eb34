"""A folder that is filled beside its place and moved there when it is whole."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from trocar.errors import InputError


@contextmanager
def whole_folder(folder: Path, force: bool) -> Iterator[Path]:
    """Lend an empty folder whose content becomes `folder`'s when the block ends without an error.

    With an error nothing of it stays. With `force`, what was in the folder under the same name is
    replaced, and the rest stays.

    Args:
        folder: where; is made, with the folders above it
        force: whether it may hold something

    Raises:
        InputError: it is no folder, it holds something, or it cannot be written
    """
    folder = folder.expanduser().resolve()
    check_folder(folder, force)
    existing = next(place for place in (folder, *folder.parents) if place.exists())
    try:
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=existing) as beside:
            built = Path(beside) / "new"
            built.mkdir()
            yield built
            if folder.exists():
                _move_into(folder, built, Path(beside) / "old")
            else:
                folder.parent.mkdir(parents=True, exist_ok=True)
                built.rename(folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from error


def check_folder(folder: Path, force: bool) -> None:
    """Refuse a folder that cannot be written to.

    Raises:
        InputError: it is no folder, or holds something that nobody allowed to replace
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is not a folder; allowed: a new or an empty folder")
    if folder.is_dir() and not force:
        held = sorted(entry.name for entry in folder.iterdir())
        if held:
            more = f" and {len(held) - 1} more" if len(held) > 1 else ""
            raise InputError(
                f"{folder}: is not empty (got {held[0]}{more}); allowed: a new or an empty folder,"
                " or --force to replace existing files"
            )


def _move_into(folder: Path, built: Path, old: Path) -> None:
    """Replace entries of a folder by new ones; what cannot be replaced leaves all as it was."""
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
