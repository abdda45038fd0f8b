"""Reads, writes and locks below a results root, and what is said where they cannot be."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrm import parquet
from rrm.files import make_folder, read_bounded, refresh, sync_folder, write_atomically
from rrmctl.errors import Exit, UserError

if TYPE_CHECKING:
    import pyarrow as pa

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})

#: What the operating system says when it is the place, not the program, that cannot take a write.
STORAGE_ERRNOS = _FULL | {errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}

#: What it says of a file that is not there, or was replaced by another machine since it was opened (NFS).
_GONE = frozenset({errno.ENOENT, errno.ENOTDIR, errno.ESTALE})

#: After so long nobody is still writing a temporary file, seconds.
_LEFT_S = 600.0

#: Long enough for a lock that only readers hold, who have it for an instant; seconds.
PATIENCE_S = 1.0

#: A file that another machine replaces just then can be missing to who opens it, also to make it (FUSE, NFS): so often.
_OPENINGS = 10

#: How often one who waits looks whether a lock is free, seconds.
_LOOK_S = 0.01


class StorageError(UserError):
    """The results folder took no write, or could not be read just now. What was written before stays as it is.

    `todo` is what a person should do before going on, `code` the exit code of a command that cannot.
    """

    def __init__(self, message: str, todo: str, code: Exit = Exit.USAGE) -> None:
        super().__init__(message, f"{todo}, then run the same command again")
        self.todo = todo
        self.code = code


class DamagedError(UserError):
    """A file of the store does not hold what it should."""


class VersionError(UserError):
    """A file of the store is of another schema version: whole, and not for this program."""


def storage_error(path: Path, error: OSError, what: str = "write") -> StorageError:
    """The message for `path`, with which one could not do `what`."""
    full = error.errno in _FULL
    todo = "make space" if full else "make the folder writable, or name another (of results with --results)"
    return StorageError(
        f"cannot {what} {path}: {error.strerror or error}",
        f"what was written before is untouched; {todo}",
        Exit.INCOMPLETE if full else Exit.USAGE,
    )


def unreadable(path: Path, error: OSError) -> StorageError:
    """The message for `path`, which cannot be read now: that says nothing about what it holds."""
    todo = "nothing was touched; see that the file can be read"
    return StorageError(f"{path} cannot be read now: {error.strerror or error}", todo)


def read_bytes(path: Path, largest: int = 2**30) -> bytes | None:
    """The content of a file; None where there is none. Raises StorageError where it cannot be read now.

    In one read: the file may be replaced by its successor at any moment, and this one stays what it was.
    """
    for _ in range(2):
        try:
            return read_bounded(path, largest)
        except OSError as error:
            if error.errno not in _GONE:
                raise unreadable(path, error) from error
            refresh(path.parent)
    return None


def write_bytes(path: Path, data: bytes) -> None:
    """Replace `path` by `data`, creating its folder; after a crash it holds the old bytes or the new, as a whole."""
    with storing(path):
        make_folder(path.parent)
        write_atomically(path, data)


def write_table(path: Path, table: pa.Table, **settings: Any) -> None:
    """`write_bytes` of `table` as a parquet file, with settings as in `rrm.parquet`."""
    with storing(path):
        make_folder(path.parent)
        parquet.write_table(path, table, **settings)


@contextlib.contextmanager
def storing(path: Path) -> Iterator[None]:
    """Around a write of `path`: an `OSError` becomes a StorageError."""
    try:
        yield
    except OSError as error:
        raise storage_error(path, error) from error


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files of writers that died in `folder`. Young ones may be those of somebody at work.

    How young is told by the file system's own clock, since those of other machines may differ from this one's.
    """
    left = list(folder.glob(".*.tmp"))
    if not left:
        return
    with contextlib.suppress(OSError), tempfile.TemporaryFile(dir=folder) as new:
        now = os.fstat(new.fileno()).st_mtime
        for path in left:
            with contextlib.suppress(FileNotFoundError):
                if now - path.stat().st_mtime > _LEFT_S:
                    path.unlink()


def set_aside(path: Path, suffix: str) -> Path:
    """Rename `path` to the first free `<path>.<suffix>-N`, durably, and return that name."""
    number = 1
    while (aside := path.with_name(f"{path.name}.{suffix}-{number}")).exists():
        number += 1
    path.replace(aside)
    sync_folder(path.parent)
    return aside


def open_lock(path: Path) -> int:
    """A descriptor of the file behind which a lock is, made where it is missing."""
    tries = _OPENINGS
    while True:
        try:
            return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError as error:
            tries -= 1
            if error.errno not in _GONE or tries == 0:
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

    Closing the descriptor that is returned, or dying, frees the lock.
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
    except OSError as error:
        if error.errno not in _GONE:
            raise
        return False


@contextlib.contextmanager
def locked(path: Path, patience_s: float = 60.0, busy: UserError | None = None) -> Iterator[None]:
    """Hold the exclusive lock behind `path`, waiting for it. `busy` says that others hold it all the while, where they
    may do so for longer than moments.
    """
    descriptor = try_lock(path, patience_s)
    if descriptor is None:
        raise busy or StorageError(
            f"{path} was held by another process for a minute", "see whether an rrmctl is paused"
        )
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
