"""The way from a world to one image of it is short."""

from __future__ import annotations

import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import FrameType

import pytest

import trocar
from trocar.rendering import Endoscope, Look
from trocar.simulation import World

#: Most calls of a capture, and most changes from a file to another. Source: our own choice; it
#: took 217 and 112 when data went to and fro.
MOST_CALLS, MOST_CHANGES = 230, 40


def path_of(action: Callable[[], object]) -> list[tuple[str, str]]:
    """Return (file, function) of every Python call of trocar's that an action makes."""
    calls: list[tuple[str, str]] = []
    ours = str(Path(trocar.__file__).parent)

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(ours):
            calls.append((frame.f_code.co_filename, frame.f_code.co_name))

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(before)
    return calls


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("style", ["plain", "surgical"])
@pytest.mark.parametrize("beside", [False, True])
def test_an_image_is_drawn_in_one_direction(style: str, beside: bool) -> None:
    world = World("training")
    look = Look(style=style)  # type: ignore[arg-type]
    scope = Endoscope(
        world, preset="dvrk_sd_640x480", depth=beside, ids=beside, normals=beside, look=look
    )
    scope.capture()  # the first compiles programs, and fills buffers
    calls = path_of(scope.capture)
    scope.close()
    assert len(calls) <= MOST_CALLS, calls
    assert sum(a != b for (a, _), (b, _) in pairwise(calls)) <= MOST_CHANGES, calls
