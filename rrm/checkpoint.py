"""Checkpoints: a folder of states, each committed by the rename of its marker; the newest intact one is used.

A state is a tree of dicts and lists with tensors, arrays and JSON values as leaves. Tensors go into a safetensors file,
which cannot execute anything, the rest of the tree into its header. What only ever grows (the experience of a run) is
kept by its owner in append-only logs beside the states; a state records how long each log was, and its checksum up to
there.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from rrm import tensors
from rrm.errors import CheckpointError, ConfigError, MissingResultError, NumericalError
from rrm.files import UnfitFileError, naming, open_regular, read_bounded, sync_folder, write_atomically
from rrm.types import State

#: Of the layout written here; another version is refused with its number.
FORMAT = 3
KEPT = 2  #: newest checkpoints that stay
_LARGEST_MARKER = 1 << 16  # bytes
#: What comes of a marker that says something else.
_ODD = (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError)
_Arrays = dict[str, np.ndarray[Any, Any]]
_BLOCK = 1 << 22  # bytes of a log in memory while it is read back


def encode(state: State) -> bytes:
    """The state as one safetensors file; a leaf that is neither tensor, array nor JSON value is a `TypeError`."""
    arrays: _Arrays = {}
    return tensors.pack(arrays, tensors.TREE, _split(state, "state", arrays))


def check_finite(state: State) -> None:
    """Refuse a state in which training has diverged; a `NumericalError` names the tensor with NaN or infinity."""
    arrays: _Arrays = {}
    _split(state, "state", arrays)
    for path, values in arrays.items():
        bad = values.size - np.isfinite(values).sum() if values.dtype.kind == "f" else 0
        if bad:
            raise NumericalError(f"{path.removeprefix('state/')} is not finite in {bad:,} of {values.size:,} numbers")


def decode(data: bytes) -> State:
    """The state that `encode` was given, tensors on the CPU; a `CheckpointError` where the bytes are none."""
    try:
        arrays, tree = tensors.unpack(data, tensors.TREE)
        return _join(tree, arrays)  # type: ignore[no-any-return]
    except (ValueError, KeyError) as error:
        raise CheckpointError(f"not a saved state: {error}") from error


def read_networks(path: Path, what: str) -> State:
    """The state that a finished run left in a file; `what` that is to the reader, for messages.

    A `MissingResultError` says that there is none, or that it is damaged, and how to make it again.
    """
    try:
        return decode(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError) as error:
        raise MissingResultError(f"{path}, {what}, is missing: {again(path)}") from error
    except CheckpointError as error:
        raise MissingResultError(f"{path}, {what}, is damaged ({error}): {again(path)}") from error


def again(path: Path) -> str:
    """What to do where a file that a run left behind is of no use, in words."""
    run = path.parents[path.stem.isdecimal()]  # networks of a step have a folder of their own in the run's
    return f"bring it back, or remove {run} and run the experiment again with --retry-failed"


def _split(node: Any, path: str, arrays: _Arrays) -> Any:
    if isinstance(node, dict):
        return {str(key): _split(value, f"{path}/{key}", arrays) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_split(value, f"{path}/{i}", arrays) for i, value in enumerate(node)]
    if isinstance(node, torch.Tensor):
        arrays[path] = np.asarray(node.detach().cpu().numpy(), order="C")
        return {"$tensor": path}
    if isinstance(node, np.ndarray):
        arrays[path] = np.asarray(node, order="C")
        return {"$array": path}
    if isinstance(node, np.generic):
        return node.item()
    if node is None or isinstance(node, bool | int | float | str):
        return node
    raise TypeError(f"{path}: a state cannot hold a {type(node).__name__}")


def _join(node: Any, arrays: _Arrays) -> Any:
    if isinstance(node, list):
        return [_join(value, arrays) for value in node]
    if not isinstance(node, dict):
        return node
    if "$tensor" in node:
        return torch.from_numpy(arrays[node["$tensor"]].copy())
    if "$array" in node:
        return arrays[node["$array"]].copy()
    return {key: _join(value, arrays) for key, value in node.items()}


class AppendLog:
    """A file that only grows; a checkpoint needs no more of it than its length and checksum at the time."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.size = 0  #: bytes that count; what lies behind them was written by a process that died
        self.crc = 0  #: CRC-32 of those bytes

    def append(self, data: bytes) -> None:
        """Write `data` behind the bytes that count, durably."""
        with naming(self._path), self._path.open("r+b" if self._path.exists() else "w+b") as file:
            file.seek(self.size)
            file.truncate()
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        self.size += len(data)
        self.crc = zlib.crc32(data, self.crc)

    def restore(self, size: int, crc: int, record: int) -> Iterator[bytes]:
        """The first `size` bytes in blocks of whole records; later appends continue there.

        No block cuts a record of so many bytes. Whether they are intact is known only behind the last block: what was
        made of them must be thrown away if this raises `CheckpointError`: the file is missing, too short or damaged.
        """
        read = checksum = 0
        try:
            with open_regular(self._path) as file:
                while block := file.read(min(size - read, _BLOCK // record * record)):
                    read, checksum = read + len(block), zlib.crc32(block, checksum)
                    if len(block) % record:
                        break
                    yield block
        except (FileNotFoundError, UnfitFileError) as error:
            raise CheckpointError(f"{self._path}: {error.strerror}") from error
        if read != size or checksum != crc:
            raise CheckpointError(f"{self._path}: damaged (its first {size} bytes do not match their checksum)")
        self.size, self.crc = size, crc


class Checkpoints:
    """The checkpoints of one run, in one folder. The newest two are kept."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.skipped: list[str] = []  #: what `load` found damaged, newest first, for the log
        self.newest = 0  #: step of the newest checkpoint that `load` met, damaged or not

    def save(self, step: int, state: State) -> None:
        """Write the state of `step` and commit it; older ones than the newest two go.

        An `OSError` leaves the checkpoints before as they are.
        """
        data = encode(state)
        name = f"state-{step:012d}"
        write_atomically(self.folder / f"{name}.safetensors", data)
        marker = {"format": FORMAT, "step": step, "size": len(data), "crc32": zlib.crc32(data)}
        sealed = marker | {"checksum": _seal(marker)}
        write_atomically(self.folder / f"{name}.json", json.dumps(sealed).encode())
        for old in self._markers()[KEPT:]:
            old.unlink()
            old.with_suffix(".safetensors").unlink(missing_ok=True)
        sync_folder(self.folder)

    def load(self, restore: Callable[[State], None]) -> int | None:
        """Hand the newest intact state to `restore`, the next older one if that raises `CheckpointError`.

        Damaged checkpoints are set aside as `damaged-...`, so that they cannot stand before the good ones that follow.
        What processes that died in the middle of a checkpoint left behind is removed: nobody else may be writing here.

        Returns the step of that state; None when there is no usable checkpoint (see `skipped`). Nothing is set aside
        where one was written in another format (`ConfigError`) or cannot be read now (`OSError`).
        """
        self.skipped, markers = [], self._markers()
        for path in (*self.folder.glob(".*.tmp"), *self.folder.glob("state-*.safetensors")):
            if path.with_suffix(".json") not in markers:  # not written to its end, or its marker is set aside
                path.unlink(missing_ok=True)
        self.newest = int(markers[0].stem.removeprefix("state-")) if markers else 0
        for marker in markers:
            try:
                step, state = self._read(marker)
                restore(state)
                return step
            except CheckpointError as error:
                self.skipped.append(f"{marker.stem}: {error}")
                marker.replace(marker.with_name(f"damaged-{marker.name}"))
                sync_folder(self.folder)
        return None

    def _markers(self) -> list[Path]:
        return sorted(self.folder.glob("state-*.json"), reverse=True)

    def _read(self, marker: Path) -> tuple[int, State]:
        try:
            entries = json.loads(read_bounded(marker, _LARGEST_MARKER))
            seal = entries.pop("checksum", None)
            version, step, size, crc = (int(entries[key]) for key in ("format", "step", "size", "crc32"))
            if version != 1 and seal != _seal(entries):  # the first format had none
                raise CheckpointError("damaged (its marker does not match its checksum)")
            data = read_bounded(marker.with_suffix(".safetensors"), size)
        except (FileNotFoundError, UnfitFileError, *_ODD) as error:
            raise CheckpointError(f"unreadable ({error})") from error
        if version != FORMAT:
            raise ConfigError(
                f"{marker} was written in checkpoint format {version}, this version reads {FORMAT}: "
                "finish the run with the version that began it, or start it again with --force"
            )
        if len(data) != size or zlib.crc32(data) != crc:
            raise CheckpointError("damaged (does not match its checksum)")
        return step, decode(data)


def _seal(marker: dict[str, Any]) -> int:
    """Checksum over a marker's entries, whatever version wrote them."""
    return zlib.crc32(json.dumps(marker, sort_keys=True).encode())
