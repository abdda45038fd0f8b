"""From the host to a graphics card and back, without waiting for it."""

from __future__ import annotations

import torch
from torch import Tensor

from rrm.devices import CUDA
from rrm.types import Floats


def pinned(device: torch.device | str, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """Memory of the host, which a card reads and writes by itself where that is what `device` is."""
    return torch.zeros(*shape, dtype=dtype, pin_memory=torch.device(device).type == CUDA)


def brought(device: torch.device | str, place: Tensor) -> Floats:
    """A copy of what was written to `pinned` memory, once the device has done so: this waits."""
    if place.is_pinned():
        torch.cuda.current_stream(device).synchronize()
    return place.numpy().copy()


def to(device: torch.device | str, values: Tensor) -> Tensor:
    """The values on a device. What comes from the host is on its way: nobody waits."""
    if values.device.type != "cpu" or torch.device(device).type != CUDA:
        return values.to(device)
    return values.pin_memory().to(device, non_blocking=True)
