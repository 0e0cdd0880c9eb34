"""Who looks at the page while it is measured: a browser, or a program in its place."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from tempfile import TemporaryDirectory

#: Source: the names of Debian's, Fedora's and Google's packages.
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-port=0",
    "--window-size=860,700",
)
MODULE = "trocar.interfaces.viewer.spectator"
#: How long ending may take [s].
FAREWELL_S = 10.0


def browser() -> str | None:
    """Return the path of a browser, None where there is none."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


@contextmanager
def looking(url: str, path: str = "") -> Iterator[None]:
    """Let a browser look at a page while the block lasts, or a program where no path is given."""
    with TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        words: Sequence[str] = (sys.executable, "-m", MODULE, url)
        if path:
            root = ("--no-sandbox",) if hasattr(os, "geteuid") and os.geteuid() == 0 else ()
            words = (path, *FLAGS, *root, f"--user-data-dir={profile}", url)
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            yield
        finally:
            process.terminate()
            try:
                process.wait(FAREWELL_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
