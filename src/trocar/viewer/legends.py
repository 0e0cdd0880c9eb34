"""Legends of false colours: depth in millimetres, and the names of objects."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np
from numpy.typing import NDArray

from trocar.rendering.frames import NEAR_TO_FAR, depth_ends, ids_picture

TICKS = 5
"""Depths that stand below the colours. Source: by eye."""

NAMED = 14
"""Objects that are named, those with the most pixels. Source: by eye."""


def depth_legend(depth: NDArray[np.float32]) -> str:
    """Return the colours of depths as HTML, near to far, with millimetres below.

    Args:
        depth: of the eyes that are shown in one scale, (eyes, height, width) [m], inf at nothing
    """
    near, far = depth_ends(depth)
    colours = ", ".join("rgb({:.0f} {:.0f} {:.0f})".format(*colour) for colour in NEAR_TO_FAR)
    shares = np.linspace(0.0, 1.0, TICKS)
    ticks = "".join(f"<span>{_mm(near * (far / near) ** share)}</span>" for share in shares)
    return (
        '<div class="trocar" data-trocar="legend">'
        f'<div style="height:10px;background:linear-gradient(to right, {colours})"></div>'
        f'<div style="display:flex;justify-content:space-between">{ticks}</div>'
        '<div style="opacity:.62">depth along the view [mm], logarithmic; black: nothing</div>'
        "</div>"
    )


def ids_legend(ids: NDArray[np.int32], names: Mapping[int, str]) -> str:
    """Return the colours of the objects in a picture as HTML, the largest first.

    Args:
        ids: object at each pixel, 0 at nothing
        names: {id: name}
    """
    found, counts = np.unique(ids, return_counts=True)
    order = [int(found[k]) for k in np.argsort(-counts, kind="stable") if found[k] != 0]
    chips = "".join(
        '<span style="white-space:nowrap;margin-right:10px"><span style="display:inline-block;'
        f'width:10px;height:10px;background:rgb({_colour(number)})"></span> '
        f"{escape(names.get(number, str(number)))}</span>"
        for number in order[:NAMED]
    )
    more = f"<span>and {len(order) - NAMED} more</span>" if len(order) > NAMED else ""
    return (
        '<div class="trocar" data-trocar="legend" style="display:flex;flex-wrap:wrap">'
        f"{chips}{more}</div>"
    )


def _mm(depth: float) -> str:
    return f"{1e3 * depth:.0f}" if depth >= 0.01 else f"{1e3 * depth:.1f}"


def _colour(number: int) -> str:
    r, g, b = ids_picture(np.array([[number]], dtype=np.int32))[0, 0]
    return f"{r} {g} {b}"
