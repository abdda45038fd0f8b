"""How each method is drawn: the same in every figure, told apart without colour too.

What a method's reward is built on gives colour and marker; how it uses it gives the line, and a hollow marker where
nothing is learned: `rrm-proxy` and `sac-proxy` share a colour, one solid and filled, one dashed and hollow. A method
with a suffix (`pebble-bfloat16`, `finetune-mse`) is a lighter, hollow one of the method it is named after, with a line
of its own. Methods that an experiment compares stay apart for the colour-blind and in greyscale (a test measures it).

A method or prior of the user's (`rrm-mine`, `pebble-wide`) gets a marker and a line that nothing else has of what it is
drawn with: those that its name suggests, or else the next that are free.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

Dashes = Literal["-", ":"] | tuple[float, tuple[float, ...]]
#: A letter of matplotlib's; or corners, 1 for a star, and the angle it is turned by.
Marker = str | tuple[int, int, int]


class Style(NamedTuple):
    """Arguments of matplotlib's `plot`."""

    color: str
    marker: Marker
    linestyle: Dashes
    markerfacecolor: str  #: white where the marker is hollow


Looks = Mapping[str, Style]
Hue = tuple[str, Marker]

#: What every line has, for matplotlib's `plot`.
LINE: dict[str, Any] = {"linewidth": 1.3, "markersize": 3.8, "markeredgewidth": 0.8}

#: Those of the main figure go from dark to light.
_LEARNERS: dict[str, Hue] = {
    "oracle": ("#000000", ""),
    "pebble": ("#0072B2", "s"),
    "surf": ("#56B4E9", "D"),
    "mrn": ("#004D73", "v"),
    "finetune": ("#7A4A2B", "H"),
}
_PRIORS: dict[str, Hue] = {
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
_HUES = _LEARNERS | _PRIORS
#: Of new names; where these do not suffice, those of known ones that are not there, the least common first.
_NEW: tuple[Hue, ...] = (
    ("#661100", "p"),
    ("#C2185B", "x"),
    ("#6699CC", (4, 1, 0)),
    ("#117733", "+"),
    ("#F0A58F", "1"),
    ("#888833", "|"),
)

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
#: Of new names, in turn, where the family leaves the line solid.
_NEW_LINES: tuple[Dashes, ...] = (_SOLID, (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (9, 1.5, 2, 1.5)))
#: Of methods with a suffix: share of white in the colour, marker (none: the base's), line.
_VARIANTS: dict[str, tuple[float, Marker, Dashes]] = {
    "bfloat16": (0.4, "", (0, (2, 1))),
    "tanh": (0.2, "o", (0, (2, 1))),
    "mse": (0.4, "^", (0, (7, 1.5))),
    "mse-tanh": (0.55, "D", (0, (4, 1, 1, 1))),
}
_WHITE = 0.4


def styles(methods: Iterable[str]) -> Looks:
    """The looks of methods that are drawn together; their order does not matter."""
    named = {method: _parts(method) for method in methods}
    new = {each: (bool(each[0]), *each[1:]) for each in named.values() if not _is_known(*each)}
    bases = {base for _, base, _ in named.values()}
    free = [*_NEW, *(hue for base, hue in reversed(_HUES.items()) if hue[1] and base not in bases)]
    places = _places(sorted(set(new.values())))
    return {
        method: _new(*each, places[new[each]], free) if each in new else _known(*each) for method, each in named.items()
    }


def style(method: str) -> Style:
    """The look of a method by itself."""
    return styles([method])[method]


def parts(method: str) -> tuple[str, str]:
    """Family and base of a name: `rrm-surf-proxy` -> ("rrm-surf", "proxy"), `pebble` -> ("", "pebble")."""
    for family in sorted(_LINES, key=len, reverse=True):
        if family and method.startswith(f"{family}-"):
            return family, method.removeprefix(f"{family}-")
    return "", method


def _parts(method: str) -> tuple[str, str, str]:
    """Family, base and suffix: `rrm-proxy-bfloat16` -> ("rrm", "proxy", "bfloat16")."""
    family, rest = parts(method)
    for base in _HUES:
        if rest.startswith(f"{base}-"):
            return family, base, rest.removeprefix(f"{base}-")
    return family, rest, ""


def _is_known(family: str, base: str, suffix: str) -> bool:
    """Whether the tables tell the look, and tell it from every other."""
    if base not in (_PRIORS if family else _LEARNERS):
        return False
    ours = suffix == "bfloat16" or (base == "finetune" and suffix in _VARIANTS)
    return not suffix or (ours and family in ("", "rrm"))


def _known(family: str, base: str, suffix: str) -> Style:
    colour, marker = _HUES[base]
    if not suffix:
        hollow = family == ALONE
        return Style(colour, marker, _DOTTED if base == "oracle" else _LINES[family], "white" if hollow else colour)
    white, own_marker, line = _VARIANTS[suffix]
    # Dots remain the oracle's; a marker then tells its variants from itself.
    return Style(_lighter(colour, white), own_marker or marker or "o", _DOTTED if base == "oracle" else line, "white")


def _places(keys: Sequence[tuple[bool, str, str]]) -> dict[tuple[bool, str, str], int]:
    """Of each new name one of `_NEW`, the one it suggests if that is free, or a higher number."""
    found: dict[tuple[bool, str, str], int] = {}
    for key in keys:
        first = zlib.crc32("-".join(key[1:]).encode())
        order = [*((first + step) % len(_NEW) for step in range(len(_NEW))), *range(len(_NEW), len(_NEW) + len(keys))]
        found[key] = next(place for place in order if place not in found.values())
    return found


def _new(family: str, base: str, suffix: str, place: int, free: Sequence[Hue]) -> Style:
    """Whoever comes after all are taken has a marker that is there already, hollow, and another line."""
    again, at = divmod(place, len(free))
    colour, marker = free[at]
    line = _NEW_LINES[(at + again) % len(_NEW_LINES)] if family in ("", "rrm") else _LINES[family]
    if suffix:
        return Style(_lighter(_HUES[base][0], _WHITE), marker, _DOTTED if base == "oracle" else line, "white")
    return Style(colour, marker, line, "white" if again or family == ALONE else colour)


def _lighter(colour: str, white: float) -> str:
    """The colour mixed with this share of white."""
    mixed = (round(int(colour[at : at + 2], 16) * (1 - white) + 255 * white) for at in (1, 3, 5))
    return "#" + "".join(f"{channel:02X}" for channel in mixed)
