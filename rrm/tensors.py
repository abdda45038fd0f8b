"""Tensors and what is to be said of them in one safetensors file, with a checksum over both.

What is said is a JSON object, the one entry of the header: safetensors writes several in any order, and what is equal
should be equal files. Files of earlier versions have no checksum.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

Arrays = Mapping[str, np.ndarray[Any, Any]]

TREE = "tree"  #: the entry of files that hold a state, see `rrm.checkpoint.encode`
_CHECKSUM = "$crc32"  #: key of the checksum in the object


def pack(arrays: Arrays, entry: str, content: Mapping[str, Any]) -> bytes:
    """The bytes of the file; `entry` is the name of the object `content` in its header."""
    sealed = {**content, _CHECKSUM: _checksum(arrays, content)}
    return safetensors.numpy.save(dict(arrays), {entry: json.dumps(sealed)})


def unpack(data: bytes, entry: str) -> tuple[dict[str, np.ndarray[Any, Any]], dict[str, Any]]:
    """The tensors and the object that `pack` was given; a `ValueError` where the bytes are no such file."""
    try:
        arrays = safetensors.numpy.load(data)
        header = int.from_bytes(data[:8], "little")
        content = json.loads(json.loads(data[8 : 8 + header])["__metadata__"][entry])
    except (safetensors.SafetensorError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(str(error)) from error
    if not isinstance(content, dict):
        raise ValueError(f"{entry} is no object")
    checksum = content.pop(_CHECKSUM, None)
    if checksum is not None and checksum != _checksum(arrays, content):
        raise ValueError("its content does not match its checksum")
    return arrays, content


def _checksum(arrays: Arrays, content: Mapping[str, Any]) -> int:
    """CRC-32 over the object, and over names, types, shapes and values of the tensors."""
    crc = zlib.crc32(json.dumps(content, sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        crc = zlib.crc32(f"{name} {array.dtype.str} {array.shape}".encode(), crc)
        crc = zlib.crc32(array.tobytes(), crc)
    return crc
