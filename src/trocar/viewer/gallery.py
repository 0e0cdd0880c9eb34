"""The gallery: scenes and rigs with pictures; one is loaded in place of what runs."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Literal

import viser

PICTURES = files("trocar.viewer").joinpath("pictures")

STYLE = """<style>
.gallery { display: grid; grid-template-columns: repeat(auto-fill, minmax(170px, 1fr)); gap: 8px; }
.gallery button { font: inherit; text-align: left; padding: 0; border: 1px solid #c6d2de;
  border-radius: 6px; background: none; cursor: pointer; overflow: hidden; color: inherit;
  display: flex; flex-direction: column; }
.gallery button:hover, .gallery button:focus { border-color: #1c6fa4; }
.gallery button[disabled] { opacity: .5; cursor: default; }
.gallery img { width: 100%; display: block; aspect-ratio: 8 / 5; object-fit: cover; }
.mantine-Modal-content:has(.gallery) { flex-basis: min(960px, 94vw); }
.gallery b, .gallery small { display: block; padding: 2px 8px; }
.gallery small { opacity: .7; padding-bottom: 4px; line-height: 1.3; }
</style>"""


@dataclass(frozen=True)
class Choice:
    """A scene or a rig by its name."""

    kind: Literal["scene", "rig"]
    name: str


@dataclass(frozen=True)
class Card:
    """An entry of the gallery.

    Attributes:
        choice: that it loads
        title: of the scene or rig
        figures: difficulty and success of the scripted policy, in a few words; "" for a rig
    """

    choice: Choice
    title: str
    figures: str = ""


class Gallery:
    """The cards.

    Args:
        cards: returns the cards, in their order
        running: name of what is served

    Attributes:
        chosen: the choice of a person; None before
    """

    def __init__(self, cards: Callable[[], Sequence[Card]], running: str) -> None:
        self._cards = cards
        self.running = running
        self.chosen: Choice | None = None

    def choose(self, words: str) -> bool:
        """Choose by "scene/NAME" or "rig/NAME"; return whether there is such a card."""
        for card in self._cards():
            if words == f"{card.choice.kind}/{card.choice.name}":
                self.chosen = card.choice
                return True
        return False

    def open(self, gui: viser.GuiApi, blocked: str) -> None:
        """Open the sheet in one browser.

        Args:
            gui: of the browser
            blocked: why it may not load anything; "": it may
        """
        with gui.add_modal("Load a scene or a rig") as sheet:
            note = blocked or f"{self.running} ends, and with it its clients and recordings."
            gui.add_html(gallery_html(self._cards(), note, disabled=bool(blocked)))
            close = gui.add_button("Close")

        @close.on_click
        async def _(_: object) -> None:
            sheet.close()


def gallery_html(cards: Sequence[Card], note: str, *, disabled: bool) -> str:
    """Return the cards; client.js sends the words of one that is pressed."""
    off = " disabled" if disabled else ""
    made: list[str] = [f"{STYLE}<p>{escape(note)}</p>"]
    for kind, title in (("scene", "Scenes"), ("rig", "Rigs")):
        made.append(f'<h4>{title}</h4><div class="gallery">')
        made += [
            f'<button type="button" data-trocar-send="load/{kind}/{escape(card.choice.name)}"'
            f"{off}>{_picture(card.choice.name)}<b>{escape(card.choice.name)}</b>"
            f"<small>{escape(card.title)}{'<br>' + escape(card.figures) if card.figures else ''}"
            "</small></button>"
            for card in cards
            if card.choice.kind == kind
        ]
        made.append("</div>")
    return "".join(made)


def _picture(name: str) -> str:
    """Return the picture of a name, nothing for a scene or rig of the user's own."""
    file = PICTURES.joinpath(f"{name}.jpg")
    if not file.is_file():
        return ""
    data = base64.b64encode(file.read_bytes()).decode()
    return f'<img alt="" src="data:image/jpeg;base64,{data}">'
