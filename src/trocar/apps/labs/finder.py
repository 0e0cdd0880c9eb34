"""Where the files lie that a configuration names."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from trocar.errors import DescriptionError

#: Folders of the dVRK's `share` that configurations name files by. Source:
#: sawIntuitiveResearchKit share/.
SHELVES = ("arm", "kinematic", "tool", "pid", "system")


class Finder:
    """Looks for files as the dVRK does: beside the configuration, then in its search path.

    Args:
        system: the system's file
        more: folders that the user names, such as sawIntuitiveResearchKit's `share`
    """

    def __init__(self, system: Path, more: Iterable[Path]) -> None:
        beside = system.resolve().parent
        above = [
            folder
            for folder in (beside, *list(beside.parents)[:2])
            if any((folder / shelf).is_dir() for shelf in SHELVES)
        ]
        self.folders = list(dict.fromkeys([beside, *(p.expanduser() for p in more), *above]))

    def add(self, folders: Iterable[str]) -> None:
        """Look in these, too: relative ones from where the system's file lies, and from here."""
        for folder in folders:
            for place in (self.folders[0] / folder, Path(folder)):
                if place.is_dir() and place not in self.folders:
                    self.folders.append(place)

    def find(self, name: str) -> Path | None:
        """Return a file's path, None where it is nowhere."""
        for folder in self.folders:
            if (folder / name).is_file():
                return folder / name
        return None

    def missing(self, file: str, key: str, name: str) -> DescriptionError:
        """Return the error that says where a file was looked for."""
        places = ", ".join(str(folder) for folder in self.folders)
        return DescriptionError(
            file,
            key,
            f"got {name!r}, which is in none of {places}; allowed: a file in one of these, or in a"
            " folder that --share names (sawIntuitiveResearchKit/share)",
        )
