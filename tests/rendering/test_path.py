"""The way from a world to one image of it is short."""

from __future__ import annotations

import pytest

from tests.calls import calls_of, changes_of_file
from trocar.rendering import Endoscope, Look
from trocar.simulation import World

#: Most calls of a capture, and most changes from a file to another. Source: our own choice; it
#: took 217 and 112 when data went to and fro.
MOST_CALLS, MOST_CHANGES = 230, 40


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
    calls = calls_of(scope.capture)
    scope.close()
    assert len(calls) <= MOST_CALLS, calls
    assert changes_of_file(calls) <= MOST_CHANGES, calls
