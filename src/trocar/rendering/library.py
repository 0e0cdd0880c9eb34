"""The graphics library: opened here, and what to do where it is missing."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING

from trocar.errors import MissingExtraError, TrocarError

if TYPE_CHECKING:
    import moderngl

#: What brings OpenGL to a machine that has none, with or without a graphics card.
PACKAGES = "on Debian and Ubuntu: sudo apt install libegl1 libgl1-mesa-dri"
#: OpenGL 4.3 draws many parts by one call. Source: the OpenGL 4.3 specification, 10.4.
VERSION = 430


def load() -> ModuleType:
    """Import moderngl.

    Raises:
        MissingExtraError: the extra `scope` is not installed
    """
    try:
        import moderngl
    except ImportError:
        raise MissingExtraError("moderngl", "scope", "The endoscope") from None
    return moderngl


def open_context() -> moderngl.Context:
    """Return a context that draws without a display.

    Raises:
        MissingExtraError: the extra `scope` is not installed
        TrocarError: there is no OpenGL 4.3, with the Debian packages that bring it
    """
    library = load()
    try:
        if sys.platform == "linux":
            return library.create_context(require=VERSION, standalone=True, backend="egl")
        return library.create_context(require=VERSION, standalone=True)
    except Exception as problem:  # each platform's library fails in its own way
        raise TrocarError(f"no OpenGL 4.3 to draw with: {problem} ({PACKAGES})") from problem


def limit(context: moderngl.Context) -> int:
    """Return how many pixels wide and high a picture of this driver may be."""
    info = context.info
    sides = (info["GL_MAX_TEXTURE_SIZE"], info["GL_MAX_RENDERBUFFER_SIZE"])
    return int(min(*sides, *info["GL_MAX_VIEWPORT_DIMS"]))


def driver(context: moderngl.Context) -> str:
    """Return who draws: "llvmpipe (LLVM 15.0.6, 256 bits)" or a graphics card's name."""
    return str(context.info["GL_RENDERER"])


def on_processor(context: moderngl.Context) -> bool:
    """Return whether pictures are drawn by the processor and not by a graphics card."""
    return any(name in driver(context).lower() for name in ("llvmpipe", "softpipe", "swrast"))
