"""Text from elsewhere on a terminal: names, messages and logs may hold signs that would be the terminal's to obey."""

from __future__ import annotations

import re
import sys
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from rich.console import Console

#: Control characters but line breaks and tabs, halves of characters but the bytes of names, and what turns the
#: direction of reading.
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udc9f\udd00-\udfff]")


def spelled(text: str) -> str:
    """The text with its control characters spelled out, which then clear no screen."""
    return _CONTROL.sub(lambda sign: repr(sign[0])[1:-1], text)


def console(file: TextIO | None = None, **options: Any) -> Console:
    """A `rich.console.Console` that spells out what it is given and takes it as it stands: brackets and colons mean
    nothing. Colours are its own.
    """
    from rich.console import Console
    from rich.segment import Segment

    class Spelling(Console):
        def render(self, *args: Any, **kwargs: Any) -> Any:
            for segment in super().render(*args, **kwargs):
                yield segment if segment.control else Segment(spelled(segment.text), segment.style)

    return Spelling(file=file, highlight=False, markup=False, emoji=False, **options)


def stdout_console(unwatched: int = 200, **options: Any) -> Console:
    """Standard output, as wide as the terminal; where nobody looks, so wide that a program that reads it finds no name
    cut or folded.
    """
    return console(width=None if sys.stdout.isatty() else unwatched, **options)
