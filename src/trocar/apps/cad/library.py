"""The library that draws solids, which is not installed by default."""

from __future__ import annotations

from trocar.errors import MissingExtraError


def need_library() -> None:
    """Make sure that solids can be drawn.

    Raises:
        MissingExtraError: build123d is not installed
    """
    try:
        import build123d  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("build123d", "cad", "drawing solids") from error
