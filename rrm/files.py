"""Reads that end, and writes that either happen or do not: temporary file, flush to disk, rename."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO


class UnfitFileError(OSError):
    """What bears a file's name is a folder, pipe, device or socket, or larger than such a file can be."""


def open_regular(path: Path) -> BinaryIO:
    """Open a file to be read; raise `UnfitFileError` where it is no regular one. A pipe is not waited for."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise UnfitFileError(errno.EINVAL, "not a regular file", str(path))
    return os.fdopen(descriptor, "rb")


def read_bounded(path: Path, limit: int) -> bytes:
    """The content of a regular file of at most `limit` bytes. Raises as `open_regular`, and for a larger one."""
    with open_regular(path) as file:
        if os.fstat(file.fileno()).st_size > limit:
            raise UnfitFileError(errno.EFBIG, f"longer than {limit:,} bytes", str(path))
        return file.read()  # with a number, Python would set that much memory aside


def place(path: str | Path) -> Path:
    """A path as people write it: `~` at its start is their home folder, which not every shell and program replaces."""
    try:
        return Path(path).expanduser()
    except RuntimeError:  # ~name of nobody: a file may be called so
        return Path(path)


def write_atomically(path: Path, data: bytes) -> None:
    """Replace `path` by `data`; after a crash it holds the old bytes or the new ones, never a mixture.

    A file that holds these bytes already is left alone, and may be in a folder that takes no write. An `OSError` names
    `path`, and leaves the old file untouched.
    """
    with contextlib.suppress(OSError):
        if path.stat().st_size == len(data) and path.read_bytes() == data:
            return
    replace(path, data, durably=True)


def replace(path: Path, data: bytes, *, durably: bool = False) -> None:
    """Replace `path` by `data` as a whole for every reader; only `durably` does it survive the machine's crash."""
    temporary = beside(path)
    with naming(path):
        try:
            with temporary.open("xb") as file:
                file.write(data)
                if durably:
                    file.flush()
                    os.fsync(file.fileno())
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        if durably:
            sync_folder(path.parent)


def create(path: Path, data: bytes) -> bool:
    """Make `path`, with `data` from its first moment on; False where it is there. Of many who try at once, on whatever
    machine, one does: no lock is needed for that. An `OSError` names `path`.
    """
    temporary = beside(path)
    with naming(path):
        try:
            temporary.write_bytes(data)
            os.link(temporary, path)
        except FileExistsError:
            return temporary.samefile(path)  # NFS may repeat a call whose answer was lost
        except OSError as error:
            if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS):
                raise
            with contextlib.suppress(FileExistsError), path.open("xb") as file:  # no links here, as on FAT
                return bool(file.write(data))
            return False
        finally:
            temporary.unlink(missing_ok=True)
        return True


def beside(path: Path) -> Path:
    """A temporary file of this writer alone: processes of two machines or containers can have one number, and threads
    of one process do.
    """
    return path.parent / f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}.tmp"


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """An `OSError` from inside says which file it is about; the system leaves that out when a write fails."""
    try:
        yield
    except OSError as error:
        error.filename = str(path)
        raise


def refresh(folder: Path) -> None:
    """Where another machine may have made something in the folder: NFS may hold for half a minute that a name which
    was looked for before is not there, unless the folder is listed.
    """
    with contextlib.suppress(OSError):
        list(folder.iterdir())


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it that are missing, durably. One that is there is left alone."""
    if not folder.is_dir():
        make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        sync_folder(folder.parent)


def sync_folder(folder: Path) -> None:
    """Make renames and new names in `folder` durable."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
