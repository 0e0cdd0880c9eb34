"""Hooks of mkdocs: links that leave docs/ become plain text, and the site gets the JSON schemas."""

from __future__ import annotations

import posixpath
import re
import shutil
from pathlib import Path
from typing import Any

SCHEMAS = Path(__file__).parents[2] / "src/trocar/descriptions/data/schema"
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)#:\s]+)(#[^)]*)?\)")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Return a page's Markdown without links to files that the site does not have."""
    folder = posixpath.dirname(page.file.src_uri)

    def inside(found: re.Match[str]) -> str:
        place = posixpath.normpath(posixpath.join(folder, found[2]))
        kept = not place.startswith("..") and not place.endswith(".py")
        return found[0] if kept else found[1]

    return LINK.sub(inside, markdown)


def on_post_build(config: Any, **_: Any) -> None:
    """Copy the JSON schemas of TOML files into the site."""
    shutil.copytree(SCHEMAS, Path(config["site_dir"]) / "schema", dirs_exist_ok=True)
