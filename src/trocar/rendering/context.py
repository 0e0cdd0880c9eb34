"""OpenGL: contexts without a display, the errors where it is missing, and its C library."""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING

from trocar.errors import MissingExtraError, TrocarError

if TYPE_CHECKING:
    import moderngl

#: Packages that install OpenGL, with or without a graphics card.
PACKAGES = "on Debian and Ubuntu: sudo apt install libegl1 libgl1 libgl1-mesa-dri"
#: Least version of OpenGL, which draws many parts by one call. Source: the OpenGL 4.3
#: specification, 10.4.
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
    """Return the largest width and height of this driver's pictures [px]."""
    info = context.info
    sides = (info["GL_MAX_TEXTURE_SIZE"], info["GL_MAX_RENDERBUFFER_SIZE"])
    return int(min(*sides, *info["GL_MAX_VIEWPORT_DIMS"]))


def driver(context: moderngl.Context) -> str:
    """Return the driver's name: "llvmpipe (LLVM 15.0.6, 256 bits)" or a graphics card's."""
    return str(context.info["GL_RENDERER"])


def on_processor(context: moderngl.Context) -> bool:
    """Test whether pictures are drawn by the processor and not by a graphics card."""
    return any(name in driver(context).lower() for name in ("llvmpipe", "softpipe", "swrast"))


#: Constants of OpenGL. Source: the OpenGL registry, gl.xml.
TRIANGLES, UNSIGNED_INT, DRAW_INDIRECT_BUFFER = 0x0004, 0x1405, 0x8F3F
FRAMEBUFFER, FIRST_ATTACHMENT, PACK_ALIGNMENT = 0x8D40, 0x8CE0, 0x0D05
#: {(components, type): format and type of glReadPixels}. Source: the same.
FORMATS = {
    (3, "uint8"): (0x1907, 0x1401),
    (1, "float32"): (0x1903, 0x1406),
    (1, "int32"): (0x8D94, 0x1404),
    (3, "float32"): (0x1907, 0x1406),
}
#: Size of one command, five numbers [bytes]. Source: the OpenGL 4.3 specification, 10.4.
COMMAND = 20


@cache
def opengl_library() -> ctypes.CDLL | None:
    """Return the C library that calls the current context's driver, or None without one."""
    if sys.platform != "linux":
        return None
    try:
        gl = ctypes.CDLL("libGL.so.1")
    except OSError:
        return None
    for name, kinds in {
        "glUseProgram": [ctypes.c_uint],
        "glBindVertexArray": [ctypes.c_uint],
        "glBindBuffer": [ctypes.c_uint, ctypes.c_uint],
        "glMultiDrawElementsIndirect": [
            ctypes.c_uint, ctypes.c_uint, ctypes.c_void_p, ctypes.c_int, ctypes.c_int,
        ],
        "glFlush": [],
        "glBindFramebuffer": [ctypes.c_uint, ctypes.c_uint],
        "glReadBuffer": [ctypes.c_uint],
        "glPixelStorei": [ctypes.c_uint, ctypes.c_int],
        "glReadPixels": [*[ctypes.c_int] * 4, ctypes.c_uint, ctypes.c_uint, ctypes.c_void_p],
    }.items():  # fmt: skip
        function = getattr(gl, name, None)
        if function is None:
            return None
        function.argtypes, function.restype = kinds, None
    return gl
