"""Figures of the page: inside of it, sharp when enlarged, and never large."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING

from rrmctl.reports.canvas import encode
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
    return element("figure", button, element("figcaption", caption), id=name, style=f"width: {width}px")


def _data(figure: Figure) -> str:
    kind, data = "svg+xml", encode(figure, "svg")
    if len(data) > MOST_BYTES:
        kind, data = "png", _small_png(figure)
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def _small_png(figure: Figure) -> bytes:
    for dpi in _DPI[:-1]:
        data = encode(figure, "png", dpi)
        if len(data) <= MOST_BYTES:
            return data
    return encode(figure, "png", _DPI[-1])
