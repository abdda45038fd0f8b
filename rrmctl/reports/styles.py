"""How each method is drawn: the same in every figure, told apart without colour too.

What a method's reward is built on gives colour and marker (Okabe and Ito's palette, safe for the colour-blind); how it
uses it gives the line: `rrm-proxy` and `sac-proxy` share a colour, one solid and one dashed.
"""

from __future__ import annotations

import zlib
from typing import Literal, NamedTuple

Dashes = Literal["-", ":"] | tuple[float, tuple[float, ...]]


class Style(NamedTuple):
    """Arguments of matplotlib's `plot`."""

    color: str
    marker: str
    linestyle: Dashes


#: Learners without a prior, and priors: colour and marker.
_LOOKS = {
    "oracle": ("#000000", ""),
    "pebble": ("#0072B2", "s"),
    "surf": ("#56B4E9", "D"),
    "mrn": ("#004D73", "v"),
    "proxy": ("#D55E00", "o"),
    "language": ("#009E73", "^"),
    "imitation": ("#CC79A7", "P"),
    "o2g": ("#E69F00", "<"),
    "h2o": ("#56B4E9", ">"),
    "sparse": ("#882255", "X"),
    "zero": ("#999999", "d"),
    "opposite": ("#332288", "*"),
    "random": ("#AA8800", "h"),
}
#: For names that are not in the table: a name always gets the same one, though two names may share it.
_COLOURS = ("#44AA99", "#117733", "#AA4499", "#661100", "#6699CC", "#888833")
_MARKERS = ("p", "H", "8", "o", "s", "^", "D", "v")

_SOLID: Dashes = "-"
_DOTTED: Dashes = ":"
_LINES: dict[str, Dashes] = {
    "rrm": _SOLID,
    "sac": (0, (4, 2)),
    "rrm-surf": (0, (6, 1.5, 1, 1.5)),
    "rrm-mrn": (0, (6, 1.5, 1, 1.5, 1, 1.5)),
}


def style(method: str) -> Style:
    """The look of a method, by its name alone."""
    family, base = _parts(method)
    colour, marker = _LOOKS.get(base) or _look_of_unknown(base)
    if method == "oracle":
        return Style(colour, marker, _DOTTED)
    return Style(colour, marker, _LINES.get(family, _SOLID))


def _parts(method: str) -> tuple[str, str]:
    """`rrm-surf-proxy` -> ("rrm-surf", "proxy"); a method without a prior is its own base."""
    for family in sorted(_LINES, key=len, reverse=True):
        if method.startswith(f"{family}-"):
            return family, method.removeprefix(f"{family}-")
    return "", method


def _look_of_unknown(base: str) -> tuple[str, str]:
    digest = zlib.crc32(base.encode())
    return _COLOURS[digest % len(_COLOURS)], _MARKERS[digest // len(_COLOURS) % len(_MARKERS)]
