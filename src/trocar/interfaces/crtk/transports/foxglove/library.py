"""Foxglove's SDK, asked for when needed."""

from __future__ import annotations

from types import ModuleType

from trocar.errors import MissingExtraError


def load() -> ModuleType:
    """Import the SDK.

    Raises:
        MissingExtraError: the extra `foxglove` is not installed
    """
    try:
        import foxglove
        import foxglove.websocket
    except ImportError:
        raise MissingExtraError("foxglove-sdk", "foxglove", "Foxglove") from None
    return foxglove
