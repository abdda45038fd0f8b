"""Reads and writes below a results root, and what is said where they cannot be."""

from __future__ import annotations

import contextlib
import errno
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrm import parquet
from rrm.files import make_folder, read_bounded, sync_folder, write_atomically
from rrmctl.errors import Exit, UserError

if TYPE_CHECKING:
    import pyarrow as pa

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})

#: What the operating system says when it is the place, not the program, that cannot take a write.
STORAGE_ERRNOS = _FULL | {errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}

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


def read_bytes(path: Path, largest: int = 2**30) -> bytes | None:
    """The content of a file; None where there is none. Raises StorageError where it cannot be read now.

    In one read: the file may be replaced by its successor at any moment, and this one stays what it was.
    """
    try:
        return read_bounded(path, largest)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise unreadable(path, error) from error


def write_bytes(path: Path, data: bytes) -> None:
    """Replace `path` by `data`, creating its folder; after a crash it holds the old bytes or the new, as a whole."""
    with _storing(path):
        write_atomically(path, data)


def write_table(path: Path, table: pa.Table, **settings: Any) -> None:
    """`write_bytes` of `table` as a parquet file, with settings as in `rrm.parquet`."""
    with _storing(path):
        parquet.write_table(path, table, **settings)


@contextlib.contextmanager
def _storing(path: Path) -> Iterator[None]:
    try:
        make_folder(path.parent)
        yield
    except OSError as error:
        raise storage_error(path, error) from error


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
