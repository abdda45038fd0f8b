"""Commands that see runs of this results root to their end: each has a file here while it lives, and holds its lock."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from rrmctl.errors import UserError
from rrmctl.store.files import is_locked, storing, try_lock
from rrmctl.store.layout import Layout
from rrmctl.store.owner import HERE


class Driver(NamedTuple):
    """One of them."""

    host: str
    pid: int
    here: bool  #: a process of that number, seen from here, is the command
    again: tuple[str, ...]  #: what has `resume` run things in its way


@contextlib.contextmanager
def driving(layout: Layout, experiments: Collection[str], again: Sequence[str] = ()) -> Iterator[None]:
    """Be one of them, for these experiments. Raises StorageError."""
    for path, host, _ in _files(layout):
        with contextlib.suppress(OSError, UserError):
            if host == HERE.host and not is_locked(path):  # its process was killed
                path.unlink()
    path = layout.drivers / f"{HERE.host}.{os.getpid()}"
    held = try_lock(path, patience_s=1.0)
    try:
        if held is not None:  # else another machine of this name has a process of this number
            content = {"place": _place(), "again": list(again), "experiments": list(experiments)}
            with storing(path):
                os.ftruncate(held, 0)
                os.write(held, json.dumps(content).encode())
        yield
    finally:
        if held is not None:
            with contextlib.suppress(OSError):
                path.unlink()
            os.close(held)


def drivers(layout: Layout, experiment: str) -> list[Driver]:
    """Those that run the experiment now, as far as locks are seen from here."""
    found = []
    for path, host, pid in _files(layout):
        with contextlib.suppress(OSError, UserError, ValueError, KeyError, TypeError):
            content = json.loads(path.read_bytes())
            if experiment in content["experiments"] and is_locked(path):
                here = host == HERE.host and content["place"] == _place()
                found.append(Driver(host, pid, here, tuple(map(str, content["again"]))))
    return found


def _files(layout: Layout) -> Iterator[tuple[Path, str, int]]:
    """Each file with the host and the process that its name says."""
    for path in layout.drivers.glob("*.*"):
        host, _, pid = path.name.rpartition(".")
        if pid.isdecimal():
            yield path, host, int(pid)


def _place() -> str:
    """Where numbers of processes mean the same: a container has some of its own, whatever it is called."""
    with contextlib.suppress(OSError):
        return f"{HERE.boot} {Path('/proc/self/ns/pid').readlink()}"
    return HERE.boot
