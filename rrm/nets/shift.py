"""From stored frames to what convolutions read: stacks moved by whole pixels, with the channels of a pixel together."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor

from rrm.nets.compiled import move


def pictures(frames: Tensor, moves: Tensor | None = None) -> Tensor:
    """Each stack as one picture, x - 128 as int8 [B, stack x channels, height, width], channels last in memory.

    Args:
        frames: uint8 [B, stack, channels, height, width].
        moves: how many pixels down and to the right of its own the one lies that a pixel takes its value from, int64
            [B, 2]; beyond the edge that is the edge's, as if the picture went on.
    """
    count, planes, (height, width) = len(frames), frames.shape[1] * frames.shape[2], frames.shape[3:]
    if frames.device.type != "cpu":
        return _gathered(frames.flatten(1, 2), moves)
    if not frames[0].is_contiguous():
        frames = frames.contiguous()
    by = np.zeros((count, 2), np.int64) if moves is None else moves.numpy()
    moved = np.empty((count, planes, height, width), np.uint8)
    move(frames.data_ptr(), frames.stride(0), by, moved.ctypes.data, planes, height, width)
    together = np.empty((count, height * width, planes), np.uint8)
    for target, source in zip(together, moved.reshape(count, planes, -1), strict=True):
        target[...] = cv2.transpose(source)
    return torch.from_numpy(together.view(np.int8)).view(count, height, width, planes).permute(0, 3, 1, 2)


def _gathered(planes: Tensor, moves: Tensor | None) -> Tensor:
    """The same of planes [B, planes, height, width] on a card."""
    if moves is not None:
        rows, columns = (
            (torch.arange(side, device=planes.device) + moves[:, axis, None]).clamp_(0, side - 1)
            for axis, side in enumerate(planes.shape[2:])
        )
        one, every = (torch.arange(n, device=planes.device) for n in planes.shape[:2])
        planes = planes[one[:, None, None, None], every[:, None, None], rows[:, None, :, None], columns[:, None, None]]
    shifted = planes.permute(0, 2, 3, 1).contiguous() - 128  # wraps as it should: 0 is -128 in int8
    return shifted.view(torch.int8).permute(0, 3, 1, 2)
