"""Requests to stop a command that trains, while no worker runs: it is planned, recorded or summed up.

Whatever is written then is written as a whole, so that the command may leave anywhere. While workers run, the pool
obeys (`rrmctl.running.supervisor`).
"""

from __future__ import annotations

import functools
import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import ParamSpec

import typer

from rrmctl.cli.screen import tell
from rrmctl.errors import Exit, room_error

_Arguments = ParamSpec("_Arguments")


class _LeaveError(BaseException):
    """A stop was asked for. Not an Exception, so that nothing in between keeps it."""


def resumable(command: Callable[_Arguments, None]) -> Callable[_Arguments, None]:
    """Have SIGTERM and SIGINT end a command with the exit code for "incomplete"."""

    @functools.wraps(command)
    def obedient(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> None:
        if threading.current_thread() is not threading.main_thread():  # Python allows handlers nowhere else
            return command(*args, **kwargs)
        before = {number: signal.signal(number, _leave) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            return command(*args, **kwargs)
        except _LeaveError:
            tell("Not complete: the same command goes on.")
            raise typer.Exit(Exit.INCOMPLETE) from None
        except Exception as error:
            if (room := room_error(error)) is None:
                raise
            room.code = Exit.INCOMPLETE  # all that is done is done, and the same command goes on
            raise room from error
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    return obedient


def _leave(_number: int, _frame: FrameType | None) -> None:
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_IGN)  # a second one must not disturb the leaving
    raise _LeaveError
