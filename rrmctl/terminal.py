"""Standard input, output and error, whatever they are, and text from elsewhere on them.

They may be closed, full, read by nobody, in an encoding of few signs. What cannot be written costs nothing but itself,
with one exception: where what a command prints is all that it was asked for, it ends as soon as standard output takes
no more of it. Names, messages and logs may hold signs that would be the terminal's to obey; they are spelled out.
"""

from __future__ import annotations

import codecs
import io
import os
import re
import select
import sys
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from rich.console import Console

#: Control characters but line breaks and tabs, halves of characters but the bytes of names, and what turns the
#: direction of reading.
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udc9f\udd00-\udfff]")
#: How signs that the program prints are spelled in an encoding that lacks them.
_PLAIN = {"·": "-", "–": "-", "−": "-", "±": "+-", "×": "x", "≥": ">=", "≤": "<=", "…": "..."}


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


class UndeliveredError(BaseException):
    """Standard output takes no more; `reason` says why. Not an Exception, so that no library in between keeps it."""

    def __init__(self, reason: OSError) -> None:
        super().__init__(str(reason))
        self.reason = reason


class Outlet(io.FileIO):
    """A descriptor, left open, that drops what cannot be written, and waits where another program made it one that
    fails; if it is `telling`, the first loss raises `UndeliveredError`.
    """

    def __init__(self, descriptor: int, *, telling: bool = False) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._telling = telling

    def write(self, data: Any) -> int:
        try:
            while (written := super().write(data)) is None:
                select.select((), (self,), ())
        except OSError as error:
            if self._telling:
                self._telling = False  # what the interpreter still flushes when it ends is dropped
                raise UndeliveredError(error) from None
            return memoryview(data).nbytes
        return written


def attend(*, telling: bool = False) -> None:
    """Replace the three standard streams by ones that never fail, for the beginning of a process; where `telling`, a
    loss on standard output raises `UndeliveredError`, once.
    """
    codecs.register_error(_plainly.__name__, _plainly)
    sys.stdin = sys.stdin or os.fdopen(_nothing())
    sys.stdout = _stream(sys.stdout, telling=telling)
    sys.stderr = _stream(sys.stderr)


def _stream(stream: Any, *, telling: bool = False) -> io.TextIOWrapper:
    descriptor, encoding = (_nothing(), "utf-8") if stream is None else (stream.fileno(), stream.encoding)
    buffer = io.BufferedWriter(Outlet(descriptor, telling=telling))
    return io.TextIOWrapper(buffer, encoding, errors=_plainly.__name__, line_buffering=True)


def _nothing() -> int:
    """A descriptor in the place of a standard stream that is closed: a file that got its number would be written to."""
    descriptor = os.open(os.devnull, os.O_RDWR)
    os.set_inheritable(descriptor, True)
    return descriptor


def _plainly(error: UnicodeError) -> tuple[str | bytes, int]:
    """The sign that an encoding lacks in signs that every one has; a byte of a file's name that is no text as it is."""
    assert isinstance(error, UnicodeEncodeError)
    sign = error.object[error.start]
    if "\udc80" <= sign <= "\udcff":
        return sign.encode("utf-8", "surrogateescape"), error.start + 1
    return _PLAIN.get(sign, sign.encode("ascii", "backslashreplace").decode()), error.start + 1
