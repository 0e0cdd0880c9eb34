"""Matplotlib figures as PNG files or as SVG inside a page."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING, Any, cast

from trocar.errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Colours that are distinct with every kind of colour vision. Source: Okabe and Ito, 2008.
MEASURED, SETPOINT, ERROR, EFFORT, WARNING = "#0072B2", "#D55E00", "#CC79A7", "#009E73", "#E69F00"
PALETTE = (MEASURED, SETPOINT, EFFORT, ERROR, WARNING, "#56B4E9")
PNG_DPI = 110


def new_figure(width_in: float, height_in: float, purpose: str) -> Figure:
    """Return an empty figure that makes room for its own labels.

    Args:
        width_in, height_in: its size [inch]
        purpose: for the error if matplotlib is missing ("drawing a recording")

    Raises:
        MissingExtraError: matplotlib is not installed
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("matplotlib", "plot", purpose) from error
    return Figure(figsize=(width_in, height_in), layout="constrained")


def png(figure: Figure) -> bytes:
    """Return a figure as PNG."""
    buffer, drawn = io.BytesIO(), cast(Any, figure)  # its types are partial
    drawn.savefig(buffer, format="png", dpi=PNG_DPI)
    return buffer.getvalue()


def svg(figure: Figure) -> str:
    """Return a figure as an SVG element to stand in a page."""
    import matplotlib as mpl

    library, source, buffer = cast(Any, mpl), cast(Any, figure), io.StringIO()
    with library.rc_context({"svg.fonttype": "none", "svg.hashsalt": "trocar"}):
        source.savefig(buffer, format="svg", metadata={"Date": None})
    drawn = buffer.getvalue()
    drawn = drawn[drawn.index("<svg") :]
    return re.sub(r"<metadata>.*?</metadata>", "", drawn, flags=re.DOTALL)
