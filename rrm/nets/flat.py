"""Tensors of several shapes in one buffer: an optimiser's step or an average is then a single operation."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

#: Every tensor starts on a cache line, so that results do not depend on the sizes of its neighbours; in numbers.
ALIGN = 16


class Parameters:
    """Float32 parameters, zero at first, and room for their gradients."""

    def __init__(self, shapes: Sequence[tuple[int, ...]], device: torch.device | str = "cpu") -> None:
        starts = [0]
        for shape in shapes:
            starts.append(starts[-1] + -(-math.prod(shape) // ALIGN) * ALIGN)
        self.flat = torch.zeros(starts[-1], device=device)  #: all of them; the padding between them stays zero
        self.flat_grad = torch.zeros_like(self.flat)

        def windows(flat: Tensor) -> list[Tensor]:
            return [flat[at : at + math.prod(s)].view(s) for at, s in zip(starts, shapes, strict=False)]

        self.values, self.grads = windows(self.flat), windows(self.flat_grad)

    def leaves(self) -> list[Tensor]:
        """For autograd: they share memory with `values`, and what it adds to their gradients with `grads`."""
        leaves = [value.detach().requires_grad_() for value in self.values]
        for leaf, grad in zip(leaves, self.grads, strict=True):
            leaf.grad = grad
        return leaves
