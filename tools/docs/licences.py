"""Write docs/licences.md: the licence of every distribution of constraints.txt, and its extras.

`make licences` runs it, where all extras are installed.
"""

from __future__ import annotations

import tomllib
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "licences.md"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))

# Licences that no metadata names, or none on Linux. Source: the licence file of the wheel.
READ = {
    "apsw": "Zlib",
    "automat": "MIT",
    "bd-materials": "Apache-2.0",
    "cmeel-qhull": "Qhull",
    "colorama": "BSD-3-Clause",  # on Windows only
    "cycler": "BSD-3-Clause",
    "drake": "BSD-3-Clause, with SNOPT (proprietary)",
    "embreex": "BSD-2-Clause",
    "kiwisolver": "BSD-3-Clause",
    "matplotlib": "PSF-based",
    "mergedeep": "MIT",
    "mosek": "proprietary",
    "ocpsvg": "Apache-2.0",
    "ptyprocess": "ISC",
    "scipy": "BSD-3-Clause",
    "vhacdx": "MIT",
}
# Identifiers in place of what metadata has in other words.
SPDX = {
    "Apache 2.0": "Apache-2.0",
    "Apache License, Version 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "BSD 3-Clause License": "BSD-3-Clause",
    "BSD License": "BSD",
    "EPL-2.0, BSD-3-Clause": "EPL-2.0 OR BSD-3-Clause",
    "GNU General Public License v3 (GPLv3)": "GPL-3.0",
    "ISC License (ISCL)": "ISC",
    "ISC license": "ISC",
    "MIT License": "MIT",
    "MIT license": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "The MIT License (MIT)": "MIT",
}
TEXT = """\
# Licences

trocar is BSD-3-Clause. The licence of every package that an environment of trocar may hold, at the
version of `constraints.txt`, as its metadata declares it (or its licence file, where the metadata
does not), and the [extras](install.md#extras) that install it. A wheel may contain libraries with
further licences; its own licence files name them.

Two are proprietary, both by the extra `judges`, which no other extra contains and only
`make skipped` installs: Drake requires Mosek, which solves nothing without a licence of its own
(trocar does not call it), and Drake's wheel contains SNOPT.

<!-- Written by make licences. -->

| package | licence | installed by |
|---|---|---|
"""


def pins() -> dict[str, str]:
    """Return the pinned name of each distribution of constraints.txt, by canonical name."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    names = (line.partition("==")[0] for line in lines if "==" in line)
    return {canonicalize_name(name): name for name in names}


def licence(name: str) -> str:
    """Return the licence that an installed distribution declares, as an SPDX identifier if known.

    Raises:
        PackageNotFoundError: it is not installed.
    """
    if name in READ:
        return READ[name]
    about = metadata.metadata(name)
    declared = [about.get_all(field, []) for field in ("License-Expression", "License")]
    said: str = next((texts[0] for texts in declared if texts), "")
    if "\n" in said.strip() or not said:
        rows = [str(row).split(" :: ") for row in about.get_all("Classifier", [])]
        found = [row[-1] for row in rows if row[0] == "License" and row[-1] != "OSI Approved"]
        said = " OR ".join(SPDX.get(one, one) for one in found) or said.splitlines()[0]
    return SPDX.get(said, said)


def requirements(extra: str) -> list[Requirement]:
    """Return the requirements of trocar ("") or of an extra, those of extras in it included."""
    project = PROJECT["project"]
    if extra == "build":
        lines = [*PROJECT["build-system"]["requires"], "editables", "pip"]
    else:
        lines = project["optional-dependencies"][extra] if extra else project["dependencies"]
    found: list[Requirement] = []
    for requirement in map(Requirement, lines):
        if requirement.name == project["name"]:
            found += [r for inner in sorted(requirement.extras) for r in requirements(inner)]
        else:
            found.append(requirement)
    return found


def installs(extra: str) -> set[str]:
    """Return the names of what an extra needs, as far as that is installed here."""
    seen: set[tuple[str, str]] = set()
    left = [(canonicalize_name(r.name), inner) for r in requirements(extra) for inner in _of(r)]
    while left:
        name, inner = left.pop()
        if (name, inner) in seen:
            continue
        try:
            lines = metadata.requires(name) or []
        except metadata.PackageNotFoundError:
            continue
        seen.add((name, inner))
        for below in map(Requirement, lines):
            if below.marker is None or below.marker.evaluate({"extra": inner}):
                left += [(canonicalize_name(below.name), further) for further in _of(below)]
    return {name for name, _ in seen}


def _of(requirement: Requirement) -> set[str]:
    return {"", *requirement.extras}


def page() -> str:
    """Return the page as Markdown."""
    extras = PROJECT["project"]["optional-dependencies"].keys() - {"all", "dev"}
    by = {extra: installs(extra) for extra in ["", *sorted(extras), "build"]}
    development = installs("dev")  # which contains most of the others
    rows: list[str] = []
    for name, pinned in sorted(pins().items()):
        users = [extra for extra, needed in by.items() if name in needed]
        users = users or ["dev" if name in development else "make hashes"]
        where = "always" if "" in users else ", ".join(users)
        rows.append(f"| {pinned} | {licence(name)} | {where} |")
    return TEXT + "\n".join(rows) + "\n"


def written() -> dict[str, tuple[str, str]]:
    """Return what the page says: {canonical name: (licence, extras)}."""
    lines = PAGE.read_text(encoding="utf-8").partition("|---|---|---|\n")[2].splitlines()
    rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    return {canonicalize_name(row[0]): (row[1], row[2]) for row in rows}


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
