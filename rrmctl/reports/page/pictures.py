"""Figures of the page: inside of it, sharp when enlarged, and never large."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING

from rrmctl.reports.canvas import LOOK
from rrmctl.reports.page.html import Html, element

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Bytes a figure may take as SVG; one with more in it, such as a cloud of points, becomes a PNG.
MOST_BYTES = 300_000
#: Of such a PNG, dots per inch; the first that is small enough, or the last.
_DPI = (200, 150, 100, 75)


def picture(figure: Figure, name: str, caption: str, alternative: str) -> Html:
    """The figure with its caption; pressing it enlarges it.

    Args:
        name: id of the element.
        alternative: what is said where it cannot be seen.
    """
    width = round(96 * figure.get_figwidth())
    image = element("img", src=_data(figure), alt=alternative, width=width, decoding="async")
    button = element("button", image, type="button", class_="zoom", aria_label=f"Enlarge: {caption}")
    return element("figure", button, element("figcaption", caption), id=name)


def _data(figure: Figure) -> str:
    kind, data = "svg+xml", _saved(figure, "svg")
    if len(data) > MOST_BYTES:
        kind = "png"
        for dpi in _DPI:
            data = _saved(figure, "png", dpi)
            if len(data) <= MOST_BYTES:
                break
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def _saved(figure: Figure, form: str, dpi: int = 100) -> bytes:
    """The figure as a file's content. Letters are outlines: a picture in a page can bring no font along."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    with mpl.rc_context(LOOK | {"svg.fonttype": "path", "svg.hashsalt": "rrmctl"}):
        figure.savefig(buffer, format=form, dpi=dpi, metadata={"Date": None} if form == "svg" else None)
    return buffer.getvalue()
