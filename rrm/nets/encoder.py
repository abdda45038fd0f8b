"""The convolutions of an agent that sees frames, from whole numbers to features, and back.

Everything between is computed for a few frames at a time, so that it stays in the caches; how many decides how sums
are rounded, and is fixed. Pictures lie with their channels together, and so do features. `plain` is the reference, in
plain differentiable code; the tests compare.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from rrm.nets.flat import Parameters
from rrm.nets.shift import pictures

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rrm.config import DrqConfig
    from rrm.envs.spaces import FrameSpace
    from rrm.precision import Precision

_SIDE = 3  #: of every kernel
_AT_ONCE = {torch.float32: 16, torch.bfloat16: 64}  #: pictures

#: A picture is read as x - 128, which bfloat16 holds exactly: x / 255 - 1/2 is that over 255, and so much more.
_SCALE, _MORE = 1 / 255, 128 / 255 - 0.5


class Encoder:
    """Convolutions of 3 x 3 without padding, each followed by a ReLU, of pictures scaled to [-1/2, 1/2].

    Args:
        config: its `channels` and `strides`.
        frames: a stack of so many such pictures is what is seen at once.
        generator: where the initial weights are drawn from, orthogonal with gain sqrt(2); None leaves them zero, for an
            encoder that is about to be loaded or copied into.
        precision: of the convolutions; sums of them are float32, and so are weights and gradients.
        device: where the parameters live; the generator must be of the same device.
    """

    def __init__(
        self,
        config: DrqConfig,
        frames: FrameSpace,
        generator: torch.Generator | None,
        precision: Precision = "float32",
        device: torch.device | str = "cpu",
    ) -> None:
        self._made = config, frames, precision, device
        self.dtype = getattr(torch, precision)
        self.strides = config.strides
        widths = [frames.stack * frames.channels, *[config.channels] * len(self.strides)]
        sides = [(frames.height, frames.width)]
        for stride in self.strides:
            height, width = ((side - _SIDE) // stride + 1 for side in sides[-1])
            sides.append((height, width))
        self.shapes = [(*side, width) for side, width in zip(sides[1:], widths[1:], strict=True)]  #: of what is left
        self.outputs = math.prod(self.shapes[-1])  #: features
        self._parameters = Parameters(
            [shape for i, o in pairwise(widths) for shape in ((o, _SIDE, _SIDE, i), (o,))], device
        )
        self.flat, self.flat_grad = self._parameters.flat, self._parameters.flat_grad
        if generator is not None:
            for weight in _planar(self._parameters.values)[::2]:
                drawn = torch.empty(weight.shape, device=device)
                weight.copy_(nn.init.orthogonal_(drawn, math.sqrt(2), generator=generator))

    def frozen(self) -> Encoder:
        """A copy that does not change any more."""
        config, frames, precision, device = self._made
        copy = Encoder(config, frames, None, precision, device)
        copy.flat.copy_(self.flat)
        return copy

    def parameters(self) -> list[Tensor]:
        """Leaves for autograd that share memory with `flat`: `[W0, b0, W1, b1, ...]`, W [out, 3, 3, in], b [out]."""
        return self._parameters.leaves

    @torch.no_grad()
    def encode(self, frames: Tensor) -> Tensor:
        """Features float32 [B, outputs] of uint8 [B, stack, channels, height, width], without gradient."""
        out = torch.empty(len(frames), self.outputs, device=self.flat.device)
        factors = self.factors()
        for rows in self.chunks(len(frames)):
            for h in self.layers(pictures(frames[rows]), factors):
                last = h
            out[rows] = _rows(last)
        return out

    def chunks(self, count: int) -> list[slice]:
        """Which of so many pictures are computed together."""
        step = _AT_ONCE[self.dtype] if self.flat.device.type == "cpu" else count
        return [slice(begin, min(begin + step, count)) for begin in range(0, count, step)]

    def factors(self) -> list[Tensor]:
        """`[W0, b0, ...]` as they are multiplied with: rounded, and the first take x - 128."""
        weight, bias, *rest = _planar(self._parameters.values)
        folded = [weight * _SCALE, bias + weight.sum((1, 2, 3)) * _MORE, *rest]
        return [factor.to(self.dtype) for factor in folded]

    def layers(self, x: Tensor, factors: Sequence[Tensor]) -> Iterator[Tensor]:
        """What each layer leaves of pictures int8 [b, channels, height, width]."""
        h = x.to(self.flat.device, self.dtype)
        for weight, bias, stride in zip(factors[::2], factors[1::2], self.strides, strict=True):
            h = nn.functional.conv2d(h, weight, bias, stride).relu_()
            yield h

    def plain(self, frames: Tensor, params: Sequence[Tensor] | None = None) -> Tensor:
        """The features of `frames`, differentiable in `params`, which stand in for the encoder's own."""
        params = self.parameters() if params is None else params
        h = frames.flatten(1, 2).to(params[0].dtype) / 255 - 0.5
        planar = _planar(params)
        for weight, bias, stride in zip(planar[::2], planar[1::2], self.strides, strict=True):
            h = torch.relu(nn.functional.conv2d(h, weight, bias, stride))
        return h.permute(0, 2, 3, 1).flatten(1)


def _planar(params: Sequence[Tensor]) -> list[Tensor]:
    """Weights with the axes of `conv2d`, [out, in, 3, 3], and biases."""
    return [param.permute(0, 3, 1, 2) if param.ndim == 4 else param for param in params]


def _rows(pictures: Tensor) -> Tensor:
    return pictures.permute(0, 2, 3, 1).flatten(1)
