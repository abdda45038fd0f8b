"""TOML of anybody's, in a time that grows as its length does."""

from __future__ import annotations

import re
import tomllib
from typing import Any

#: Parts of a dotted key, and tables and lists within one another.
DEEPEST = 20

_PART = r"""(?:[\w-]++|"(?:\\.|[^"\\\n])*+"|'[^'\n]*+')"""
#: A key of too many parts, for which `tomllib` takes time and memory with the square of their number.
_CHAIN = re.compile(rf"(?<![\w\\-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST}}}")


class NestingError(ValueError):
    """What a text describes is nested too deeply."""


def loads(text: str) -> dict[str, Any]:
    """The tables that a text describes.

    Raises:
        NestingError: with the line, where it is a key's.
        ValueError: it is not TOML; the message says why, with line and column.
    """
    if chain := _CHAIN.search(text):
        line = text.count("\n", 0, chain.start()) + 1
        raise NestingError(f"nested too deeply: a key of more than {DEEPEST} parts in line {line}")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"not valid TOML: {error}") from None
    except ValueError:  # Python's own limit
        raise ValueError("not valid TOML: an integer of thousands of digits") from None
    except RecursionError:
        raise NestingError("nested too deeply") from None
