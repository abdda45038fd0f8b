"""Locks that the operating system frees when their holder dies."""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from rrm.files import make_folder
from rrmctl.store.files import StorageError, storage_error, unreadable

#: Long enough for a lock that only readers hold, who have it for an instant; seconds.
PATIENCE_S = 1.0

#: How often one who waits looks whether a lock is free, seconds.
_LOOK_S = 0.01


def open_lock(path: Path) -> int:
    """A descriptor of the file behind which a lock is, made where it is missing. Raises StorageError."""
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise storage_error(path, error) from error


def wait_for(descriptor: int, patience_s: float, waiting: Callable[[], None] = lambda: None) -> bool:
    """Take the exclusive lock of an open file; False where others held it all the while. `waiting` is called often."""
    deadline = time.monotonic() + patience_s
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= deadline:
                return False
            waiting()
            time.sleep(_LOOK_S)
        else:
            return True


def try_lock(path: Path, patience_s: float = 0.0) -> int | None:
    """Take the exclusive lock behind `path`, creating the file; None if another process holds it all the while.

    Returns:
        A file descriptor; closing it, or dying, frees the lock.
    """
    try:
        make_folder(path.parent)
        while True:
            descriptor = open_lock(path)
            if not wait_for(descriptor, patience_s):
                os.close(descriptor)
                return None
            if is_open_at(descriptor, path):
                return descriptor
            os.close(descriptor)  # the file was replaced meanwhile; the lock is the one behind the name
    except OSError as error:
        raise storage_error(path, error) from error


def is_open_at(descriptor: int, path: Path) -> bool:
    """Whether the open file is the one that `path` names."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the exclusive lock behind `path`, waiting for it; for moments, not for runs."""
    descriptor = try_lock(path, patience_s=60.0)
    if descriptor is None:
        raise StorageError(f"{path} was held by another process for a minute", "see whether an rrmctl is paused")
    try:
        yield
    finally:
        os.close(descriptor)


def is_locked(path: Path) -> bool:
    """Whether a living process holds the lock behind `path`. Works on folders that cannot be written."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise unreadable(path, error) from error
    try:
        # Shared and for an instant: two readers do not disturb each other, and a worker that meets one waits a moment.
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False
