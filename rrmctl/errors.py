"""What the program says when it cannot go on, and the exit code it leaves with."""

from __future__ import annotations

import errno
from collections.abc import Collection
from enum import IntEnum

from rrm.errors import nearest


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


class RoomError(UserError):
    """The system gives this process no more memory, threads or open files."""

    def __init__(self, what: str) -> None:
        super().__init__(f"there are no more {what}", "end other programs, or raise the limit that `ulimit -a` shows")


def room_error(error: BaseException) -> RoomError | None:
    """What an error says that comes of too little room; None for all other errors."""
    number, text = getattr(error, "errno", None), str(error).lower()
    unmapped = "failed to map segment" in text or "cannot allocate memory" in text  # of a library that is loaded
    lacking = {
        "open files": number in (errno.EMFILE, errno.ENFILE),
        "threads or processes": number == errno.EAGAIN or "can't start new thread" in text,
        "pages of memory": isinstance(error, MemoryError) or number == errno.ENOMEM or unmapped,
    }
    return next((RoomError(what) for what, lacks in lacking.items() if lacks), None)


def check_known(name: str, known: Collection[str], problem: str, there: str = "known") -> None:
    """Refuse a name that is not known: the problem, with the nearest name that there is; the hint lists all of them."""
    if name not in known:
        raise UserError(f"{problem}{nearest(name, known)}", f"{there}: {', '.join(known)}")


def shown(value: object, most: int = 200) -> str:
    """A value as a message shows it: as Python writes it, cut where it is long."""
    text = repr(value)
    return text if len(text) <= most else f"{text[:most]}..."
