"""The pictures of a run: one for each row of its experience, in the order in which they were seen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from rrm.checkpoint import AppendLog

if TYPE_CHECKING:
    from rrm.envs.tasks import FrameSpace
    from rrm.types import Pixels, State


class Frames:
    """Frames uint8 [height, width, channels], held in memory and appended to a log in a checkpoint's folder."""

    def __init__(self, space: FrameSpace) -> None:
        self.stack = space.stack
        self._shape = (space.height, space.width, space.channels)
        self._pixels = torch.empty(0, *self._shape, dtype=torch.uint8)
        self._count = 0
        self._log: AppendLog | None = None
        self._logged = 0  # frames that are in the log

    def __len__(self) -> int:
        return self._count

    def append(self, frame: Pixels) -> None:
        """The picture of the next row."""
        if self._count == len(self._pixels):
            more = torch.empty(max(256, self._count // 2), *self._shape, dtype=torch.uint8)
            self._pixels = torch.cat((self._pixels, more))
        self._pixels.numpy()[self._count] = frame
        self._count += 1

    def __getitem__(self, rows: Tensor) -> Tensor:
        """The pictures of rows [...], uint8 [..., height, width, channels]."""
        return self._pixels[rows]

    def save(self, folder: Path) -> State:
        """Append what is new to the log in `folder`; the state returned says how long it is now."""
        self._log = self._log or AppendLog(folder / "frames.bin")
        self._log.append(self._pixels[self._logged : self._count].numpy().tobytes())
        self._logged = self._count
        return {"size": self._log.size, "crc": self._log.crc}

    def load(self, folder: Path, state: State) -> None:
        """Continue from what `save` returned, on an empty store."""
        self._log = AppendLog(folder / "frames.bin")
        for block in self._log.restore(int(state["size"]), int(state["crc"]), int(np.prod(self._shape))):
            for frame in np.frombuffer(block, np.uint8).reshape(-1, *self._shape):
                self.append(frame)
        self._logged = self._count
