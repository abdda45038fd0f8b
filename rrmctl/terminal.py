"""Text from elsewhere on a terminal: names, messages and logs may hold signs that would be the terminal's to obey."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

#: Control characters but line breaks and tabs, halves of characters but the bytes of names, and what turns the
#: direction of reading.
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udc9f\udd00-\udfff]")


def spelled(text: str) -> str:
    """The text with its control characters spelled out, which then clear no screen."""
    return _CONTROL.sub(lambda sign: repr(sign[0])[1:-1], text)


def console(**options: Any) -> Console:
    """A `rich.console.Console` that spells out what it is given; colours are its own."""
    from rich.console import Console
    from rich.segment import Segment

    class Spelling(Console):
        def render(self, *args: Any, **kwargs: Any) -> Any:
            for segment in super().render(*args, **kwargs):
                yield segment if segment.control else Segment(spelled(segment.text), segment.style)

    return Spelling(**options)
