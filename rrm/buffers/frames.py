"""The pictures of a run: one for each row of its experience, in the order in which they were seen.

They lie in a file that only grows and are read from there: the system keeps in memory what it has room for, and gives
it up when others need it. A memory map would count as this process' own.
"""

from __future__ import annotations

import errno
import math
import os
import tempfile
import weakref
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from rrm.checkpoint import AppendLog
from rrm.files import naming

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import Tensor

    from rrm.envs.spaces import FrameSpace
    from rrm.types import Pixels, State

_BLOCK = 1 << 22  # bytes that are copied at once


class Frames:
    """Pictures uint8 [channels, height, width], in a file of its own until `save` says where they are to stay."""

    def __init__(self, space: FrameSpace) -> None:
        self.space = space
        self.stack = space.stack
        self.shape = space.planar
        self._bytes = math.prod(self.shape)
        self._path: Path | None = None
        with tempfile.TemporaryFile() as file:
            self._hold(os.dup(file.fileno()))
        self._count = 0
        self._crc = 0

    def _hold(self, descriptor: int) -> None:
        """Read and write this file, until another takes its place or nobody needs the pictures."""
        self._file = descriptor
        self._let_go = weakref.finalize(self, os.close, descriptor)

    def __len__(self) -> int:
        return self._count

    def append(self, frame: Pixels) -> None:
        """The picture of the next row. An `OSError` where there is no room for it."""
        data = np.ascontiguousarray(frame).data.cast("B")
        with naming(self._path or Path(tempfile.gettempdir())):
            if os.pwrite(self._file, data, self._count * self._bytes) != self._bytes:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._crc = zlib.crc32(data, self._crc)
        self._count += 1

    def read(self, begin: int, into: Pixels) -> None:
        """Fill `into`, [n, channels, height, width] in one piece of memory, with the pictures from row `begin` on."""
        if os.preadv(self._file, [into.data.cast("B")], begin * self._bytes) != into.nbytes:
            raise IndexError(f"{len(into)} pictures from row {begin} on; there are {self._count}")

    def windows(self, rows: Sequence[int], depths: Sequence[int], count: int) -> Tensor:
        """What was seen at each of `rows` and at the steps behind it, `count` states in all, uint8
        [B, stack - 1 + count, channels, height, width], the earliest picture first.

        Args: depths: how many rows before each are of the same episode; its first picture stands for those before it.
        """
        pictures = np.empty((len(rows), self.stack - 1 + count, *self.shape), np.uint8)
        for picture, row, depth in zip(pictures, rows, depths, strict=True):
            before = max(self.stack - 1 - depth, 0)
            self.read(row + before - self.stack + 1, picture[before:])
            picture[:before] = picture[before]
        return torch.from_numpy(pictures)

    def save(self, path: Path) -> State:
        """Make durable what there is, in this file; the state returned says how much that is."""
        with naming(path):
            if self._path != path:
                with path.open("w+b") as file:
                    _copy(self._file, file.fileno(), self._count * self._bytes)
                    self._let_go()
                    self._hold(os.dup(file.fileno()))
                self._path = path
            os.fsync(self._file)
        return {"size": self._count * self._bytes, "crc": self._crc}

    def load(self, path: Path, state: State, *, finished: bool = False) -> None:
        """Continue from what `save` returned, on an empty store; a `CheckpointError` where the file lacks it.

        Args: finished: nothing will be appended: the file may be another's, and is left as it is.
        """
        log = AppendLog(path)
        for _ in log.restore(int(state["size"]), int(state["crc"]), self._bytes):
            pass
        self._count, self._crc, self._path = log.size // self._bytes, log.crc, path
        with naming(path), path.open("rb" if finished else "r+b") as file:
            if not finished:
                file.truncate(log.size)  # behind it lies what a process wrote that died
            self._let_go()
            self._hold(os.dup(file.fileno()))


def _copy(source: int, target: int, size: int) -> None:
    done = 0
    while done < size:
        done += os.pwrite(target, os.pread(source, min(_BLOCK, size - done), done), done)
