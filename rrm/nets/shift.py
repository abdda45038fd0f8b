"""From stored frames to what convolutions read: stacks moved by whole pixels, with the channels of a pixel together."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from rrm.nets.compiled import move

Moves = npt.NDArray[np.int64]


def pictures(frames: Tensor, moves: Moves | None = None) -> Tensor:
    """Each stack as one picture, x - 128 as int8 [B, stack x channels, height, width], channels last in memory.

    Args:
        frames: uint8 [B, stack, channels, height, width].
        moves: how many pixels down and to the right of its own the one lies that a pixel takes its value from, [B, 2];
            beyond the edge that is the edge's, as if the picture went on.
    """
    count, planes, (height, width) = len(frames), frames.shape[1] * frames.shape[2], frames.shape[3:]
    if not frames[0].is_contiguous():
        frames = frames.contiguous()
    if moves is None:
        moves = np.zeros((count, 2), np.int64)
    moved = np.empty((count, planes, height, width), np.uint8)
    move(frames.data_ptr(), frames.stride(0), moves, moved.ctypes.data, planes, height, width)
    together = np.empty((count, height * width, planes), np.uint8)
    for target, source in zip(together, moved.reshape(count, planes, -1), strict=True):
        target[...] = cv2.transpose(source)
    return torch.from_numpy(together.view(np.int8)).view(count, height, width, planes).permute(0, 3, 1, 2)
