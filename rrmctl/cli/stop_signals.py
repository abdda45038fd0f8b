"""Requests to stop a command that trains, while no worker runs: it is planned, recorded or summed up.

Whatever is written then is written as a whole, so that the command may leave anywhere. While workers run, the pool
obeys (`rrmctl.running.supervisor`).
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

import typer

from rrmctl.cli.screen import tell
from rrmctl.errors import Exit, room_error


class _LeaveError(BaseException):
    """A stop was asked for. Not an Exception, so that nothing in between keeps it."""


@contextlib.contextmanager
def resumable(*, err: bool = False) -> Iterator[None]:
    """Decorates a command: SIGTERM and SIGINT end it with the exit code for "incomplete"; `err`: said there."""
    if threading.current_thread() is not threading.main_thread():  # Python allows handlers nowhere else
        yield
        return
    before = {number: signal.signal(number, _leave) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    except _LeaveError:
        tell("Not complete: the same command goes on.", err=err)
        raise typer.Exit(Exit.INCOMPLETE) from None
    except Exception as error:
        if (room := room_error(error)) is None:
            raise
        room.code = Exit.INCOMPLETE  # all that is done is done, and the same command goes on
        raise room from error
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _leave(_number: int, _frame: FrameType | None) -> None:
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_IGN)  # a second one must not disturb the leaving
    raise _LeaveError
