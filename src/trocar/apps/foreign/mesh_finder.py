"""Where the meshes lie that a robot's file names."""

from __future__ import annotations

from pathlib import Path

from trocar.apps.foreign.xml_tree import Node


class MeshFinder:
    """Finds the files that a robot's file names."""

    def __init__(self, path: Path, packages: tuple[Path, ...]) -> None:
        self._folder = path.resolve().parent
        self._packages = packages

    def find(self, node: Node, uri: str) -> Path:
        """Return the file that a URI or relative path names.

        Raises:
            ForeignFileError: it is not there; where it was looked for is named
        """
        scheme, mark, rest = uri.partition("://")
        if not mark:
            places = [self._folder / uri]
        elif scheme == "file":
            places = [Path(rest)]
        elif scheme in ("package", "model"):
            name, _, inside = rest.partition("/")
            above = [*self._packages, self._folder, *self._folder.parents]
            places = [p / name / inside for p in above]
            places += [p / inside for p in above if p.name == name or (p / "package.xml").is_file()]
        else:
            raise node.fail(f"got {uri!r}; allowed: a path, file://, package:// or model://")
        found = next((place for place in places if place.is_file()), None)
        if found is None:
            near = ", ".join(str(place) for place in places[:3])
            raise node.fail(f"{uri!r} is not there (looked for {near}); --package-path DIR helps")
        return found
