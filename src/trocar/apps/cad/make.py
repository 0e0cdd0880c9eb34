"""Draw sets of solids and write them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from trocar.apps.cad.draw import DrawnLink, drawn
from trocar.apps.cad.sets import SolidSet, sets_of, solid_sets
from trocar.apps.cad.write import write_set
from trocar.descriptions.calibrated import as_overlay
from trocar.errors import InputError, UnknownNameError

#: Called with the set's name and a link as soon as it is drawn.
Listener = Callable[[str, DrawnLink], None]


def make_solids(
    folder: Path,
    only: Sequence[str] = (),
    calibration: str | Path | None = None,
    told: Listener | None = None,
) -> tuple[str, ...]:
    """Draw sets of solids and write each into a folder of its name; return the names.

    Args:
        folder: where the sets' folders go
        only: these sets; all that there are when empty
        calibration: an overlay: draw the calibrated robot's own links in place of the nominal
        told: called with each link that is drawn

    Raises:
        UnknownNameError: a set that does not exist
        InputError: the folder cannot be written, or the overlay is broken or for no arm of the set
    """
    sets = solid_sets()
    overlay = None if calibration is None else as_overlay(calibration)
    possible = tuple(sets) if overlay is None else sets_of(overlay)
    for name in only:
        if name not in possible:
            raise UnknownNameError("set of solids", name, possible)
    chosen = [sets[name] for name in only or possible]
    done = {one: [drawn(link, one.fineness) for link in one.links(overlay)] for one in chosen}
    for one, links in done.items():
        for link in links:
            if told is not None:
                told(one.name, link)
        _write(folder, one, links)
    return tuple(one.name for one in chosen)


def _write(folder: Path, one: SolidSet, links: list[DrawnLink]) -> None:
    try:
        write_set(folder / one.name, links)
    except OSError as problem:
        raise InputError(f"{folder / one.name}: cannot be written: {problem.strerror}") from problem
