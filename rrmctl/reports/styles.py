"""How each method is drawn: the same in every figure, told apart without colour too.

What a method's reward is built on gives colour and marker; how it uses it gives the line, and a hollow marker where
nothing is learned: `rrm-proxy` and `sac-proxy` share a colour, one solid and filled, one dashed and hollow. A method
with a suffix (`pebble-bfloat16`, `finetune-mse`) is a lighter, hollow one of the method it is named after, with a line
of its own. Methods that an experiment compares stay apart for the colour-blind and in greyscale (a test measures it).
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
    markerfacecolor: str  #: white where the marker is hollow


#: Learners without a prior, and priors: colour and marker. Those of the main figure go from dark to light.
_LOOKS = {
    "oracle": ("#000000", ""),
    "pebble": ("#0072B2", "s"),
    "surf": ("#56B4E9", "D"),
    "mrn": ("#004D73", "v"),
    "finetune": ("#7A4A2B", "H"),
    "proxy": ("#D55E00", "o"),
    "language": ("#00664B", "^"),
    "imitation": ("#D98CB8", "P"),
    "o2g": ("#E69F00", "<"),
    "h2o": ("#3DB7A8", ">"),
    "sparse": ("#6A1FB0", "X"),
    "zero": ("#999999", "d"),
    "opposite": ("#332288", "*"),
    "random": ("#C9B458", "h"),
}
#: For names that are not in the table: a name always gets the same one, though two names may share it.
_COLOURS = ("#44AA99", "#117733", "#AA4499", "#661100", "#6699CC", "#888833")
_MARKERS = ("p", "H", "8", "o", "s", "^", "D", "v")

_SOLID: Dashes = "-"
_DOTTED: Dashes = ":"
_DASHED: Dashes = (0, (4, 2))
#: The family of agents that are trained on a prior alone.
ALONE = "sac"
_LINES: dict[str, Dashes] = {
    "": _SOLID,
    "rrm": _SOLID,
    ALONE: _DASHED,
    "rrm-surf": (0, (6, 1.5, 1, 1.5)),
    "rrm-mrn": (0, (6, 1.5, 1, 1.5, 1, 1.5)),
}
#: Of methods with a suffix: share of white in the colour, marker (none: the base's), line.
_VARIANTS: dict[str, tuple[float, str, Dashes]] = {
    "bfloat16": (0.4, "", (0, (2, 1))),
    "tanh": (0.2, "o", (0, (2, 1))),
    "mse": (0.4, "^", (0, (7, 1.5))),
    "mse-tanh": (0.55, "D", (0, (4, 1, 1, 1))),
}


def style(method: str) -> Style:
    """The look of a method, by its name alone."""
    family, base, suffix = _parts(method)
    colour, marker = _LOOKS.get(base) or _look_of_unknown(base)
    if suffix:
        white, own_marker, line = _VARIANTS.get(suffix) or _unknown_variant(suffix)
        # Dots remain the oracle's; a marker then tells its variants from itself.
        return Style(
            _lighter(colour, white), own_marker or marker or "o", _DOTTED if base == "oracle" else line, "white"
        )
    if method == "oracle":
        return Style(colour, marker, _DOTTED, colour)
    return Style(colour, marker, _LINES[family], "white" if family == ALONE else colour)


def parts(method: str) -> tuple[str, str]:
    """Family and base of a name: `rrm-surf-proxy` -> ("rrm-surf", "proxy"), `pebble` -> ("", "pebble")."""
    for family in sorted(_LINES, key=len, reverse=True):
        if family and method.startswith(f"{family}-"):
            return family, method.removeprefix(f"{family}-")
    return "", method


def _parts(method: str) -> tuple[str, str, str]:
    """Family, base and suffix: `rrm-proxy-bfloat16` -> ("rrm", "proxy", "bfloat16")."""
    family, rest = parts(method)
    for base in _LOOKS:
        if rest.startswith(f"{base}-"):
            return family, base, rest.removeprefix(f"{base}-")
    return family, rest, ""


def _look_of_unknown(base: str) -> tuple[str, str]:
    digest = zlib.crc32(base.encode())
    return _COLOURS[digest % len(_COLOURS)], _MARKERS[digest // len(_COLOURS) % len(_MARKERS)]


def _unknown_variant(suffix: str) -> tuple[float, str, Dashes]:
    digest = zlib.crc32(suffix.encode())
    known = list(_VARIANTS.values())
    white, _, line = known[digest % len(known)]
    return white, _MARKERS[digest // len(known) % len(_MARKERS)], line


def _lighter(colour: str, white: float) -> str:
    """The colour mixed with this share of white."""
    mixed = (round(int(colour[at : at + 2], 16) * (1 - white) + 255 * white) for at in (1, 3, 5))
    return "#" + "".join(f"{channel:02X}" for channel in mixed)
