"""What ties a worker to its parent: progress up a pipe, and the wish to stop coming down."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Any, Self

#: Least time between two beats, seconds.
_BEAT_S = 0.25

#: How often a worker looks whether its parent still lives, seconds.
_WATCH_S = 0.5

#: How long a worker without a parent may take to checkpoint before it ends itself, seconds.
_GRACE_S = 120.0

#: What the system sends a worker whose parent died; its number is the seconds until a worker that hangs is ended.
_ORPHANED: int | None = getattr(signal, "SIGRTMAX", None)

_PR_SET_PDEATHSIG = 1  # linux/prctl.h

#: A line up to this length arrives whole or not at all (POSIX: at least 512; Linux: 4096).
_LINE = 4000 if os.name == "posix" and os.uname().sysname == "Linux" else 500


def say(text: str) -> None:
    """A line for the run's log, which is the worker's standard output."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


class Pipe:
    """The worker's end of the pipe, if there is one: a JSON object a line, without ever waiting for the reader."""

    def __init__(self, descriptor: int | None) -> None:
        self._descriptor = descriptor
        self._last_beat = -math.inf
        self.broken = False  #: the reader is gone
        if descriptor is not None:
            os.set_blocking(descriptor, False)
            os.set_inheritable(descriptor, False)

    def beat(self, event: str = "beat", **progress: Any) -> None:
        """A sign of life, a few times a second at the most: of progress, or of waiting for another process."""
        if time.monotonic() - self._last_beat >= _BEAT_S:
            self._last_beat = time.monotonic()
            self.send(event=event, **progress)

    def note(self, text: str) -> None:
        """Something a person should read; it is printed into the log as well."""
        say(f"--- {text}")
        self.send(event="note", text=text)

    def send(self, **message: Any) -> None:
        """Any message. It is dropped when the pipe is full: its reader sleeps, and the files tell the same."""
        if self._descriptor is None or self.broken:
            return
        try:
            os.write(self._descriptor, _line(message))
        except BlockingIOError:
            return
        except BrokenPipeError:
            self.broken = True


def _line(message: dict[str, Any]) -> bytes:
    """The message as one line, its longest text cut until the line is sure to arrive whole."""
    line = json.dumps(message).encode() + b"\n"
    while len(line) > _LINE:
        _, name = max((len(text), name) for name, text in message.items() if isinstance(text, str))
        message = message | {name: message[name][: len(message[name]) * 3 // 4]}
        line = json.dumps(message).encode() + b"\n"
    return line


class Leave(BaseException):
    """A stop was asked for while there was nothing to save. Not an Exception, so that no import in between keeps it."""


class StopRequest:
    """Set by SIGTERM, SIGINT, or the death of the parent, if there is one. Used as a context, in the main thread."""

    def __init__(self, parent: int | None, pipe: Pipe) -> None:
        self._parent = parent
        self._pipe = pipe
        self._requested, self._left = threading.Event(), threading.Event()
        self._at_once = False
        self._watching: threading.Thread | None = None
        self._handlers: dict[signal.Signals, Any] = {}

    @property
    def requested(self) -> bool:
        """True once the run should be checkpointed and left."""
        return self._requested.is_set() or self._pipe.broken

    @contextlib.contextmanager
    def at_once(self) -> Iterator[None]:
        """A block in which a request to stop, the one before it included, raises `Leave` in the main thread."""
        self._at_once = True
        try:
            if self.requested:
                raise Leave
            yield
        finally:
            self._at_once = False

    def __enter__(self) -> Self:
        for number in (signal.SIGTERM, signal.SIGINT):
            self._handlers[number] = signal.signal(number, self._on_signal)
        if self._parent is not None:
            _end_orphans(_ORPHANED)
            self._watching = threading.Thread(target=self._watch, args=(self._parent,), daemon=True)
            self._watching.start()
        return self

    def __exit__(self, *_exception: object) -> None:
        self._left.set()
        if self._watching is not None:
            self._watching.join()
            _end_orphans(None)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self._requested.set()
        if self._at_once:
            self._at_once = False  # a second signal must not disturb the leaving
            raise Leave

    def _watch(self, parent: int) -> None:
        while os.getppid() == parent:
            if self._left.wait(_WATCH_S):
                return
        self._requested.set()
        signal.alarm(math.ceil(_GRACE_S) + 5)  # Python runs, and is given the whole time
        if self._at_once:  # only the main thread can leave what it is doing, and only a signal reaches it there
            os.kill(os.getpid(), signal.SIGTERM)
        # Nobody is left to end this process should it hang, so it does so itself, with whatever it has started.
        if not self._left.wait(_GRACE_S):
            leads = os.getpgrp() == os.getpid()
            (os.killpg if leads else os.kill)(os.getpid(), signal.SIGKILL)


def _end_orphans(number: int | None) -> None:
    """Have the system end this process some time after its parent's death, even while Python cannot run.

    Code that never gives up the interpreter's lock (a regular expression, somebody's C) keeps every thread of Python's
    from running, and every handler. So the signal of the parent's death is handled by alarm(2) itself, which takes the
    signal's number for seconds; and the alarm, which nobody handles, ends the process.

    Args:
        number: the signal; None to undo it.
    """
    if sys.platform != "linux":
        return
    import ctypes

    libc = ctypes.CDLL(None)
    if number is None:
        libc.prctl(_PR_SET_PDEATHSIG, ctypes.c_ulong(0))
        signal.alarm(0)
    else:
        libc.signal(number, ctypes.cast(libc.alarm, ctypes.c_void_p))
        libc.prctl(_PR_SET_PDEATHSIG, ctypes.c_ulong(number))
