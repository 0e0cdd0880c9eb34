"""What draws: skipped with a reason where there is no OpenGL."""

from __future__ import annotations

import pytest

from trocar.errors import TrocarError
from trocar.rendering.library import open_context


@pytest.fixture(scope="session")
def opengl() -> str:
    """Return who draws, or skip the test."""
    try:
        context = open_context()
    except TrocarError as problem:
        pytest.skip(str(problem))
    name = str(context.info["GL_RENDERER"])
    context.release()
    return name
