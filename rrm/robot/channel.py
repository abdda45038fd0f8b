"""Messages between two processes over a socket: a line of JSON, and after it the pictures that it names."""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from rrm.types import Pixels

Message = dict[str, Any]

_LONGEST = 1_000_000  # bytes of a line


class Channel:
    """One end. `OSError` or `EOFError` where the other is gone."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._reader = end.makefile("rb")

    def send(self, message: Message, pictures: Mapping[str, Pixels] | None = None) -> None:
        """A message whose values JSON knows; NaN is one of them."""
        blobs = {name: np.ascontiguousarray(picture) for name, picture in (pictures or {}).items()}
        header = json.dumps(message | {"pictures": {name: blob.shape for name, blob in blobs.items()}})
        self._end.sendall(b"".join((header.encode(), b"\n", *(blob.tobytes() for blob in blobs.values()))))

    def receive(self) -> tuple[Message, dict[str, Pixels]]:
        """The next message, and its pictures."""
        line = self._reader.readline(_LONGEST)
        if not line.endswith(b"\n"):
            raise EOFError("the other end is gone")
        message = json.loads(line)
        pictures = {}
        for name, shape in message.pop("pictures").items():
            data = self._reader.read(int(np.prod(shape)))
            if len(data) < np.prod(shape):
                raise EOFError("the other end is gone")
            pictures[name] = np.frombuffer(data, np.uint8).reshape(shape)
        return message, pictures

    def close(self) -> None:
        """The other end notices."""
        self._end.close()
        self._reader.close()
