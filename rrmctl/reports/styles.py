"""How each method is drawn: the same in every figure, told apart without colour too.

What a method's reward is built on gives colour and marker; how it uses it gives the line, and a hollow marker where
nothing is learned: `rrm-proxy` and `sac-proxy` share a colour, one solid and filled, one dashed and hollow. A method
with a suffix (`pebble-bfloat16`, `finetune-mse`) is a lighter, hollow one of the method it is named after, with a line
of its own. Methods that an experiment compares stay apart for the colour-blind and in greyscale (a test measures it).

A method or prior of the user's (`rrm-mine`, `pebble-wide`) gets a marker and a line that nothing else has of what it is
drawn with: those that its name suggests, or else the next that are free.
"""

from __future__ import annotations

import itertools
import tomllib
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
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

#: The share of white in the colour of a method with a suffix that no table has.
_WHITE = 0.4


def _plain(value: Any) -> Any:
    """A table's value with tuples for lists."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return tuple(map(_plain, value)) if isinstance(value, list) else value


_TABLE: Mapping[str, Any] = _plain(tomllib.loads(Path(__file__).with_suffix(".toml").read_text()))
_HUES: dict[str, Hue] = _TABLE["learners"] | _TABLE["priors"]
_NEW: Sequence[Hue] = _TABLE["new"]
_LINES: Mapping[str, Dashes] = _TABLE["lines"]
#: Families of what is trained on a prior alone: the agents' names.
ALONE: Sequence[str] = _TABLE["alone"]


def styles(methods: Iterable[str]) -> Looks:
    """The looks of methods that are drawn together; their order does not matter."""
    named = {method: _parts(method) for method in methods}
    looks = {method: _tabled(*name) for method, name in named.items()}
    # A new name takes the place that it suggests if that is free, or the next one; with every family the same.
    new = {method: (bool(named[method][0]), *named[method][1:]) for method, look in looks.items() if not look}
    places: dict[tuple[bool, str, str], int] = {}
    for key in sorted(set(new.values())):
        first = zlib.crc32("-".join(key[1:]).encode())
        order = itertools.chain(((first + step) % len(_NEW) for step in range(len(_NEW))), itertools.count(len(_NEW)))
        places[key] = next(place for place in order if place not in places.values())
    bases = {base for _, base, _ in named.values()}
    free = [*_NEW, *(hue for base, hue in reversed(_HUES.items()) if hue[1] and base not in bases)]
    return {method: look or _new(*named[method], places[new[method]], free) for method, look in looks.items()}


def style(method: str) -> Style:
    """The look of a method by itself."""
    return styles([method])[method]


def parts(method: str) -> tuple[str, str]:
    """Family and base of a name: `rrm-surf-proxy` -> ("rrm-surf", "proxy"), `pebble` -> ("", "pebble")."""
    family = max((name for name in _LINES if name and method.startswith(f"{name}-")), key=len, default="")
    return family, method.removeprefix(f"{family}-") if family else method


def _parts(method: str) -> tuple[str, str, str]:
    """Family, base and suffix: `rrm-proxy-bfloat16` -> ("rrm", "proxy", "bfloat16")."""
    family, rest = parts(method)
    base = next((base for base in _HUES if rest.startswith(f"{base}-")), rest)
    return family, base, rest.removeprefix(base).removeprefix("-")


def _tabled(family: str, base: str, suffix: str) -> Style | None:
    """The look that the tables tell, where they tell it from every other."""
    if base not in _TABLE["priors" if family else "learners"]:
        return None
    (colour, marker), line = _HUES[base], _LINES[family]
    if suffix:
        named = suffix == "bfloat16" or (base == "finetune" and suffix in _TABLE["variants"])
        if not named or family not in ("", "rrm"):
            return None
        white, own_marker, line = _TABLE["variants"][suffix]
        # Dots remain the oracle's; a marker then tells its variants from itself.
        colour, marker = _lighter(colour, white), own_marker or marker or "o"
    hollow = bool(suffix) or family in ALONE
    return Style(colour, marker, ":" if base == "oracle" else line, "white" if hollow else colour)


def _new(family: str, base: str, suffix: str, place: int, free: Sequence[Hue]) -> Style:
    """Whoever comes after all are taken has a marker that is there already, hollow, and another line."""
    again, at = divmod(place, len(free))
    colour, marker = free[at]
    lines = _TABLE["new_lines"]
    line = lines[(at + again) % len(lines)] if family in ("", "rrm") else _LINES[family]
    if suffix:
        return Style(_lighter(_HUES[base][0], _WHITE), marker, ":" if base == "oracle" else line, "white")
    return Style(colour, marker, line, "white" if again or family in ALONE else colour)


def _lighter(colour: str, white: float) -> str:
    """The colour mixed with this share of white."""
    mixed = (round(int(colour[at : at + 2], 16) * (1 - white) + 255 * white) for at in (1, 3, 5))
    return "#" + "".join(f"{channel:02X}" for channel in mixed)
