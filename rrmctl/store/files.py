"""Writes that happen as a whole or not at all, and locks the operating system frees when their holder dies."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import math
import os
import time
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrm import parquet
from rrm.files import make_folder, read_bounded, sync_folder, write_atomically
from rrmctl.errors import Exit, UserError

if TYPE_CHECKING:
    import pyarrow as pa

#: What the operating system says when it is the place, not the program, that cannot take a write.
STORAGE_ERRNOS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.EFBIG})

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})

#: Long enough for a lock that only readers hold, who have it for an instant; seconds.
PATIENCE_S = 1.0
#: After so long nobody is still writing a temporary file, seconds.
_LEFT_S = 600.0


class StorageError(UserError):
    """The results folder took no write, or could not be read just now. What was written before stays as it is.

    Args:
        todo: what a person should do before going on.
        code: the exit code of a command that cannot go on.
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
    todo = "make space" if full else "make the folder writable, or choose another with --results"
    return StorageError(
        f"cannot {what} {path}: {error.strerror or error}",
        f"what was written before is untouched; {todo}",
        Exit.INCOMPLETE if full else Exit.USAGE,
    )


def unreadable(path: Path, error: OSError) -> StorageError:
    """The message for `path`, which cannot be read now: that says nothing about what it holds."""
    todo = "nothing was touched; see that the file can be read"
    return StorageError(f"{path} cannot be read now: {error.strerror or error}", todo)


def write_bytes(path: Path, data: bytes) -> None:
    """Replace `path` by `data`, creating its folder; after a crash it holds the old bytes or the new, never a mixture.

    Raises:
        StorageError: no space, no permission; the old file is untouched.
    """
    with _storing(path):
        write_atomically(path, data)


def write_table(path: Path, table: pa.Table, **settings: Any) -> None:
    """`write_bytes` of `table` as a parquet file, with settings as in `rrm.parquet`.

    Raises:
        StorageError: no space, no permission; the old file is untouched.
    """
    with _storing(path):
        parquet.write_table(path, table, **settings)


@contextlib.contextmanager
def _storing(path: Path) -> Iterator[None]:
    try:
        make_folder(path.parent)
        yield
    except OSError as error:
        raise storage_error(path, error) from error


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """`write_bytes` of `value` as indented JSON, its last line a checksum over those before.

    Raises:
        ValueError: it holds NaN, which JSON does not have.
    """
    body = json.dumps(value, indent=1, allow_nan=False).removesuffix("\n}").encode()
    write_bytes(path, body + (_CHECKSUM % zlib.crc32(body) if value else b"\n"))


#: The end of a file of at least one entry. One without it was written by hand, or by an earlier version.
_CHECKSUM = b',\n "checksum": "%08x"\n}\n'
_LENGTH = len(_CHECKSUM % 0)

_LARGEST = 2**28  # bytes; the record of a hundred thousand runs has an eighth of it
_DEEPEST = 50


def read_json(path: Path) -> dict[str, Any] | None:
    """The object in `path`; None where there is no such file.

    Raises:
        DamagedError: the file does not hold a JSON object, or not the one its checksum is of.
        StorageError: it cannot be read now.
    """
    try:
        data = read_bounded(path, _LARGEST)
        value = json.loads(data.decode())
        _refuse_odd(value)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise unreadable(path, error) from error
    except (ValueError, RecursionError) as error:
        raise DamagedError(f"{path} cannot be read: {error}", "move it away; what it recorded is made again") from error
    if not isinstance(value, dict):
        raise DamagedError(f"{path} does not hold a JSON object", "move it away; what it recorded is made again")
    if value.pop("checksum", None) is not None and data[-_LENGTH:].startswith(_CHECKSUM[:14]):
        body = data[:-_LENGTH]
        if data[-_LENGTH:] != _CHECKSUM % zlib.crc32(body):
            raise DamagedError(
                f"{path} is damaged: its content does not match its checksum",
                "move it away; what it recorded is made again",
            )
    return value


def _refuse_odd(value: Any) -> None:
    """Refuse what JSON can say, no file of the store does, and readers would stumble over. Raises ValueError."""
    left = [(value, 0)]
    while left:
        value, depth = left.pop()
        if depth > _DEEPEST:
            raise ValueError(f"nested more than {_DEEPEST} times")
        match value:
            case dict():
                left += [(each, depth + 1) for both in value.items() for each in both]
            case list():
                left += [(each, depth + 1) for each in value]
            case str():
                value.encode()  # halves of characters
            case int() if not -(2**63) <= value < 2**63:
                raise ValueError("an integer of more than 64 bits")
            case float() if not math.isfinite(value):
                raise ValueError(f"{value} is no number")


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files of writers that died in `folder`. Young ones may be those of somebody at work."""
    for path in folder.glob(".*.tmp"):
        with contextlib.suppress(FileNotFoundError):
            if time.time() - path.stat().st_mtime > _LEFT_S:
                path.unlink()


def set_aside(path: Path, suffix: str) -> Path:
    """Rename `path` to the first free `<path>.<suffix>-N`, durably, and return that name."""
    number = 1
    while (aside := path.with_name(f"{path.name}.{suffix}-{number}")).exists():
        number += 1
    path.replace(aside)
    sync_folder(path.parent)
    return aside


def try_lock(path: Path, patience_s: float = 0.0) -> int | None:
    """Take the exclusive lock behind `path`, creating the file; None if another process holds it all the while.

    Returns:
        A file descriptor; closing it, or dying, frees the lock.

    Raises:
        StorageError: the file cannot be created.
    """
    try:
        make_folder(path.parent)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise storage_error(path, error) from error
    deadline = time.monotonic() + patience_s
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if is_open_at(descriptor, path):
                return descriptor
            os.close(descriptor)  # the file was replaced meanwhile; the lock is the one behind the name
            return try_lock(path, deadline - time.monotonic())
        except BlockingIOError:
            if time.monotonic() >= deadline:
                os.close(descriptor)
                return None
            time.sleep(0.02)
        except OSError as error:
            os.close(descriptor)
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
    """Whether a living process holds the lock behind `path`. Works on folders that cannot be written.

    Raises:
        StorageError: it cannot be looked at now.
    """
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
