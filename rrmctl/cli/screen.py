"""Output that a command can do without: where it cannot be written, its work goes on, and obeys signals all the while.

A terminal may be stopped (Ctrl-S), the reader of a pipe may sleep.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import queue
import threading
import time
from collections.abc import Mapping
from typing import Any, TextIO

import typer

from rrmctl.terminal import Outlet, UndeliveredError, spelled

#: Pieces of text that wait to be written; further ones are dropped.
_WAITING = 10_000
#: How long what waits may take to be written at the end, seconds.
_LAST_S = 2.0


class Screen:
    """A text stream whose writer neither waits nor fails: a thread passes on what it is given, as far as it can, to the
    descriptor of `stream` in its encoding.
    """

    def __init__(self, stream: TextIO) -> None:
        self._outlet = Outlet(stream.fileno())
        self.encoding, self.errors = stream.encoding, stream.errors or "backslashreplace"
        self.fileno, self.isatty, self.flush = self._outlet.fileno, self._outlet.isatty, self._outlet.flush
        self._waiting: queue.Queue[str] = queue.Queue(_WAITING)
        threading.Thread(target=self._pass_on, daemon=True).start()
        atexit.register(self.drain)

    def write(self, text: str) -> int:
        with contextlib.suppress(queue.Full):
            self._waiting.put_nowait(text)
        return len(text)

    def drain(self) -> None:
        """Wait until all is written, or for two seconds."""
        deadline = time.monotonic() + _LAST_S
        while self._waiting.unfinished_tasks and time.monotonic() < deadline:
            time.sleep(0.005)

    def _pass_on(self) -> None:
        # Not through Python's own stream: its lock, held by a thread that waits, would keep the process from ending.
        while True:
            data = self._waiting.get().encode(self.encoding, self.errors)
            while data:
                data = data[self._outlet.write(data) :]
            self._waiting.task_done()


def unfailing(stream: TextIO) -> TextIO:
    """The stream as a `Screen`, unless it has no file descriptor (a test's) or the system has no room for a thread."""
    try:
        return Screen(stream)  # type: ignore[return-value]
    except (OSError, ValueError, RuntimeError):
        return stream


def drain(stream: object) -> None:
    """Before something is written elsewhere that should stand below: wait for a `Screen`; others do not keep back."""
    if isinstance(stream, Screen):
        stream.drain()


def plain_json(facts: Mapping[str, Any]) -> str:
    """For programs: what is no number is null."""
    plain = json.loads(json.dumps(facts), parse_constant=lambda _: None)
    return json.dumps(plain, indent=1, allow_nan=False)


def tell(text: str, *, err: bool = False) -> None:
    """A line about work that is done elsewhere, in files, on standard output or error; given up where it takes none."""
    with contextlib.suppress(UndeliveredError):
        typer.echo(spelled(text), err=err)
