"""Hooks of mkdocs: links that leave docs/ (to examples, source, CONTRIBUTING) become plain text."""

from __future__ import annotations

import posixpath
import re
from typing import Any

LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)#:\s]+)(#[^)]*)?\)")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Return a page's Markdown without links to files that the site does not have."""
    folder = posixpath.dirname(page.file.src_uri)

    def inside(found: re.Match[str]) -> str:
        place = posixpath.normpath(posixpath.join(folder, found[2]))
        kept = not place.startswith("..") and not place.endswith(".py")
        return found[0] if kept else found[1]

    return LINK.sub(inside, markdown)
