"""What the program says when it cannot go on, and the exit code it leaves with."""

from __future__ import annotations

from enum import IntEnum


class Exit(IntEnum):
    """Exit codes of `rrmctl`."""

    DONE = 0  #: all that was asked for is there
    FAILED = 1  #: some job failed
    USAGE = 2  #: bad manifest, option, file or label
    INCOMPLETE = 75  #: stopped in good order before all was done; the same command goes on
    INTERRUPTED = 130  #: stopped at once by a second Ctrl-C


class UserError(Exception):
    """One clear message for a person: what, where, what to do. Becomes an exit code without a traceback."""

    code = Exit.USAGE

    def __init__(self, message: str, hint: str | None = None) -> None:
        super().__init__(message)
        self.hint = hint


def shown(value: object, most: int = 200) -> str:
    """A value as a message shows it: as Python writes it, cut where it is long."""
    text = repr(value)
    return text if len(text) <= most else f"{text[:most]}..."
